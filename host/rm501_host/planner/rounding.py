"""Circular blends between lines and arcs of one plane (thesis 4.3.3): line-line, line-arc, arc-arc.

A circle of radius rho that touches both neighbours has its centre where their offset curves cross: a line moves aside
by rho, a circle of radius R becomes R - rho where the blend lies inside it (concave) and R + rho where outside
(convex). rho is the largest that keeps the corner within the tolerance (distance from the corner to the centre, less
rho) and cuts at most half of either neighbour; all three grow with rho, so it is found by bisection. Between two
lines there is a formula: rho = d / tan(theta / 2), deviation d tan(theta / 4).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import acos, atan2, hypot, pi, sqrt, tan

import numpy as np

from .elements import Array, Element, Space, hermite

_FLAT = 1e-9
_BISECTIONS = 44


@dataclass(frozen=True, slots=True)
class _Flat:
    """A line or a circle in the plane, seen from the corner at the origin.

    `tx`, `ty`: direction of travel at the corner; `curvature`: signed, left turns positive; `length`.
    """

    tx: float
    ty: float
    curvature: float
    length: float


def round_lines(
    first: Element, second: Element, tolerance_mm: float, sharpest_rad: float
) -> tuple[float, Element] | None:
    """Distance that is cut off both lines and the arc between them; None for reversals and for no corner."""
    a = first.coefficients[1, :3]
    b = second.coefficients[1, :3]
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    sx, sy, sz = bx - ax, by - ay, bz - az
    half_sine = 0.5 * sqrt(sx * sx + sy * sy + sz * sz)
    px, py, pz = ax + bx, ay + by, az + bz
    half_cosine = 0.5 * sqrt(px * px + py * py + pz * pz)
    theta = 2.0 * atan2(half_sine, half_cosine)
    if theta > sharpest_rad or theta < 1e-9:
        return None
    reach = min(first.length, second.length) * 0.5
    cut = min(reach, tolerance_mm / tan(0.25 * theta))
    radius = cut / tan(0.5 * theta)
    corner = second.coefficients[0, :3]
    inward = np.array((sx, sy, sz)) * (0.5 / half_sine)
    centre = corner + inward * (radius / half_cosine)
    start = corner - cut * a
    return cut, _arc_between(first, second, cut, cut, centre, start - centre, radius * a, radius, theta)


def round_curves(
    first: Element, second: Element, tolerance_mm: float, sharpest_rad: float
) -> tuple[float, float, Element] | None:
    """Distances cut off the two neighbours and the arc between them; None where they share no plane."""
    corner, t1 = (row[:3] for row in first.at(first.length))
    t2 = second.at(0.0)[1][:3]
    theta = acos(max(-1.0, min(1.0, float(t1 @ t2))))
    if theta > sharpest_rad or theta < 1e-6:
        return None
    normal = np.cross(t1, t2)
    normal /= float(np.linalg.norm(normal))
    flat1, flat2 = _flat(first, t1, normal), _flat(second, t2, normal)
    if flat1 is None or flat2 is None:
        return None
    across = np.cross(normal, t1)
    one = replace(flat1, tx=1.0, ty=0.0)
    two = replace(flat2, tx=float(t2 @ t1), ty=float(t2 @ across))
    low, best, high = 0.0, None, _largest(one, two)
    for _ in range(_BISECTIONS):
        rho = 0.5 * (low + high)
        found = _touch(one, two, rho)
        if found is None or found[2] > 0.5 * one.length or found[3] > 0.5 * two.length or found[4] > tolerance_mm:
            high = rho
        else:
            low, best = rho, (rho, found)
    if best is None or best[0] < 1e-7:
        return None
    rho, (cx, cy, before, after, _) = best
    centre = corner + cx * t1 + cy * across
    start, start_slope = first.at(first.length - before)
    _, end_slope = second.at(after)
    turn = atan2(float(np.cross(start_slope[:3], end_slope[:3]) @ normal), float(start_slope[:3] @ end_slope[:3])) % (
        2.0 * pi
    )
    return (
        before,
        after,
        _arc_between(first, second, before, after, centre, start[:3] - centre, rho * start_slope[:3], rho, turn),
    )


def _arc_between(
    first: Element,
    second: Element,
    before: float,
    after: float,
    centre: Array,
    cosine: Array,
    sine: Array,
    radius: float,
    turn_rad: float,
) -> Element:
    length = radius * turn_rad
    start, start_slope = first.at(first.length - before)
    end, end_slope = second.at(after)
    if not (start_slope[3:].any() or end_slope[3:].any()):
        coefficients = np.zeros((4, 5))
        coefficients[0, 3:] = start[3:]
    else:
        coefficients = hermite(Space.TASK, start, start_slope, end, end_slope, length, first.source).coefficients.copy()
        coefficients[1:, :3] = 0.0
    coefficients[0, :3] = centre
    return Element(
        Space.TASK,
        length,
        coefficients,
        first.source,
        cosine=cosine,
        sine=sine,
        omega=turn_rad / length,
        feed_mm_s=min(first.feed_mm_s, second.feed_mm_s),
        rate=min(first.rate, second.rate),
        is_blend=True,
        branch=first.branch,
    )


def _flat(element: Element, tangent: Array, normal: Array) -> _Flat | None:
    """The element in the plane through the corner; None when it leaves the plane or is no line or circle."""
    if element.curve is not None or element.growth or element.coefficients[2:, :3].any():
        return None
    if element.omega == 0.0:
        return _Flat(0.0, 0.0, 0.0, element.length)
    if float(np.abs(element.coefficients[1, :3]).max()) > _FLAT:
        return None
    radius = float(np.linalg.norm(element.cosine))
    axis = np.cross(element.cosine, element.sine) / (radius * radius)
    along = float(axis @ normal)
    if abs(abs(along) - 1.0) > 1e-9:
        return None
    left = 1.0 if along * element.omega > 0.0 else -1.0
    return _Flat(0.0, 0.0, left / radius, element.length)


def _largest(one: _Flat, two: _Flat) -> float:
    radii = [1.0 / flat.curvature for flat in (one, two) if flat.curvature > 0.0]
    return min([*radii, 4.0 * (one.length + two.length)])


def _touch(one: _Flat, two: _Flat, rho: float) -> tuple[float, float, float, float, float] | None:
    """Centre x, y of the blend circle to the left of both, cuts before and after, deviation; None if there is none."""
    centres = _crossings(_offset(one, rho), _offset(two, rho))
    if not centres:
        return None
    cx, cy = min(centres, key=lambda point: hypot(*point))
    before = _run(one, cx, cy, -1.0)
    after = _run(two, cx, cy, 1.0)
    if before is None or after is None:
        return None
    return cx, cy, before, after, hypot(cx, cy) - rho


_Offset = tuple[bool, float, float, float, float]


def _offset(flat: _Flat, rho: float) -> _Offset:
    """The curve moved to its left by rho: (is circle, ...): point and direction, or centre and radius."""
    nx, ny = -flat.ty, flat.tx
    if flat.curvature == 0.0:
        return False, nx * rho, ny * rho, flat.tx, flat.ty
    signed = 1.0 / flat.curvature
    return True, nx * signed, ny * signed, abs(signed - rho), 0.0


def _crossings(a: _Offset, b: _Offset) -> list[tuple[float, float]]:
    if not a[0] and not b[0]:
        _, ax, ay, ux, uy = a
        _, bx, by, vx, vy = b
        det = ux * vy - uy * vx
        if abs(det) < 1e-12:
            return []
        k = ((bx - ax) * vy - (by - ay) * vx) / det
        return [(ax + k * ux, ay + k * uy)]
    if not a[0]:
        return _crossings(b, a)
    _, ax, ay, radius, _ = a
    if not b[0]:
        _, bx, by, vx, vy = b
        k = (ax - bx) * vx + (ay - by) * vy
        fx, fy = bx + k * vx, by + k * vy
        square = radius * radius - (fx - ax) ** 2 - (fy - ay) ** 2
        if square < 0.0:
            return []
        root = sqrt(square)
        return [(fx + root * vx, fy + root * vy), (fx - root * vx, fy - root * vy)]
    _, bx, by, other, _ = b
    dx, dy = bx - ax, by - ay
    gap = hypot(dx, dy)
    if gap < 1e-12:
        return []
    k = (radius * radius - other * other + gap * gap) / (2.0 * gap)
    square = radius * radius - k * k
    if square < 0.0:
        return []
    root = sqrt(square)
    fx, fy = ax + k * dx / gap, ay + k * dy / gap
    return [(fx - root * dy / gap, fy + root * dx / gap), (fx + root * dy / gap, fy - root * dx / gap)]


def _run(flat: _Flat, cx: float, cy: float, sign: float) -> float | None:
    """Length along the curve from the corner to where the blend circle about (cx, cy) touches it, along or against
    (sign) the direction of travel; None when it touches on the other side.
    """
    if flat.curvature == 0.0:
        run = sign * (cx * flat.tx + cy * flat.ty)
        return run if run >= 0.0 else None
    signed = 1.0 / flat.curvature
    ox, oy = -flat.ty * signed, flat.tx * signed
    # angle from the corner to the touching point, seen from the circle's centre; both lie on one ray or opposite
    ux, uy = cx - ox, cy - oy
    size = hypot(ux, uy)
    if size < 1e-12:
        return None
    px, py = ux / size, uy / size
    qx, qy = -ox / abs(signed), -oy / abs(signed)
    angle = atan2(qx * py - qy * px, qx * px + qy * py)
    run = sign * angle * signed
    return run if run >= 0.0 else None

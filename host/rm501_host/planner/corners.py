"""Corners: how one element goes over into the next: smoothly as it is, by a blend, or not without a stop.

A blend cuts off the ends of both neighbours, at most half of each, and joins them with equal slopes. Between lines
and arcs of one plane it is a circle (`rounding`), with pitch and roll as a cubic along it; everywhere else, and where
`parabolic` is asked for, it is the cubic through both ends with both slopes, which between two lines is a parabola:
in task space when both neighbours are, else in joint space. The tolerance P bounds the distance of the blend from
the corner and from the path, in mm at the tool centre point, also for blends in joint space.

Where a corner turns by more than `CHECKED_RAD`, the blend is used only if the fastest law through it is faster than
the one that stops: the limits are anisotropic (the waist has ten times the acceleration of the others), so a blend
is not always faster. Both are timed on one rough grid first, which settles what differs clearly, on a finer one only
where that leaves doubt; many corners at a time, for a numpy call costs as much for one as for many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import acos, inf, pi, sqrt, tan

import numpy as np

from rm501_host.kinematics import Arm
from rm501_host.moves import PathMode, Source

from .elements import Array, Element, ElementTable, Space, hermite
from .errors import PlanError
from .geometry import path_points
from .grid import COARSE, ROUGH, GridBuilder
from .limits import Limits
from .quintic import QuinticCurve
from .rounding import round_curves, round_lines
from .timelaw import fastest_speeds, law_durations, stopping_lines

TANGENT = 1e-7
"""Relative difference of tangents that counts as none: at 30 deg/s, 3e-6 deg/s of jump."""
SHARPEST_RAD = pi - 0.02
"""Turns sharper than this are reversals: the arm stops there."""
CHECKED_RAD = 0.35
"""Turns sharper than this are blended only where it is faster; below, it always was (random corners, 20 deg)."""
CLEARLY_FASTER = 0.95
CLEARLY_SLOWER = 1.15
"""Ratios of the times on the rough grid, passing over stopping, from which on the finer ones need not be asked: the
rough law is legal, so passing never takes longer than it says, and up to 12 % shorter."""
_SHORTEST_MM = 1e-6
_PROBES = 17
_SHARES = np.linspace(0.0, 1.0, 33)
_QUINTIC_END = _SHARES**3 * (10.0 - 15.0 * _SHARES + 6.0 * _SHARES**2)
_QUINTIC_SLOPE = _SHARES**3 * (-4.0 + 7.0 * _SHARES - 3.0 * _SHARES**2)


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """What replaces a corner: `before` and `after` are cut off the two neighbours, `elements` go between. `spare_mm`:
    how much is left of the tolerance; `is_doubtful`: whether it is only used if that is faster than to stop.
    """

    before: float
    after: float
    elements: tuple[Element, ...]
    spare_mm: float = 0.0
    is_doubtful: bool = False


_LEAST_SHARE = 0.2
"""Jerk-limited blends take half of both neighbours unless one is shorter than this share of the other."""

SMOOTH = Corner(0.0, 0.0, ())


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A corner in doubt: from `first`, whose first `used` is taken already, into `second`, by `corner`."""

    first: Element
    used: float
    second: Element
    corner: Corner


class CornerMaker:
    """Decides what happens between two elements."""

    def __init__(self, arm: Arm, limits: Limits, *, parabolic: bool = False, jerk_limited: bool = False) -> None:
        self._arm = arm
        self._parabolic = parabolic or jerk_limited
        self._jerk_limited = jerk_limited
        self._judge = GridBuilder(arm, limits, fineness=COARSE)
        self._glance = GridBuilder(arm, limits, fineness=ROUGH)

    def between(
        self, first: Element, used: float, second: Element, mode: PathMode, tolerance_mm: float
    ) -> Corner | None:
        """The way from `first` (whose first `used` is taken already) into `second`; None: stop there."""
        corner = self.candidate(first, second, mode, tolerance_mm)
        if corner is not None and corner.is_doubtful:
            (is_faster,) = self.are_faster([Passage(first, used, second, corner)])
            return corner if is_faster else None
        return corner

    def candidate(self, first: Element, second: Element, mode: PathMode, tolerance_mm: float) -> Corner | None:
        """As `between`, but for the question whether a corner in doubt is faster than to stop."""
        if mode is PathMode.EXACT_STOP:
            return None
        if first.is_straight and second.is_straight:
            end_slope, start_slope = first.coefficients[1], second.coefficients[1]
        else:
            _, end_slope = first.at(first.length)
            _, start_slope = second.at(0.0)
        same = first.space is second.space and first.branch is second.branch
        if same:
            scale = max(float(np.abs(end_slope).max()), float(np.abs(start_slope).max()))
            if float(np.abs(end_slope - start_slope).max()) <= TANGENT * scale and (
                not self._jerk_limited or _bends_alike(first, second)
            ):
                return SMOOTH
        if mode is not PathMode.BLEND or tolerance_mm <= 0.0:
            return None
        if self._jerk_limited and not (first.is_straight and second.is_straight):
            return None
        corner = None
        moving = same and first.space is Space.TASK and _is_travel(end_slope) and _is_travel(start_slope)
        theta = pi
        if moving:
            theta = _angle(end_slope[:3], start_slope[:3])
            if theta > SHARPEST_RAD:
                return None
            corner = self._rounded(first, second, tolerance_mm)
        if corner is None and same and _angle(end_slope, start_slope) > SHARPEST_RAD:
            return None
        if corner is None:
            corner = self._cubic(first, second, tolerance_mm, theta)
        if corner is None:
            return None
        return replace(corner, is_doubtful=True) if theta > CHECKED_RAD else corner

    def _rounded(self, first: Element, second: Element, tolerance_mm: float) -> Corner | None:
        if self._parabolic:
            return None
        if first.is_straight and second.is_straight:
            found = round_lines(first, second, tolerance_mm, SHARPEST_RAD)
            return None if found is None else Corner(found[0], found[0], (found[1],))
        curved = round_curves(first, second, tolerance_mm, SHARPEST_RAD)
        return None if curved is None else Corner(curved[0], curved[1], (curved[2],))

    def _cubic(self, first: Element, second: Element, tolerance_mm: float, theta: float) -> Corner | None:
        """The cubic between equal cuts, made smaller until it keeps the tolerance. Where the jerk is limited and the
        turn by `theta` slight, half of both neighbours is taken, so that blends touch (`bends`).
        """
        before = after = 0.5 * min(first.length, second.length)
        if (
            self._jerk_limited
            and theta <= CHECKED_RAD
            and before > 0.5 * _LEAST_SHARE * max(first.length, second.length)
        ):
            before, after = 0.5 * first.length, 0.5 * second.length
        for _ in range(24):
            if min(before, after) < _SHORTEST_MM:
                return None
            share = 0.5
            try:
                blend, deviation_mm = self._cubic_at(first, second, before, after)
            except PlanError:
                pass
            else:
                if deviation_mm <= tolerance_mm:
                    return Corner(before, after, (blend,), tolerance_mm - deviation_mm)
                share = min(0.9, max(0.2, 0.98 * tolerance_mm / deviation_mm))
            before, after = before * share, after * share
        return None

    def _cubic_at(self, first: Element, second: Element, before: float, after: float) -> tuple[Element, float]:
        task = first.space is Space.TASK and second.space is Space.TASK and first.branch is second.branch
        space = Space.TASK if task else Space.JOINT
        start, start_slope = self._ends(first, first.length - before, task)
        end, end_slope = self._ends(second, after, task)
        length = before + after
        if self._jerk_limited and task:
            length *= _arc_share(start_slope, end_slope)
        blend = replace(
            self._joining(space, start, start_slope, end, end_slope, length, first.source),
            feed_mm_s=min(first.feed_mm_s, second.feed_mm_s),
            rate=min(first.rate, second.rate),
            is_blend=True,
            branch=first.branch,
        )
        if self._jerk_limited and task and first.is_straight and second.is_straight:
            return blend, _deviation_mm(start_slope, end_slope, before, after, length)
        shares = np.linspace(0.0, 1.0, _PROBES)
        along = self._places(blend, blend.length * shares)
        head = self._places(first, first.length - before * (1.0 - shares))
        path = np.concatenate((head, self._places(second, after * shares)))
        deviation = float(_distances(along, path).max())
        corner = float(_distances(head[-1:], along).max())
        return blend, max(deviation, corner) * 1.001

    def _joining(
        self,
        space: Space,
        start: Array,
        start_slope: Array,
        end: Array,
        end_slope: Array,
        length: float,
        source: Source,
    ) -> Element:
        if not self._jerk_limited:
            return hermite(space, start, start_slope, end, end_slope, length, source)
        curve = QuinticCurve.through(start, start_slope, end, end_slope, length)
        return Element(space, length, np.zeros((4, 5)), source, curve=curve)

    def _ends(self, element: Element, s: float, task: bool) -> tuple[Array, Array]:
        if task or element.space is Space.JOINT:
            return element.at(s)
        points = path_points(self._arm, ElementTable([element]), np.zeros(1, dtype=np.intp), np.array([s]))
        return points.q_deg[0], points.q1[0]

    def _places(self, element: Element, s: Array) -> Array:
        values, _, _ = element.evaluate(s)
        if element.space is Space.TASK:
            return values[:, :3]
        return self._arm.fk_batch(values)[0]

    def are_faster(self, passages: Sequence[Passage]) -> list[bool]:
        """Whether passing each corner beats stopping in it, from rest to rest over both neighbours."""
        ratios = _ratios(self._glance, passages)
        doubtful = [i for i, ratio in enumerate(ratios) if CLEARLY_FASTER <= ratio <= CLEARLY_SLOWER]
        for i, ratio in zip(doubtful, _ratios(self._judge, [passages[i] for i in doubtful]), strict=True):
            ratios[i] = ratio
        return [ratio < 1.0 for ratio in ratios]


def _arc_share(start_slope: Array, end_slope: Array) -> float:
    """How much shorter than both cuts an arc is that turns slightly from one direction (5,) into the other (5,)."""
    if not (_is_travel(start_slope) and _is_travel(end_slope)):
        return 1.0
    half = 0.5 * _angle(start_slope[:3], end_slope[:3])
    return half / tan(half) if 0.0 < half < 0.5 * CHECKED_RAD else 1.0


def _deviation_mm(start_slope: Array, end_slope: Array, before: float, after: float, length: float) -> float:
    """How far a quintic of `length` between two lines is from them at most, their corner included.

    Compared at equal shares of the way it stands off by a multiple of the slopes' difference; nearest points are
    nearer.
    """
    turn = end_slope[:3] - start_slope[:3]
    whole = before + after
    off = after * _QUINTIC_END + length * _QUINTIC_SLOPE - np.maximum(whole * _SHARES - before, 0.0)
    # the start's slope over a length that is not the whole way
    lag = (whole - length) * np.abs(_QUINTIC_END - _SHARES).max()
    return 1.001 * (float(np.abs(off).max()) * sqrt(float(turn @ turn)) + float(lag))


def _ratios(builder: GridBuilder, passages: Sequence[Passage]) -> list[float]:
    """Time of passing over that of stopping, all on one grid; infinite where the arm cannot follow."""
    if not passages:
        return []
    elements: list[Element] = []
    firsts: list[int] = []
    of_passage: list[int] = []
    for number, passage in enumerate(passages):
        for way in _ways(passage):
            firsts.append(len(elements))
            elements += way
        of_passage += [number] * (len(elements) - len(of_passage))
    try:
        grid = builder.build(ElementTable(elements), np.array(of_passage, dtype=np.intp))
    except PlanError:
        if len(passages) == 1:
            return [inf]
        return [ratio for passage in passages for ratio in _ratios(builder, [passage])]
    begins = np.searchsorted(grid.element, firsts)
    times = np.add.reduceat(
        law_durations(grid.lines.length, fastest_speeds(stopping_lines(grid.lines, begins))), begins
    )
    passing, head, tail = times.reshape(-1, 3).T
    ratios: list[float] = (passing / (head + tail)).tolist()
    return ratios


def _ways(passage: Passage) -> tuple[list[Element], list[Element], list[Element]]:
    """What is passed by way of the corner; up to the corner; from it on."""
    first, used, second, corner = passage.first, passage.used, passage.second, passage.corner
    last = first.length - corner.before
    blended = [first.trimmed(used, last)] if last - used > 1e-9 else []
    blended += [*corner.elements, second.trimmed(corner.after, second.length)]
    return blended, [first.trimmed(used, first.length)], [second]


def _bends_alike(first: Element, second: Element) -> bool:
    """Whether the second derivatives agree too, so that no joint's acceleration jumps there."""
    last = first.evaluate(np.array([first.length]))[2][0]
    start = second.evaluate(np.zeros(1))[2][0]
    return bool(np.abs(last - start).max() <= 1e-7 * (1.0 + np.abs(last).max()))


def _is_travel(slope: Array) -> bool:
    """Whether s is the tool's way there, not an angle."""
    return abs(float(slope[:3] @ slope[:3]) - 1.0) < 1e-6


def _angle(a: Array, b: Array) -> float:
    """Between two directions, rad; a curve that begins or ends without one (a cusp) counts as a reversal."""
    size = float(np.linalg.norm(a)) * float(np.linalg.norm(b))
    return pi if size == 0.0 else acos(max(-1.0, min(1.0, float(a @ b) / size)))


def _distances(points: Array, path: Array) -> Array:
    """Distance of each point (n, 3) from the polyline (m, 3), (n,)."""
    starts, steps = path[:-1], np.diff(path, axis=0)
    squares = np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-300)
    offsets = points[:, None, :] - starts[None]
    shares = np.clip(np.einsum("nmi,mi->nm", offsets, steps) / squares, 0.0, 1.0)
    gaps = offsets - shares[:, :, None] * steps[None]
    nearest: Array = np.sqrt(np.einsum("nmi,nmi->nm", gaps, gaps).min(axis=1))
    return nearest

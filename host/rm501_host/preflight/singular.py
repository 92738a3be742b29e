"""Paths through a singularity, found between the checked points: there the joints would have to jump.

What the joints allow along a path, 1 / max |q'_i| / v_i, falls to nothing over the waist axis and at full stretch.
Points 1 mm apart straddle such places, so minima between neighbours are looked for by golden sections: of that speed
where it is low, and of the distance from the waist axis where the next point could be beyond it (an arc may pass the
axis tangentially and be slow over a few micrometres only). A path that could only be crept along there is refused, as
the planner refuses it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm
from rm501_host.planner.elements import ElementTable, Indices
from rm501_host.planner.geometry import joints_at
from rm501_host.planner.grid import CREEP_MM_S
from rm501_host.planner.jointspace import joint_derivatives
from rm501_host.planner.limits import Limits

Array = NDArray[np.float64]

SUSPECT_S_PER_MM = 0.1
"""Half a millimetre beside the waist axis the waist's 30 deg/s are 0.26 mm/s; slower than 10 mm/s is looked at."""
_SECTIONS = 64
"""2 mm times 0.618^64 is 8e-14 mm."""
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)


def slowness(limits: Limits, q1: Array) -> Array:
    """What each mm (deg) takes at least (n,), in s, where the joints turn by `q1` (n, 5) deg along it; inf for nan."""
    taken = (np.abs(q1 @ limits.rows.T) / limits.velocity).max(axis=1)
    return np.where(np.isnan(taken), np.inf, taken)


def singular_places(
    arm: Arm, limits: Limits, table: ElementTable, index: Indices, s: Array, values: Array, q1: Array
) -> list[int]:
    """Points (n,) beside which their element runs through a singularity, one an element.

    `index`, `s`, `values`, `q1`: points along the elements in order, what the elements are there (n, 5), and the joint
    derivatives (n, 5).
    """
    with np.errstate(all="ignore"):
        taken = slowness(limits, q1)
        taken[table.is_joint[index]] = 0.0
        radius = np.where(table.is_joint[index], np.inf, _radius(arm, values))

        def slow(element: Indices, place: Array) -> Array:
            return _slowness_at(arm, limits, table, element, place)

        def near(element: Indices, place: Array) -> Array:
            return -_radius(arm, table.evaluate(element, place)[0])

        before, after = _neighbours(index)
        spacing = np.maximum(s[after] - s, s - s[before])
        found: list[int] = []
        for suspect, value, function in ((taken > SUSPECT_S_PER_MM, taken, slow), (radius < spacing, -radius, near)):
            at = np.flatnonzero(suspect & (value >= value[before]) & (value >= value[after]))
            if len(at):
                place = _peak(function, index[at], s[before[at]], s[after[at]])
                worst = np.maximum(slow(index[at], place), taken[at])
                found += at[worst * CREEP_MM_S > 1.0].tolist()
    places = np.array(sorted(found), dtype=np.intp)
    _, firsts = np.unique(index[places], return_index=True)
    result: list[int] = places[firsts].tolist()
    return result


def _neighbours(index: Indices) -> tuple[Indices, Indices]:
    """The points (n,) before and after each on the same element; itself at its ends."""
    own = np.arange(len(index))
    before, after = np.maximum(own - 1, 0), np.minimum(own + 1, len(own) - 1)
    return np.where(index[before] == index, before, own), np.where(index[after] == index, after, own)


def _peak(function: Callable[[Indices, Array], Array], element: Indices, low: Array, high: Array) -> Array:
    """Where a function of (element, s) is largest within [low, high], (n,) each."""
    a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    f_a, f_b = function(element, a), function(element, b)
    for _ in range(_SECTIONS):
        left = f_a > f_b
        high, low = np.where(left, b, high), np.where(left, low, a)
        next_a, next_b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        f = function(element, np.where(left, next_a, next_b))
        a, b = np.where(left, next_a, b), np.where(left, a, next_b)
        f_a, f_b = np.where(left, f, f_b), np.where(left, f_a, f)
    return np.where(f_a > f_b, a, b)


def _slowness_at(arm: Arm, limits: Limits, table: ElementTable, element: Indices, s: Array) -> Array:
    values, y1, y2 = table.evaluate(element, s)
    q_deg, _ = joints_at(arm, table, element, values)
    q1, _ = joint_derivatives(arm, q_deg, y1, y2, values[:, :3])
    return slowness(limits, q1)


def _radius(arm: Arm, values: Array) -> Array:
    """|r| (n,) in mm: how far in front of or behind the waist axis the tool is, its sideways offset left out."""
    tx, ty, _ = arm.geometry.tcp_mm
    roll = np.radians(values[:, 4])
    sideways = np.sin(roll) * tx + np.cos(roll) * ty
    squares = values[:, 0] ** 2 + values[:, 1] ** 2 - sideways**2
    result: Array = np.sqrt(np.maximum(squares, 0.0))
    return result

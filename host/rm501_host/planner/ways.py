"""How far along its path a law is: the one coordinate that stays when the same path is timed anew.

The way of a law is what has been gone of its elements' own parameters (mm, deg where only joints or angles move), from
0 at its start. Two laws over the same elements agree on it whatever their speeds are.
"""

from __future__ import annotations

import numpy as np

from .elements import Array, Element, ElementTable
from .jerk import JerkLaw
from .law import PathLaw, passed
from .pieces import Law

Along = PathLaw | JerkLaw
"""Laws that follow a path of elements."""
_SECTIONS = 256
_ROUNDS = 7
"""256 sections, seven times: 56 bits, in seven calls."""


def along(law: Law | None) -> Along | None:
    """The law as one that follows a path; None for those that do not (a wait, a trajectory timed from outside)."""
    return law if isinstance(law, PathLaw | JerkLaw) else None


def way_at(law: Along, time_s: float) -> float:
    """The way at a time of the law."""
    return float(_ways_at(law, np.array([time_s]))[0])


def _ways_at(law: Along, time_s: Array) -> Array:
    index, s = law.places(np.concatenate((np.zeros(1), time_s)))
    ends = _ends(law.table)
    ways: Array = ends[index[1:]] + s[1:] - ends[index[0]] - s[0]
    return ways


def length_of(law: Along) -> float:
    """The way at the end."""
    return way_at(law, law.duration_s)


def time_at(law: Along, way: float) -> float:
    """The time in s at which a law has come so far."""
    if isinstance(law, JerkLaw):
        low, high = 0.0, law.duration_s
        for _ in range(_ROUNDS):
            times = np.linspace(low, high, _SECTIONS + 1)
            k = int(np.clip(np.count_nonzero(_ways_at(law, times) < way), 1, _SECTIONS))
            low, high = float(times[k - 1]), float(times[k])
        return 0.5 * (low + high)
    begins = grid_ways(law)
    k = int(np.clip(np.searchsorted(begins, way, side="right") - 1, 0, len(law.element) - 1))
    length = float(begins[k + 1] - begins[k])
    ds = float(np.clip(way - begins[k], 0.0, length))
    v0, v1 = float(law.speed[k]), float(law.speed[k + 1])
    # v^2 is linear in s, and the mean speed up to there is half the sum of the speeds at both ends
    v = float(np.sqrt(max(0.0, v0 * v0 + (v1 * v1 - v0 * v0) * ds / length)))
    return float(law.time_s[k]) + (2.0 * ds / (v0 + v) if ds > 0.0 else 0.0)


def elements_between(law: Along, first: float, last: float) -> list[Element]:
    """The elements, trimmed, that the law passes from way `first` to way `last`."""
    ends = _ends(law.table)
    index, s = law.places(np.array([0.0]))
    places = np.array([first, last]) + float(ends[index[0]] + s[0])
    numbers = np.clip(np.searchsorted(ends, places, side="right") - 1, 0, len(law.table) - 1)
    return passed(law.table, numbers, np.clip(places - ends[numbers], 0.0, law.table.length[numbers]))


def grid_ways(law: PathLaw) -> Array:
    """The way at each grid point (n + 1,)."""
    return np.concatenate((np.zeros(1), np.cumsum(law.stop - law.start)))


def sliced(law: PathLaw, first: float, last: float) -> PathLaw:
    """The part of a law from way `first` to way `last`: the same places at the same times, counted from its start."""
    begins = grid_ways(law)
    count = len(law.element)
    low = int(np.clip(np.searchsorted(begins, first, side="right") - 1, 0, count - 1))
    high = int(np.clip(np.searchsorted(begins, last, side="left") - 1, low, count - 1))
    ends = np.interp([first, last], begins, law.speed**2)
    squared = np.concatenate((ends[:1], law.speed[low + 1 : high + 1] ** 2, ends[1:]))
    start, stop = law.start[low : high + 1].copy(), law.stop[low : high + 1].copy()
    start[0] += max(0.0, first - float(begins[low]))
    stop[-1] -= max(0.0, float(begins[high + 1]) - last)
    return PathLaw.from_speeds(law.arm, law.table, law.element[low : high + 1], start, stop, squared)


def _ends(table: ElementTable) -> Array:
    return np.concatenate((np.zeros(1), np.cumsum(table.length)))

"""An averaged law that is being played, from the place where another one shall take over.

An average at a time is made of the base law up to that time, so to leave it there is to leave its base law there, with
what has been passed of that in the last window as the past of what follows (`jerk_window`). The base law is ahead of
its average: ways are counted from where the base law is when the other one shall take over, times from that moment.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from .elements import Array, Element, Indices
from .jerk import JerkLaw
from .law import PathLaw
from .pieces import Piece
from .ways import grid_ways, sliced, way_at

_KEPT_S = 0.02
"""Base law before the window that is kept: limits are probed a little before where a law begins."""
_LEAST_WAY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Passed:
    """A part of a base law as rows: `elements`, which of them and from where to where each interval goes (n,), squared
    speeds (n + 1,). Elements end where they are left, so that ways can be counted in them.
    """

    elements: tuple[Element, ...]
    element: Indices
    start: Array
    stop: Array
    squared: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Played:
    """A part of the average, from lead time `begin_s` on; its part of the base law, whose way begins at `way`."""

    law: JerkLaw
    scale: float
    begin_s: float
    base: PathLaw
    way: float


class SmoothLead:
    """The averaged law that is followed until another one can take over."""

    def __init__(self, played: Iterable[tuple[Piece, float]], time_s: float) -> None:
        """`played`: pieces and the scales of their feeds, from the one under way on; `time_s`: in the first of them."""
        self._played: Iterator[tuple[Piece, float]] = iter(played)
        self._parts: list[_Played] = []
        self._is_complete = False
        self._followed_s = 0.0
        self._times = self._known_ways = np.zeros(0)
        piece, scale = next(self._played)
        law = piece.law
        assert isinstance(law, JerkLaw)
        self._is_complete = piece.ends_at_rest
        self.window_s = law.window_s * law.stretch
        now_s = law.lead_s + time_s / law.stretch
        base = _stretched(law, max(0.0, now_s - law.window_s - _KEPT_S))
        here = way_at(law.base, now_s) - way_at(law.base, max(0.0, now_s - law.window_s - _KEPT_S))
        self._parts.append(_Played(law, scale, -time_s, base, -here))
        self.ahead = way_at(law.base, min(now_s, law.base.duration_s)) - _base_way(law, time_s)
        """How far the base law is ahead of the average at the beginning."""
        self._index()

    def squared(self, ways: Array) -> Array:
        """Squared speeds (n,) of the base law at ways (n,), as far as it goes."""
        while not self._is_complete and self._ways[-1] < ways[-1]:
            self._extend()
        return np.interp(ways, self._ways, self._squared)

    def times_s(self, ways: Array) -> Array:
        """When the base law passes ways (n,), to the precision of a grid interval."""
        return np.interp(ways, self._ways, self._times)

    def _extend(self) -> None:
        item = next(self._played, None)
        if item is None or not isinstance(item[0].law, JerkLaw):
            self._is_complete = True
            return
        piece, law = item[0], item[0].law
        self._is_complete = piece.ends_at_rest
        before = self._parts[-1]
        begin_s = before.begin_s + before.law.duration_s
        self._parts.append(_Played(law, item[1], begin_s, _stretched(law, law.lead_s), float(self._ways[-1])))
        self._index()

    def _index(self) -> None:
        ways, squared = [], []
        for part in self._parts:
            ways.append(part.way + grid_ways(part.base))
            squared.append(part.base.speed**2)
        self._ways, self._squared = np.concatenate(ways), np.concatenate(squared)
        speeds = np.sqrt(self._squared)
        steps = np.diff(self._ways)
        spans = np.where(steps > 0.0, 2.0 * steps / np.maximum(speeds[:-1] + speeds[1:], 1e-300), 0.0)
        times = np.concatenate((np.zeros(1), np.cumsum(spans)))
        if not len(self._times):
            self._times = times
            self._times = times - self._time_at(0.0)
        else:
            # parts are only added behind and dropped in front
            self._times = float(np.interp(self._ways[0], self._known_ways, self._times)) + times
        self._known_ways = self._ways

    def past(self, way: float) -> Passed:
        """The base law from before the window that ends where it passes `way`, up to there."""
        first = float(np.interp(self._time_at(way) - self.window_s - _KEPT_S, self._times, self._ways))
        elements: list[Element] = []
        rows: list[tuple[Indices, Array, Array, Array]] = []
        for part in self._parts:
            length = float(grid_ways(part.base)[-1])
            low, high = max(0.0, first - part.way), min(length, way - part.way)
            if high - low < _LEAST_WAY:
                continue
            law = sliced(part.base, low, high)
            whole = law.stop - law.start > _LEAST_WAY
            k = np.flatnonzero(whole)
            squared = law.speed**2
            used = int(law.element[k[0]]), int(law.element[k[-1]]) + 1
            mine = law.table.elements[used[0] : used[1]]
            shared = bool(elements) and elements[-1] is mine[0]
            if elements and not shared:
                elements[-1] = elements[-1].trimmed(0.0, float(rows[-1][2][-1]))
            offset = len(elements) - shared - used[0]
            elements.extend(mine[shared:])
            rows.append((law.element[k] + offset, law.start[k], law.stop[k], squared[np.append(k, k[-1] + 1)]))
        elements[-1] = elements[-1].trimmed(0.0, float(rows[-1][2][-1]))
        return Passed(
            tuple(elements),
            np.concatenate([row[0] for row in rows]),
            np.concatenate([row[1] for row in rows]),
            np.concatenate([row[2] for row in rows]),
            np.concatenate([row[3][:-1] for row in rows[:-1]] + [rows[-1][3]]),
        )

    def _time_at(self, way: float) -> float:
        """When the base law passes a way, exactly."""
        k = int(np.clip(np.searchsorted(self._ways, way, side="right") - 1, 0, len(self._ways) - 2))
        x0, x = float(self._squared[k]), float(np.interp(way, self._ways, self._squared))
        return float(self._times[k]) + 2.0 * (way - float(self._ways[k])) / max(sqrt(x0) + sqrt(x), 1e-300)

    def until(self, way: float) -> list[tuple[JerkLaw, float]]:
        """What of the average is played before the base law passes `way`, and has not been taken yet: laws and the
        scales of their feeds; inf: all of it, to its rest.
        """
        end_s = np.inf
        if np.isfinite(way):
            end_s = self._time_at(way)
        else:
            while not self._is_complete:
                self._extend()
        taken = []
        for part in self._parts:
            low = max(0.0, self._followed_s - part.begin_s)
            high = min(part.law.duration_s, end_s - part.begin_s)
            if high - low > 1e-9:
                law = part.law
                taken.append((replace(law, lead_s=law.lead_s + low / law.stretch, length_s=high - low), part.scale))
        self._followed_s = max(self._followed_s, end_s)
        needed_s = self._followed_s - self.window_s - 2.0 * _KEPT_S
        kept = [part for part in self._parts if part.begin_s + part.law.duration_s > needed_s]
        if kept and len(kept) < len(self._parts):
            self._parts = kept
            self._index()
        return taken


def _base_way(law: JerkLaw, time_s: float) -> float:
    """The way of the average at a time, counted along its base law from that one's start."""
    index, s = law.places(np.array([time_s]))
    k = int(np.searchsorted(law.base.element, int(index[0]), side="left"))
    return float(law.way[k]) + float(s[0]) - float(law.base.start[k])


def _stretched(law: JerkLaw, first_s: float) -> PathLaw:
    """The base law as it is played, from a time of its own to its end or to where the average's part ends."""
    base = law.base
    last_s = base.duration_s
    if law.length_s is not None:
        last_s = min(last_s, law.lead_s + law.length_s / law.stretch)
    part = sliced(base, way_at(base, first_s), way_at(base, last_s))
    return PathLaw.from_speeds(
        part.arm, part.table, part.element, part.start, part.stop, part.speed**2 / law.stretch**2
    )

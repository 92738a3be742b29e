"""What is checked at once: elements and runs of moves in the order of the program, and points along them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from rm501_host.moves import Source
from rm501_host.planner.elements import Element, ElementTable, Indices
from rm501_host.planner.splines import SplineCurve

from .runs import Geometry, MoveRun, rows_of
from .turning import Turning

Array = NDArray[np.float64]

SPACING_MM = 1.0
"""Between checked points (deg in joint space); between them joints are followed by their derivatives."""
MOST_POINTS = 2000
POINTS_AT_ONCE = 4096
"""What stays in the processor's cache: with four times as many, long moves take two and a half times as long."""


class Batch:
    """Collects elements and runs of moves, each with the joints at its start, its goal, and its number."""

    def __init__(self) -> None:
        self._elements: list[tuple[int, Element]] = []
        self._runs: list[tuple[int, MoveRun]] = []
        self._sources: list[Source] = []
        self._numbers: list[int] = []
        self._starts: list[Array] = []
        self._goals: list[Array] = []

    def __len__(self) -> int:
        return len(self._sources)

    @property
    def splines(self) -> int:
        """How many splines are in it."""
        return sum(len(run.splines) for _, run in self._runs)

    def add(self, element: Element, start_deg: Array, goal: Array, number: int) -> None:
        """An element from joints `start_deg` (5,) to task values `goal` (5,); `number`: which move it is."""
        self._elements.append((len(self), element))
        self._sources.append(element.source)
        self._numbers.append(number)
        self._starts.append(start_deg[None])
        self._goals.append(goal[None])

    def add_run(self, run: MoveRun) -> None:
        """A run of moves."""
        self._runs.append((len(self), run))
        self._sources.extend(run.sources)
        self._numbers.extend(run.numbers.tolist())
        self._starts.append(run.start_deg)
        self._goals.append(run.end)

    def parts(self) -> Iterator[BatchPoints]:
        """Everything collected, with points along it, in parts of so many points as are well checked at once."""
        table = BatchTable(len(self), self._elements, self._runs)
        starts, goals = np.concatenate(self._starts), np.concatenate(self._goals)
        counts = np.clip(np.ceil(table.length / SPACING_MM), 1, MOST_POINTS).astype(np.intp) + 1
        ends = np.cumsum(counts)
        first = 0
        while first < len(self):
            before = int(ends[first - 1]) if first else 0
            last = max(first + 1, int(np.searchsorted(ends, before + POINTS_AT_ONCE, side="right")))
            yield BatchPoints(table, self._sources, self._numbers, starts, goals, np.arange(first, last), counts)
            first = last


class BatchTable(ElementTable):
    """A table in which runs of moves stand as arrays, without an element for each."""

    def __init__(
        self, count: int, elements: Sequence[tuple[int, Element]], runs: Sequence[tuple[int, MoveRun]]
    ) -> None:
        self.length, self.feed_mm_s, self.rate = np.empty(count), np.empty(count), np.empty(count)
        self.branch = np.zeros(count, dtype=np.intp)
        self.is_joint = np.zeros(count, dtype=bool)
        self._geometry = Geometry.blank(count)
        self._splines: dict[int, SplineCurve] = {}
        self._turning: list[tuple[range, Turning]] = []
        for first, run in runs:
            rows = slice(first, first + len(run))
            self.length[rows], self.feed_mm_s[rows], self.rate[rows] = run.length, run.feed_mm_s, run.rate
            self.branch[rows] = run.branch
            self._geometry.put(first, len(run), run.geometry)
            self._splines.update((first + row, curve) for row, curve in run.splines.items())
            if run.turning is not None:
                self._turning.append((range(first, first + len(run)), run.turning))
        # elements have a table of their own: where each of its rows stands here, and the other way round
        self._own = ElementTable([element for _, element in elements]) if elements else None
        self._row_of_own = np.full(count, -1, dtype=np.intp)
        if self._own is not None:
            at = np.array([row for row, _ in elements], dtype=np.intp)
            self._row_of_own[at] = np.arange(len(at))
            for mine, theirs in (
                (self.length, self._own.length),
                (self.feed_mm_s, self._own.feed_mm_s),
                (self.rate, self._own.rate),
            ):
                mine[at] = theirs
            self.branch[at], self.is_joint[at] = self._own.branch, self._own.is_joint

    def __len__(self) -> int:
        return len(self.length)

    def evaluate(self, index: Indices, s: Array) -> tuple[Array, Array, Array]:
        """As `ElementTable.evaluate`."""
        values, slopes, bends = self._geometry.evaluate(index, s)
        for row, chosen in rows_of(index, self._splines):
            values[chosen], slopes[chosen], bends[chosen] = self._splines[row].evaluate(s[chosen])
        for rows, turning in self._turning:
            chosen = np.flatnonzero((index >= rows.start) & (index < rows.stop)).astype(np.intp)
            if len(chosen):
                first = rows.start
                values[chosen, 3:], slopes[chosen, 3:], bends[chosen, 3:] = turning.angles(
                    lambda number, at, first=first: self._places(number + first, at),  # type: ignore[misc]
                    index[chosen] - first,
                    s[chosen],
                )
        if self._own is not None:
            own = self._row_of_own[index]
            chosen = np.flatnonzero(own >= 0).astype(np.intp)
            if len(chosen):
                values[chosen], slopes[chosen], bends[chosen] = self._own.evaluate(own[chosen], s[chosen])
        return values, slopes, bends

    def _places(self, index: Indices, s: Array) -> Array:
        values = self._geometry.places(index, s)
        for row, chosen in rows_of(index, self._splines):
            values[chosen] = self._splines[row].evaluate(s[chosen])[0][:, :3]
        return values


class BatchPoints:
    """Points along some elements of a batch, so many `moves`: `index` (n,) of the element, `s` (n,) on it."""

    def __init__(
        self,
        table: ElementTable,
        sources: list[Source],
        numbers: list[int],
        start_deg: Array,
        goal: Array,
        elements: Indices,
        counts: Indices,
    ) -> None:
        self.table = table
        self.moves = len(elements)
        self.sources = sources
        self.numbers = numbers
        self.start_deg = start_deg
        self.goal = goal
        counts = counts[elements]
        self.index: Indices = np.repeat(elements, counts)
        within = np.arange(len(self.index)) - np.repeat(np.cumsum(counts) - counts, counts)
        self.s: Array = table.length[self.index] * within / (np.repeat(counts, counts) - 1)

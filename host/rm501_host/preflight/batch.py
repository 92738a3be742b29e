"""What is checked at once: elements and runs of lines in the order of the program, and points along them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rm501_host.moves import Source
from rm501_host.planner.elements import Element, ElementTable, Indices, Space

from .lines import LineRun

Array = NDArray[np.float64]

SPACING_MM = 1.0
"""Between checked points (deg in joint space); between them joints are followed by their derivatives."""
MOST_POINTS = 2000
_LINE = Element(Space.TASK, 1.0, np.zeros((4, 5)), Source("", 0))
"""Stands for a line in the list of elements; its numbers are in the table's arrays."""


class Batch:
    """Collects elements and runs of lines, each with the joints at its start, its goal, and its number."""

    def __init__(self) -> None:
        self._elements: list[Element] = []
        self._sources: list[Source] = []
        self._numbers: list[int] = []
        self._starts: list[Array] = []
        self._goals: list[Array] = []
        self._runs: list[tuple[int, LineRun]] = []

    def __len__(self) -> int:
        return len(self._elements)

    def add(self, element: Element, start_deg: Array, goal: Array, number: int) -> None:
        """An element from joints `start_deg` (5,) to task values `goal` (5,); `number`: which move it is."""
        self._elements.append(element)
        self._sources.append(element.source)
        self._numbers.append(number)
        self._starts.append(start_deg[None])
        self._goals.append(goal[None])

    def add_lines(self, run: LineRun) -> None:
        """A run of lines."""
        self._runs.append((len(self._elements), run))
        self._elements.extend([_LINE] * len(run))
        self._sources.extend(run.sources)
        self._numbers.extend(run.numbers.tolist())
        self._starts.append(run.start_deg)
        self._goals.append(run.end)

    def points(self) -> BatchPoints:
        """Everything collected, with points along it."""
        return BatchPoints(
            BatchTable(self._elements, self._runs),
            self._sources,
            self._numbers,
            np.concatenate(self._starts),
            np.concatenate(self._goals),
        )


class BatchTable(ElementTable):
    """A table in which runs of lines stand as arrays, without an element for each."""

    def __init__(self, elements: Sequence[Element], runs: Sequence[tuple[int, LineRun]]) -> None:
        lines = sum(len(run) for _, run in runs)
        self._only_lines = lines == len(elements)
        if not self._only_lines:
            super().__init__(elements)
        else:
            self._blank(elements)
        for first, run in runs:
            rows = slice(first, first + len(run))
            self.coefficients[rows, 0] = run.start
            self.coefficients[rows, 1] = (run.end - run.start) / run.length_mm[:, None]
            self.length[rows] = run.length_mm
            self.feed_mm_s[rows] = run.feed_mm_s
            self.branch[rows] = run.branch

    def _blank(self, elements: Sequence[Element]) -> None:
        count = len(elements)
        self.elements = tuple(elements)
        self.coefficients = np.zeros((count, 4, 5))
        self.cosine, self.sine = np.zeros((count, 3)), np.zeros((count, 3))
        self.omega, self.growth = np.zeros(count), np.zeros(count)
        self.length, self.feed_mm_s = np.empty(count), np.empty(count)
        self.rate = np.full(count, np.inf)
        self.branch = np.zeros(count, dtype=np.intp)
        self.is_joint = np.zeros(count, dtype=bool)
        self.is_straight = np.ones(count, dtype=bool)
        self._round = False
        self._curves = []

    def evaluate(self, index: Indices, s: Array) -> tuple[Array, Array, Array]:
        """As `ElementTable.evaluate`, the short way where there are lines alone."""
        if not self._only_lines:
            return super().evaluate(index, s)
        slopes = self.coefficients[index, 1]
        return self.coefficients[index, 0] + s[:, None] * slopes, slopes, np.zeros_like(slopes)


class BatchPoints:
    """Points along the elements of a batch: `index` (n,) of the element, `s` (n,) on it; `counts` per element."""

    def __init__(
        self, table: ElementTable, sources: list[Source], numbers: list[int], start_deg: Array, goal: Array
    ) -> None:
        self.table = table
        self.sources = sources
        self.numbers = numbers
        self.start_deg = start_deg
        self.goal = goal
        counts = np.clip(np.ceil(table.length / SPACING_MM), 1, MOST_POINTS).astype(np.intp) + 1
        self.index: Indices = np.repeat(np.arange(len(table)), counts)
        within = np.arange(len(self.index)) - np.repeat(np.cumsum(counts) - counts, counts)
        self.s: Array = table.length[self.index] * within / (counts[self.index] - 1)

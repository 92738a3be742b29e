"""Runs of short lines, in the jerk-limited mode: their points are moved a little, so that the path bends evenly.

Points are rounded, by programs to 0.001 or 0.0001 mm, and on lines of a fraction of a millimetre that makes curvature
jump from line to line; however small, such jumps take all of the jerk that joints may have. So points inside a run of
short lines that turn slightly are replaced by the binomial mean of their neighbours (weights C(2 w, k) / 4^w, w as many
lines as reach `_REACH_MM` as a standard deviation), and moved by `_SHARE` of the tolerance at most. A run's ends stay,
and near them w shrinks; means over rows of points keep their order. As many lines come out as went in.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import comb

import numpy as np

from .elements import Array, Element, Space, line

_LONGEST_MM = 1.0
_SHARPEST = 0.94
"""Cosine of the largest turn inside a run, 20 deg: sharper ones are corners."""
_REACH_MM = 0.5
_LEAST_LINES = 2
_MOST_LINES = 32
_SHARE = 0.25
_BATCH = 64
"""Lines that are worked out at once."""


class LineSmoother:
    """Lines go in one by one (`add`), and come out, moved, a run or a batch at a time; `take` ends the run."""

    def __init__(self) -> None:
        self.tolerance_mm = 0.0
        """How far blending may leave the lines."""
        self._lines: list[Element] = []
        self._points: list[Array] = []
        self._done = 0
        self._start: Array | None = None
        self._passed = 0

    def add(self, element: Element) -> list[Element]:
        """Lines that are ready, in order."""
        ready: list[Element] = []
        if self._lines and not _go_on(self._lines[-1], element):
            ready = self.take()
        if self.tolerance_mm <= 0.0 or not _is_short(element):
            return [*ready, element]
        if not self._lines:
            self._points = [element.coefficients[0]]
        self._lines.append(element)
        self._points.append(element.coefficients[0] + element.length * element.coefficients[1])
        if len(self._lines) - self._done >= _BATCH + _MOST_LINES:
            ready += self._moved(_BATCH, is_end=False)
        return ready

    def take(self) -> list[Element]:
        """What is held back, to the end of the run."""
        ready = self._moved(len(self._lines) - self._done, is_end=True) if self._lines else []
        self._lines, self._points, self._start = [], [], None
        self._done = self._passed = 0
        return ready

    def _moved(self, count: int, *, is_end: bool) -> list[Element]:
        """The next `count` lines; `_done` lines before them are kept for their points."""
        points = np.array(self._points)
        size = float(np.mean([element.length for element in self._lines]))
        reach = int(np.clip(np.ceil(2.0 * (_REACH_MM / size) ** 2), _LEAST_LINES, _MOST_LINES))
        first, last = self._done + 1, self._done + count
        moved = points[first : last + 1].copy()
        for k in range(first, last + 1):
            w = min(reach, self._passed + k, len(points) - 1 - k if is_end else reach)
            if w > 0:
                moved[k - first] = _weights(w) @ points[k - w : k + w + 1]
        shift = moved - points[first : last + 1]
        far = np.linalg.norm(shift[:, :3], axis=1)
        allowed = np.array([_SHARE * self.tolerance_mm - element.merged_mm for element in self._lines])
        behind = np.append(allowed[1:], allowed[-1:])
        room = np.maximum(np.minimum(allowed, behind)[first - 1 : last], 0.0)
        part = room / np.maximum(far, 1e-12)
        moved = points[first : last + 1] + shift * np.minimum(part, 1.0)[:, None]
        start = points[first - 1] if self._start is None else self._start
        ready, off_before = [], float(np.linalg.norm((start - points[first - 1])[:3]))
        for k, end in enumerate(moved):
            element = self._lines[first - 1 + k]
            off = float(np.linalg.norm((end - points[first + k])[:3]))
            length = float(np.linalg.norm((end - start)[:3]))
            if max(off, off_before) > 0.0 and length > 0.1 * element.length:
                fresh = line(Space.TASK, start, end, length, element.source)
                element = replace(
                    element,
                    length=length,
                    coefficients=fresh.coefficients,
                    merged_mm=element.merged_mm + max(off, off_before),
                )
            ready.append(element)
            start, off_before = end, off
        self._start = start
        self._done += count
        drop = max(0, self._done - _MOST_LINES)
        self._lines, self._points = self._lines[drop:], self._points[drop:]
        self._done -= drop
        self._passed += drop
        return ready


@cache
def _weights(w: int) -> Array:
    row: Array = np.array([comb(2 * w, k) for k in range(2 * w + 1)], dtype=np.float64) / 4.0**w
    return row


def _is_short(element: Element) -> bool:
    return (
        element.space is Space.TASK
        and element.is_straight
        and element.length <= _LONGEST_MM
        and abs(float(np.linalg.norm(element.coefficients[1, :3])) - 1.0) < 1e-6
    )


def _go_on(before: Element, element: Element) -> bool:
    """Whether a run goes on from one line into the next."""
    if not _is_short(element) or before.branch is not element.branch:
        return False
    return float(before.coefficients[1, :3] @ element.coefficients[1, :3]) >= _SHARPEST

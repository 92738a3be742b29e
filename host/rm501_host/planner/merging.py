"""G64 Q: lines that are nearly one line become one (RS274's naive CAM detector), never leaving the tolerance.

A line is added to those collected while every point between them stays within Q of the line from the first to the
last, in the order in which they come, with pitch and roll within Q deg of their place on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .elements import Array, Element, Space, line

MOST_POINTS = 200
"""Points between that are kept to be checked again: bounds the work of one line."""


class LineMerger:
    """Collects lines; `add` gives back what is finished, `take` the rest. `tolerance_mm` 0: passes everything on."""

    def __init__(self) -> None:
        self.tolerance_mm = 0.0
        self._line: Element | None = None
        self._between: list[Array] = []

    def add(self, element: Element) -> list[Element]:
        """Elements that nothing can be merged with any more, in order; the new one is kept where it may grow."""
        if self.tolerance_mm <= 0.0 or not element.is_straight or element.space is not Space.TASK:
            return [*self.take(), element]
        held = self._line
        if held is None:
            self._line, self._between = element, []
            return []
        merged = self._merged(held, element)
        if merged is not None:
            self._between.append(held.at(held.length)[0])
            self._line = merged
            return []
        finished = self.take()
        self._line = element
        return finished

    def take(self) -> list[Element]:
        """What is held, if anything."""
        held, self._line, self._between = self._line, None, []
        return [] if held is None else [held]

    def _merged(self, held: Element, element: Element) -> Element | None:
        same = (
            held.feed_mm_s == element.feed_mm_s
            and held.rate == element.rate
            and held.branch is element.branch
            and len(self._between) < MOST_POINTS
        )
        if not same or not np.isfinite(held.feed_mm_s):
            return None
        start, end = held.coefficients[0], element.at(element.length)[0]
        step = end[:3] - start[:3]
        length = float(np.linalg.norm(step))
        if length < 1e-6:
            return None
        points = np.array([*self._between, element.coefficients[0]])
        along = (points[:, :3] - start[:3]) @ step / length
        if along[0] <= 0.0 or along[-1] >= length or (np.diff(along) <= 0.0).any():
            return None
        ideal = start + (end - start) * (along / length)[:, None]
        off = points - ideal
        moved_mm = float(np.linalg.norm(off[:, :3], axis=1).max())
        if moved_mm > self.tolerance_mm:
            return None
        if float(np.abs(off[:, 3:]).max()) > self.tolerance_mm:
            return None
        joined = line(Space.TASK, start, end, length, held.source)
        return replace(joined, feed_mm_s=held.feed_mm_s, rate=held.rate, branch=held.branch, merged_mm=moved_mm)

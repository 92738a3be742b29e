"""Blends that touch, in the jerk-limited mode: they keep their curvature where one goes over into the next.

Lines so short that blends use them up would bend and straighten at every corner, and the third derivative of such a
path allows hardly any speed. So where two quintics meet in the middle of a line, both get the same second derivative
there: per group (place, pitch, roll) the harmonic mean of what either turns by over its length, if both turn the same
way, else none. On lines that sample a circle that is the circle's own curvature, and the quintics come close to its
arc. Both ends and both slopes stay, and the path moves by at most 0.0173 length^2 times the second derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from .elements import Array, Element, Space
from .quintic import QuinticCurve

_REACH = 0.01729
"""The largest value of t^2 (1 - t)^3 / 2, by which a second derivative at an end moves a quintic of length 1."""
_GROUPS = (slice(0, 3), slice(3, 4), slice(4, 5))


@dataclass(frozen=True, slots=True, eq=False)
class TouchingBlend:
    """A quintic blend that ends where another one may begin: its ends (2, 5), its slopes there (2, 5), and its second
    derivative at its start (5,). `spare_mm`: how far it may still be moved.
    """

    element: Element
    ends: Array
    slopes: Array
    start_bend: Array
    spare_mm: float

    @classmethod
    def of(cls, elements: Sequence[Element], spare_mm: float) -> TouchingBlend | None:
        """For what replaces a corner; None unless that is one quintic in task space."""
        if len(elements) != 1:
            return None
        element = elements[0]
        if element.space is not Space.TASK or not isinstance(element.curve, QuinticCurve):
            return None
        ends, slopes, _ = element.curve.evaluate(np.array([0.0, element.length]))
        return cls(element, ends, slopes, np.zeros(5), spare_mm)

    def finished(self, end_bend: Array | None = None) -> Element:
        """The blend with this second derivative at its end (5,), none unless given."""
        if end_bend is None:
            if not self.start_bend.any():
                return self.element
            end_bend = np.zeros(5)
        (start, end), (start_slope, end_slope) = self.ends, self.slopes
        length = self.element.length
        curve = QuinticCurve.through(start, start_slope, end, end_slope, length, self.start_bend, end_bend)
        return replace(self.element, curve=curve)


def joined(first: TouchingBlend, second: TouchingBlend) -> tuple[Element, TouchingBlend]:
    """Both with the same second derivative where they meet, as far as the tolerance of either allows."""
    length_a, length_b = first.element.length, second.element.length
    turn_a = (first.slopes[1] - first.slopes[0]) / length_a
    turn_b = (second.slopes[1] - second.slopes[0]) / length_b
    bend = _mean_bend(turn_a, turn_b)
    # chords of the turned tangents are shorter than their arcs
    angles = (turn_a[:3] @ turn_a[:3]) * length_a**2 + (turn_b[:3] @ turn_b[:3]) * length_b**2
    bend[:3] *= 1.0 + angles / 12.0
    size = sqrt(float(bend[:3] @ bend[:3]))
    moved_a, moved_b = _REACH * size * length_a**2, _REACH * size * length_b**2
    if moved_a > first.spare_mm or moved_b > second.spare_mm:
        return first.finished(), second
    return first.finished(bend), replace(second, start_bend=bend, spare_mm=second.spare_mm - moved_b)


def _mean_bend(a: Array, b: Array) -> Array:
    bend = np.zeros(5)
    for group in _GROUPS:
        in_a, in_b = a[group], b[group]
        if float(in_a @ in_b) > 0.0:
            size_a, size_b = sqrt(float(in_a @ in_a)), sqrt(float(in_b @ in_b))
            both = in_a + in_b
            bend[group] = both * (2.0 * size_a * size_b / (size_a + size_b) / sqrt(float(both @ both)))
    return bend

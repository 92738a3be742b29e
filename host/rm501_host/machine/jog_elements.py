"""What the way of a jog is made of: a heading, straight parts that return to their line, splines of damped parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rm501_host.moves import Source
from rm501_host.planner.elements import Element, Space

Array = NDArray[np.float64]

JOG_SOURCE = Source("(jog)", 0)
DAMPED_SOURCE = Source("(jog)", 1)
"""The source of damped parts: by its line a segment tells that the tool may be off its way."""


@dataclass(frozen=True, slots=True, eq=False)
class Heading:
    """Where a jog wants to go, per unit of its way (mm, or deg of a turn).

    `direction` (5,): x, y, z in mm of the base frame, pitch, roll in deg. `waist_share`: what of the waist's turn the
    roll follows so that the hand keeps its direction in the room: 1 tool down, -1 tool up, 0 not at all.
    """

    direction: Array
    waist_share: float = 0.0

    @property
    def is_turn(self) -> bool:
        """Whether the tool centre point stays where it is."""
        return not self.direction[:3].any()


@dataclass(frozen=True, slots=True, eq=False)
class Straight:
    """The line from `start` (5,) along a heading, shifted by `offset` (5,) that fades away over `fade` of the way.

    Values are x, y, z, pitch, roll; `waist_deg` and `axis_mm` (complex) tell how the roll follows the waist: the
    waist turns as the point (x + i y - axis) does. s is 0 at the start.
    """

    start: Array
    heading: Heading
    offset: Array
    fade: float
    arm_mm: complex
    shift_mm: complex

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives, each (n, 5)."""
        x = np.clip(s / self.fade, 0.0, 1.0)
        left = 1.0 - x * x * x * (10.0 - x * (15.0 - 6.0 * x))
        left1 = -30.0 * x * x * (1.0 - x) ** 2 / self.fade
        left2 = -60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / self.fade**2
        d = self.heading.direction
        values = self.start + s[:, None] * d + left[:, None] * self.offset
        slopes = d + left1[:, None] * self.offset
        bends = left2[:, None] * self.offset
        share = self.heading.waist_share
        if share:
            radius = values[:, 0] + 1j * values[:, 1] - self.shift_mm
            safe = np.where(np.abs(radius) < 1e-9, 1e-9, radius)
            # the derivatives of log(radius): its imaginary part is the angle
            first = (slopes[:, 0] + 1j * slopes[:, 1]) / safe
            second = (bends[:, 0] + 1j * bends[:, 1]) / safe - first * first
            values[:, 4] += share * np.degrees(np.angle(safe / self.arm_mm))
            slopes[:, 4] += share * np.degrees(first.imag)
            bends[:, 4] += share * np.degrees(second.imag)
        return values, slopes, bends


def spline_elements(knots: Array, points: Array, first: Array, last: Array) -> list[Element]:
    """The cubic spline through joints (n, 5) with given slopes (5,) at both ends, one element an interval."""
    h = np.diff(knots)[:, None]
    slope = np.diff(points, axis=0) / h
    count = len(knots)
    v = np.empty_like(points)
    v[0], v[-1] = first, last
    if count > 2:
        # Thomas' algorithm for h_i v_(i-1) + 2 (h_(i-1) + h_i) v_i + h_(i-1) v_(i+1) = 3 (h_i m_(i-1) + h_(i-1) m_i)
        right = 3.0 * (h[1:] * slope[:-1] + h[:-1] * slope[1:])
        right[0] -= h[1] * first
        right[-1] -= h[-2] * last
        diagonal = 2.0 * (h[:-1] + h[1:])
        for i in range(1, count - 2):
            share = h[i + 1] / diagonal[i - 1]
            diagonal[i] -= share * h[i - 1]
            right[i] -= share * right[i - 1]
        v[count - 2] = right[-1] / diagonal[-1]
        for i in range(count - 4, -1, -1):
            v[i + 1] = (right[i] - h[i] * v[i + 2]) / diagonal[i]
    elements = []
    for i in range(count - 1):
        coefficients = np.stack(
            (
                points[i],
                v[i],
                (3.0 * slope[i] - 2.0 * v[i] - v[i + 1]) / h[i],
                (v[i] + v[i + 1] - 2.0 * slope[i]) / h[i] ** 2,
            )
        )
        elements.append(Element(Space.JOINT, float(h[i, 0]), coefficients, DAMPED_SOURCE))
    return elements


def with_speed(elements: list[Element], heading: Heading, speed: float, tool_mm_s: float) -> list[Element]:
    """The elements at `speed` (mm/s, or deg/s of a turn), the tool never above `tool_mm_s`.

    In a damped part the commanded way passes at that speed, and the tool gets on more slowly.
    """
    if heading.is_turn:
        return [replace(element, rate=speed, feed_mm_s=tool_mm_s) for element in elements]
    feed = min(speed, tool_mm_s)
    return [
        replace(element, feed_mm_s=feed, rate=feed if element.space is Space.JOINT else np.inf) for element in elements
    ]

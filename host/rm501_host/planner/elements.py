"""Path elements: pieces of geometry with exact first and second derivatives.

An element is a function of its own parameter s in [0, length], in task space (x, y, z in mm of the base frame, pitch
and roll in deg) or in joint space (five DH angles in deg):

    y(s) = c0 + c1 s + c2 s^2 + c3 s^3 + (1 + g s) (e cos(w s) + f sin(w s)),      e, f: in x, y, z only

One formula covers lines (w = 0), arcs, helices and arcs whose radius grows (w, g), parabolic and cubic blends (c2,
c3). Everything else is a `Curve` (splines, orientations given as roll, pitch, yaw) that evaluates itself. s is the
arc length in mm wherever the tool moves, deg where only joints or angles do; blends may run at a slightly different
pace, so feed is always taken of |dp/ds|, never of ds/dt.

`ElementTable` holds many elements as arrays and evaluates any mixture of them at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Branch
from rm501_host.moves import Source

from .quintic import QuinticCurve, evaluate_quintics

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


_NONE = np.zeros(3)
_NONE.setflags(write=False)


class Space(Enum):
    """What an element's five values are."""

    TASK = "task"
    JOINT = "joint"


class Curve(Protocol):
    """Geometry that is no polynomial and no arc."""

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives with respect to s, each (n, 5)."""
        ...


@dataclass(frozen=True, slots=True)
class OutputMark:
    """Outputs that change where the path passes `at` (the element's own s): those in `mask` become `levels`."""

    at: float
    mask: int
    levels: int
    source: Source


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """One piece of the path.

    `coefficients`: (4, 5), of 1, s, s^2, s^3; `cosine`, `sine`: (3,), mm; `omega`: rad per unit of s; `growth`: 1 per
    unit of s. `feed_mm_s` limits |dp/dt| of the tool centre point, `rate` limits ds/dt. `branch` is the arm's
    way of reaching a task-space element. `merged_mm`: how far merging has moved it off the programmed lines.
    `marks`: in order, never at its end. `is_line`: known to be straight unless there is a curve.
    """

    space: Space
    length: float
    coefficients: Array
    source: Source
    cosine: Array = field(default_factory=lambda: _NONE)
    sine: Array = field(default_factory=lambda: _NONE)
    omega: float = 0.0
    growth: float = 0.0
    feed_mm_s: float = np.inf
    rate: float = np.inf
    curve: Curve | None = None
    curve_start: float = 0.0
    is_blend: bool = False
    branch: Branch = Branch.FRONT_UP
    merged_mm: float = 0.0
    marks: tuple[OutputMark, ...] = ()
    is_line: bool = False

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives at s (n,), each (n, 5)."""
        return ElementTable([self]).evaluate(np.zeros(len(s), dtype=np.intp), s)

    def at(self, s: float) -> tuple[Array, Array]:
        """Value and first derivative at one s, each (5,)."""
        if self.is_straight:
            start, slope = self.coefficients[0], self.coefficients[1]
            return start + s * slope, slope
        values, slopes, _ = self.evaluate(np.array([s]))
        return values[0], slopes[0]

    def trimmed(self, first: float, last: float) -> Element:
        """The part from s = first to s = last, its own parameter starting at 0 again."""
        if first == 0.0 and last == self.length:
            return self
        marks = self.marks
        if marks:
            marks = tuple(replace(mark, at=mark.at - first) for mark in marks if first <= mark.at < last)
        if self.curve is not None:
            return replace(self, length=last - first, curve_start=self.curve_start + first, marks=marks)
        if self.is_straight:
            coefficients = self.coefficients.copy()
            coefficients[0] += first * coefficients[1]
            return replace(self, length=last - first, coefficients=coefficients, marks=marks)
        a = first
        c0, c1, c2, c3 = self.coefficients
        shifted = np.stack((c0 + a * (c1 + a * (c2 + a * c3)), c1 + a * (2 * c2 + 3 * a * c3), c2 + 3 * a * c3, c3))
        size = 1.0 + self.growth * a
        angle_cos, angle_sin = np.cos(self.omega * a), np.sin(self.omega * a)
        return replace(
            self,
            length=last - first,
            coefficients=shifted,
            cosine=size * (self.cosine * angle_cos + self.sine * angle_sin),
            sine=size * (self.sine * angle_cos - self.cosine * angle_sin),
            growth=self.growth / size,
            marks=marks,
        )

    @property
    def is_straight(self) -> bool:
        """Whether it is a straight line in its space (a blend is never one)."""
        if self.curve is not None or self.is_line:
            return self.curve is None
        return self.omega == 0.0 and not self.is_blend and not self.coefficients[2:].any()


class ElementTable:
    """Many elements as arrays; `evaluate` takes any mixture of them at once. `turns_roll`: whether the fifth of the
    values may change in any of them.
    """

    def __init__(self, elements: Sequence[Element]) -> None:
        self.elements = tuple(elements)
        self.coefficients = np.array([e.coefficients for e in elements]).reshape(-1, 4, 5)
        self._bent = bool(self.coefficients[:, 2:].any())
        self.cosine = np.array([e.cosine for e in elements]).reshape(-1, 3)
        self.sine = np.array([e.sine for e in elements]).reshape(-1, 3)
        self.omega = np.array([e.omega for e in elements])
        self.growth = np.array([e.growth for e in elements])
        self.length = np.array([e.length for e in elements])
        self.feed_mm_s = np.array([e.feed_mm_s for e in elements])
        self.rate = np.array([e.rate for e in elements])
        self.branch = np.array([e.branch for e in elements], dtype=np.intp)
        self.is_joint = np.array([e.space is Space.JOINT for e in elements], dtype=bool)
        self.is_straight = np.array([e.is_straight for e in elements], dtype=bool)
        self.is_blend = np.array([e.is_blend for e in elements], dtype=bool)
        self._round = bool(self.omega.any())
        self.turns_roll = bool(self.coefficients[:, 1:, 4].any()) or any(e.curve is not None for e in elements)
        curves = [(i, e.curve) for i, e in enumerate(elements) if e.curve is not None]
        self._curves = [i for i, curve in curves if not isinstance(curve, QuinticCurve)]
        quintics = [(i, curve.coefficients) for i, curve in curves if isinstance(curve, QuinticCurve)]
        self._has_quintics = bool(quintics)
        if quintics:
            self._quintics = np.array([rows for _, rows in quintics])
            self._quintic = np.full(len(elements), -1, dtype=np.intp)
            self._quintic[[i for i, _ in quintics]] = np.arange(len(quintics))
            self._curve_start = np.array([e.curve_start for e in elements])

    def __len__(self) -> int:
        return len(self.elements)

    def evaluate(self, index: Indices, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives of element `index` (n,) at its own s (n,), each (n, 5)."""
        c = self.coefficients[index]
        t = s[:, None]
        if self._bent:
            values = c[:, 0] + t * (c[:, 1] + t * (c[:, 2] + t * c[:, 3]))
            slopes = c[:, 1] + t * (2.0 * c[:, 2] + 3.0 * t * c[:, 3])
            bends = 2.0 * c[:, 2] + 6.0 * t * c[:, 3]
        else:
            slopes = c[:, 1].copy()
            values, bends = c[:, 0] + t * slopes, np.zeros_like(slopes)
        if self._round:
            omega = self.omega[index]
            angle_cos = np.cos(omega * s)[:, None]
            angle_sin = np.sin(omega * s)[:, None]
            e, f, w = self.cosine[index], self.sine[index], omega[:, None]
            g = self.growth[index][:, None]
            size = 1.0 + g * t
            circle = e * angle_cos + f * angle_sin
            turned = w * (f * angle_cos - e * angle_sin)
            values[:, :3] += size * circle
            slopes[:, :3] += size * turned + g * circle
            bends[:, :3] += -size * w * w * circle + 2.0 * g * turned
        if self._has_quintics:
            chosen = np.flatnonzero(self._quintic[index] >= 0)
            used = index[chosen]
            found = evaluate_quintics(self._quintics[self._quintic[used]], self._curve_start[used] + s[chosen])
            values[chosen], slopes[chosen], bends[chosen] = found
        for i in self._curves:
            chosen = np.flatnonzero(index == i)
            if len(chosen):
                element = self.elements[i]
                assert element.curve is not None
                values[chosen], slopes[chosen], bends[chosen] = element.curve.evaluate(element.curve_start + s[chosen])
        return values, slopes, bends


def line(
    space: Space,
    start: Array,
    end: Array,
    length: float,
    source: Source,
    *,
    feed_mm_s: float = np.inf,
    rate: float = np.inf,
    branch: Branch = Branch.FRONT_UP,
) -> Element:
    """The straight line from `start` to `end`, each (5,), mm and deg or deg, over `length` of the
    parameter (mm; deg where only angles move).
    """
    coefficients = np.zeros((4, 5))
    coefficients[0] = start
    np.subtract(end, start, out=coefficients[1])
    coefficients[1] /= length
    return Element(space, length, coefficients, source, feed_mm_s=feed_mm_s, rate=rate, branch=branch, is_line=True)


def arc(
    start: Array,
    end: Array,
    centre_mm: Array,
    axis: Array,
    angle_rad: float,
    source: Source,
) -> Element:
    """A circular or helical arc about `axis` (unit) through `start` to `end`, each (5,), turning by `angle_rad`.

    The rise along the axis, pitch and roll are linear in the angle, and so is a radius that differs at the end. s is
    the arc length of the helix of the mean radius (exact where the radius does not change).
    """
    offset = start[:3] - centre_mm
    height = float(offset @ axis)
    radial = offset - height * axis
    radius = float(np.linalg.norm(radial))
    end_offset = end[:3] - centre_mm
    rise = float(end_offset @ axis) - height
    end_radius = float(np.linalg.norm(end_offset - (rise + height) * axis))
    across = np.cross(axis, radial)
    mean_radius = 0.5 * (radius + end_radius)
    length = float(np.hypot(mean_radius * angle_rad, rise))
    coefficients = np.zeros((4, 5))
    coefficients[0, :3] = centre_mm + height * axis
    coefficients[0, 3:] = start[3:]
    coefficients[1, :3] = axis * (rise / length)
    coefficients[1, 3:] = (end[3:] - start[3:]) / length
    growth = (end_radius - radius) / (radius * length)
    if abs(growth * length) < 1e-12:
        growth = 0.0
    return Element(
        Space.TASK, length, coefficients, source, cosine=radial, sine=across, omega=angle_rad / length, growth=growth
    )


def hermite(
    space: Space, start: Array, start_slope: Array, end: Array, end_slope: Array, length: float, source: Source
) -> Element:
    """The cubic with these values and slopes at s = 0 and s = length, each (5,)."""
    chord = (end - start) / length
    coefficients = np.stack(
        (
            start,
            start_slope,
            (3.0 * chord - 2.0 * start_slope - end_slope) / length,
            (start_slope + end_slope - 2.0 * chord) / length**2,
        )
    )
    return Element(space, length, coefficients, source)

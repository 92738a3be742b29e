"""The ideal law of a stretch of motion: which place on which element at which time."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm

from .elements import Array, Element, ElementTable, Indices
from .geometry import joints_along, path_points
from .outputs import output_events
from .pieces import PieceEvent

SHORTEST_PART = 1e-9
"""Parts of elements below this many mm or deg are none."""


def passed(table: ElementTable, index: Indices, s: Array) -> list[Element]:
    """The elements from (index[0], s[0]) to (index[1], s[1]), the first and the last of them cut there."""
    low, high = int(index[0]), int(index[1])
    found = []
    for number in range(low, high + 1):
        element = table.elements[number]
        begin = float(s[0]) if number == low else 0.0
        end = float(s[1]) if number == high else element.length
        if end - begin > SHORTEST_PART:
            found.append(element.trimmed(begin, end))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class PathLaw:
    """Piecewise constant path acceleration over the intervals of a grid.

    `element`, `start`, `stop` (n,): the intervals; `time_s` (n + 1,), from 0; `speed` (n + 1,): ds/dt at the grid
    points. After the last point the arm stands at its end.
    """

    arm: Arm
    table: ElementTable
    element: Indices
    start: Array
    stop: Array
    time_s: Array
    speed: Array

    @classmethod
    def from_speeds(
        cls, arm: Arm, table: ElementTable, element: Indices, start: Array, stop: Array, x: Array
    ) -> PathLaw:
        """The law whose squared path speeds at the grid points are `x` (n + 1,), (mm or deg)^2/s^2; its n intervals
        go from `start` to `stop` (n,) of the parameter of their `element`.
        """
        speed = np.sqrt(x)
        durations = 2.0 * (stop - start) / (speed[:-1] + speed[1:])
        time_s = np.concatenate((np.zeros(1), np.cumsum(durations)))
        return cls(arm, table, element, start, stop, time_s, speed)

    @property
    def duration_s(self) -> float:
        """From the first to the last grid point."""
        return float(self.time_s[-1])

    def locate(self, time_s: Array) -> tuple[Indices, Array, Array, Array]:
        """Interval index, s, ds/dt and d2s/dt2 at the times given, (n,) each; times are clipped to the law."""
        count = len(self.element)
        k = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, count - 1)
        begin = self.time_s[k]
        span = self.time_s[k + 1] - begin
        tau = np.clip(time_s - begin, 0.0, span)
        v0, v1 = self.speed[k], self.speed[k + 1]
        u = (v1 - v0) / span
        low, high = self.start[k], self.stop[k]
        s = np.clip(low + tau * (v0 + 0.5 * u * tau), low, high)
        beyond = time_s > self.time_s[-1]
        v = np.where(beyond, 0.0, v0 + u * tau)
        return k, s, v, np.where(beyond, 0.0, u)

    def places(self, time_s: Array) -> tuple[Indices, Array]:
        """Which element of `table` and which s on it at the times given, (n,) each."""
        k, s, _, _ = self.locate(time_s)
        return self.element[k], s

    def elements_between(self, first_s: float, last_s: float) -> list[Element]:
        """The elements that it passes between two of its times, in order, cut to what is passed."""
        return passed(self.table, *self.places(np.array([first_s, last_s])))

    def time_at(self, index: int, s: float) -> float:
        """When it passes s on element `index`, which it does."""
        first = int(np.searchsorted(self.element, index, side="left"))
        last = int(np.searchsorted(self.element, index, side="right"))
        k = max(first, first + int(np.searchsorted(self.start[first:last], s, side="right")) - 1)
        way, v0 = max(0.0, s - float(self.start[k])), float(self.speed[k])
        span = float(self.time_s[k + 1] - self.time_s[k])
        u = (float(self.speed[k + 1]) - v0) / span
        tau = 2.0 * way / max(v0 + sqrt(max(v0 * v0 + 2.0 * u * way, 0.0)), 1e-300)
        return float(self.time_s[k]) + min(tau, span)

    def outputs(self) -> tuple[PieceEvent, ...]:
        """The output changes of the path that fall into this law, in order, at their exact times."""
        first = (int(self.element[0]), float(self.start[0]))
        last = (int(self.element[-1]), float(self.stop[-1]))
        return output_events(self.table, first, last, self.time_at)

    def q_deg(self, time_s: Array) -> Array:
        """Joint angles (n, 5) in deg at the times given."""
        k, s, _, _ = self.locate(time_s)
        q_deg, _ = joints_along(self.arm, self.table, self.element[k], s)
        return q_deg

    def states(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Joint angles, rates and accelerations, each (n, 5), in deg, deg/s, deg/s^2.

        At a grid point the acceleration is that of the interval after it.
        """
        k, s, v, u = self.locate(time_s)
        points = path_points(self.arm, self.table, self.element[k], s)
        rates = points.q1 * v[:, None]
        return points.q_deg, rates, points.q1 * u[:, None] + points.q2 * (v * v)[:, None]

    def tool_speeds_mm_s(self, time_s: Array) -> Array:
        """Speed of the tool centre point, (n,)."""
        k, s, v, _ = self.locate(time_s)
        points = path_points(self.arm, self.table, self.element[k], s)
        speeds: Array = np.linalg.norm(points.p1, axis=1) * v
        return speeds

    def lines(self, time_s: Array) -> NDArray[np.int64]:
        """Source line at the times given, (n,)."""
        k, _, _, _ = self.locate(time_s)
        numbers = np.array([element.source.line for element in self.table.elements], dtype=np.int64)
        result: NDArray[np.int64] = numbers[self.element[k]]
        return result

    def kinks_s(self) -> tuple[Array, Array]:
        """Times at which the joint accelerations may jump, and for each -1 where the path acceleration is larger
        before it, 1 where it is larger after, 0 where that is not known (another element begins).
        """
        spans = np.diff(self.time_s)
        u = np.abs(np.diff(self.speed) / spans)
        signed = np.diff(self.speed) / spans
        scale = u.max(initial=0.0)
        jump = np.abs(np.diff(signed)) > 0.05 * scale
        change = np.diff(self.element) != 0
        kinks = jump | change
        side = np.where(change, 0.0, np.sign(u[1:] - u[:-1]))
        return self.time_s[1:-1][kinks], side[kinks]

"""The jerk-limited law: the time-optimal one, smoothed along its path, and slowed down until every limit holds.

s(t) of the time-optimal law is averaged over a window of length w (a box filter), which turns its piecewise constant
path acceleration into a piecewise linear one and never leaves the path:

    s~(t) = (S(t) - S(t - w)) / w,     S' = s,     ds~/dt = (s(t) - s(t - w)) / w,     d2s~/dt2 = (v(t) - v(t - w)) / w

w = max 2 A_i / J_i: over that time a joint's acceleration may swing from -A to A. On a straight line in joint space
the result keeps all limits and the jerk; on curved paths it is measured (joints and motors, every millisecond): where
it is too fast the speed of the base law is capped and the law solved again, until at most 1 % is missing; the rest is
taken from the whole law by stretching it in time by the smallest factor k that makes it legal (accelerations fall by
k^2, jerks by k^3). Chains too long for that are planned in windows (`jerk_window`). The path itself must have
continuous curvature, so in this mode blends are quintics without curvature at their ends, and where the curvature jumps
(line to arc) the arm stops.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm

from .elements import Array, Element, ElementTable, Indices
from .geometry import joints_along, path_points
from .jerk_slowing import slowdown_of_intervals, slowed
from .law import PathLaw, passed
from .limits import Limits
from .outputs import Place, output_events
from .pieces import PieceEvent
from .timelaw import IntervalLines, fastest_speeds

PROBE_S = 1e-3
_CLOSEST_S = 1e-5
"""Between probes closer together than this the difference of accelerations is rounding."""
_MARGIN = 1e-6
_ROUNDS = 24
_CLOSE = 1.0004
_OVER = 1.0005
_PATIENCE = 6


def window_of(limits: Limits) -> float:
    """The window in s: over it a joint's acceleration may swing from -A to A within its jerk."""
    return float((2.0 * limits.joint_acceleration_deg_s2 / limits.jerk_deg_s3).max())


@dataclass(frozen=True, slots=True, eq=False)
class JerkLaw:
    """A `PathLaw`, averaged over `window_s` and stretched by `stretch` in time.

    From rest to rest; or, where `length_s` is given, the part of it that begins `lead_s` after the start of `base`,
    which then holds what the average needs. `first`, `last`: the places on the path from which on and before which
    output changes belong to it.
    """

    base: PathLaw
    window_s: float
    stretch: float
    way: Array
    area: Array
    lead_s: float = 0.0
    length_s: float | None = None
    first: Place | None = None
    last: Place | None = None

    @classmethod
    def over(cls, base: PathLaw, lines: IntervalLines, limits: Limits, frame_s: float) -> JerkLaw:
        """The law for the path of `base`, whose intervals have the limits `lines`, that keeps all limits and the
        joints' jerk, a whole number of frames long.
        """
        window_s = window_of(limits)
        # neither way is better everywhere: sharp blends want speeds capped, everything else accelerations lowered too
        found = [cls._slowed_down(base, lines, limits, window_s, with_accelerations=both) for both in (True, False)]
        _, best = min(found, key=lambda item: item[0])
        _, ratios = best.slowdowns(limits)
        stretch = max(1.0, float(ratios.max())) * (1.0 + _MARGIN)
        frames = np.ceil(best.duration_s * stretch / frame_s - 1e-9)
        return replace(best, stretch=float(frames * frame_s / best.duration_s))

    @classmethod
    def _slowed_down(
        cls, base: PathLaw, lines: IntervalLines, limits: Limits, window_s: float, *, with_accelerations: bool
    ) -> tuple[float, JerkLaw]:
        """The average of a base law slowed down where it is too fast, and how long it takes once stretched."""
        best = law = cls.smoothed(base, window_s)
        least = np.inf
        count = len(base.element)
        cap, scale = np.full(count, np.inf), np.ones(count)
        for turn in range(_ROUNDS):
            times, ratios = law.slowdowns(limits)
            duration = law.duration_s * float(max(1.0, ratios.max()))
            if duration < least:
                least, best = duration, law
            if ratios.max() <= _CLOSE:
                break
            needed = slowdown_of_intervals(law.base.time_s, times, ratios, window_s)
            gain = 1.0 + max(0, turn - _PATIENCE) if with_accelerations else 1.0
            factor = np.where(needed > 1.0, (needed * _OVER) ** (-2.0 * gain), 1.0)
            squared = np.maximum(law.base.speed[:-1], law.base.speed[1:]) ** 2
            cap = np.where(needed > 1.0, np.minimum(cap, squared * factor), cap)
            if with_accelerations:
                scale = scale * factor
            speeds = fastest_speeds(slowed(lines, scale, cap))
            speeds[-1] = 0.0
            again = PathLaw.from_speeds(base.arm, base.table, base.element, base.start, base.stop, speeds)
            law = cls.smoothed(again, window_s)
        return least, best

    @classmethod
    def smoothed(cls, base: PathLaw, window_s: float) -> JerkLaw:
        """The average, whether it keeps the limits or not."""
        spans = np.diff(base.time_s)
        lengths = base.stop - base.start
        way = np.concatenate((np.zeros(1), np.cumsum(lengths)))
        v0, v1 = base.speed[:-1], base.speed[1:]
        # integral of s over an interval: s0 T + v0 T^2 / 2 + u T^3 / 6
        pieces = way[:-1] * spans + spans**2 * (v0 / 2.0 + (v1 - v0) / 6.0)
        area = np.concatenate((np.zeros(1), np.cumsum(pieces)))
        return cls(base, window_s, 1.0, way, area)

    @property
    def duration_s(self) -> float:
        """From rest to rest, or of the part."""
        if self.length_s is not None:
            return self.length_s
        return (self.base.duration_s + self.window_s) * self.stretch

    def _at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Integral of s, s and ds/dt of the base law, extended by rest on both sides."""
        times = self.base.time_s
        inside = np.clip(time_s, 0.0, times[-1])
        k = np.clip(np.searchsorted(times, inside, side="right") - 1, 0, len(times) - 2)
        tau, span = inside - times[k], times[k + 1] - times[k]
        v0 = self.base.speed[k]
        u = (self.base.speed[k + 1] - v0) / span
        s = self.way[k] + tau * (v0 + 0.5 * u * tau)
        area = self.area[k] + tau * (self.way[k] + tau * (0.5 * v0 + u * tau / 6.0))
        after = time_s > times[-1]
        area = area + np.where(after, (time_s - times[-1]) * self.way[-1], 0.0)
        still = after | (time_s < 0.0)
        return area, s, np.where(still, 0.0, v0 + u * tau)

    def _path(self, time_s: Array) -> tuple[Array, Array, Array]:
        """s, ds/dt, d2s/dt2 of the smoothed law."""
        t = time_s / self.stretch + self.lead_s
        area1, s1, v1 = self._at(t)
        area0, s0, v0 = self._at(t - self.window_s)
        w = self.window_s
        return (area1 - area0) / w, (s1 - s0) / (w * self.stretch), (v1 - v0) / (w * self.stretch**2)

    def _place(self, s: Array) -> tuple[Indices, Array]:
        base = self.base
        k = np.clip(np.searchsorted(self.way, s, side="right") - 1, 0, len(base.element) - 1)
        return base.element[k], np.clip(base.start[k] + (s - self.way[k]), base.start[k], base.stop[k])

    @property
    def arm(self) -> Arm:
        """The arm, with the tool of that moment."""
        return self.base.arm

    @property
    def table(self) -> ElementTable:
        """The elements of the path."""
        return self.base.table

    def places(self, time_s: Array) -> tuple[Indices, Array]:
        """Which element of `table` and which s on it at the times given, (n,) each."""
        return self._place(self._path(time_s)[0])

    def elements_between(self, first_s: float, last_s: float) -> list[Element]:
        """The elements that it passes between two of its times, in order, cut to what is passed."""
        return passed(self.table, *self.places(np.array([first_s, last_s])))

    def time_at(self, index: int, s: float) -> float:
        """When it passes s on element `index`, which it does: by bisection, as the place only rises."""
        k = int(np.searchsorted(self.base.element, index, side="left"))
        wanted = float(self.way[k]) + s - float(self.base.start[k])
        low, high = 0.0, self.duration_s
        for _ in range(64):
            middle = 0.5 * (low + high)
            if float(self._path(np.array([middle]))[0][0]) < wanted:
                low = middle
            else:
                high = middle
        return high if wanted > 0.0 else 0.0

    def outputs(self) -> tuple[PieceEvent, ...]:
        """The output changes of the path that fall into this law, in order, at their exact times."""
        end = len(self.table) - 1
        last = self.last or (end, float(self.table.length[end]))
        return output_events(self.table, self.first or (0, 0.0), last, self.time_at)

    def q_deg(self, time_s: Array) -> Array:
        """Joint angles (n, 5) in deg."""
        index, s = self._place(self._path(time_s)[0])
        return joints_along(self.base.arm, self.base.table, index, s)[0]

    def states(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Joint angles, rates and accelerations, each (n, 5)."""
        way, v, u = self._path(time_s)
        index, s = self._place(way)
        points = path_points(self.base.arm, self.base.table, index, s)
        rates = points.q1 * v[:, None]
        return points.q_deg, rates, points.q1 * u[:, None] + points.q2 * (v * v)[:, None]

    def lines(self, time_s: Array) -> NDArray[np.int64]:
        """Source line at the times, (n,)."""
        index, _ = self._place(self._path(time_s)[0])
        numbers = np.array([element.source.line for element in self.base.table.elements], dtype=np.int64)
        result: NDArray[np.int64] = numbers[index]
        return result

    def kinks_s(self) -> tuple[Array, Array]:
        """None: accelerations are continuous."""
        return np.zeros(0), np.zeros(0)

    def _probes(self, first_s: float) -> Array:
        """Every millisecond, and where the average passes the grid points of its base law: the grid is fine where the
        path bends sharply, within less than a millisecond at times.
        """
        count = max(32, int((self.duration_s - first_s) / PROBE_S))
        even = np.linspace(first_s, self.duration_s, count + 1)
        passed_s = np.interp(self.way, self._path(even)[0], even)
        probes: Array = np.unique(np.concatenate((even, passed_s[passed_s >= first_s])))
        return probes

    def slowdowns(self, limits: Limits, first_s: float = 0.0, anchor_s: float | None = None) -> tuple[Array, Array]:
        """Times (n,), and how much slower the law would have to be there for every limit to hold (n,): the ratio of
        rates, the square root of that of accelerations, the cube root of that of jerks. From `first_s` on, every
        millisecond and where it passes grid points; with `anchor_s` at whole milliseconds from that.
        """
        if anchor_s is None:
            times = self._probes(first_s)
        else:
            low, high = np.floor((first_s - anchor_s) / PROBE_S), np.ceil((self.duration_s - anchor_s) / PROBE_S)
            times = anchor_s + PROBE_S * np.arange(low, high + 1.0)
        way, v, u = self._path(times)
        index, s = self._place(way)
        points = path_points(self.base.arm, self.base.table, index, s)
        rates = points.q1 * v[:, None]
        accelerations = points.q1 * u[:, None] + points.q2 * (v * v)[:, None]
        jerks = (
            np.abs(np.diff(accelerations, axis=0))
            / np.maximum(np.diff(times), _CLOSEST_S)[:, None]
            / limits.jerk_deg_s3
        )
        speed = (np.abs(rates @ limits.rows.T) / limits.velocity).max(axis=1)
        feed = np.minimum(self.base.table.feed_mm_s[index], limits.tcp_speed_mm_s)
        speed = np.maximum(speed, np.linalg.norm(points.p1, axis=1) * v / feed)
        speed = np.maximum(speed, v / self.base.table.rate[index])
        acceleration = (np.abs(accelerations @ limits.rows.T) / limits.acceleration).max(axis=1)
        jerk = np.zeros(len(times))
        jerk[:-1] = jerks.max(axis=1)
        jerk[1:] = np.maximum(jerk[1:], jerk[:-1])
        needed = np.maximum(np.maximum(speed * 1.0005, np.sqrt(acceleration * 1.001)), np.cbrt(jerk * 1.01))
        return times, needed

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
from .law import PathLaw, passed
from .limits import Limits
from .outputs import Place, output_events
from .pieces import PieceEvent
from .timelaw import IntervalLines, fastest_speeds

PROBE_S = 1e-3
_MARGIN = 1e-6
_ROUNDS = 24
_CLOSE = 1.01


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
        best = law = cls.smoothed(base, window_s)
        least = np.inf
        cap = np.full(len(base.element), np.inf)
        for _ in range(_ROUNDS):
            times, ratios = law.slowdowns(limits)
            duration = law.duration_s * float(max(1.0, ratios.max()))
            if duration < least:
                least, best = duration, law
            if ratios.max() <= _CLOSE:
                break
            # where the smoothed law is too fast, the base law passed half a window to either side of it
            slower = np.ones(len(base.element))
            first = np.searchsorted(law.base.time_s, times - window_s) - 1
            last = np.searchsorted(law.base.time_s, times)
            for at in np.flatnonzero(ratios > 1.0):
                span = slice(max(0, int(first[at])), int(last[at]) + 1)
                slower[span] = np.maximum(slower[span], ratios[at])
            squared = np.maximum(law.base.speed[:-1], law.base.speed[1:]) ** 2
            cap = np.minimum(cap, np.where(slower > 1.0, squared / slower**2, np.inf))
            capped = replace(lines, peak_x=np.minimum(lines.peak_x, cap), y_cap=np.minimum(lines.y_cap, cap))
            speeds = fastest_speeds(capped)
            speeds[-1] = 0.0
            again = PathLaw.from_speeds(base.arm, base.table, base.element, base.start, base.stop, speeds)
            law = cls.smoothed(again, window_s)
        _, ratios = best.slowdowns(limits)
        stretch = max(1.0, float(ratios.max())) * (1.0 + _MARGIN)
        frames = np.ceil(best.duration_s * stretch / frame_s - 1e-9)
        return replace(best, stretch=float(frames * frame_s / best.duration_s))

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

    def slowdowns(self, limits: Limits, first_s: float = 0.0, anchor_s: float | None = None) -> tuple[Array, Array]:
        """Times (n,), and how much slower the law would have to be there for every limit to hold (n,): the ratio of
        rates, the square root of that of accelerations, the cube root of that of jerks. From `first_s` on; with
        `anchor_s` at whole milliseconds from that.
        """
        if anchor_s is None:
            count = max(32, int((self.duration_s - first_s) / PROBE_S))
            times = np.linspace(first_s, self.duration_s, count + 1)
        else:
            low, high = np.floor((first_s - anchor_s) / PROBE_S), np.ceil((self.duration_s - anchor_s) / PROBE_S)
            times = anchor_s + PROBE_S * np.arange(low, high + 1.0)
        way, v, u = self._path(times)
        index, s = self._place(way)
        points = path_points(self.base.arm, self.base.table, index, s)
        rates = points.q1 * v[:, None]
        accelerations = points.q1 * u[:, None] + points.q2 * (v * v)[:, None]
        jerks = np.abs(np.diff(accelerations, axis=0)) / (times[1] - times[0]) / limits.jerk_deg_s3
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

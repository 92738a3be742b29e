"""The jerk-limited law: the time-optimal one, smoothed along its path, and slowed down until every limit holds.

s(t) of the time-optimal law is averaged over a window of length w (a box filter), which turns its piecewise constant
path acceleration into a piecewise linear one and never leaves the path:

    s~(t) = (S(t) - S(t - w)) / w,     S' = s,     ds~/dt = (s(t) - s(t - w)) / w,     d2s~/dt2 = (v(t) - v(t - w)) / w

w = max 2 A_i / J_i: over that time a joint's acceleration may swing from -A to A. On a straight line in joint space
the result keeps all limits and the jerk; on curved paths it is measured (joints and motors, every 2 ms) and the whole
law is stretched in time by the smallest factor k that makes it legal: accelerations fall by k^2, jerks by k^3. The
path itself must have continuous curvature, so in this mode blends are quintics without curvature at their ends, and
where the curvature jumps (line to arc) the arm stops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .elements import Array
from .geometry import joints_along, path_points
from .law import PathLaw
from .limits import Limits

_PROBE_S = 2e-3
_MARGIN = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class JerkLaw:
    """A `PathLaw` from rest to rest, averaged over `window_s` and stretched by `stretch` in time."""

    base: PathLaw
    window_s: float
    stretch: float
    way: Array
    area: Array
    offsets: Array

    @classmethod
    def over(cls, base: PathLaw, limits: Limits, frame_s: float) -> JerkLaw:
        """The law for `base` that keeps the limits and the joints' jerk, a whole number of frames long."""
        window_s = float((2.0 * limits.joint_acceleration_deg_s2 / limits.jerk_deg_s3).max())
        spans = np.diff(base.time_s)
        lengths = base.stop - base.start
        way = np.concatenate((np.zeros(1), np.cumsum(lengths)))
        v0, v1 = base.speed[:-1], base.speed[1:]
        # integral of s over an interval: s0 T + v0 T^2 / 2 + u T^3 / 6
        pieces = way[:-1] * spans + spans**2 * (v0 / 2.0 + (v1 - v0) / 6.0)
        area = np.concatenate((np.zeros(1), np.cumsum(pieces)))
        ends = np.concatenate((np.zeros(1), np.cumsum(base.table.length)))
        law = cls(base, window_s, 1.0, way, area, ends)
        stretch = law._needed_stretch(limits) * (1.0 + _MARGIN)
        duration = (base.duration_s + window_s) * stretch
        frames = np.ceil(duration / frame_s - 1e-9)
        return cls(base, window_s, float(frames * frame_s / (base.duration_s + window_s)), way, area, ends)

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
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
        t = time_s / self.stretch
        area1, s1, v1 = self._at(t)
        area0, s0, v0 = self._at(t - self.window_s)
        w = self.window_s
        return (area1 - area0) / w, (s1 - s0) / (w * self.stretch), (v1 - v0) / (w * self.stretch**2)

    def _place(self, s: Array) -> tuple[NDArray[np.intp], Array]:
        lengths = self.base.table.length
        inside = np.clip(s, 0.0, self.offsets[-1])
        index = np.clip(np.searchsorted(self.offsets, inside, side="right") - 1, 0, len(lengths) - 1)
        return index, np.clip(inside - self.offsets[index], 0.0, lengths[index])

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

    def _needed_stretch(self, limits: Limits) -> float:
        count = max(32, int(self.duration_s / _PROBE_S))
        times = np.linspace(0.0, self.duration_s, count + 1)
        _, rates, accelerations = self.states(times)
        jerks = np.diff(accelerations, axis=0) / (times[1] - times[0])
        tool = np.inf
        speed = float((np.abs(rates @ limits.rows.T) / limits.velocity).max())
        acceleration = float((np.abs(accelerations @ limits.rows.T) / limits.acceleration).max())
        jerk = float((np.abs(jerks) / limits.jerk_deg_s3).max())
        feed = np.minimum(self.base.table.feed_mm_s, limits.tcp_speed_mm_s)
        if np.isfinite(feed).any():
            way, v, _ = self._path(times)
            index, s = self._place(way)
            points = path_points(self.base.arm, self.base.table, index, s)
            tool = float((np.linalg.norm(points.p1, axis=1) * v / feed[index]).max())
            speed = max(speed, tool)
        needed = (1.0, speed * 1.0005, float(np.sqrt(acceleration * 1.001)), float(np.cbrt(jerk * 1.01)))
        return max(needed)

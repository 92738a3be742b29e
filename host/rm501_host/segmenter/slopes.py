"""How steeply a hold or a stop may change the rate of motion time on each segment.

At rate r a motor's real acceleration is r^2 a + r' v, so |a| + slope |v| <= ratio * A bounds the slope:
(ratio A - |a|) / |v|, the least over motors and frames. A ramp that starts on one segment goes on over those that
follow, and the board judges by the slope of the one it is on whether it can still stop in time; so each segment
carries the least slope of all that lie within the longest ramp ahead of it, or up to the next rest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rm501_host.config import Config
from rm501_protocol.enums import SegmentFlag

from .fit import Cubic
from .motors import MotorMap

if TYPE_CHECKING:
    from .segmenter import PlannedSegment

SLOPE_UNITS = 1 << 20
"""Slopes travel in 2^-20 rate per real frame."""
STEEPEST = 0xFFFF
_SAMPLES = 9


class Slopes:
    """Gives each segment its slopes, holding it back until what follows within the ramp is known."""

    def __init__(self, config: Config, motors: MotorMap) -> None:
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self._acceleration = motors.limits.motor_acceleration_steps_s2 * self._frame_s**2
        self._hold = config.planner.hold_acceleration_ratio
        self._stop = config.planner.stop_acceleration_ratio
        self._waiting: deque[PlannedSegment] = deque()

    def local(self, cubic: Cubic, frames: int) -> tuple[float, float]:
        """Hold and stop slope of one polynomial by itself, in rate per real frame."""
        n = np.linspace(0.0, frames + 1.0, _SAMPLES)[:, None]
        speed = np.abs(cubic.b + n * (2.0 * cubic.c + 3.0 * n * cubic.d))
        acceleration = np.abs(2.0 * cubic.c + 6.0 * n * cubic.d)
        moving = np.maximum(speed, 1e-12)
        hold = float(((self._hold * self._acceleration - acceleration) / moving).min())
        stop = float(((self._stop * self._acceleration - acceleration) / moving).min())
        least = 1.0 / SLOPE_UNITS
        return max(hold, least), max(stop, least)

    def add(self, planned: PlannedSegment) -> Iterator[PlannedSegment]:
        """Take the next segment; yield those whose slopes are settled."""
        self._waiting.append(planned)
        if planned.segment.flags & SegmentFlag.ENDS_AT_REST:
            yield from self.finish()
            return
        while self._waiting:
            head = self._waiting[0]
            slope = min(item.hold_slope_local for item in self._waiting)
            # a ramp from rate 1 at this slope takes 1 / (2 slope) of motion time
            if planned.end_frame - head.end_frame < 0.5 / slope:
                return
            yield self._settled()

    def finish(self) -> Iterator[PlannedSegment]:
        """Yield everything: the last one ends at rest."""
        while self._waiting:
            yield self._settled()

    def _settled(self) -> PlannedSegment:
        head = self._waiting[0]
        hold = stop = float("inf")
        for item in self._waiting:
            if item is not head and item.start_frame - head.end_frame > 0.5 / hold:
                break
            hold = min(hold, item.hold_slope_local)
            stop = min(stop, item.stop_slope_local)
        self._waiting.popleft()
        segment = replace(head.segment, hold_slope=_units(hold), stop_slope=_units(stop))
        return replace(head, segment=segment)


def _units(slope: float) -> int:
    return max(1, min(STEEPEST, int(min(slope, 1.0) * SLOPE_UNITS)))

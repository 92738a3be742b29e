"""How far ahead motion must be queued: what an on-path stop consumes, plus the stall budget.

From rate 1 at slope k per real frame the ramp takes 1/k real frames and 1/(2k) motion frames; or less, where the arm
comes to rest before.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rm501_host.config import Config
from rm501_protocol.enums import SegmentFlag

from .segmenter import PlannedSegment
from .slopes import SLOPE_UNITS


@dataclass(frozen=True, slots=True)
class Horizon:
    """Longest motion time that a hold and a stop consume, the lead to keep queued, and how many segments that takes.

    `tail_s`: rests, all together, in which play is still being taken up after the law has ended.
    """

    hold_s: float
    stop_s: float
    lead_s: float
    lead_segments: int
    tail_s: float


def stop_horizon(config: Config, planned: Iterable[PlannedSegment]) -> Horizon:
    """The horizon of these segments; each carries its slopes already."""
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    segments = list(planned)
    rest = 0
    hold = stop = 0.0
    for item in reversed(segments):
        if item.segment.flags & SegmentFlag.ENDS_AT_REST:
            rest = item.end_frame
        if not item.segment.motors:
            continue
        left = rest - item.start_frame
        hold = max(hold, min(left, 0.5 * SLOPE_UNITS / item.segment.hold_slope))
        stop = max(stop, min(left, 0.5 * SLOPE_UNITS / item.segment.stop_slope))
    lead = hold * frame_s + config.planner.stall_budget_s
    most = first = 0
    for last, item in enumerate(segments):
        while segments[first].end_frame < item.start_frame - lead / frame_s:
            first += 1
        most = max(most, last - first + 1)
    tail_frames = sum(item.tail_frames for item in segments)
    return Horizon(hold * frame_s, stop * frame_s, lead, most, tail_frames * frame_s)

"""Cutting the queue of a moving board and going on with another law from there: what an override above 100 % does.

    choose    a boundary of the queue that lies beyond the stop horizon, with time for planning and for the wire
    prepare   the new law and its first segments from that boundary, while the old ones go on being played
    cut       Truncate at the boundary, if anything beyond it has been sent; nothing else is sent meanwhile
    answer    Truncated: the mirror goes back to the boundary, whose positions are known to the last bit, and the new
              segments follow. Refused, because the board is too near to it by now: nothing has happened, the old law
              goes on, and another boundary is tried, with more time.

Whatever comes late, the worst is that the board runs low before the new segments arrive: then it stops on its path and
is resumed, as always.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.motion.mirror import Mirror
from rm501_host.planner import Piece
from rm501_host.segmenter import PlannedSegment, Segmenter
from rm501_protocol.enums import SegmentFlag

BATCH = 8
"""Segments planned at a time away from the event loop: long enough to be worth a thread, short enough to stop soon.
"""
FIRST_BATCH = 2
"""The same before the start, which somebody waits for."""
_NEWS_S = 0.1
"""How old the board's last word on where it is may be, and how long a message may take there."""
_ROOM = 1 << 19
"""Sum of slopes that brakes from rate 1 (`firmware.md`)."""
_LONGEST_S = 0.5
"""An arc about the waist is one cubic from its start to its end, 6 s in the thesis's program."""
PLANNING_SHARES = (0.3, 1.0, 2.0, 3.0, 4.0)
"""What each attempt leaves for planning, in stall budgets: a plan takes 0.05 s, and one that comes too late costs
nothing but the next attempt.
"""


@runtime_checkable
class Respeedable(Protocol):
    """Pieces whose law can be replaced while they are played (`motion.live.LivePath`)."""

    def __iter__(self) -> Iterator[Piece]:
        """The pieces as they are now."""
        ...

    @property
    def is_respeed_wanted(self) -> bool:
        """Whether another law is wanted."""
        ...

    def may_respeed(self, planned: PlannedSegment) -> bool:
        """Whether another law can take over at the start of this segment, and would differ."""
        ...

    def respeeded(self, planned: PlannedSegment) -> Iterator[Piece]:
        """The pieces of the other law from the start of this segment; plans, raises PlanError."""
        ...

    def adopt(self) -> None:
        """The other law has taken over."""
        ...

    def discard(self, why: str, *, for_good: bool) -> None:
        """It has not, and why; `for_good`: it will not be tried again before the wish changes."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Takeover:
    """Segments that go on from the start of `at`: the first of them and the rest."""

    at: PlannedSegment
    first: list[PlannedSegment]
    others: Iterator[PlannedSegment]


def longest_frames(config: Config) -> int:
    """How long segments may be whose law may be replaced: another law takes over at their boundaries only."""
    return round(_LONGEST_S / (config.board.base_period_us * len(config.board.table) * 1e-6))


def takeover_place(
    config: Config,
    live: Respeedable,
    mirror: Mirror,
    waiting: deque[PlannedSegment],
    now_frame: int,
    attempts: int,
) -> tuple[PlannedSegment, PlannedSegment] | None:
    """The segment at whose start another law may take over, and the one before it; None where there is none yet."""
    known = [*mirror.sent, *waiting]
    earliest = earliest_cut(config, known, now_frame, PLANNING_SHARES[attempts] * config.planner.stall_budget_s)
    if earliest is None:
        return None
    for before, planned in pairwise(known):
        if planned.start_frame >= earliest and live.may_respeed(planned):
            return planned, before
    return None


def earliest_cut(
    config: Config, known: Sequence[PlannedSegment], now_frame: int, planning_s: float = 0.0
) -> int | None:
    """The first boundary at which the board could still stop when it hears of the cut, by its own rule, with so much
    time for planning before.
    """
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    soon = now_frame + round((_NEWS_S + planning_s) / frame_s)
    room = 0
    for planned in known:
        left = planned.end_frame - max(planned.start_frame, soon)
        if left <= 0:
            continue
        if planned.segment.flags & SegmentFlag.ENDS_AT_REST:
            return planned.end_frame
        room += planned.segment.hold_slope * left
        if room > _ROOM + 2 * planned.segment.hold_slope:
            return planned.end_frame
    return None


def prepared(config: Config, live: Respeedable, at: PlannedSegment, before: PlannedSegment) -> Takeover:
    """Plan and segment from the start of `at` on, where motion has the speed at the end of `before`."""
    segmenter = Segmenter(
        config,
        at.start_q48,
        at.start_frame,
        before.offsets,
        end_speed(before),
        most_frames=longest_frames(config),
    )
    segments = segmenter.segments(live.respeeded(at))
    return Takeover(at, list(islice(segments, BATCH)), segments)


def end_speed(planned: PlannedSegment) -> NDArray[np.float64]:
    """Speed (5,) of the arm's motors at the end of a segment, in steps/frame: the derivative of its polynomial."""
    speed = np.zeros(5)
    if planned.segment.flags & SegmentFlag.ENDS_AT_REST:
        return speed
    n = planned.segment.length_frames
    for term in planned.segment.motors:
        v, a, j = term.v << 16, term.a << 8, term.j
        v, a = v + n * a + n * (n - 1) // 2 * j, a + n * j
        speed[term.motor] = (v - a / 2 + j / 3) / 2.0**48
    return speed

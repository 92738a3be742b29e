"""Where the board's queue ends, to the last bit, and which segments lead there."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from rm501_host.config import Config
from rm501_host.motion.offsets import PlayOffsets
from rm501_host.segmenter import PlannedSegment
from rm501_protocol.segment import end_positions_q48

_BOARD_EVENTS = 32
"""Output and hand events that a board holds at once, over all queued segments (the firmware's ring of events)."""


class Mirror:
    """Follows the board's integer arithmetic over the segments that are sent to it.

    `positions_q48`: exact positions of all motors where the queue ends, in 2^-48 step; `end_frame`: the motion frame of
    that, never wrapping; `offsets`: how much of the positions is play taken up; `sent`: the segments that are not
    played yet, as far as is known.
    """

    def __init__(self, config: Config) -> None:
        self.positions_q48: tuple[int, ...] = ()
        self.end_frame = 0
        self.offsets = PlayOffsets(config)
        self.sent: deque[PlannedSegment] = deque()

    def stand(self, positions_q48: Sequence[int], end_frame: int) -> None:
        """Nothing is queued, motion stands here."""
        self.positions_q48 = tuple(positions_q48)
        self.end_frame = end_frame
        self.offsets.end_at(end_frame)
        self.sent.clear()

    def end_at(self, positions_q48: Sequence[int], end_frame: int) -> None:
        """Motion ended before its queue did; may be told twice. `sent` still tells what it was."""
        self.positions_q48 = tuple(positions_q48)
        self.end_frame = end_frame
        self.offsets.end_at(end_frame)

    def add(self, planned: PlannedSegment) -> None:
        """A segment is handed to the link; it starts where the queue ends."""
        assert planned.start_frame == self.end_frame
        self.positions_q48 = end_positions_q48(self.positions_q48, planned.segment)
        self.end_frame += planned.segment.length_frames
        self.offsets.add(planned)
        self.sent.append(planned)

    def back_to(self, frame: int) -> list[PlannedSegment]:
        """The queue ends at this boundary after all; gives what is not in it any more, oldest first."""
        dropped: list[PlannedSegment] = []
        while self.sent and self.sent[-1].start_frame >= frame:
            dropped.append(self.sent.pop())
        if dropped:
            self.positions_q48, self.end_frame = dropped[-1].start_q48, dropped[-1].start_frame
            self.offsets.cut_at(self.end_frame)
        return dropped[::-1]

    def forget_played(self, frame: int) -> None:
        """Motion has come to this frame; the segment that brought it there stays known."""
        while len(self.sent) > 1 and self.sent[0].end_frame <= frame:
            self.sent.popleft()

    def under_way(self, frame: int) -> PlannedSegment | None:
        """The segment that is played, or begins, at a frame; None where none is known."""
        for planned in self.sent:
            if planned.start_frame <= frame < planned.end_frame:
                return planned
        return self.sent[-1] if self.sent and self.sent[-1].end_frame == frame else None

    def between(self, first_frame: int, last_frame: int) -> tuple[PlannedSegment, ...]:
        """Segments that are played between two frames."""
        return tuple(p for p in self.sent if p.end_frame > first_frame and p.start_frame <= last_frame)

    def takes_events_of(self, planned: PlannedSegment, played_frame: int) -> bool:
        """Whether the board's queue of events has room for those of one more segment."""
        if not planned.segment.events:
            return True
        waiting = sum(
            item.start_frame + event.offset_frames >= played_frame
            for item in self.sent
            for event in item.segment.events
        )
        return waiting + len(planned.segment.events) <= _BOARD_EVENTS

"""Output changes on the way: from the times of the ideal law to frames of segments, none lost, none too many."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

from rm501_host.planner.pieces import EventKind, Piece, PieceEvent
from rm501_protocol.segment_message import MAX_EVENTS, SegmentEvent, hand_event, output_event


def wire_event(offset_frames: int, event: PieceEvent) -> SegmentEvent:
    """The event as a segment carries it."""
    if event.kind is EventKind.HAND:
        return hand_event(offset_frames, event.value)
    return output_event(offset_frames, event.mask, event.levels)


class EventsAhead:
    """The events of moving pieces that no segment carries yet, in order, each with its frame.

    An event belongs to the first frame that is not before its time; those of one frame become one. A segment carries
    eight at most: `last_end` is where it has to end for that. At a rest everything goes with its last segment.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, PieceEvent]] = []

    def add(self, piece: Piece, origin_frame: float, frame_s: float) -> None:
        """Take the events of a piece whose time 0 lies at `origin_frame`."""
        for event in piece.events:
            frame = ceil(event.offset_s / frame_s + origin_frame - 1e-6)
            if self._waiting:
                before, other = self._waiting[-1]
                if before == frame and event.kind is other.kind is EventKind.OUTPUT:
                    levels = other.levels & ~event.mask | event.levels
                    self._waiting[-1] = frame, replace(other, mask=other.mask | event.mask, levels=levels)
                    continue
            self._waiting.append((frame, event))

    @property
    def last_end(self) -> int | None:
        """The frame at which the next segment must end at the latest, None: anywhere."""
        return self._waiting[MAX_EVENTS][0] if len(self._waiting) > MAX_EVENTS else None

    def take(self, first: int, frames: int, *, ends_at_rest: bool) -> tuple[SegmentEvent, ...]:
        """The events of the segment over [first, first + frames)."""
        count = 0
        for frame, _ in self._waiting[:MAX_EVENTS]:
            if frame >= first + frames and not ends_at_rest:
                break
            count += 1
        taken, self._waiting = self._waiting[:count], self._waiting[count:]
        return tuple(wire_event(min(max(frame - first, 0), frames - 1), event) for frame, event in taken)

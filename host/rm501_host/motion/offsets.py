"""How much of the motors' positions is play taken up: at every motion frame that is queued, and where motion ended."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from rm501_host.segmenter import NO_OFFSETS, OffsetLaw, PlannedSegment

_MOST_KEPT = 512
"""Segments remembered: a board's queue and what the link holds are far fewer."""


class PlayOffsets:
    """Follows the segments that are sent; joints are what the motors stand for, less these offsets.

    Without play, and before anything is known, all of them are 0: the middle of the play.
    """

    def __init__(self) -> None:
        self._sent: deque[PlannedSegment] = deque(maxlen=_MOST_KEPT)
        self._rest: OffsetLaw = NO_OFFSETS

    @property
    def law(self) -> OffsetLaw:
        """The offsets where the queue ends, to go on from."""
        return self._sent[-1].offsets if self._sent else self._rest

    @property
    def deg(self) -> tuple[float, ...]:
        """Offsets (5,) in deg where the queue ends."""
        last = self._sent[-1] if self._sent else None
        return last.offsets.offsets_deg(last.end_frame) if last is not None else self._rest.offsets_deg(0)

    def set(self, offsets_deg: Sequence[float]) -> None:
        """They are these (5,) now, at rest."""
        self._sent.clear()
        self._rest = OffsetLaw.still(offsets_deg) if any(offsets_deg) else NO_OFFSETS

    def add(self, planned: PlannedSegment) -> None:
        """A segment has been sent."""
        if planned.offsets is not NO_OFFSETS:
            self._sent.append(planned)

    def at(self, frame: int) -> tuple[float, ...]:
        """Offsets (5,) in deg at a motion frame (64 bits); outside what is known those of its nearer end."""
        for planned in self._sent:
            if frame <= planned.end_frame:
                return planned.offsets.offsets_deg(max(frame, planned.start_frame))
        return self.deg

    def end_at(self, frame: int) -> None:
        """Motion ended at this motion frame, earlier than what was sent: what came after has not happened."""
        if self._sent:
            self.set(self.at(frame))

    def cut_at(self, frame: int) -> None:
        """What was sent from this motion frame on is replaced; motion goes on from there."""
        while self._sent and self._sent[-1].start_frame >= frame:
            dropped = self._sent.pop()
            if not self._sent:
                # nothing is known before it: it began at rest
                self.set(dropped.offsets.offsets_deg(dropped.start_frame))

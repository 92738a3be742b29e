"""How much of the motors' positions is play taken up: at every motion frame that is queued, and where motion ended."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rm501_host.config import Config
from rm501_host.planner import Limits
from rm501_host.segmenter import NO_OFFSETS, OffsetLaw, PlannedSegment, play_columns

_MOST_KEPT = 512
"""Segments remembered: a board's queue and what the link holds are far fewer."""


class _Sent(NamedTuple):
    """A segment, without the plan behind it."""

    start_frame: int
    end_frame: int
    offsets: OffsetLaw


class PlayOffsets:
    """Follows the segments that are sent; joints are what the motors stand for, less these offsets.

    Without play, and before anything is known, all of them are 0: the middle of the play.
    """

    def __init__(self, config: Config) -> None:
        self._columns = play_columns(Limits.from_config(config))
        self._sent: deque[_Sent] = deque(maxlen=_MOST_KEPT)
        self._rest: OffsetLaw = NO_OFFSETS

    @property
    def law(self) -> OffsetLaw:
        """The offsets where the queue ends, to go on from."""
        return self._sent[-1].offsets if self._sent else self._rest

    @property
    def deg(self) -> tuple[float, ...]:
        """Offsets (5,) of the joints in deg where the queue ends."""
        return self.law.offsets_deg(self._end_frame)

    @property
    def leads_deg(self) -> tuple[float, ...]:
        """Offsets (7,) at the places of play (`planner.limits`) where the queue ends."""
        return self.law.leads_deg(self._end_frame)

    @property
    def _end_frame(self) -> int:
        return self._sent[-1].end_frame if self._sent else 0

    def set(self, leads_deg: Sequence[float]) -> None:
        """They are these at the places of play (7,) now, at rest."""
        self._sent.clear()
        self._rest = OffsetLaw.still(leads_deg, self._columns) if any(leads_deg) else NO_OFFSETS

    def add(self, planned: PlannedSegment) -> None:
        """A segment has been sent."""
        if planned.offsets is not NO_OFFSETS:
            self._sent.append(_Sent(planned.start_frame, planned.end_frame, planned.offsets))

    def at(self, frame: int) -> tuple[float, ...]:
        """Offsets (5,) of the joints in deg at a motion frame (64 bits); outside what is known those of its nearer
        end.
        """
        law, frame = self._around(frame)
        return law.offsets_deg(frame)

    def leads_at(self, frame: int) -> tuple[float, ...]:
        """The same at the places of play (7,)."""
        law, frame = self._around(frame)
        return law.leads_deg(frame)

    def _around(self, frame: int) -> tuple[OffsetLaw, int]:
        for sent in self._sent:
            if frame <= sent.end_frame:
                return sent.offsets, max(frame, sent.start_frame)
        return self.law, self._end_frame

    def end_at(self, frame: int) -> None:
        """Motion ended at this motion frame, earlier than what was sent: what came after has not happened."""
        if self._sent:
            self.set(self.leads_at(frame))

    def cut_at(self, frame: int) -> None:
        """What was sent from this motion frame on is replaced; motion goes on from there."""
        while self._sent and self._sent[-1].start_frame >= frame:
            dropped = self._sent.pop()
            if not self._sent:
                # nothing is known before it: it began at rest
                self.set(dropped.offsets.leads_deg(dropped.start_frame))


def flank_deg(limits: Limits, offsets: PlayOffsets, joint: int, way: float) -> float:
    """How far the motor side of a joint is ahead of its link once it has moved alone in the direction `way` (1, -1) far
    enough to take its play up.
    """
    return float(limits.play_columns[joint] @ np.array(limits.on_the_flank(offsets.leads_deg, joint, way)))

"""What the board has told about the motion under way.

A report may be overtaken by the status that shows the same: an end of motion that is told after the next motion has
begun is known by its real frame, and is nobody's any more.
"""

from __future__ import annotations

from rm501_host.session.board_session import Notice
from rm501_host.session.counters import FrameCounter
from rm501_protocol.messages import (
    ArmTrigger,
    FaultReport,
    MotionEnded,
    Refused,
    Start,
    TriggerReport,
    Truncate,
    Truncated,
)
from rm501_protocol.segment_message import Segment

_OF_THE_PLAY = (Segment.ID, Start.ID, ArmTrigger.ID)
"""A refusal of one of these ends a play; others are answers to whoever asked."""


class Reports:
    """The newest of each kind since `forget`; the first refusal, since those that follow it are for the gap it left.

    `real_frames`: the board's real frames, as the session follows them.
    """

    def __init__(self, real_frames: FrameCounter) -> None:
        self._real_frames = real_frames
        self._since_frame = 0
        self.ended: MotionEnded | None = None
        self.fault: FaultReport | None = None
        self.refused: Refused | None = None
        self.trigger: TriggerReport | None = None
        self.truncated: Truncated | None = None
        self.truncate_refused: Refused | None = None

    def forget(self) -> None:
        """A new play begins, on a board whose newest status shows it at rest."""
        self._since_frame = self._real_frames.value
        self.ended = self.fault = self.refused = self.trigger = None
        self.forget_truncate()

    def forget_truncate(self) -> None:
        """A Truncate is about to be sent: what comes now answers it."""
        self.truncated = self.truncate_refused = None

    def is_late(self, ended: MotionEnded) -> bool:
        """Whether this tells the end of a motion that was over when the play began."""
        return self._real_frames.extend(ended.real_frame) <= self._since_frame

    def listen(self, notice: Notice) -> None:
        """A listener of the session."""
        match notice:
            case MotionEnded():
                if not self.is_late(notice):
                    self.ended = notice
            case FaultReport():
                self.fault = notice
            case Truncated():
                self.truncated = notice
            case Refused(message_id=Truncate.ID):
                self.truncate_refused = notice
            case Refused() if notice.message_id in _OF_THE_PLAY:
                self.refused = self.refused or notice
            case TriggerReport():
                self.trigger = notice
            case _:
                pass

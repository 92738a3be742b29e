"""What the board has told about the motion under way."""

from __future__ import annotations

from rm501_host.session.board_session import Notice
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
    """The newest of each kind since `forget`; the first refusal, since those that follow it are for the gap it left."""

    def __init__(self) -> None:
        self.ended: MotionEnded | None = None
        self.fault: FaultReport | None = None
        self.refused: Refused | None = None
        self.trigger: TriggerReport | None = None
        self.truncated: Truncated | None = None
        self.truncate_refused: Refused | None = None

    def forget(self) -> None:
        """A new play begins."""
        self.ended = self.fault = self.refused = self.trigger = None
        self.forget_truncate()

    def forget_truncate(self) -> None:
        """A Truncate is about to be sent: what comes now answers it."""
        self.truncated = self.truncate_refused = None

    def listen(self, notice: Notice) -> None:
        """A listener of the session."""
        match notice:
            case MotionEnded():
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

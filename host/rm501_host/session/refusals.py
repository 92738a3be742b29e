"""What the board refused, in words."""

from __future__ import annotations

from rm501_host.errors import RefusedError
from rm501_protocol.declaration import registry
from rm501_protocol.faults import REFUSAL_TEXTS
from rm501_protocol.messages import NO_MOTOR, Refused


class BoardRefusedError(RefusedError):
    """The board refused a message as a whole; `refused` has the reason, the motor, the value and the limit.

    `where` the arm was, and what it does now (`then`), where it was under way.
    """

    def __init__(self, refused: Refused, where: str = "", then: str = "") -> None:
        self.refused = refused
        known = registry().get(refused.message_id)
        name = known.__name__ if known is not None else f"message 0x{refused.message_id:02x}"
        text = REFUSAL_TEXTS[refused.reason]
        motor = "" if refused.motor == NO_MOTOR else f", motor {refused.motor}"
        super().__init__(
            f"the board refused {name}{where}: {text.cause}{motor} "
            f"(value {refused.value}, limit {refused.limit}); {text.remedy}{then}"
        )

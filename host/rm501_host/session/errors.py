"""How a session ends that nobody ended.

::

    StoppedError
    └── LinkLostError                  the board cannot be reached any more
        ├── SessionLostError           it can, but knows nothing of the session
        └── ContradictionError         it says what cannot be
"""

from __future__ import annotations

from rm501_host.errors import StoppedError
from rm501_protocol.link_events import LossReason

__all__ = ["ContradictionError", "LinkLostError", "SessionLostError"]


class LinkLostError(StoppedError):
    """The board cannot be reached any more; what it does then is its own rule: it holds on the path and waits for a
    user. `reason`: why alone, without what the arm does and what to do.
    """

    def __init__(self, text: str, reason: str = "") -> None:
        super().__init__(text)
        self.reason = reason or text


class SessionLostError(LinkLostError):
    """The line is there, but the board knows nothing of the session any more; `loss` says why."""

    def __init__(self, loss: LossReason) -> None:
        super().__init__(
            f"the session with the board is over: {loss.value}; its queue and its position are lost: "
            "connect again and home the arm",
            loss.value,
        )
        self.loss = loss


class ContradictionError(LinkLostError):
    """The board reports what a sound one cannot: its positions are not to be trusted, whatever it says of them."""

    def __init__(self, contradiction: str) -> None:
        super().__init__(
            f"the board contradicts itself: {contradiction}; its firmware or memory is not sound, so no position is "
            "trusted any more: stop the arm, reset the board, and home every joint",
            f"the board contradicts itself: {contradiction}",
        )

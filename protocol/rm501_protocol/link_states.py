"""The states of a link and every transition between them; `docs/protocol.md` draws its diagrams from these tables.

What is not listed cannot happen: the link's own code would raise KeyError, and a test walks every combination that
the outside can bring about.
"""

from __future__ import annotations

from enum import Enum

__all__ = [
    "BOARD_TRANSITIONS",
    "HOST_TRANSITIONS",
    "STOP_TRANSITIONS",
    "BoardInput",
    "BoardSessionState",
    "HostInput",
    "HostState",
    "StopInput",
    "StopState",
]


class HostState(Enum):
    """The session, at the host."""

    CLOSED = "CLOSED"
    OPENING = "OPENING"
    OPEN = "OPEN"


class HostInput(Enum):
    """What moves the host's session."""

    CONNECT = "connect()"
    IDENTIFIED = "Identify with our nonce"
    REFUSED = "Identify with our nonce, of another major version or without a session"
    FOREIGN = "packet of an unknown epoch, or of a board without a session"


HOST_TRANSITIONS: dict[tuple[HostState, HostInput], HostState] = {
    (HostState.CLOSED, HostInput.CONNECT): HostState.OPENING,
    (HostState.OPENING, HostInput.CONNECT): HostState.OPENING,
    (HostState.OPEN, HostInput.CONNECT): HostState.OPENING,
    (HostState.OPENING, HostInput.IDENTIFIED): HostState.OPEN,
    (HostState.OPENING, HostInput.REFUSED): HostState.CLOSED,
    (HostState.OPEN, HostInput.FOREIGN): HostState.CLOSED,
}


class BoardSessionState(Enum):
    """The session, at the board."""

    CLOSED = "CLOSED"
    OPEN = "OPEN"


class BoardInput(Enum):
    """What moves the board's session."""

    NEW_HELLO = "Hello with a new nonce"
    OTHER_MAJOR = "Hello of another major version"


BOARD_TRANSITIONS: dict[tuple[BoardSessionState, BoardInput], BoardSessionState] = {
    (BoardSessionState.CLOSED, BoardInput.NEW_HELLO): BoardSessionState.OPEN,
    (BoardSessionState.OPEN, BoardInput.NEW_HELLO): BoardSessionState.OPEN,
    (BoardSessionState.CLOSED, BoardInput.OTHER_MAJOR): BoardSessionState.CLOSED,
    (BoardSessionState.OPEN, BoardInput.OTHER_MAJOR): BoardSessionState.OPEN,
}


class StopState(Enum):
    """A stop, at the host; independent of the session."""

    NONE = "NONE"
    ASKED = "ASKED"


class StopInput(Enum):
    """What moves a stop."""

    ASKED = "stop()"
    EXECUTED = "StopReply: executed"
    NOT_EXECUTED = "StopReply: not executed, ask beyond the board's generation"


STOP_TRANSITIONS: dict[tuple[StopState, StopInput], StopState] = {
    (StopState.NONE, StopInput.ASKED): StopState.ASKED,
    (StopState.ASKED, StopInput.ASKED): StopState.ASKED,
    (StopState.ASKED, StopInput.EXECUTED): StopState.NONE,
    (StopState.ASKED, StopInput.NOT_EXECUTED): StopState.ASKED,
}

"""The conversation with one board: port, handshake, configuration, messages, status."""

from rm501_host.session.board_session import BoardSession, open_session
from rm501_host.session.counters import FrameCounter
from rm501_host.session.errors import ContradictionError, LinkLostError, SessionLostError
from rm501_host.session.refusals import BoardRefusedError

__all__ = [
    "BoardRefusedError",
    "BoardSession",
    "ContradictionError",
    "FrameCounter",
    "LinkLostError",
    "SessionLostError",
    "open_session",
]

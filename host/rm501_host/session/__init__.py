"""The conversation with one board: port, handshake, configuration, messages, status."""

from rm501_host.session.board_session import BoardSession, LinkLostError, SessionLostError, open_session
from rm501_host.session.counters import FrameCounter
from rm501_host.session.refusals import BoardRefusedError

__all__ = [
    "BoardRefusedError",
    "BoardSession",
    "FrameCounter",
    "LinkLostError",
    "SessionLostError",
    "open_session",
]

"""The link between host and board: one state machine per end over one shared core, sans-IO.

::

    link.receive_data(data, now_us)          bytes that arrived
    link.next_event()                        what it means, until None
    link.send(message)                       queue a message
    link.data_to_send(now_us)                bytes to write: call it after each of the others and at
    link.next_deadline_us()                  the time by which `data_to_send` wants to be called again
"""

from __future__ import annotations

from .board_link import BoardLink
from .framing import PacketCodec, StreamCodec
from .host_link import HostLink
from .link_core import LinkStats
from .link_events import (
    Event,
    GenerationAdvanced,
    LinkHeard,
    LinkNoisy,
    LinkSilent,
    LossReason,
    Received,
    SessionLost,
    SessionOpened,
    SessionRefused,
    StopAcknowledged,
    StopKind,
    StopReceived,
    Undecodable,
)

__all__ = [
    "BoardLink",
    "Event",
    "GenerationAdvanced",
    "HostLink",
    "LinkHeard",
    "LinkNoisy",
    "LinkSilent",
    "LinkStats",
    "LossReason",
    "PacketCodec",
    "Received",
    "SessionLost",
    "SessionOpened",
    "SessionRefused",
    "StopAcknowledged",
    "StopKind",
    "StopReceived",
    "StreamCodec",
    "Undecodable",
]

"""The header that every packet begins with, in both directions.

::

    byte 0   message id
    byte 1   flags: 0 from the board | 1 session open | 2 nak | 3 sequenced
    byte 2   sequence: of this packet if sequenced, else of the sender's next sequenced packet
    byte 3   ack: the sequence that the sender expects next (everything before it arrived)
    byte 4-5 epoch of the session, little endian
    byte 6   stop generation
    byte 7   from the board: free slots of the segment queue, at the state that `ack` describes; from the host: 0
"""

from __future__ import annotations

import struct
from typing import NamedTuple

__all__ = [
    "FLAG_FROM_BOARD",
    "FLAG_NAK",
    "FLAG_OPEN",
    "FLAG_SEQUENCED",
    "HEADER",
    "HEADER_SIZE",
    "Header",
    "ahead",
    "parse_header",
]

FLAG_FROM_BOARD = 0x01
FLAG_OPEN = 0x02
FLAG_NAK = 0x04
FLAG_SEQUENCED = 0x08
_KNOWN_FLAGS = 0x0F

HEADER = struct.Struct("<BBBBHBB")
HEADER_SIZE = HEADER.size


class Header(NamedTuple):
    """A parsed header; fields as in the module's table."""

    message_id: int
    flags: int
    sequence: int
    ack: int
    epoch: int
    generation: int
    free_slots: int


def parse_header(packet: bytes) -> Header | None:
    """The header of `packet`, None when it is too short or carries unknown flags."""
    if len(packet) < HEADER_SIZE:
        return None
    header = Header._make(HEADER.unpack_from(packet))
    return None if header.flags & ~_KNOWN_FLAGS else header


def ahead(later: int, earlier: int) -> int:
    """How far the 8-bit number `later` is ahead of `earlier`, 0..255; below 128 means ahead or equal."""
    return (later - earlier) & 0xFF

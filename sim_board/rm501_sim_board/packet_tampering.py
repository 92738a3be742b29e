"""A board that lies about its queue: packets on their way to the host get another number of free slots."""

from __future__ import annotations

from collections.abc import Callable

from rm501_protocol.framing import StreamCodec
from rm501_protocol.header import HEADER, parse_header


def claim_free_slots(slots: int) -> Callable[[bytes], bytes]:
    """A filter for the board's byte stream that claims `slots` free slots in every packet."""
    codec = StreamCodec()

    def alter(data: bytes) -> bytes:
        out = bytearray()
        for packet in codec.feed(data):
            header = parse_header(packet)
            if header is not None:
                packet = HEADER.pack(*header._replace(free_slots=slots)) + packet[HEADER.size :]
            out += codec.encode(packet)
        return bytes(out)

    return alter

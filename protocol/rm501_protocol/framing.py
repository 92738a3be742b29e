"""Packets on the wire: header, payload, CRC-32, and on a byte stream COBS with a zero delimiter.

::

    packet   header (8 bytes, see `header`) | payload (0..242) | CRC-32 of both, little endian     at most 254 bytes
    stream   COBS(packet) | 0x00                                                                    at most 256 bytes

The CRC is zlib's. A CRC-16 is not enough: one without a final XOR accepted a single flipped delimiter bit in 400 of
400 frames. Whatever arrives, the decoders never raise, never hold more than one frame, and are in step again at the
next delimiter.
"""

from __future__ import annotations

import zlib

from cobs import cobs

__all__ = ["CRC_SIZE", "FRAME_OVERHEAD", "MAX_FRAME", "MAX_PACKET", "PacketCodec", "StreamCodec"]

CRC_SIZE = 4
MAX_PACKET = 254
"""Header, payload and CRC: one COBS block, so stuffing adds exactly one byte."""
MAX_FRAME = MAX_PACKET + 1
"""Longest stuffed frame without its delimiter; what is longer cannot be one of ours."""
FRAME_OVERHEAD = 8 + CRC_SIZE + 2
"""Bytes on a serial line beyond the payload: header, checksum, stuffing, delimiter."""
_CRC_OF_ANYTHING_WITH_ITS_CRC = 0x2144DF1C  # zlib.crc32(x + crc32(x).to_bytes(4, "little")) for every x


class StreamCodec:
    """Packets on a stream of bytes."""

    __slots__ = ("_bad_frames", "_buffer", "_skipping")

    def __init__(self) -> None:
        self._buffer = b""
        self._skipping = False
        self._bad_frames = 0

    @property
    def delimiter(self) -> bytes:
        """A zero byte."""
        return b"\x00"

    @property
    def bad_frames(self) -> int:
        """Frames dropped so far: stuffing or checksum wrong, or too long."""
        return self._bad_frames

    def encode(self, packet: bytes) -> bytes:
        """`packet` with checksum, stuffed, with the delimiter at its end."""
        stuffed: bytes = cobs.encode(packet + zlib.crc32(packet).to_bytes(4, "little"))
        return stuffed + b"\x00"

    def feed(self, data: bytes) -> list[bytes]:
        """Packets (without checksum) that `data` completes."""
        packets: list[bytes] = []
        *frames, rest = data.split(b"\x00")
        for frame in frames:
            if self._skipping:
                self._skipping = False
                continue
            if self._buffer:
                frame = self._buffer + frame
                self._buffer = b""
            if frame:
                packet = self._packet(frame)
                if packet is None:
                    self._bad_frames += 1
                else:
                    packets.append(packet)
        if rest and not self._skipping:
            if len(self._buffer) + len(rest) > MAX_FRAME:
                self._buffer = b""
                self._skipping = True
                self._bad_frames += 1
            else:
                self._buffer += rest
        return packets

    @property
    def buffered(self) -> int:
        """Bytes of an unfinished frame held now, never more than MAX_FRAME."""
        return len(self._buffer)

    @staticmethod
    def _packet(frame: bytes) -> bytes | None:
        if len(frame) > MAX_FRAME:
            return None
        try:
            raw = cobs.decode(frame)
        except cobs.DecodeError:
            return None
        return _checked(raw)


class PacketCodec:
    """Packets on a transport that keeps their borders (CAN transfers): the checksum only."""

    __slots__ = ("_bad_frames",)

    def __init__(self) -> None:
        self._bad_frames = 0

    @property
    def delimiter(self) -> bytes:
        """Nothing: the transport keeps packets apart."""
        return b""

    @property
    def bad_frames(self) -> int:
        """Packets dropped so far: checksum wrong or length impossible."""
        return self._bad_frames

    def encode(self, packet: bytes) -> bytes:
        """`packet` with checksum."""
        return packet + zlib.crc32(packet).to_bytes(4, "little")

    def feed(self, data: bytes) -> list[bytes]:
        """The packet in `data`, which must be exactly one."""
        packet = _checked(data) if len(data) <= MAX_PACKET else None
        if packet is None:
            self._bad_frames += 1
            return []
        return [packet]


def _checked(raw: bytes) -> bytes | None:
    if len(raw) <= CRC_SIZE or zlib.crc32(raw) != _CRC_OF_ANYTHING_WITH_ITS_CRC:
        return None
    return raw[:-CRC_SIZE]

"""Packets on CAN: each is a transfer of frames under one identifier.

::

    id (11 bits)    class (3) | direction (1) | node (7)        class 0 wins the bus: stops, then clock, then the rest
    frame           up to 7 (classic) or 63 (FD) bytes of the transfer, then the tail byte
    tail            bit 7 start of transfer, bit 6 end, bit 5 toggle, bits 0-4 transfer id
    transfer        length of the packet (u8) | packet with its CRC-32 | zeros up to a length that CAN FD has

Toggle is 1 in the first frame and alternates; the transfer id counts per class. One identifier per transfer means
that its frames cannot overtake each other on the way. A frame that is lost, repeated or out of order makes the
receiver drop the whole transfer; sequence and retransmission of the link do the rest. The tail follows Cyphal's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from .framing import MAX_PACKET
from .messages import ClockQuery, ClockReply, Kill, Stop, StopReply

__all__ = [
    "CLASS_CLOCK",
    "CLASS_NORMAL",
    "CLASS_STOP",
    "CanFrame",
    "TransferReceiver",
    "TransferSender",
    "TransferStats",
    "can_id",
    "class_of",
]

CLASS_STOP: Final = 0
CLASS_CLOCK: Final = 1
CLASS_NORMAL: Final = 4
_CLASSES = {
    Stop.ID: CLASS_STOP,
    Kill.ID: CLASS_STOP,
    StopReply.ID: CLASS_STOP,
    ClockQuery.ID: CLASS_CLOCK,
    ClockReply.ID: CLASS_CLOCK,
}

_START, _END, _TOGGLE, _TRANSFER = 0x80, 0x40, 0x20, 0x1F
_FD_LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_MAX_TRANSFER = 1 + MAX_PACKET


class CanFrame(NamedTuple):
    """One frame: 11-bit identifier and up to 8 or 64 bytes."""

    can_id: int
    data: bytes


def can_id(transfer_class: int, from_board: bool, node: int) -> int:
    """The identifier; raises ValueError outside class 0..7, node 0..127."""
    if not 0 <= transfer_class <= 7 or not 0 <= node <= 127:
        raise ValueError(f"class {transfer_class} must be 0..7 and node {node} 0..127")
    return transfer_class << 8 | int(from_board) << 7 | node


def class_of(packet: bytes) -> int:
    """The class that a packet travels in."""
    return _CLASSES.get(packet[0], CLASS_NORMAL)


class TransferSender:
    """Cuts packets into frames. `frame_bytes` is 8 for classic CAN, up to 64 for FD."""

    def __init__(self, node: int, *, from_board: bool, frame_bytes: int = 8) -> None:
        if frame_bytes not in _FD_LENGTHS or frame_bytes < 8:
            raise ValueError(f"frame_bytes = {frame_bytes}: must be 8, 12, 16, 20, 24, 32, 48 or 64")
        can_id(0, from_board, node)
        self._node = node
        self._from_board = from_board
        self._room = frame_bytes - 1
        self._next_transfer = [0] * 8

    def frames(self, packet: bytes) -> list[CanFrame]:
        """The frames of one packet (with its checksum, as `PacketCodec.encode` gives it)."""
        if not 1 <= len(packet) <= MAX_PACKET:
            raise ValueError(f"a packet has 1..{MAX_PACKET} bytes, not {len(packet)}")
        transfer_class = class_of(packet)
        transfer = self._next_transfer[transfer_class]
        self._next_transfer[transfer_class] = (transfer + 1) & _TRANSFER
        identifier = can_id(transfer_class, self._from_board, self._node)
        content = bytes((len(packet),)) + packet
        frames = []
        toggle = _TOGGLE
        for start in range(0, len(content), self._room):
            part = content[start : start + self._room]
            tail = transfer | toggle
            if start == 0:
                tail |= _START
            if start + self._room >= len(content):
                tail |= _END
                part += bytes(_padded(len(part) + 1) - len(part) - 1)
            frames.append(CanFrame(identifier, part + bytes((tail,))))
            toggle ^= _TOGGLE
        return frames


def _padded(length: int) -> int:
    return next(size for size in _FD_LENGTHS if size >= length)


@dataclass(slots=True)
class TransferStats:
    """Counters of a receiver."""

    frames: int = 0
    dropped_transfers: int = 0
    """Transfers begun and not delivered: a frame was lost, repeated or out of order, or the length was wrong."""
    stray_frames: int = 0
    """Frames of no transfer in progress, of another node or direction, or empty."""


class _Assembly:
    __slots__ = ("content", "toggle", "transfer")

    def __init__(self, transfer: int, content: bytes) -> None:
        self.transfer = transfer
        self.content = bytearray(content)
        self.toggle = 0


class TransferReceiver:
    """Puts frames of one node and direction together again; at most one unfinished transfer per class, 255 bytes
    each.
    """

    def __init__(self, node: int, *, from_board: bool) -> None:
        self._match = can_id(0, from_board, node)
        self._assemblies: list[_Assembly | None] = [None] * 8
        self.stats = TransferStats()

    def feed(self, frame: CanFrame) -> bytes | None:
        """The packet (with its checksum) that `frame` completes, None when it completes none. Never raises."""
        self.stats.frames += 1
        identifier, data = frame
        if identifier & 0xFF != self._match or identifier > 0x7FF or not 2 <= len(data) <= 64:
            self.stats.stray_frames += 1
            return None
        transfer_class = identifier >> 8
        tail = data[-1]
        transfer = tail & _TRANSFER
        assembly = self._assemblies[transfer_class]
        if tail & _START:
            return self._begin(transfer_class, transfer, tail, data)
        if assembly is None:
            self.stats.stray_frames += 1
            return None
        expected_toggle = bool(assembly.toggle)
        if assembly.transfer != transfer or bool(tail & _TOGGLE) != expected_toggle:
            self._drop(transfer_class)
            return None
        assembly.content += data[:-1]
        assembly.toggle = not expected_toggle
        if len(assembly.content) > _MAX_TRANSFER + 63:
            self._drop(transfer_class)
            return None
        return self._finish(transfer_class) if tail & _END else None

    def _begin(self, transfer_class: int, transfer: int, tail: int, data: bytes) -> bytes | None:
        assembly = self._assemblies[transfer_class]
        if assembly is not None:
            repeated = assembly.transfer == transfer
            self._drop(transfer_class)
            if repeated:
                return None
        if not tail & _TOGGLE:
            self.stats.stray_frames += 1
            return None
        self._assemblies[transfer_class] = _Assembly(transfer, data[:-1])
        return self._finish(transfer_class) if tail & _END else None

    def _finish(self, transfer_class: int) -> bytes | None:
        assembly = self._assemblies[transfer_class]
        assert assembly is not None
        length = assembly.content[0]
        content = bytes(assembly.content[1 : 1 + length])
        if not 1 <= length <= MAX_PACKET or len(content) != length or any(assembly.content[1 + length :]):
            self._drop(transfer_class)
            return None
        self._assemblies[transfer_class] = None
        return content

    def _drop(self, transfer_class: int) -> None:
        self._assemblies[transfer_class] = None
        self.stats.dropped_transfers += 1

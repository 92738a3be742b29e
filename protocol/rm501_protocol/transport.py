"""What a transport of bytes looks like to the code above it: typing protocols only, no I/O here.

Implementations live with the host (serial, sockets, CAN) and with the emulated board; the entry-point group
`rm501.transports` maps a URL scheme to an ``async open_transport(url) -> Transport``.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

__all__ = ["Codec", "OpenTransport", "Receiver", "Transport"]


@runtime_checkable
class Receiver(Protocol):
    """Who gets what arrives; both methods are called on the event loop's thread and must not block."""

    def data_received(self, data: bytes) -> None:
        """Some bytes arrived (in `packets` mode: exactly one packet)."""
        ...

    def connection_lost(self, exc: Exception | None) -> None:
        """The transport is gone: `exc` says why, None after `aclose`. Called once; nothing follows."""
        ...


@runtime_checkable
class Transport(Protocol):
    """An open connection to a board."""

    @property
    def packets(self) -> bool:
        """False: a stream of bytes, framed with COBS. True: whole packets, each checked by its CRC-32 (CAN
        transfers).
        """
        ...

    @property
    def bytes_per_second(self) -> int | None:
        """Line speed in payload bytes per second, None when it is not a bottleneck."""
        ...

    def start(self, receiver: Receiver) -> None:
        """Deliver what arrives to `receiver` from now on."""
        ...

    def write(self, data: bytes) -> None:
        """Queue bytes for sending; never blocks. Raises TransportClosedError after the end."""
        ...

    async def aclose(self) -> None:
        """Close, let go of the port; the receiver's `connection_lost` is called with None. May be called twice."""
        ...


class OpenTransport(Protocol):
    """What an entry point of `rm501.transports` names."""

    async def __call__(self, url: str) -> Transport:
        """Open `url`; raises OSError with a remedy in its text."""
        ...


class Codec(Protocol):
    """How packets travel on a transport: `encode` one packet to bytes, `feed` bytes and get the whole good packets
    that they complete.
    """

    @property
    def delimiter(self) -> bytes:
        """What ends a packet, and may be put before one to shake off noise; empty when packets are kept apart."""
        ...

    @property
    def bad_frames(self) -> int:
        """What was dropped so far: stuffing, checksum or length wrong."""
        ...

    def encode(self, packet: bytes) -> bytes:
        """Bytes to write for one packet."""
        ...

    def feed(self, data: bytes) -> list[bytes]:
        """Packets completed by `data`; anything broken is counted and dropped."""
        ...

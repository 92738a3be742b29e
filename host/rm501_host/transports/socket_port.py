"""TCP: ``socket://host:port``."""

from __future__ import annotations

import asyncio
import socket
from typing import cast
from urllib.parse import urlsplit

from rm501_protocol.transport import Transport

from .errors import PortError
from .stream import WRITE_CAP_BYTES, StreamBase

__all__ = ["SocketTransport", "open_transport"]


async def open_transport(url: str) -> Transport:
    """Connect; raises PortError."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise PortError(url, f"{error}; write socket://host:port") from None
    if not host or port is None or parts.path.strip("/") or parts.query:
        raise PortError(url, "write socket://host:port")
    transport = SocketTransport(url)
    try:
        await asyncio.get_running_loop().create_connection(lambda: _Connection(transport), host, port)
    except OSError as error:
        reason = error.strerror or str(error)
        raise PortError(url, f"{reason}; is the board or emulator listening there?") from error
    return transport


class SocketTransport(StreamBase):
    """A TCP connection."""

    def __init__(self, url: str) -> None:
        super().__init__(url, None)
        self._transport: asyncio.Transport | None = None

    def write(self, data: bytes) -> None:
        """Queue for sending."""
        self._require_open()
        assert self._transport is not None
        self._transport.write(data)
        if self._transport.get_write_buffer_size() > WRITE_CAP_BYTES:
            self._transport.abort()
            self._end(PortError(self.url, "takes no data; check the network and the board"))

    async def aclose(self) -> None:
        """Close the connection."""
        if self._transport is not None:
            self._transport.close()
        self._end(None)


class _Connection(asyncio.Protocol):
    """The event loop's view of the connection."""

    def __init__(self, owner: SocketTransport) -> None:
        self._owner = owner

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Send small frames at once instead of collecting them."""
        stream = cast(asyncio.Transport, transport)
        raw = stream.get_extra_info("socket")
        if raw is not None:
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._owner._transport = stream

    def data_received(self, data: bytes) -> None:
        """Hand on."""
        self._owner._deliver(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """The other end closed, or the network failed."""
        reason = "closed by the other end" if exc is None else str(exc)
        self._owner._end(PortError(self._owner.url, f"{reason}; reconnect when it is back"))

"""Ports by which another process reaches an emulated board: a pseudo terminal, a TCP socket.

Both hand bytes to a `PacedBoard` and take bytes from it; neither knows what they mean. Like a UART, they never push
back: what nobody reads is lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from pathlib import Path

from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.pacing import PacedBoard

_READ_BYTES = 4096
# A UART driver's receive buffer: beyond it a slow reader loses bytes.
_TCP_BACKLOG_BYTES = 65536


class PtyPort:
    """A pseudo terminal whose far end appears under `link` (POSIX only)."""

    def __init__(self, board: PacedBoard, link: Path, loop: asyncio.AbstractEventLoop) -> None:
        if sys.platform == "win32":
            raise BenchConfigError("pseudo terminals do not exist on Windows; use --tcp HOST:PORT")
        import tty

        self._board = board
        self._loop = loop
        self._link = link
        self.lost_bytes = 0
        self.device = ""
        if link.exists() and not link.is_symlink():
            raise BenchConfigError(f"{link} exists and is no symbolic link; choose another name")
        self._set_raw = tty.setraw
        self._open()

    @property
    def description(self) -> str:
        """Where it listens, for a person."""
        return f"pty {self._link} ({self.device})"

    async def aclose(self) -> None:
        """Remove the link and close the terminal."""
        self._board.detach()
        self._close()

    def _open(self) -> None:
        self._master, self._slave = os.openpty()
        self.device = os.ttyname(self._slave)
        self._set_raw(self._slave)
        os.set_blocking(self._master, False)
        try:
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(self.device)
        except OSError as error:
            self._close_files()
            raise BenchConfigError(f"cannot make the link {self._link}: {error.strerror}") from error
        self._loop.add_reader(self._master, self._readable)
        self._board.attach(self._send, self._plug)

    def _plug(self, plugged: bool) -> None:
        """The cable was pulled or put back: the device goes and comes, under the same link."""
        if plugged:
            self._open()
        else:
            self._close()

    def _close(self) -> None:
        if not self.device:
            return
        self._loop.remove_reader(self._master)
        if self._link.is_symlink() and os.readlink(self._link) == self.device:
            self._link.unlink()
        self._close_files()

    def _close_files(self) -> None:
        self.device = ""
        os.close(self._master)
        os.close(self._slave)

    def _readable(self) -> None:
        # EIO: the last user closed the terminal; the next one opens it again.
        with contextlib.suppress(BlockingIOError, OSError):
            self._received(os.read(self._master, _READ_BYTES))

    def _received(self, data: bytes) -> None:
        self._board.write(data)

    def _send(self, data: bytes) -> None:
        self._put(data)

    def _put(self, data: bytes) -> None:
        try:
            written = os.write(self._master, data)
        except BlockingIOError:
            written = 0
        self.lost_bytes += len(data) - written


class TcpPort:
    """A TCP server for one client at a time; a second one is turned away."""

    def __init__(self, board: PacedBoard) -> None:
        self._board = board
        self._client: asyncio.Transport | None = None
        self._server: asyncio.Server | None = None
        self._where = ""

    @classmethod
    async def listen(cls, board: PacedBoard, host: str, port: int, loop: asyncio.AbstractEventLoop) -> TcpPort:
        """Listen on `host`:`port`; port 0 takes a free one."""
        self = cls(board)
        try:
            self._server = await loop.create_server(lambda: _TcpClient(self), host, port)
        except OSError as error:
            raise BenchConfigError(f"cannot listen on {host}:{port}: {error.strerror or error}") from error
        name = self._server.sockets[0].getsockname()
        self._where = f"{name[0]}:{name[1]}"
        return self

    @property
    def port(self) -> int:
        """The TCP port in use."""
        return int(self._where.rsplit(":", 1)[1])

    @property
    def description(self) -> str:
        """Where it listens, for a person."""
        return f"tcp socket://{self._where}"

    async def aclose(self) -> None:
        """Stop listening and hang up."""
        if self._server is not None:
            self._server.close()
        if self._client is not None:
            self._client.close()
        self._board.detach()

    def take(self, client: asyncio.Transport) -> bool:
        """A client has connected; False when the line is busy."""
        if self._client is not None or not self._board.plugged:
            return False
        self._client = client
        self._board.attach(self._send, self._plug)
        return True

    def leave(self, client: asyncio.Transport) -> None:
        """A client is gone."""
        if self._client is client:
            self._client = None
            self._board.detach()

    def _plug(self, plugged: bool) -> None:
        if not plugged and self._client is not None:
            self._client.abort()

    def receive(self, data: bytes) -> None:
        """Bytes from the client."""
        self._board.write(data)

    def _send(self, data: bytes) -> None:
        if self._client is not None and self._client.get_write_buffer_size() < _TCP_BACKLOG_BYTES:
            self._client.write(data)


class _TcpClient(asyncio.Protocol):
    def __init__(self, port: TcpPort) -> None:
        self._port = port
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a TCP connection is a stream")
        if self._port.take(transport):
            self._transport = transport
        else:
            transport.close()

    def data_received(self, data: bytes) -> None:
        if self._transport is not None:
            self._port.receive(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._port.leave(self._transport)

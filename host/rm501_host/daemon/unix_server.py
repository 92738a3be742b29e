"""The unix socket: one JSON-RPC message a line, both ways. Whoever may open the file may do everything."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from pathlib import Path

from rm501_host.daemon.access import Access
from rm501_host.daemon.connection import Requests
from rm501_host.daemon.methods import api
from rm501_host.daemon.rpc import MAX_BODY_BYTES, Code, Dispatcher, error_response
from rm501_host.daemon.service import Client, Service
from rm501_host.errors import Rm501Error

_MODE = 0o660


class SocketInUseError(Rm501Error):
    """Another daemon answers on the socket."""


class UnixServer:
    """Listens on `path`; use as an async context manager inside a task group."""

    def __init__(self, service: Service, path: Path, tasks: asyncio.TaskGroup) -> None:
        self._service = service
        self._path = path
        self._tasks = tasks
        self._dispatcher: Dispatcher[Client] = Dispatcher(api)
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()

    async def start(self) -> None:
        """Listen; raises SocketInUseError when another daemon does, StorageError-like OSError as Rm501Error."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        _remove_stale(self._path)
        try:
            self._server = await asyncio.start_unix_server(self._serve, self._path, limit=MAX_BODY_BYTES)
        except OSError as error:
            raise Rm501Error(f"{self._path}: cannot listen: {error.strerror}; choose another --socket") from error
        self._path.chmod(_MODE)

    async def aclose(self) -> None:
        """Stop listening, hang up, remove the file."""
        if self._server is not None:
            self._server.close()
        for writer in tuple(self._writers):
            writer.close()
        with contextlib.suppress(OSError):
            self._path.unlink()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        def send(message: bytes) -> None:
            if not writer.is_closing():
                writer.write(message + b"\n")

        transport = writer.transport
        try:
            client = self._service.connect("unix", Access.FULL, send, transport.get_write_buffer_size)
        except ConnectionRefusedError as error:
            send(error_response(Code.RATE_LIMITED, str(error)))
            writer.close()
            return
        self._writers.add(writer)
        requests = Requests(client, self._dispatcher, self._tasks)
        try:
            while True:
                try:
                    line = await reader.readuntil(b"\n")
                except asyncio.LimitOverrunError:
                    send(error_response(Code.INVALID_REQUEST, f"longer than {MAX_BODY_BYTES} bytes"))
                    return
                except (asyncio.IncompleteReadError, ConnectionError):
                    return
                if line.strip():
                    requests.take(line)
                    # a client that writes without reading is not let run ahead
                    with contextlib.suppress(ConnectionError):
                        await writer.drain()
        finally:
            requests.cancel()
            self._service.disconnect(client)
            self._writers.discard(writer)
            writer.close()


def _remove_stale(path: Path) -> None:
    """Remove the socket that a killed daemon left behind; raises SocketInUseError when one answers."""
    if not path.exists():
        return
    if not path.is_socket():
        raise SocketInUseError(f"{path} exists and is no socket; choose another --socket or remove it")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
            return
    raise SocketInUseError(f"another daemon answers on {path}; stop it first, or choose another --socket")

"""The asyncio client of the daemon's JSON-RPC interface, over its unix socket or over WebSocket.

    async with await connect("unix:/run/user/1000/rm501.sock") as daemon:
        motion = await daemon.call("home")
        await daemon.wait(motion)

A daemon that is not there is NoBoardError (exit code 4); what it refuses or reports comes back as the error class that
the same thing has inside the host, so exit codes are the same whether a command talks to a board or to a daemon.

    RemoteError(Rm501Error)
    ├── RemoteRefusedError(RemoteError, RefusedError)
    ├── RemoteStoppedError(RemoteError, StoppedError)
    └── RemoteNoBoardError(RemoteError, NoBoardError)
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import msgspec

from rm501_host.errors import NoBoardError, RefusedError, Rm501Error, StoppedError

CALL_TIMEOUT_S = 10.0
_LONG_METHODS = frozenset({"program.run", "program.check", "mdi", "move.trajectory"})
"""Checking and planning take their time: they are waited for as long as the daemon answers other questions."""
_WAIT_S = 20.0
_ALIVE_S = 3.0
"""How often a daemon that checks or plans is asked whether it still does."""
_MAX_LINE_BYTES = 8 * 1024 * 1024
"""Answers may be longer than requests: a log of 500 records."""
_MAX_STATUSES = 1000
_POINTS_A_CALL = 300
"""Twice five numbers of 16 characters and a time each stay well below the 64 KiB of a message."""
_DIGITS = 9
_STOPPED, _NO_BOARD, _UNAUTHORIZED = -32012, -32013, -32001
_START_IT = "start it: rm501-host serve (another --socket or RM501_SOCKET points elsewhere)"


class RemoteError(Rm501Error):
    """The daemon answered with an error; `code` and `kind` as in docs/api.md."""

    def __init__(self, code: int, message: str, kind: str) -> None:
        super().__init__(message)
        self.code = code
        self.kind = kind


class RemoteRefusedError(RemoteError, RefusedError):
    """The daemon refused; nothing moved."""


class RemoteStoppedError(RemoteError, StoppedError):
    """Motion ended before its time."""


class RemoteNoBoardError(RemoteError, NoBoardError):
    """The daemon has no board."""


class _Line(Protocol):
    async def send(self, message: bytes) -> None: ...

    async def receive(self) -> bytes | None: ...

    async def aclose(self) -> None: ...


class DaemonClient:
    """A connection to a daemon; made by `connect`."""

    def __init__(self, line: _Line) -> None:
        self._line = line
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self._statuses: deque[dict[str, Any]] = deque(maxlen=_MAX_STATUSES)
        self._status_arrived = asyncio.Event()
        self._reader: asyncio.Task[None] | None = None
        self._tasks = asyncio.TaskGroup()
        self._lost: Rm501Error | None = None
        self.status: dict[str, Any] = {}
        """The status as subscribed, kept up to date."""
        self.on_status: Callable[[dict[str, Any]], None] | None = None
        self.on_alive: Callable[[dict[str, Any]], None] | None = None
        """Given the whole status every few seconds while a call takes long."""

    async def __aenter__(self) -> Self:
        await self._tasks.__aenter__()
        self._reader = self._tasks.create_task(self._read())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._reader is not None:
            self._reader.cancel()
        await self._line.aclose()
        await self._tasks.__aexit__(None, None, None)

    async def call(self, method: str, **params: object) -> Any:
        """Call a method; raises a RemoteError, NoBoardError when the daemon is gone or silent."""
        if method not in _LONG_METHODS:
            return await self.call_within(CALL_TIMEOUT_S, method, params)
        async with self._asked(method, params) as answer:
            while not (await asyncio.wait({answer}, timeout=_ALIVE_S))[0]:
                status = await self.call_within(CALL_TIMEOUT_S, "status", {})
                if self.on_alive is not None and not answer.done():
                    self.on_alive(status)
            return answer.result()

    async def call_within(self, timeout_s: float, method: str, params: dict[str, object]) -> Any:
        """As `call`, with its own limit on the time; raises what `call` raises."""
        try:
            async with self._asked(method, params) as answer, asyncio.timeout(timeout_s):
                return await answer
        except TimeoutError:
            raise NoBoardError(f"the daemon did not answer {method} within {timeout_s:.0f} s; is it stopped?") from None

    @contextlib.asynccontextmanager
    async def _asked(self, method: str, params: dict[str, object]) -> AsyncIterator[asyncio.Future[Any]]:
        """Ask, and expect the answer until the end of the block; raises NoBoardError when the daemon is gone."""
        if self._lost is not None:
            raise self._lost
        number = next(self._numbers)
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        try:
            await self._line.send(
                msgspec.json.encode({"jsonrpc": "2.0", "id": number, "method": method, "params": params})
            )
            yield answer
        except ConnectionError as error:
            raise NoBoardError(f"the daemon hung up: {error}; {_START_IT}") from error
        finally:
            self._waiting.pop(number, None)
            if not answer.cancel() and not answer.cancelled():
                answer.exception()  # somebody else has told why already

    async def motion(self, method: str, timeout_s: float | None = None, **params: object) -> dict[str, Any]:
        """Call a method that moves, and wait for the end of the motion, as `wait` does."""
        started = await self.call(method, **params)
        return await self.wait(started, timeout_s)

    async def follow(
        self,
        points_deg: Sequence[Sequence[float]],
        times_s: Sequence[float],
        velocities_deg_s: Sequence[Sequence[float]] | None = None,
        *,
        stretch: bool = False,
    ) -> dict[str, Any]:
        """Have a timed joint trajectory checked and started; sent in pieces when it is long. `wait` waits for its end.

        `points_deg` (n, 5), `times_s` (n,), `velocities_deg_s` (n, 5) or None; as method `move.trajectory`.
        """
        answer: dict[str, Any] = {}
        for first in range(0, max(1, len(times_s)), _POINTS_A_CALL):
            piece = slice(first, first + _POINTS_A_CALL)
            answer = await self.call(
                "move.trajectory",
                points_deg=_rounded(points_deg[piece]),
                times_s=[round(float(time_s), _DIGITS) for time_s in times_s[piece]],
                velocities_deg_s=None if velocities_deg_s is None else _rounded(velocities_deg_s[piece]),
                stretch=stretch,
                more=first + _POINTS_A_CALL < len(times_s),
            )
        return answer

    async def wait(self, started: dict[str, Any], timeout_s: float | None = None) -> dict[str, Any]:
        """Wait for the end of a motion that `call` gave, however long it takes; raises what ended it early.

        With `timeout_s` it raises TimeoutError then; the motion goes on.
        """
        async with asyncio.timeout(timeout_s):
            while True:
                params: dict[str, object] = {"motion": started["motion"], "timeout_s": _WAIT_S}
                answer = await self.call_within(_WAIT_S + CALL_TIMEOUT_S, "motion.wait", params)
                if answer["done"]:
                    result: dict[str, Any] = answer["result"]
                    return result

    async def subscribe(self, period_ms: int = 50, fields: tuple[str, ...] = ()) -> dict[str, Any]:
        """Keep `status` up to date from now on; returns it."""
        self.status = dict(await self.call("subscribe", period_ms=period_ms, fields=list(fields)))
        return self.status

    async def status_where(self, wanted: Callable[[dict[str, Any]], bool], timeout_s: float = 30.0) -> dict[str, Any]:
        """Wait until the subscribed status satisfies `wanted`; raises TimeoutError."""
        async with asyncio.timeout(timeout_s):
            while not wanted(self.status):
                if self._lost is not None:
                    raise self._lost
                self._status_arrived.clear()
                await self._status_arrived.wait()
        return self.status

    async def closed(self) -> None:
        """Wait until the daemon has hung up, then raise NoBoardError."""
        while self._lost is None:
            self._status_arrived.clear()
            await self._status_arrived.wait()
        raise self._lost

    async def _read(self) -> None:
        try:
            while (line := await self._line.receive()) is not None:
                self._take(msgspec.json.decode(line))
        except (ConnectionError, msgspec.DecodeError):
            pass
        self._lost = NoBoardError(f"the daemon hung up; {_START_IT}")
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(self._lost)
        self._status_arrived.set()

    def _take(self, message: Any) -> None:
        if not isinstance(message, dict):
            return
        if message.get("method") == "status":
            self.status.update(message["params"])
            self._status_arrived.set()
            if self.on_status is not None:
                self.on_status(message["params"])
            return
        answer = self._waiting.get(message.get("id", -1))
        if answer is None or answer.done():
            return
        if "error" in message:
            answer.set_exception(_error(message["error"]))
        else:
            answer.set_result(message.get("result"))


def _rounded(rows: Sequence[Sequence[float]]) -> list[list[float]]:
    return [[round(float(value), _DIGITS) for value in row] for row in rows]


async def connect(address: str, *, token: str | None = None, name: str = "client") -> DaemonClient:
    """Connect to `unix:PATH` or `ws://HOST:PORT/rpc`; raises NoBoardError with the remedy when nobody is there."""
    if address.startswith("unix:"):
        line: _Line = await _connect_unix(Path(address.removeprefix("unix:")))
    elif address.startswith(("ws://", "wss://")):
        line = await _connect_web(address, token)
    else:
        raise NoBoardError(f"{address!r} is no address of a daemon; use unix:PATH or ws://HOST:PORT/rpc")
    client = DaemonClient(line)
    await line.send(msgspec.json.encode({"jsonrpc": "2.0", "id": 0, "method": "hello", "params": {"name": name}}))
    return client


def _error(body: dict[str, Any]) -> RemoteError:
    code, message = int(body["code"]), str(body["message"])
    kind = str((body.get("data") or {}).get("kind", ""))
    if code == _STOPPED:
        return RemoteStoppedError(code, message, kind)
    if code == _NO_BOARD:
        return RemoteNoBoardError(code, message, kind)
    return RemoteRefusedError(code, message, kind)


class _UnixLine:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    async def send(self, message: bytes) -> None:
        self._writer.write(message + b"\n")
        await self._writer.drain()

    async def receive(self) -> bytes | None:
        try:
            return await self._reader.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return None

    async def aclose(self) -> None:
        self._writer.close()
        with contextlib.suppress(ConnectionError):
            await self._writer.wait_closed()


async def _connect_unix(path: Path) -> _Line:
    if not hasattr(asyncio, "open_unix_connection"):
        raise NoBoardError("this system has no unix sockets; use ws://127.0.0.1:7501/rpc")
    try:
        reader, writer = await asyncio.open_unix_connection(path, limit=_MAX_LINE_BYTES)
    except OSError as error:
        raise NoBoardError(f"no daemon on {path} ({error.strerror or error}); {_START_IT}") from error
    return _UnixLine(reader, writer)


class _WebLine:
    def __init__(self, session: Any, socket: Any) -> None:
        self._session = session
        self._socket = socket

    async def send(self, message: bytes) -> None:
        await self._socket.send_str(message.decode())

    async def receive(self) -> bytes | None:
        from aiohttp import WSMsgType

        message = await self._socket.receive()
        return message.data.encode() if message.type is WSMsgType.TEXT else None

    async def aclose(self) -> None:
        await self._socket.close()
        await self._session.close()


async def _connect_web(address: str, token: str | None) -> _Line:
    import aiohttp

    session = aiohttp.ClientSession()
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    try:
        socket = await session.ws_connect(address, headers=headers, max_msg_size=_MAX_LINE_BYTES)
    except aiohttp.WSServerHandshakeError as error:
        await session.close()
        if error.status == 401:
            raise RemoteRefusedError(
                _UNAUTHORIZED, f"{address}: the token is missing or wrong; give the daemon's token", ""
            ) from error
        raise NoBoardError(f"{address}: refused ({error.status} {error.message})") from error
    except (aiohttp.ClientError, OSError) as error:
        await session.close()
        cause = getattr(error, "os_error", error)
        reason = getattr(cause, "strerror", None) or cause
        raise NoBoardError(
            f"no daemon on {address} ({reason}); start it: rm501-host serve --listen HOST:PORT (then ws://HOST:PORT/rpc)"
        ) from error
    return _WebLine(session, socket)

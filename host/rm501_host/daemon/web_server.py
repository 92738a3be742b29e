"""WebSocket on TCP, `ws://HOST:PORT/rpc`: a JSON-RPC message a frame. Guarded by Host, Origin and token."""

from __future__ import annotations

import asyncio
from collections import deque

from aiohttp import WSCloseCode, WSMsgType, web

from rm501_host.daemon.access import Guard
from rm501_host.daemon.connection import Requests
from rm501_host.daemon.methods import api
from rm501_host.daemon.rpc import MAX_BODY_BYTES, Dispatcher
from rm501_host.daemon.service import Client, Service
from rm501_host.errors import Rm501Error

_HEARTBEAT_S = 10.0


class WebServer:
    """Listens on `host`:`port`; `port` 0 takes a free one, see `port` after `start`."""

    def __init__(self, service: Service, guard: Guard, host: str, port: int, tasks: asyncio.TaskGroup) -> None:
        self._service = service
        self._guard = guard
        self._host = host
        self.port = port
        self._tasks = tasks
        self._dispatcher: Dispatcher[Client] = Dispatcher(api)
        self._runner: web.AppRunner | None = None
        self._sockets: set[web.WebSocketResponse] = set()

    async def start(self) -> None:
        """Listen; raises Rm501Error naming the address when it cannot."""
        app = web.Application(client_max_size=MAX_BODY_BYTES)
        app.router.add_get("/rpc", self._serve)
        self._runner = web.AppRunner(app, access_log=None)
        await self._runner.setup()
        site = web.TCPSite(self._runner, self._host, self.port)
        try:
            await site.start()
        except OSError as error:
            await self._runner.cleanup()
            raise Rm501Error(f"{self._host}:{self.port}: cannot listen: {error.strerror}; choose another") from error
        addresses = self._runner.addresses
        self.port = addresses[0][1]

    async def aclose(self) -> None:
        """Stop listening and hang up."""
        for response in tuple(self._sockets):
            await response.close(code=WSCloseCode.GOING_AWAY, message=b"the daemon ends")
        if self._runner is not None:
            await self._runner.cleanup()

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        origin, host = request.headers.get("Origin"), request.headers.get("Host", "")
        if self._guard.foreign(host, origin):
            return web.Response(status=403, text="this origin may not talk to the daemon\n")
        peer = request.remote or ""
        access = self._guard.access(peer, request.headers.get("Authorization"))
        if access is None:
            return web.Response(status=401, text="a token is needed\n", headers={"WWW-Authenticate": "Bearer"})
        response = web.WebSocketResponse(max_msg_size=MAX_BODY_BYTES, heartbeat=_HEARTBEAT_S)
        if not response.can_prepare(request).ok:
            return web.Response(status=426, text="this is a WebSocket\n", headers={"Upgrade": "websocket"})
        await response.prepare(request)
        outbox = _Outbox(response)
        try:
            client = self._service.connect(f"web {peer}", access, outbox.put, lambda: outbox.size)
        except ConnectionRefusedError as error:
            await response.close(code=WSCloseCode.TRY_AGAIN_LATER, message=str(error).encode())
            return response
        self._sockets.add(response)
        requests = Requests(client, self._dispatcher, self._tasks)
        writer = self._tasks.create_task(outbox.run())
        try:
            async for message in response:
                if message.type is WSMsgType.TEXT:
                    requests.take(message.data.encode("utf-8", "surrogatepass"))
                elif message.type is WSMsgType.BINARY:
                    requests.take(message.data)
        finally:
            requests.cancel()
            writer.cancel()
            self._service.disconnect(client)
            self._sockets.discard(response)
        return response


class _Outbox:
    """Messages on their way to one WebSocket, in order."""

    def __init__(self, response: web.WebSocketResponse) -> None:
        self._response = response
        self._messages: deque[bytes] = deque()
        self._filled = asyncio.Event()
        self.size = 0

    def put(self, message: bytes) -> None:
        self._messages.append(message)
        self.size += len(message)
        self._filled.set()

    async def run(self) -> None:
        while True:
            await self._filled.wait()
            self._filled.clear()
            while self._messages:
                message = self._messages.popleft()
                self.size -= len(message)
                try:
                    await self._response.send_str(message.decode())
                except (ConnectionError, RuntimeError):
                    return

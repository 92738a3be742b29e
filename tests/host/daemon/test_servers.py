"""The real sockets: tokens, origins, sizes, two daemons on one socket, systemd's messages."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import pytest

from rm501_host.client import connect
from rm501_host.client.client import RemoteRefusedError
from rm501_host.daemon.access import AccessError, Guard, read_token
from rm501_host.daemon.methods import api
from rm501_host.daemon.notify import Notifier
from rm501_host.daemon.unix_server import SocketInUseError, UnixServer
from rm501_host.daemon.web_server import WebServer
from rm501_host.errors import NoBoardError
from tests.support.patience import PATIENCE_S, until
from tests.support.virtual_machine import running_service

TOKEN = "correct-horse-battery-staple"


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    path.chmod(0o600)
    return path


@asynccontextmanager
async def web(folder: Path, token_file: Path | None) -> AsyncIterator[tuple[str, object]]:
    async with running_service(folder) as service, asyncio.TaskGroup() as tasks:
        server = WebServer(service, Guard("127.0.0.1", token_file), "127.0.0.1", 0, tasks)
        await server.start()
        try:
            yield f"http://127.0.0.1:{server.port}/rpc", service
        finally:
            await server.aclose()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Authorization": "Bearer wrong"}, 401),
        ({"Authorization": f"Basic {TOKEN}"}, 401),
        ({"Authorization": ""}, 401),
        ({"Authorization": f"Bearer {TOKEN}", "Origin": "http://evil.example"}, 403),
        ({"Authorization": f"Bearer {TOKEN}", "Origin": "null"}, 403),
        ({"Authorization": f"Bearer {TOKEN}", "Host": "evil.example"}, 403),
        ({"Origin": "http://evil.example"}, 403),
    ],
)
async def test_who_does_not_get_in(tmp_path: Path, token_file: Path, headers: dict[str, str], status: int) -> None:
    async with web(tmp_path, token_file) as (url, _), aiohttp.ClientSession() as session:
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(url, headers=headers)
        assert refused.value.status == status


async def test_with_the_token_everything_without_it_only_stop(tmp_path: Path, token_file: Path) -> None:
    async with web(tmp_path, token_file) as (url, service):
        address = url.replace("http", "ws")
        async with await connect(address, token=TOKEN) as client:
            assert (await client.call("status"))["task_state"] == "ESTOP"
            await client.call("reset")
            assert (await client.call("status"))["task_state"] == "ON"
        async with await connect(address) as client:
            for method in api:
                if method.access.name != "STOP":
                    with pytest.raises(RemoteRefusedError, match="token"):
                        await client.call(method.name)
            assert (await client.call("hold")) == {"held": False}
            await client.call("stop")
        await until(lambda: service.machine.state.name == "OFF")  # type: ignore[attr-defined]


async def test_an_oversized_message_ends_the_connection_and_nothing_else(tmp_path: Path, token_file: Path) -> None:
    async with web(tmp_path, token_file) as (url, _), aiohttp.ClientSession() as session:
        headers = {"Authorization": f"Bearer {TOKEN}"}
        async with session.ws_connect(url, headers=headers) as wire:
            await wire.send_str('{"jsonrpc":"2.0","id":1,"method":"version","params":{"a":"' + "x" * 70_000 + '"}}')
            message = await wire.receive(timeout=PATIENCE_S)
            assert message.type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.CLOSING)
        async with session.ws_connect(url, headers=headers) as wire:
            await wire.send_str('{"jsonrpc":"2.0","id":1,"method":"version"}')
            assert json.loads((await wire.receive(timeout=PATIENCE_S)).data)["result"]["api"] == 1
        async with session.post(url, data="{}") as answer:
            assert answer.status == 405
        async with session.get(url.replace("/rpc", "/../../etc/passwd")) as answer:
            assert answer.status == 404


async def test_unix_socket_limits_and_stale_files(tmp_path: Path) -> None:
    path = tmp_path / "s.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    async with running_service(tmp_path) as service, asyncio.TaskGroup() as tasks:
        server = UnixServer(service, path, tasks)
        await server.start()
        assert path.stat().st_mode & 0o777 == 0o660
        with pytest.raises(SocketInUseError, match="another daemon answers"):
            await UnixServer(service, path, tasks).start()
        async with await connect(f"unix:{path}") as client:
            assert (await client.call("version"))["api"] == 1
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(b"x" * 200_000 + b"\n")
        assert b"longer than 65536" in await reader.read(1000)
        writer.close()
        await until(lambda: not service.clients)
        await server.aclose()
    with pytest.raises(NoBoardError, match="rm501-host serve"):
        await connect(f"unix:{path}")


def test_unsafe_arrangements_do_not_start(tmp_path: Path, token_file: Path) -> None:
    for host in ("0.0.0.0", "192.168.1.5", "::", "arm.example"):
        with pytest.raises(AccessError, match="--token-file"):
            Guard(host, None)
    Guard("0.0.0.0", token_file)
    token_file.chmod(0o644)
    with pytest.raises(AccessError, match="chmod 600"):
        read_token(token_file)
    token_file.chmod(0o600)
    token_file.write_text("short")
    with pytest.raises(AccessError, match="shorter"):
        read_token(token_file)
    with pytest.raises(AccessError, match="cannot be read"):
        read_token(tmp_path / "none")


async def test_systemd_hears_ready_and_the_watchdog(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.setblocking(False)
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "100000", "WATCHDOG_PID": "77"}
        notifier = Notifier(environment, 77)
        notifier.send("READY=1")
        assert listener.recv(100) == b"READY=1"
        async with asyncio.TaskGroup() as tasks:
            alive = tasks.create_task(notifier.keep_alive())
            loop = asyncio.get_running_loop()
            async with asyncio.timeout(PATIENCE_S):
                assert [await loop.sock_recv(listener, 100) for _ in range(2)] == [b"WATCHDOG=1"] * 2
            alive.cancel()
        assert Notifier(environment, 78).watchdog_s == 0.0
        for _ in range(2000):  # more than any system keeps for a listener that is stuck
            notifier.send("WATCHDOG=1", wait=False)
    Notifier({}, 1).send("READY=1")
    notifier.send("nobody listens any more")

"""The daemon's life: everything is made, listens, runs until asked to end, and comes to rest before it ends.

One root task group holds every task. A request to end (SIGTERM, SIGINT) brings a moving arm to rest on its path, motors
held, and only then lets go of the board; a second one ends at once and leaves that to the board.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rm501_host.blackbox import BlackBox
from rm501_host.config import Config
from rm501_host.daemon.access import Guard
from rm501_host.daemon.notify import Notifier
from rm501_host.daemon.service import Folders, Service
from rm501_host.machine import MachineParts
from rm501_host.storage import JsonLog, PositionFile
from rm501_protocol.transport import Transport

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """How to serve: where to listen, where to keep files, and what is injected."""

    open_transport: Callable[[], Coroutine[Any, Any, Transport]]
    nonce: Callable[[], int]
    utc: Callable[[], str]
    folders: Folders
    socket: Path | None
    host: str = "127.0.0.1"
    port: int | None = None
    token_file: Path | None = None
    origins: tuple[str, ...] = ()


def make_service(config: Config, options: ServeOptions) -> Service:
    """The service of `options`; call inside the running loop."""
    loop = asyncio.get_running_loop()
    state = options.folders.state
    parts = MachineParts(
        open_transport=options.open_transport,
        nonce=options.nonce,
        log=JsonLog(state / "log.jsonl", loop.time, options.utc),
        black_box=BlackBox(state / "blackbox", loop.time),
        position_file=PositionFile(state / "position.json"),
        utc=options.utc,
    )
    return Service(config, parts, options.folders)


async def serve(
    config: Config,
    options: ServeOptions,
    notifier: Notifier,
    end: asyncio.Event,
    on_ready: Callable[[list[str]], None],
) -> None:
    """Serve until `end` is set; `on_ready` gets a line for each address. Raises Rm501Error when it cannot start."""
    guard = Guard(options.host, options.token_file, options.origins) if options.port is not None else None
    service = make_service(config, options)
    addresses: list[str] = []
    servers: list[Any] = []
    try:
        async with asyncio.TaskGroup() as tasks:
            if options.socket is not None:
                from rm501_host.daemon.unix_server import UnixServer

                unix = UnixServer(service, options.socket, tasks)
                await unix.start()
                servers.append(unix)
                addresses.append(f"unix:{options.socket}")
            if guard is not None and options.port is not None:
                from rm501_host.daemon.web_server import WebServer

                web = WebServer(service, guard, options.host, options.port, tasks)
                await web.start()
                servers.append(web)
                addresses.append(f"ws://{options.host}:{web.port}/rpc")
            machine = tasks.create_task(service.machine.run(), name="machine")
            alive = tasks.create_task(notifier.keep_alive(), name="watchdog")
            service.machine.write_log("started", addresses=addresses)
            notifier.send("READY=1\nSTATUS=serving " + ", ".join(addresses))
            on_ready(addresses)
            try:
                await end.wait()
            finally:
                notifier.send("STOPPING=1")
                with contextlib.suppress(TimeoutError):
                    await service.machine.shut_down()
                for server in servers:
                    await server.aclose()
                machine.cancel()
                alive.cancel()
    finally:
        service.machine.write_log("ended")
        service.machine.log.close()

"""`rm501-host serve`: run the daemon in the foreground."""

from __future__ import annotations

import asyncio
import json
import os
import random
import signal
from collections.abc import Callable, Coroutine
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from rm501_host.cli.context import CommandContext
from rm501_host.client.session import ignore_broken_pipes
from rm501_host.daemon.notify import Notifier
from rm501_host.daemon.paths import socket_path, state_folder
from rm501_host.daemon.serve import ServeOptions, serve
from rm501_host.daemon.service import Folders
from rm501_host.error_groups import told_by
from rm501_host.transports import SteadyPort
from rm501_protocol.transport import Transport


@click.command("serve")
@click.option(
    "--socket", type=click.Path(path_type=Path), help="Unix socket; default RM501_SOCKET or the run-time folder."
)
@click.option("--no-socket", is_flag=True, help="No unix socket.")
@click.option("--listen", metavar="HOST:PORT", help="WebSocket as well, such as 127.0.0.1:7501 (port 0: a free one).")
@click.option("--token-file", type=click.Path(path_type=Path), help="Token for --listen (mode 0600).")
@click.option("--origin", "origins", multiple=True, help="Web origin that may connect, such as http://localhost:8080.")
@click.option("--state", type=click.Path(path_type=Path), help="Folder for log, position, teach points, tables.")
@click.option("--programs", type=click.Path(path_type=Path), help="Folder of G-code programs; default STATE/programs.")
@click.pass_obj
def serve_command(
    context: CommandContext,
    socket: Path | None,
    no_socket: bool,
    listen: str | None,
    token_file: Path | None,
    origins: tuple[str, ...],
    state: Path | None,
    programs: Path | None,
) -> None:
    """Own the arm: state, homing, jogging, programs, recovery; an API for people and programs."""
    config = context.config
    host, port = _address(listen)
    if no_socket and port is None:
        raise click.UsageError("--no-socket without --listen: nobody could talk to the daemon")
    unix_here = hasattr(os, "getuid") and hasattr(asyncio, "start_unix_server")
    if not unix_here and port is None:
        raise click.UsageError("this system has no unix sockets; give --listen 127.0.0.1:7501")
    folder = state or state_folder(os.environ, Path.home())
    randomness = random.SystemRandom()
    url = context.port_url
    options = ServeOptions(
        open_transport=_telling(SteadyPort(_with_baud(url, config.link.baud)).open),
        nonce=lambda: randomness.getrandbits(32),
        utc=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"),
        folders=Folders(folder, programs or folder / "programs"),
        socket=None if no_socket or not unix_here else socket or socket_path(os.environ, os.getuid()),
        host=host,
        port=port,
        token_file=token_file,
        origins=origins,
    )

    def ready(addresses: list[str]) -> None:
        if context.json_output:
            click.echo(json.dumps({"ready": True, "port": url, "addresses": addresses, "state": str(folder)}))
        else:
            click.echo(f"rm501-host serves {url} on {', '.join(addresses)}; files in {folder}")

    ignore_broken_pipes()
    try:
        try:
            asyncio.run(_serve(context, options, ready))
        except BaseExceptionGroup as group:
            raise told_by(group) from None
    except asyncio.CancelledError as cancelled:
        raise click.Abort from cancelled


async def _serve(context: CommandContext, options: ServeOptions, ready: object) -> None:
    end = asyncio.Event()
    loop = asyncio.get_running_loop()
    here = asyncio.current_task()

    def asked_to_end() -> None:
        if end.is_set() and here is not None:
            here.cancel()
        end.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, asked_to_end)
    assert callable(ready)
    await serve(context.config, options, Notifier(os.environ, os.getpid()), end, ready)


def _telling(
    open_transport: Callable[[], Coroutine[Any, Any, Transport]],
) -> Callable[[], Coroutine[Any, Any, Transport]]:
    """`open_transport` that says on standard error, once, that the first board is missing."""
    is_quiet = False

    async def opened() -> Transport:
        nonlocal is_quiet
        try:
            transport = await open_transport()
        except OSError as error:
            if not is_quiet:
                click.echo(f"no board yet: {error}; it is tried again until there is one", err=True)
            is_quiet = True
            raise
        is_quiet = True
        return transport

    return opened


def _with_baud(url: str, baud: int) -> str:
    is_path = url.startswith(("/", "./", "../", "~")) or url.upper().startswith("COM")
    return f"{url}?baud={baud}" if is_path and "?" not in url else url


def _address(listen: str | None) -> tuple[str, int | None]:
    if listen is None:
        return "127.0.0.1", None
    host, _, port = listen.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise click.BadParameter("give HOST:PORT, such as 127.0.0.1:7501", param_hint="--listen")
    return host.strip("[]"), int(port)

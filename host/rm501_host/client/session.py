"""One command's conversation with the daemon: connect, talk, hang up, all on one event loop."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import click

from rm501_host.cli.context import CommandContext
from rm501_host.client.client import DaemonClient, connect
from rm501_host.daemon.paths import socket_path
from rm501_host.errors import NoBoardError

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])


def daemon_option(command: F) -> F:
    """`--daemon ADDRESS` and `--token-file FILE` for a command that talks to the daemon."""
    command = click.option(
        "--token-file", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="The daemon's token."
    )(command)
    return click.option(
        "--daemon", metavar="ADDRESS", help="unix:PATH or ws://HOST:PORT/rpc; default: the local daemon's socket."
    )(command)


def ignore_broken_pipes() -> None:
    """Make writing to a socket whose other end is gone an error instead of the end of the process.

    The command line lets SIGPIPE end it, for `| head`; a daemon would die of a client that was killed.
    """
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def talk(daemon: str | None, token_file: Path | None, work: Callable[[DaemonClient], Coroutine[Any, Any, T]]) -> T:
    """Run `work` with a connected client; raises NoBoardError (exit code 4) when no daemon is there."""
    address = daemon or f"unix:{socket_path(os.environ, os.getuid() if hasattr(os, 'getuid') else 0)}"
    token = None if token_file is None else token_file.read_text("utf-8").strip()

    ignore_broken_pipes()

    async def conversation() -> T:
        try:
            client = await connect(address, token=token, name=f"rm501-host {os.getpid()}")
        except NoBoardError as error:
            raise NoBoardError(f"{error}{_about_port()}") from error
        async with client:
            return await work(client)

    return asyncio.run(conversation())


def _about_port() -> str:
    """What to tell somebody who named a port to a command that only knows the daemon."""
    context = click.get_current_context(silent=True)
    given = None if context is None else context.find_object(CommandContext)
    if given is None or given.port is None:
        return ""
    return f"; this command asks the daemon, which alone opens the port: rm501-host --port {given.port} serve"

"""The real processes: an emulated board on a pty, the daemon in front of it, and how to take them away."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from rm501_host.client import DaemonClient, connect
from rm501_host.errors import NoBoardError
from tests.support.patience import PATIENCE_S

REPOSITORY = Path(__file__).resolve().parents[2]


class Process:
    """A child process whose first line of output says that it is ready."""

    def __init__(self, child: asyncio.subprocess.Process, ready: str) -> None:
        self.child = child
        self.ready = ready

    def send(self, number: int) -> None:
        self.child.send_signal(number)

    async def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and wait for the end; the exit code."""
        if self.child.returncode is None:
            self.child.send_signal(number)
            if number in (signal.SIGTERM, signal.SIGKILL):
                self.child.send_signal(signal.SIGCONT)
        try:
            async with asyncio.timeout(PATIENCE_S):
                return await self.child.wait()
        except TimeoutError:
            self.child.kill()
            return await self.child.wait()


async def start(*command: str) -> Process:
    child = await asyncio.create_subprocess_exec(
        *command,
        stdout=asyncio.subprocess.PIPE,
        stderr=sys.stderr,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert child.stdout is not None
    async with asyncio.timeout(PATIENCE_S):
        line = (await child.stdout.readline()).decode()
    if not line:
        raise RuntimeError(f"{command[0]} ended at once with {await child.wait()}")
    return Process(child, line)


async def start_board(folder: Path, preset: str = "real", seed: int = 1) -> Process:
    code = "from rm501_sim_board.cli import main; main()"
    return await start(
        sys.executable, "-c", code, "--pty", str(folder / "arm"), "--preset", preset, "--seed", str(seed)
    )


async def start_daemon(folder: Path, config: str = "thesis.toml") -> Process:
    code = "from rm501_host.cli import main; main()"
    return await start(
        sys.executable, "-c", code, "--config", str(REPOSITORY / "configs" / config), "--port", str(folder / "arm"),
        "serve", "--socket", str(folder / "s.sock"), "--state", str(folder / "state"),
    )  # fmt: skip


@asynccontextmanager
async def client_of(folder: Path, name: str = "operator") -> AsyncIterator[DaemonClient]:
    """A client of the daemon in `folder`, subscribed to everything."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            try:
                client = await connect(f"unix:{folder / 's.sock'}", name=name)
                break
            except NoBoardError:
                await asyncio.sleep(0.1)
    async with client:
        await client.subscribe(20)
        yield client

"""A machine on the emulated board, on whatever loop runs: for tests of the machine, the daemon and its clients."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from rm501_host.blackbox import BlackBox
from rm501_host.config import Config, load_config
from rm501_host.daemon.service import Folders, Service
from rm501_host.machine import MachineParts, Owner
from rm501_host.storage import JsonLog, PositionFile
from rm501_host.transports import open_transport
from rm501_protocol.transport import Transport

REPOSITORY = Path(__file__).resolve().parents[2]
ME = Owner(1000, "tester")
OTHER = Owner(1001, "somebody else")


def thesis_config() -> Config:
    return load_config(REPOSITORY / "configs" / "thesis.toml")


@asynccontextmanager
async def running_service(
    folder: Path,
    url: str = "emu://?preset=ideal&seed=1",
    config: Config | None = None,
    on_transport: Callable[[Transport], Transport] = lambda transport: transport,
    seed: int = 7,
) -> AsyncIterator[Service]:
    """A service whose machine runs and is connected; ended, with everything cancelled, on the way out.

    `seed`: another one for every service that meets the same board, whose sessions would else have the same nonces.
    """
    loop = asyncio.get_running_loop()
    randomness = random.Random(seed)

    async def opened() -> Transport:
        return on_transport(await open_transport(url))

    parts = MachineParts(
        open_transport=opened,
        nonce=lambda: randomness.getrandbits(32),
        log=JsonLog(None, loop.time, lambda: ""),
        black_box=BlackBox(folder / "blackbox", loop.time),
        position_file=PositionFile(folder / "position.json"),
        utc=lambda: "",
    )
    service = Service(config or thesis_config(), parts, Folders(folder, folder / "programs"))
    async with asyncio.TaskGroup() as tasks:
        machine = tasks.create_task(service.machine.run())
        async with asyncio.timeout(30):
            while not service.machine.connected:  # noqa: ASYNC110  # polled from outside
                await asyncio.sleep(0.02)
        try:
            yield service
        finally:
            machine.cancel()


async def homed(service: Service) -> None:
    """Reset and home."""
    from rm501_host.machine import operations

    await service.machine.reset(ME)
    await operations.home(service.machine, ME).wait()


def kinds(service: Service) -> list[str]:
    """Kinds of the log's records."""
    return [record.kind for record in service.machine.log.ring]

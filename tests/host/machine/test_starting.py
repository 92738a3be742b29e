"""From a command to the first step: a motion begins once what is queued outlasts a stall and still lets it stop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from math import cos, sin
from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.daemon.service import Service
from rm501_host.machine import Job, MachineState, operations
from rm501_host.virtual_time import VirtualLoop, run_virtual
from rm501_protocol.enums import BoardState
from tests.support.virtual_machine import ME, REPOSITORY, homed, running_service

PLAIN = load_config(REPOSITORY / "configs" / "rm501.toml")
START = (0.0, 60.0, -60.0, 60.0, 0.0)
WAVES = "G21 G90 G64 P1\nG0 X270 Y0 Z250 A0 B0\n" + "".join(
    f"G1 X{270 + 30 * sin(i * 0.3):.3f} Y{40 * cos(i * 0.3) - 40:.3f} F3000\n" for i in range(80)
)


async def jog(service: Service) -> Job:
    return service.jogger.start(ME, "world", "y", 50.0)


async def program(service: Service) -> Job:
    return await service.programs.run(ME, "waves.ngc")


async def until_it_runs(service: Service) -> None:
    async with asyncio.timeout(5):
        while (status := service.machine.board_status) is None or status.state is not BoardState.RUNNING:  # noqa: ASYNC110
            await asyncio.sleep(0.001)


@pytest.mark.parametrize(("start", "filled"), [(jog, 8), (program, 20)])
def test_motion_of_many_segments_begins_before_the_queue_is_full(
    tmp_path: Path, start: Callable[[Service], Awaitable[Job]], filled: int
) -> None:
    """The whole way of the jog is some ten segments, that of the program fills the queue of 32."""

    async def scenario() -> None:
        async with running_service(tmp_path, config=PLAIN) as service:
            (tmp_path / "programs" / "waves.ngc").write_text(WAVES + "M2\n")
            await homed(service)
            await operations.move_joints(service.machine, ME, START).wait()
            loop = asyncio.get_running_loop()
            began_s = loop.time()
            await start(service)
            await until_it_runs(service)
            assert loop.time() - began_s < 0.06, "32 segments take 0.18 s on the wire"
            await asyncio.sleep(0.15)
            status, stream = service.machine.board_status, service.machine.stream
            assert status is not None and stream is not None
            assert status.queue_used > filled, "the queue goes on being filled while the arm moves"

    run_virtual(scenario())


def test_a_stall_of_the_budget_right_after_the_start_is_not_noticed(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path, config=PLAIN) as service:
            (tmp_path / "programs" / "waves.ngc").write_text(WAVES + "M2\n")
            await homed(service)
            loop = asyncio.get_running_loop()
            assert isinstance(loop, VirtualLoop)
            states = set()
            for start in (program, program):
                job = await start(service)
                await until_it_runs(service)
                loop.stand_still(PLAIN.planner.stall_budget_s - 0.01)
                while not job.done.is_set():
                    states.add(service.machine.state)
                    await asyncio.sleep(0.004)
                await job.wait()
            assert MachineState.HOLDING not in states and MachineState.HELD not in states

    run_virtual(scenario())

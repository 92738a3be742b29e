"""What people do while something else is under way: holds for other reasons, keys released early, stops in a reset."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.daemon.service import Service
from rm501_host.errors import RefusedError, StoppedError
from rm501_host.machine import MachineState, operations
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, OTHER, REPOSITORY, homed, running_service

PLAIN = load_config(REPOSITORY / "configs" / "rm501.toml")
START = (0.0, 60.0, -60.0, 60.0, 0.0)
NEXT = (60.0, 75.0, -45.0, 30.0, 20.0)


def at_start(tmp_path: Path, scenario: Callable[[Service], Awaitable[None]]) -> None:
    """Run a scenario on a homed machine at START, on virtual time."""

    async def whole() -> None:
        async with running_service(tmp_path, config=PLAIN) as service:
            await homed(service)
            await operations.move_joints(service.machine, ME, START).wait()
            await scenario(service)

    run_virtual(whole())


async def until(service: Service, state: MachineState) -> None:
    async with asyncio.timeout(20):
        while service.machine.state is not state:  # noqa: ASYNC110
            await asyncio.sleep(0.02)


def test_everybody_holds_a_jog_also_of_one_who_keeps_the_lease(tmp_path: Path) -> None:
    async def scenario(service: Service) -> None:
        machine = service.machine
        machine.lease.take(ME)
        job = service.jogger.start(ME, "joint", "waist", 20.0)
        for _ in range(20):
            service.jogger.keep(ME, job.id)
            await asyncio.sleep(0.02)
        assert await machine.hold(OTHER)
        assert job.done.is_set() and machine.state is MachineState.IDLE
        with pytest.raises(RefusedError, match="owns the motion"):
            await machine.abort(OTHER)

    at_start(tmp_path, scenario)


def test_a_hold_of_an_arm_that_stands_for_another_reason_is_a_users(tmp_path: Path) -> None:
    """With override 0 it stands, too; raising that must not move an arm that somebody has held meanwhile."""

    async def scenario(service: Service) -> None:
        machine = service.machine
        job = operations.move_joints(machine, ME, NEXT)
        await asyncio.sleep(0.5)
        await machine.set_override(0.0, ME)
        await until(service, MachineState.HELD)
        assert await machine.hold(OTHER)
        await asyncio.sleep(0.2)
        await machine.set_override(1.0, ME)
        steps = machine.arm_state.steps
        await asyncio.sleep(2.0)
        assert machine.state is MachineState.HELD and machine.arm_state.steps == steps
        assert service.status().hold_cause == "USER"
        await machine.resume(ME)
        await job.wait()
        assert machine.arm_state.joints_deg == pytest.approx(NEXT, abs=0.03)

    at_start(tmp_path, scenario)


@pytest.mark.parametrize("distance", [None, 5.0])
def test_a_key_released_before_the_jog_began_moves_nothing(tmp_path: Path, distance: float | None) -> None:
    async def scenario(service: Service) -> None:
        steps = service.machine.arm_state.steps
        job = service.jogger.start(ME, "joint", "waist", 20.0, distance=distance)
        service.jogger.end(ME)
        await job.wait()
        await asyncio.sleep(1.0)
        assert service.machine.arm_state.steps == steps

    at_start(tmp_path, scenario)


def test_a_program_is_not_checked_from_a_moving_arm_and_what_is_shown_stays(tmp_path: Path) -> None:
    async def scenario(service: Service) -> None:
        programs = service.programs
        for name, text in (
            ("runs.ngc", "G21 G90\nG0 X270 Y0 Z250 A0 B0\nG1 Y80 F1000\nG1 X290\nM2\n"),
            ("other.ngc", "G21 G90\nG0 X270 Y0 Z250 A0 B0\nM2\n"),
        ):
            (tmp_path / "programs" / name).write_text(text)
        job = await programs.run(ME, "runs.ngc")
        async with asyncio.timeout(10):
            while service.status().line != 3:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        await asyncio.sleep(0.5)
        before = service.status()
        assert before.program == "runs.ngc" and before.progress > 0.0
        for call in (programs.load("other.ngc"), programs.run(ME, "other.ngc")):
            with pytest.raises(RefusedError, match=r"from where the arm stands, and tester moves it \(program\)"):
                await call
        after = service.status()
        assert (after.program, after.line, after.block) == (before.program, before.line, before.block)
        assert after.progress >= before.progress
        await job.wait()
        assert (await programs.load("other.ngc")).complete

    at_start(tmp_path, scenario)


def test_a_stop_during_a_reset_wins(tmp_path: Path) -> None:
    async def scenario(service: Service) -> None:
        machine = service.machine
        told = 0
        for delay_ms in (0, 3, 6, 9, 12, 16, 20, 30, 40):
            await machine.stop(OTHER)
            await until(service, MachineState.OFF)
            await asyncio.sleep(0.1)
            async with asyncio.TaskGroup() as tasks:
                reset = tasks.create_task(_outcome(machine.reset(ME)))
                await asyncio.sleep(delay_ms / 1000)
                await machine.stop(OTHER)
            await asyncio.sleep(0.5)
            status = machine.board_status
            assert status is not None and not status.power and machine.state is MachineState.OFF, delay_ms
            assert machine.cause is not None and "stopped by an operator" in machine.cause.text, delay_ms
            told += "during the reset" in reset.result()
        assert told >= 4

    at_start(tmp_path, scenario)


async def _outcome(call: Awaitable[None]) -> str:
    try:
        await call
    except StoppedError as error:
        return str(error)
    return ""

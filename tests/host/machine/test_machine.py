"""The machine on the emulated board, in virtual time: home, move, hold, abort, stop, recover, be without a board."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

from rm501_host.errors import NoBoardError, RefusedError, StoppedError
from rm501_host.machine import LeaseHeldError, MachineState, operations
from rm501_host.virtual_time import run_virtual
from rm501_protocol.link_events import StopKind
from tests.support.virtual_machine import ME, OTHER, homed, kinds, running_service

START = (0.0, 60.0, -60.0, 60.0, 0.0)
NEXT = (40.0, 70.0, -50.0, 40.0, 20.0)


def virtual(test: Coroutine[Any, Any, None]) -> None:
    run_virtual(test)


def test_starts_in_estop_and_nothing_moves_before_reset_and_home(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            assert machine.state is MachineState.ESTOP
            with pytest.raises(RefusedError, match="then reset"):
                operations.home(machine, ME)
            await machine.reset(ME)
            assert machine.state is MachineState.IDLE
            with pytest.raises(RefusedError, match="not homed: waist, shoulder, elbow, pitch, roll"):
                operations.move_joints(machine, ME, START)
            with pytest.raises(RefusedError, match="not homed"):
                service.jogger.start(ME, "world", "x", 10)
            await operations.home(machine, ME).wait()
            assert machine.arm_state.homed == (True,) * 5
            assert machine.arm_state.joints_deg == pytest.approx(machine.config.home_deg, abs=0.03)

    virtual(scenario())


def test_a_fault_that_does_not_exist_is_refused_whether_or_not_one_is_latched(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            with pytest.raises(RefusedError, match="no fault 'NIX'; the faults are OVERFLOW, ESTOP, KILLED"):
                await service.machine.reset(ME, "NIX")
            assert service.machine.state is MachineState.ESTOP
            await service.machine.reset(ME, "killed")  # none is latched any more: somebody else was quicker
            assert service.machine.state is MachineState.IDLE

    virtual(scenario())


def test_hold_and_resume_end_where_an_undisturbed_move_ends(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            await operations.move_joints(machine, ME, NEXT).wait()
            undisturbed = machine.stream.positions_q48 if machine.stream else ()
            await operations.move_joints(machine, ME, START).wait()
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(0.6)
            assert await machine.hold(OTHER)
            await asyncio.sleep(3.0)
            assert machine.state is MachineState.HELD
            before = machine.arm_state.steps
            await asyncio.sleep(5.0)
            assert machine.state is MachineState.HELD and machine.arm_state.steps == before
            await machine.resume(ME)
            await job.wait()
            assert machine.state is MachineState.IDLE
            assert machine.stream is not None and undisturbed == machine.stream.positions_q48

    virtual(scenario())


def test_abort_keeps_motors_and_trust_and_the_mirror_is_exact(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            for delay_s in (0.05, 0.4, 0.9, 1.3):
                job = operations.move_joints(machine, ME, NEXT)
                await asyncio.sleep(delay_s)
                await machine.abort(ME)
                with pytest.raises(StoppedError):
                    await job.wait()
                assert machine.state is MachineState.IDLE and machine.arm_state.homed == (True,) * 5
                # an exact mirror is the condition for the next motion to be accepted at all
                await operations.move_joints(machine, ME, START).wait()
                assert machine.arm_state.joints_deg == pytest.approx(START, abs=0.03)

    virtual(scenario())


def test_stop_ends_on_the_path_with_motors_off_and_needs_an_operator(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(0.7)
            await machine.stop(OTHER)
            with pytest.raises(StoppedError, match="STOP"):
                await job.wait()
            await asyncio.sleep(1.0)
            assert machine.state is MachineState.OFF
            # the power line is fitted: without power the arm sinks, so nothing is trusted
            assert machine.arm_state.homed == (False,) * 5
            steps = machine.arm_state.steps
            await asyncio.sleep(10.0)
            assert machine.state is MachineState.OFF and machine.arm_state.steps == steps
            with pytest.raises(RefusedError, match="OFF"):
                operations.home(machine, ME)
            await machine.reset(ME)
            await operations.home(machine, ME).wait()
            assert machine.arm_state.homed == (True,) * 5

    virtual(scenario())


def test_kill_is_a_fault_that_a_reset_has_to_name(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(0.7)
            await machine.stop(OTHER, StopKind.KILL)
            with pytest.raises(StoppedError):
                await job.wait()
            await asyncio.sleep(0.5)
            assert machine.state is MachineState.ESTOP and machine.cause is not None
            assert "KILLED" in machine.cause.text
            for wrong in (None, "OVERFLOW", "nonsense"):
                with pytest.raises(RefusedError, match="has to name the fault: KILLED"):
                    await machine.reset(ME, wrong)
                assert machine.state is MachineState.ESTOP
            await machine.reset(ME, "killed")
            assert machine.state is MachineState.IDLE and machine.arm_state.homed == (False,) * 5
            assert "black_box" in kinds(service)
            assert list((tmp_path / "blackbox").glob("*.jsonl.gz"))

    virtual(scenario())


@pytest.mark.parametrize("when_s", [0.0, 3.0, 6.6, 13.0, 25.0, 31.0])
def test_stop_during_homing_wins(tmp_path: Path, when_s: float) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await machine.reset(ME)
            job = operations.home(machine, ME)
            await asyncio.sleep(when_s)
            await machine.stop(OTHER)
            with pytest.raises(StoppedError):
                await job.wait()
            await asyncio.sleep(1.0)
            steps = machine.arm_state.steps
            await asyncio.sleep(5.0)
            assert machine.state is MachineState.OFF and machine.arm_state.steps == steps

    virtual(scenario())


def test_two_clients_one_moves_both_can_stop(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            job = operations.move_joints(machine, ME, NEXT)
            with pytest.raises(LeaseHeldError, match="tester"):
                operations.move_joints(machine, OTHER, START)
            await asyncio.sleep(0.3)
            await machine.stop(OTHER)
            with pytest.raises(StoppedError):
                await job.wait()
            await asyncio.sleep(1)
            await machine.reset(OTHER)
            job = operations.home(machine, OTHER)
            await asyncio.sleep(1)
            await machine.stop(ME)
            with pytest.raises(StoppedError):
                await job.wait()

    virtual(scenario())


def test_without_a_board_every_request_says_so(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            session = machine.session
            session.connection_lost(OSError("unplugged"))
            await asyncio.sleep(0)
            with pytest.raises(NoBoardError):
                await machine.stop(ME)
            await asyncio.sleep(0.5)
            assert machine.state is MachineState.ESTOP and machine.cause is not None

    virtual(scenario())

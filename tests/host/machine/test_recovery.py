"""What happens when the line, the board or the daemon goes away: what is trusted, what nobody may resume alone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rm501_host.config import load_config
from rm501_host.daemon.service import Service
from rm501_host.errors import NoBoardError, RefusedError, Rm501Error, StoppedError
from rm501_host.machine import Job, MachineState, operations
from rm501_host.motion import MotionStream
from rm501_host.session import LinkLostError
from rm501_host.virtual_time import VirtualLoop, run_virtual
from rm501_protocol.enums import BoardState
from rm501_protocol.link_events import StopKind
from rm501_protocol.transport import Transport
from rm501_sim_board.emu_transport import running_board, shut_down
from tests.support.lying_line import Lie, LyingLine
from tests.support.virtual_machine import ME, homed, running_service

START = (0.0, 60.0, -60.0, 60.0, 0.0)
NEXT = (60.0, 75.0, -45.0, 30.0, 20.0)
WHEN_S = 60.0


@asynccontextmanager
async def homed_service(tmp_path: Path, url: str = "emu://?preset=ideal&seed=1") -> AsyncIterator[Service]:
    """A service whose arm has just homed."""
    async with running_service(tmp_path, url) as service:
        await homed(service)
        yield service


@asynccontextmanager
async def moving_service(tmp_path: Path, fault: str) -> AsyncIterator[tuple[Service, Job]]:
    """A service whose arm is on its way to NEXT at WHEN_S, when the fault happens."""
    async with homed_service(tmp_path, f"emu://?preset=ideal&seed=1&fault={fault}") as service:
        loop = asyncio.get_running_loop()
        await operations.move_joints(service.machine, ME, START).wait()
        assert loop.time() < WHEN_S - 0.8
        await asyncio.sleep(WHEN_S - 0.8 - loop.time())
        yield service, operations.move_joints(service.machine, ME, NEXT)


def virtual(test: Coroutine[Any, Any, None]) -> None:
    run_virtual(test)


def test_a_stall_of_three_seconds_holds_and_only_an_operator_resumes(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with moving_service(tmp_path, f"host-stall:ms=3000@{WHEN_S}s") as (service, job):
            machine = service.machine
            await asyncio.sleep(6.0)
            assert machine.state is MachineState.HELD
            assert service.status().hold_cause == "LINK_LOST"
            steps = machine.arm_state.steps
            await asyncio.sleep(5.0)
            assert machine.state is MachineState.HELD and machine.arm_state.steps == steps
            await machine.resume(ME)
            await job.wait()
            assert machine.arm_state.joints_deg == pytest.approx(NEXT, abs=0.03)
            assert machine.arm_state.homed == (True,) * 5

    virtual(scenario())


@pytest.mark.parametrize(
    ("fault", "trusted"), [("unplug@60s/2s", True), ("reset@60s", False), ("reset:dark_ms=3000@60s", False)]
)
def test_after_a_lost_link_trust_depends_on_the_boot(tmp_path: Path, fault: str, trusted: bool) -> None:
    async def scenario() -> None:
        async with moving_service(tmp_path, fault) as (service, job):
            machine = service.machine
            with pytest.raises(StoppedError):
                await job.wait()
            async with asyncio.timeout(20):
                while machine.state is not MachineState.ESTOP or not machine.connected:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            await asyncio.sleep(1.0)
            steps = machine.arm_state.steps
            await asyncio.sleep(2.0)
            assert machine.state is MachineState.ESTOP and machine.arm_state.steps == steps
            assert (machine.arm_state.homed == (True,) * 5) is trusted
            await machine.reset(ME)
            assert machine.state is MachineState.IDLE
            if not trusted:
                await operations.home(machine, ME).wait()
            await operations.move_joints(machine, ME, NEXT).wait()
            assert machine.arm_state.joints_deg == pytest.approx(NEXT, abs=0.03)

    virtual(scenario())


def test_who_stops_or_holds_without_a_board_is_told_that_nobody_heard_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path, "emu://?preset=ideal&seed=1&fault=unplug@5s/4s") as service:
            machine = service.machine
            async with asyncio.timeout(20):
                while machine.connected:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            for kind in (StopKind.STOP, StopKind.KILL):
                with pytest.raises(NoBoardError, match=f"{kind.name} was not delivered: .*holds a moving arm"):
                    await machine.stop(ME, kind)
            with pytest.raises(NoBoardError, match=r"nobody can be told to hold: .*holds a moving arm"):
                await machine.hold(ME)
            assert await machine.abort(ME) is False
            assert "stop_not_delivered" in [record.kind for record in machine.log.ring]

    virtual(scenario())


def test_a_stop_and_a_hold_that_a_silent_board_has_not_acknowledged_say_so(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with moving_service(tmp_path, f"host-stall:ms=4500@{WHEN_S}s") as (service, job):
            machine = service.machine
            async with asyncio.timeout(5):
                while not machine.link_silent:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            with pytest.raises(LinkLostError, match=r"hold is on its way.*silent for a second.*holds a moving arm"):
                await machine.hold(ME)
            with pytest.raises(LinkLostError, match=r"STOP has not been acknowledged: .*holds a moving arm"):
                await machine.stop(ME)
            with pytest.raises(StoppedError):
                await job.wait()

    virtual(scenario())


@pytest.mark.parametrize("board", ["724", "732"])
def test_an_overflow_names_the_board_and_distrusts_its_joints(tmp_path: Path, board: str) -> None:
    async def scenario() -> None:
        async with moving_service(tmp_path, f"overflow:board={board}@{WHEN_S}s/0.5s") as (service, job):
            machine = service.machine
            with pytest.raises(StoppedError):
                await job.wait()
            await asyncio.sleep(1.0)
            assert machine.state is MachineState.ESTOP and machine.cause is not None
            assert "OVERFLOW" in machine.cause.text and "--fault OVERFLOW" in machine.cause.remedy
            assert list((tmp_path / "blackbox").glob("*overflow*.gz"))
            await machine.reset(ME, "OVERFLOW")
            waist, shoulder, elbow, pitch, roll = machine.arm_state.homed
            if board == "724":
                assert (waist, elbow) == (False, False)
            else:
                assert (shoulder, pitch, roll) == (False, False, False)
            await operations.home(machine, ME, machine.arm_state.unhomed()).wait()
            assert machine.arm_state.homed == (True,) * 5

    virtual(scenario())


def test_another_configuration_is_not_believed(tmp_path: Path) -> None:
    """The board still trusts its counts, but they were defined under another configuration of the host."""

    async def scenario() -> None:
        async with homed_service(tmp_path) as service:
            machine = service.machine
            identify, status = machine.session.link.identify, machine.board_status
            assert identify is not None and status is not None and status.trusted_mask & 31 == 31
            assert "stay homed" in machine.arm_state.connected(identify, status)
            other = type(machine.arm_state)(machine.arm, load_config(), machine.arm_state._file, lambda: "")
            assert "another configuration" in other.connected(identify, status)
            assert other.homed == (False,) * 5
            (tmp_path / "position.json").write_text("{}")
            assert "no usable position file" in machine.arm_state.connected(identify, status)
            assert machine.arm_state.homed == (False,) * 5

    virtual(scenario())


def test_what_is_not_trusted_stays_so_for_the_next_daemon_until_it_has_homed(tmp_path: Path) -> None:
    """Homing one joint writes the file anew, for this boot and configuration: the others are still not trusted."""
    url = "emu://vetoed?preset=ideal&seed=1"

    async def scenario() -> None:
        async with running_service(tmp_path, url) as service:
            await homed(service)
        (tmp_path / "position.json").unlink()
        async with running_service(tmp_path, url, seed=8) as service:
            await service.machine.reset(ME)
            assert service.machine.arm_state.homed == (False,) * 5
            await operations.home(service.machine, ME, ("waist",)).wait()
        for seed in (9, 10):
            async with running_service(tmp_path, url, seed=seed) as service:
                assert service.machine.arm_state.homed == (True, False, False, False, False)
        async with running_service(tmp_path, url, seed=11) as service:
            machine = service.machine
            await machine.reset(ME)
            await operations.home(machine, ME, machine.arm_state.unhomed()).wait()
        async with running_service(tmp_path, url, seed=12) as service:
            assert service.machine.arm_state.homed == (True,) * 5
        shut_down("vetoed")

    virtual(scenario())


def test_a_board_that_contradicted_itself_is_not_trusted_by_the_next_daemon_either(tmp_path: Path) -> None:
    url = "emu://contradicted?preset=ideal&seed=1"
    lines: list[LyingLine] = []

    def lying(transport: Transport) -> Transport:
        lines.append(LyingLine(transport, 4, (Lie.POSITION,), 1.0))
        return lines[-1]

    async def scenario() -> None:
        async with running_service(tmp_path, url, on_transport=lying) as service:
            machine = service.machine
            await homed(service)
            lines[0].is_lying = True
            await asyncio.sleep(0.5)
            assert machine.cause is not None and "contradicts itself" in machine.cause.text
            await asyncio.sleep(2.0)
            assert machine.connected and machine.arm_state.homed == (False,) * 5
        async with running_service(tmp_path, url, seed=8) as service:
            assert service.machine.arm_state.homed == (False,) * 5
        shut_down("contradicted")

    virtual(scenario())


def test_a_full_disk_stops_nothing_and_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import errno
    import os

    async def scenario() -> None:
        async with homed_service(tmp_path) as service:
            machine = service.machine

            def no_space(descriptor: int) -> None:
                raise OSError(errno.ENOSPC, "No space left on device")

            monkeypatch.setattr(os, "fsync", no_space)
            await operations.move_joints(machine, ME, START).wait()
            assert any("No space left" in warning for warning in service.status().warnings)
            with pytest.raises(Rm501Error, match="No space left"):
                service.teach.record("here", machine.arm_state.joints_deg)
            monkeypatch.undo()
            await operations.move_joints(machine, ME, NEXT).wait()
            assert service.status().warnings == ()

    virtual(scenario())


def test_shutting_down_brings_a_moving_arm_to_rest_with_motors_held(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with homed_service(tmp_path) as service:
            machine = service.machine
            await operations.move_joints(machine, ME, START).wait()
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(0.5)
            await machine.shut_down()
            assert job.done.is_set() and job.error is not None
            status = machine.board_status
            assert status is not None and status.state.name == "READY" and status.power and status.rate == 0
            assert machine.arm_state.homed == (True,) * 5

    virtual(scenario())
    record = (tmp_path / "position.json").read_text()
    assert '"dirty":false' in record


def test_a_plug_pulled_while_a_motion_begins_leaves_nothing_behind(tmp_path: Path) -> None:
    """Also between the segments and their start: what was queued then must not keep anybody from going on."""

    async def scenario() -> None:
        queued_at_rest = 0
        async with homed_service(tmp_path, "emu://begins?preset=ideal&seed=1") as service:
            machine = service.machine
            await operations.move_joints(machine, ME, START).wait()
            board = running_board("begins").board
            for delay_ms in range(0, 48, 4):
                job = operations.move_joints(machine, ME, NEXT)
                await asyncio.sleep(delay_ms / 1000)
                board.pull_plug()
                with pytest.raises(StoppedError):
                    await job.wait()
                await asyncio.sleep(1.5)
                board.put_plug_back()
                async with asyncio.timeout(20):
                    while not machine.connected:  # noqa: ASYNC110
                        await asyncio.sleep(0.05)
                status, steps = machine.board_status, machine.arm_state.steps
                assert status is not None
                queued_at_rest += status.state is BoardState.READY and status.queue_used > 0
                await machine.reset(ME)
                await asyncio.sleep(0.5)
                assert machine.state is MachineState.IDLE
                assert machine.arm_state.steps == steps
                assert machine.arm_state.homed == (True,) * 5
            await operations.move_joints(machine, ME, START).wait()
            assert machine.arm_state.joints_deg == pytest.approx(START, abs=0.03)
            shut_down("begins")
        assert queued_at_rest > 0

    virtual(scenario())


@pytest.mark.parametrize("what", ["process", "line"])
def test_what_stood_still_before_a_motion_began_does_not_begin_it(tmp_path: Path, what: str) -> None:
    """The operator's command is seconds old by then: it is not begun, or held at once, and a user decides."""

    async def scenario() -> None:
        ends = {"held": 0, "not begun": 0}
        async with homed_service(tmp_path, "emu://stalls?preset=ideal&seed=1") as service:
            machine = service.machine
            loop = asyncio.get_running_loop()
            assert isinstance(loop, VirtualLoop)
            for delay_ms in (0, 8, 16, 60):
                await operations.move_joints(machine, ME, START).wait()
                await asyncio.sleep(3.0)
                job = operations.move_joints(machine, ME, NEXT)
                if what == "process":
                    loop.call_later(delay_ms / 1000, loop.stand_still, 5.0)
                else:
                    loop.call_later(delay_ms / 1000, running_board("stalls").faults.inject, "drop:p=1/2.5s")
                await asyncio.sleep(7.0)
                steps = machine.arm_state.steps
                await asyncio.sleep(4.0)
                assert machine.arm_state.steps == steps, delay_ms
                if machine.state is MachineState.HELD:
                    ends["held"] += 1
                    await machine.resume(ME)
                    await job.wait()
                else:
                    ends["not begun"] += 1
                    with pytest.raises(StoppedError, match="stood still for more than a second before the motion"):
                        await job.wait()
                    assert machine.state is MachineState.IDLE
                    assert machine.arm_state.joints_deg == pytest.approx(START, abs=0.03)
                    await operations.move_joints(machine, ME, NEXT).wait()
                assert machine.arm_state.joints_deg == pytest.approx(NEXT, abs=0.03), (delay_ms, ends)
            shut_down("stalls")
        assert ends["held"] > 0
        assert what == "line" or ends["not begun"] > 0

    virtual(scenario())


def test_nobody_plans_from_a_guess_when_the_board_does_not_settle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motion broke off and taking over the board's positions failed: the next one is refused until a reset."""

    async def scenario() -> None:
        async with homed_service(tmp_path) as service:
            machine = service.machine
            await operations.move_joints(machine, ME, START).wait()
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(1.0)

            async def refuse(stream: MotionStream) -> None:
                raise StoppedError("the board refused SetPositions")

            with monkeypatch.context() as patch:
                patch.setattr(MotionStream, "prepare", refuse)
                await machine.abort(ME)
                with pytest.raises(StoppedError):
                    await job.wait()
            assert machine.state is MachineState.ESTOP
            assert service.status().cause.startswith("where a motion that broke off has left the arm is not known")
            with pytest.raises(RefusedError):
                operations.move_joints(machine, ME, NEXT)
            await machine.reset(ME)
            assert machine.arm_state.homed == (True,) * 5
            await operations.move_joints(machine, ME, NEXT).wait()
            assert machine.arm_state.joints_deg == pytest.approx(NEXT, abs=0.03)

    virtual(scenario())

"""The machine on the emulated board, in virtual time: home, move, hold, resume, abort, stop, jog, run, recover."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

from rm501_host.errors import NoBoardError, RefusedError, StoppedError
from rm501_host.gcode.errors import GcodeError
from rm501_host.machine import LeaseHeldError, MachineState, operations, tables
from rm501_host.virtual_time import run_virtual
from rm501_protocol.link_events import StopKind
from tests.support.virtual_machine import ME, OTHER, REPOSITORY, homed, kinds, running_service

START = (0.0, 60.0, -60.0, 60.0, 0.0)
STRAIGHT_DOWN = (0.0, 58.8, -83.7, 24.9, 0.0)
"""The one orientation that five joints can keep in every horizontal direction."""
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


def test_a_jog_ends_by_itself_when_nobody_keeps_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, jogger = service.machine, service.jogger
            loop = asyncio.get_running_loop()
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            job = jogger.start(ME, "joint", "waist", 20)
            for _ in range(10):
                await asyncio.sleep(0.1)
                assert jogger.keep(ME, job.id)
            last_s = loop.time()
            await job.wait()
            # the lease of 200 ms, then the ramp from 20 deg/s
            assert 0.15 < loop.time() - last_s < 0.9
            assert machine.state is MachineState.IDLE and machine.arm_state.homed == (True,) * 5
            assert not jogger.keep(ME, job.id)
            at = machine.arm_state.joints_deg
            await asyncio.sleep(3)
            assert machine.arm_state.joints_deg == at

    virtual(scenario())


@pytest.mark.parametrize(
    ("frame", "axis", "speed", "moved"),
    [
        ("world", "x", 40.0, (1, 0, 0)),
        ("world", "y", -40.0, (0, -1, 0)),
        ("world", "z", 40.0, (0, 0, 1)),
        ("tool", "z", 40.0, None),
        ("tool", "x", -40.0, None),
    ],
)
def test_cartesian_jogs_go_straight_and_keep_the_orientation(
    tmp_path: Path, frame: str, axis: str, speed: float, moved: tuple[int, ...] | None
) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            pose = START if frame == "tool" else STRAIGHT_DOWN
            await operations.move_joints(machine, ME, pose).wait()
            before = operations.position(machine)
            tool = machine.arm.fk(pose).rotation[:, "xyz".index(axis)]
            await service.jogger.start(ME, frame, axis, speed, distance=20.0).wait()
            after = operations.position(machine)
            step = [b - a for a, b in zip(before[:3], after[:3], strict=True)]
            direction = moved if moved is not None else (machine.arm.frame.rotation.T @ tool * (1 if speed > 0 else -1))
            assert step == pytest.approx([20.0 * part for part in direction], abs=0.25)
            assert after[3:] == pytest.approx(before[3:], abs=0.1)

    virtual(scenario())


def test_jogs_stop_at_the_limits_and_refuse_to_start_beyond(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, jogger = service.machine, service.jogger
            await homed(service)
            await operations.move_joints(machine, ME, (140.0, 60.0, -60.0, 60.0, 0.0)).wait()
            job = jogger.start(ME, "joint", "waist", 1000)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            assert job.error is None and machine.arm_state.joints_deg[0] == pytest.approx(150.0, abs=0.03)
            with pytest.raises(RefusedError, match="at its limit 150"):
                await jogger.start(ME, "joint", "waist", 5).wait()
            with pytest.raises(RefusedError, match="no joint"):
                jogger.start(ME, "joint", "knee", 5)
            with pytest.raises(RefusedError, match="no axis"):
                jogger.start(ME, "tool", "a", 5)
            # straight out until the arm is stretched: ends before, without a fault
            job = jogger.start(ME, "tool", "z", 200)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            assert job.error is None and machine.state is MachineState.IDLE
            limits = machine.config.joints.ordered
            for angle, joint in zip(machine.arm_state.joints_deg, limits, strict=True):
                assert joint.min_deg - 0.03 <= angle <= joint.max_deg + 0.03

    virtual(scenario())


def test_unhomed_joints_jog_slowly_and_not_far(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, jogger = service.machine, service.jogger
            await machine.reset(ME)
            loop = asyncio.get_running_loop()
            began_s = loop.time()
            job = jogger.start(ME, "joint", "waist", 30)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            assert machine.arm_state.joints_deg[0] == pytest.approx(30.0, abs=0.03)
            # a fifth of 30 deg/s
            assert loop.time() - began_s > 30.0 / 6.0
            assert machine.arm_state.homed == (False,) * 5

    virtual(scenario())


def test_the_thesis_program_runs_with_progress_and_ends_with_the_hand_open(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, programs = service.machine, service.programs
            shutil.copy(REPOSITORY / "examples" / "pick_and_place.ngc", tmp_path / "programs" / "pnp.ngc")
            await homed(service)
            job = await programs.run(ME, "pnp.ngc")
            lines, hands, progress = [], set(), []
            while not job.done.is_set():
                await asyncio.sleep(0.5)
                lines.append(programs.line)
                progress.append(programs.progress)
                hands.add(machine.arm_state.hand)
            await job.wait()
            assert lines == sorted(lines) and lines[-1] >= 17
            assert progress == sorted(progress) and programs.progress == 1.0
            assert {"CLOSED", "OPEN", "CLOSING"} <= hands
            assert machine.arm_state.hand == "OPEN"

    virtual(scenario())


def test_pause_message_input_single_block_and_last_line(tmp_path: Path) -> None:
    program = """G21 G90 F3000
G1 X250 Y0 Z-100 A0 B0 C0
(MSG,take the part)
M0
G1 X260
M66 P1 L0
#1=#5399
G1 X[270+#1]
M1
M2
"""

    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, programs = service.machine, service.programs
            (tmp_path / "programs" / "a.ngc").write_text(program)
            await homed(service)
            await (await programs.mdi(ME, "G0 X240 Y0 Z-100 A0 B0 C0")).wait()
            job = await programs.run(ME, "a.ngc")
            assert programs.checked is not None and not programs.checked.complete
            await asyncio.sleep(3)
            assert machine.state is MachineState.HELD and machine.waiting_for == "M0"
            assert machine.messages[-1] == "a.ngc:3: take the part"
            await machine.resume(ME)
            await job.wait()
            assert operations.position(machine)[0] == pytest.approx(270.0, abs=0.2)
            programs.optional_stop = programs.single_block = True
            await (await programs.mdi(ME, "G0 X240 Y0 Z-100 A0 B0 C0")).wait()
            job = await programs.run(ME, "a.ngc")
            stops = []
            for _ in range(8):
                await asyncio.sleep(3)
                if job.done.is_set():
                    break
                stops.append((machine.waiting_for, programs.line))
                await machine.resume(ME)
            await job.wait()
            assert [what for what, _ in stops] == ["step", "M0", "step", "step", "step", "M1"]
            job = await programs.run(ME, "a.ngc", line=5)
            await asyncio.sleep(3)
            await machine.abort(ME)
            with pytest.raises(StoppedError):
                await job.wait()
            assert programs.line == 5

    virtual(scenario())


def test_wrong_programs_and_blocks_move_nothing(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, programs = service.machine, service.programs
            await homed(service)
            steps = machine.arm_state.steps
            (tmp_path / "programs" / "far.ngc").write_text("G21 G90 F1000\nG1 X250 Y0 Z-100 A0 B0 C0\nG1 X9999\nM2\n")
            (tmp_path / "programs" / "bad.ngc").write_text("G21 G90 F1000\nG1 X25O\nM2\n")
            with pytest.raises(RefusedError, match=r"far\.ngc:3: error: .*cannot be reached"):
                await programs.run(ME, "far.ngc")
            with pytest.raises(GcodeError, match=r"bad\.ngc:2"):
                await programs.run(ME, "bad.ngc")
            with pytest.raises(GcodeError):
                await programs.mdi(ME, "G1 Xfoo F100")
            for name in ("../../etc/passwd", "/etc/passwd", "a/b.ngc", "..ngc", "x.py", "nothing.ngc", "a\0.ngc"):
                with pytest.raises(RefusedError):
                    await programs.run(ME, name)
            assert machine.state is MachineState.IDLE and machine.arm_state.steps == steps
            assert machine.lease.owner is None

    virtual(scenario())


def test_teach_points_reach_programs(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, programs = service.machine, service.programs
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            service.teach.record("above", machine.arm_state.joints_deg)
            await operations.move_joints(machine, ME, NEXT).wait()
            await (await programs.mdi(ME, "G20")).wait()
            await (await programs.mdi(ME, "o<goto> call [1]")).wait()
            assert machine.arm_state.joints_deg == pytest.approx(START, abs=0.05)
            await (await programs.mdi(ME, "M110 P1 Q[#<_point_above_q1> + 15]")).wait()
            assert machine.arm_state.joints_deg[0] == pytest.approx(15.0, abs=0.05)
            with pytest.raises(GcodeError, match="no teach point"):
                await programs.mdi(ME, "o<goto> call [7]")

    virtual(scenario())


def test_override_slows_the_path_and_zero_holds(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            loop = asyncio.get_running_loop()
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            began_s = loop.time()
            await operations.move_joints(machine, ME, NEXT).wait()
            full_s = loop.time() - began_s
            await machine.set_override(0.25, ME)
            began_s = loop.time()
            await operations.move_joints(machine, ME, START).wait()
            assert loop.time() - began_s == pytest.approx(4 * full_s, rel=0.1)
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(0.5)
            await machine.set_override(0.0, ME)
            await asyncio.sleep(2.0)
            assert machine.state is MachineState.HELD
            await machine.set_override(1.0, ME)
            await job.wait()
            with pytest.raises(RefusedError, match="between 0 and 2"):
                await machine.set_override(2.01, ME)

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


def test_work_offsets_and_tools_change_what_blocks_mean(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, programs, around = service.machine, service.programs, service.around
            await homed(service)
            await (await programs.mdi(ME, "G0 X250 Y0 Z-100 A0 B0 C0")).wait()
            tables.set_offset(around, machine.arm, "G55", (30.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0)
            programs.forget_modes()
            await (await programs.mdi(ME, "G55")).wait()
            await (await programs.mdi(ME, "G0 X250")).wait()
            assert operations.position(machine)[0] == pytest.approx(280.0, abs=0.2)
            listed = {entry["name"]: entry["offset"] for entry in tables.offset_list(around, machine.arm)}
            assert listed["G55"][0] == 30.0 and listed["G54"][0] == 0.0
            await (await programs.mdi(ME, "G10 L2 P2 X10")).wait()
            await (await programs.mdi(ME, "G0 X250")).wait()
            assert operations.position(machine)[0] == pytest.approx(260.0, abs=0.2)
            tables.set_tool(around, 3, (0.0, 0.0, 25.0), 4.0, "probe tip")
            programs.forget_modes()
            await (await programs.mdi(ME, "G54")).wait()
            await (await programs.mdi(ME, "G43 H3")).wait()
            before = operations.position(machine)[2]
            await (await programs.mdi(ME, "G0 Z-100")).wait()
            # the tool points along program +Z, so a tool 25 mm longer stands 25 mm farther back
            assert operations.position(machine)[2] - before == pytest.approx(-25.0, abs=0.2)
            tables.delete_tool(around, 3)
            with pytest.raises(RefusedError, match="no tool 3"):
                tables.delete_tool(around, 3)
            with pytest.raises(RefusedError, match="G54, G55"):
                tables.set_offset(around, machine.arm, "G60", (0.0,) * 6, 0.0)

    virtual(scenario())

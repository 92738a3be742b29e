"""Programs and blocks through the machine: progress, pauses, refusals, teach points, override, offsets, tools."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

from rm501_host.errors import RefusedError, StoppedError
from rm501_host.gcode.errors import GcodeError
from rm501_host.machine import MachineState, operations, tables
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, REPOSITORY, homed, running_service

START = (0.0, 60.0, -60.0, 60.0, 0.0)
NEXT = (40.0, 70.0, -50.0, 40.0, 20.0)


def virtual(test: Coroutine[Any, Any, None]) -> None:
    run_virtual(test)


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

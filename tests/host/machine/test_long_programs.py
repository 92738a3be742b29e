"""Programs that cannot be checked to their end: endless, waiting for inputs, wrong on the way; and what they leave."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest

from rm501_host.config import load_config
from rm501_host.errors import ProgramRefusedError, RefusedError, StoppedError
from rm501_host.machine.program_check import Checked, LoadedProgram
from rm501_host.machine.snapshot import snapshot
from rm501_host.machine.states import MachineState
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, homed, running_service

CONFIG = load_config()
SHORT = msgspec.structs.replace(CONFIG, preflight=msgspec.structs.replace(CONFIG.preflight, max_blocks=100))


def put(folder: Path, text: str) -> None:
    (folder / "programs").mkdir(exist_ok=True)
    (folder / "programs" / "a.ngc").write_text(text)


def test_an_endless_program_runs_until_somebody_ends_it(tmp_path: Path) -> None:
    body = "".join(f"G1 X{280 + 10 * (i % 2)} Y{5 * (i % 3)}\n" for i in range(4))
    put(tmp_path, f"G21 G90 G94 G61.1 F6000\nG0 X280 Y0 Z200 A0 B0\no1 while [1]\n{body}o1 endwhile\nM2\n")

    async def scenario() -> None:
        async with running_service(tmp_path, config=SHORT) as service:
            machine, programs = service.machine, service.programs
            await homed(service)
            job = await programs.run(ME, "a.ngc")
            assert programs.checked is not None and not programs.checked.complete
            lines = set()
            for _ in range(16):
                await asyncio.sleep(0.5)
                lines.add(programs.line)
                status = snapshot(machine, programs, 0.0)
                assert status.checked_to_line == 7 and not status.check_complete
                assert 0.0 <= programs.progress <= 1.0
            assert lines >= {4, 5, 6, 7}
            assert machine.state is MachineState.RUNNING
            await machine.abort(ME)
            with pytest.raises(StoppedError):
                await job.wait()
            assert machine.state is MachineState.IDLE

    run_virtual(scenario())


def test_status_says_how_far_a_check_has_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, "G21 G90 G94 F6000\nG0 X280 Y0 Z200 A0 B0\nG1 X290\nG1 X300\nM2\n")
    check, seen = LoadedProgram.check, list[tuple[int, bool]]()

    async def scenario() -> None:
        async with running_service(tmp_path, config=CONFIG) as service:
            programs = service.programs
            await homed(service)

            def watched(program: LoadedProgram) -> Checked:
                found = check(program)
                seen.append((programs.checked_to_line, programs.check_complete))
                return found

            monkeypatch.setattr(LoadedProgram, "check", watched)
            await programs.load("a.ngc")
            assert seen == [(5, False)]  # under way, and not that of an earlier program
            assert programs.check_complete
            put(tmp_path, "G21 G90 G94 F6000\nG0 X280 Y0 Z900 A0 B0\nM2\n")
            with pytest.raises(RefusedError):
                await programs.load("a.ngc")
            assert programs.check_complete  # that of the one that is loaded

    run_virtual(scenario())


def test_what_follows_an_input_is_checked_ahead_of_the_motion(tmp_path: Path) -> None:
    put(
        tmp_path,
        "G21 G90 G94 F6000\nG0 X280 Y0 Z200 A0 B0\nM66 P1 L0\n(LOGOPEN, inside.txt)\n(LOG, on the way)\n"
        "G1 X290\nG1 X300\nG1 X[900+#5399]\nG1 X310\nM2\n",
    )

    async def scenario() -> None:
        async with running_service(tmp_path, config=CONFIG) as service:
            machine, programs = service.machine, service.programs
            await homed(service)
            job = await programs.run(ME, "a.ngc")
            assert programs.checked_to_line == 3 and not programs.check_complete
            with pytest.raises(ProgramRefusedError, match=r"a\.ngc:8: error: .*cannot be reached(.|\n)*was running"):
                await job.wait()
            assert machine.state is MachineState.IDLE
            assert machine.arm.program_from_joints(machine.planning_start_deg)[0] == pytest.approx(300.0, abs=0.05)
            assert programs.checked_to_line == 7
            assert programs.line == 7
            assert (tmp_path / "logs" / "inside.txt").read_text() == "on the way\n"

    run_virtual(scenario())


def test_variables_are_saved_when_a_program_has_been_played_not_when_it_is_checked(tmp_path: Path) -> None:
    put(tmp_path, "G21 G90 G94 F6000\nG10 L2 P2 X12 Y0 Z0\nG0 X280 Y0 Z200 A0 B0\nG1 X290\nM2\n")

    async def scenario() -> None:
        async with running_service(tmp_path, config=CONFIG) as service:
            programs = service.programs
            await homed(service)
            await programs.load("a.ngc")
            variables = tmp_path / "rm501.var"
            assert not variables.exists()
            await (await programs.run(ME, "a.ngc")).wait()
            saved = dict(line.split() for line in variables.read_text().splitlines() if line.strip())
            assert float(saved["5241"]) == 12.0

    run_virtual(scenario())


def test_the_time_left_of_a_long_program_becomes_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rm501_host.program_plan.EAGER_MOVES", 20)
    body = "".join(f"G1 X{280 + 10 * (i % 2)} Y{5 * (i % 3)}\n" for i in range(40))
    put(tmp_path, f"G21 G90 G94 G61.1 F6000\nG0 X280 Y0 Z200 A0 B0\n{body}M2\n")

    async def scenario() -> None:
        async with running_service(tmp_path, config=CONFIG) as service:
            programs = service.programs
            loop = asyncio.get_running_loop()
            await homed(service)
            job = await programs.run(ME, "a.ngc")
            assert programs.check_complete
            began = loop.time()
            await asyncio.sleep(8.0)
            left, passed = programs.time_left_s, loop.time()
            await job.wait()
            assert left == pytest.approx(loop.time() - passed, rel=0.2)
            assert loop.time() - began > 15.0
            assert programs.progress == 1.0

    run_virtual(scenario())

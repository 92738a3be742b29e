"""Running programs and single blocks on the machine.

    load        check it from where the arm stands, as far as may be: nothing moves, errors are found here
    run         play it; pauses, messages and inputs are handled at rest, between stretches of motion
    afterwards  the last executed line stays, so `run --line` can go on from there when an operator says so

A program that asks the outside world (M66), never ends or is very long cannot be checked to its end before the start.
It is checked as far as may be; the same check then goes on ahead of the motion, and status says `checked_to_line`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from rm501_host.errors import RefusedError
from rm501_host.machine.gcode_source import MdiSession, Surroundings
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.player import Player, WayBack
from rm501_host.machine.program_check import Checked, LoadedProgram
from rm501_host.machine.program_files import ProgramFiles
from rm501_host.planner import Planner

_SHOWN_BYTES = 5_000_000


class Programs:
    """The loaded program and the one that runs."""

    def __init__(self, machine: Machine, files: ProgramFiles, around: Surroundings) -> None:
        self.files = files
        self.player = Player(machine, around)
        self.name = ""
        self.checked: Checked | None = None
        self._machine = machine
        self._around = around
        self._mdi = MdiSession(around)
        self._running: LoadedProgram | None = None
        self._checking: LoadedProgram | None = None
        self._is_done = False

    @property
    def line(self) -> int:
        """Line of the motion under way or the last one executed."""
        return self.player.line

    @property
    def block(self) -> str:
        """Text of that line."""
        return self.player.block

    @property
    def single_block(self) -> bool:
        """Stop after every block that moves."""
        return self.player.single_block

    @single_block.setter
    def single_block(self, on: bool) -> None:
        self.player.single_block = on

    @property
    def optional_stop(self) -> bool:
        """Pause at M1."""
        return self.player.optional_stop

    @optional_stop.setter
    def optional_stop(self, on: bool) -> None:
        self.player.optional_stop = on

    @property
    def progress(self) -> float:
        """Done share of the program's path time at 100 %."""
        if self._is_done:
            return 1.0
        return min(1.0, self.player.played_s / self._total_s) if self.name and self._total_s > 0.0 else 0.0

    @property
    def time_left_s(self) -> float:
        """Path time left of the program that runs, at 100 %."""
        return max(0.0, self._total_s * (1.0 - self.progress)) if self.name else 0.0

    @property
    def checked_to_line(self) -> int:
        """How far the loaded program has been checked, or the one that is just being checked; goes on while it runs."""
        if self._checking is not None:
            return self._checking.plan.read_to_line
        checked = 0 if self.checked is None or not self.name else self.checked.checked_to_line
        return checked if self._running is None else max(checked, self._running.plan.checked_to_line)

    @property
    def check_complete(self) -> bool:
        """Whether the loaded program has been checked to its end."""
        if self._checking is not None:
            return False
        if self._running is not None:
            return self._running.plan.is_complete
        return self.checked is not None and bool(self.name) and self.checked.complete

    @property
    def _total_s(self) -> float:
        if self._running is not None:
            return self._running.plan.duration_s
        return 0.0 if self.checked is None else self.checked.duration_s

    @property
    def mdi_history(self) -> list[str]:
        """Blocks given by MDI, oldest first."""
        return list(self._mdi.history)

    def forget_modes(self) -> None:
        """MDI begins anew, with the tables as they are now."""
        self._mdi.forget()

    # ------------------------------------------------------------------------------------------ preflight

    async def load(self, name: str, *, line: int = 1, speed: float = 1.0) -> Checked:
        """Check a program from here, at `speed` times its feeds, and plan it if it is short. Raises
        ProgramNameError, GcodeError, PlanError, RefusedError.
        """
        program, checked = await self._load(name, line=line, speed=speed)
        program.close()
        return checked

    async def _load(self, name: str, *, line: int, speed: float) -> tuple[LoadedProgram, Checked]:
        path = self.files.path(name)
        self._refuse_while_moving(name)
        if not 0.0 < speed <= 2.0:
            raise RefusedError(f"speed {speed} is not above 0 and at most 2")
        if missing := self._machine.arm_state.unhomed():
            raise RefusedError(
                f"not homed: {', '.join(missing)}; home first, a program is checked from where the arm is"
            )
        start = self._machine.planning_start_deg
        step = self.single_block
        loop, messages = asyncio.get_running_loop(), self._machine.messages

        def tell(text: str) -> None:
            loop.call_soon_threadsafe(messages.append, text)

        program = LoadedProgram(self._machine, self._around, path, line, start, speed, step, tell)
        self._checking = program
        try:
            checked = await loop.run_in_executor(None, program.check)
        except BaseException:
            program.close()
            raise
        finally:
            if self._checking is program:
                self._checking = None
        try:
            self._refuse_while_moving(name)
        except RefusedError:
            program.close()
            raise
        self.checked = checked
        self.name, self._is_done = name, False
        self.player.show(_lines_of(path))
        self._machine.write_log("program_loaded", name=name, line=line, duration_s=round(checked.duration_s, 3))
        return program, checked

    def _refuse_while_moving(self, name: str) -> None:
        """A program is checked from where the arm stands; and what is shown belongs to the one that runs."""
        job = self._machine.job
        if job is not None:
            raise RefusedError(
                f"{name} is checked from where the arm stands, and {job.owner.name} moves it ({job.kind.value}); "
                "wait for the end of that, or abort it"
            )

    # ------------------------------------------------------------------------------------------------- run

    async def run(self, who: Owner, name: str, *, line: int = 1, speed: float = 1.0) -> Job:
        """Check and start a program; raises what `load` raises, and what `Machine.start_job` raises."""
        self._machine.lease.require(who)
        program, checked = await self._load(name, line=line, speed=speed)

        async def body(job: Job) -> None:
            if tuple(self._machine.planning_start_deg) != checked.start_deg:
                raise RefusedError("the arm moved while the program was checked; start it again")
            self.forget_modes()
            self._running = program
            try:
                await self.player.play(program.pieces())
                program.save_variables()
            finally:
                program.close()
                self.checked = program.checked_now()
                self._running = None
            self._is_done = True
            job.result.update(program=name, duration_s=round(program.plan.duration_s, 6))

        try:
            return self._machine.start_job(JobKind.PROGRAM, who, body)
        except BaseException:
            program.close()
            raise

    async def mdi(self, who: Owner, block: str) -> Job:
        """Run one block; raises GcodeError, PlanError when it is wrong: nothing moved then."""
        machine = self._machine
        machine.lease.require(who)
        if machine.arm_state.unhomed() == () and machine.job is None:
            start = machine.planning_start_deg
            planner = Planner(machine.arm, machine.config, start)
            joints: Callable[[], tuple[float, ...]] = lambda: tuple(planner.q_deg.tolist())  # noqa: E731
            moves = self._mdi.moves(block, machine.arm, joints)
            loop = asyncio.get_running_loop()
            try:
                pieces = await loop.run_in_executor(None, lambda: tuple(planner.plan(moves)))
            finally:
                moves.close()
        else:
            pieces = ()

        async def body(job: Job) -> None:
            self.name = ""
            self.player.show([])
            await self.player.play(iter(pieces))

        return machine.start_job(JobKind.MDI, who, body)

    async def run_back(self, who: Owner, seconds: float) -> WayBack:
        """Run a held program back along its path; see `Player.run_back`."""
        return await self.player.run_back(who, seconds)


def _lines_of(path: Path) -> list[str]:
    """The lines of a program, for showing them; none of a huge one."""
    if path.stat().st_size > _SHOWN_BYTES:
        return []
    return path.read_text("utf-8", errors="replace").splitlines()

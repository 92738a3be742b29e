"""Running programs and single blocks on the machine.

    load        check it from where the arm stands, as far as may be: nothing moves, errors are found here
    run         play it; pauses, messages and inputs are handled at rest, between stretches of motion
    afterwards  the last executed line stays, so `run --line` can go on from there when an operator says so

A program that asks the outside world (M66), never ends or is very long cannot be checked to its end before the start.
It is checked as far as may be; the same check then goes on ahead of the motion, and status says `checked_to_line`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from pathlib import Path

from rm501_host.errors import RefusedError, StoppedError
from rm501_host.gcode.resolve import ExternalAction
from rm501_host.gcode.user_m import UserMCodeError
from rm501_host.machine.gcode_source import STEP_MARK, MdiSession, Surroundings
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.program_check import Checked, LoadedProgram
from rm501_host.machine.program_files import ProgramFiles
from rm501_host.motion import PieceRuns, Progress
from rm501_host.moves import InputWait, Message, Move, Pause, PauseKind, ProgramEnd, Source
from rm501_host.planner import Piece, Planner
from rm501_host.planner.pieces import Action
from rm501_host.preflight import ProgramFault
from rm501_host.program import run_external

_INPUT_POLL_S = 0.01
_SHOWN_BYTES = 5_000_000
_IMMEDIATE, _RISE, _FALL, _HIGH = range(4)
"""M66 L0 to L3; L4 is low."""


class Programs:
    """The loaded program and the one that runs."""

    def __init__(self, machine: Machine, files: ProgramFiles, around: Surroundings) -> None:
        self.files = files
        self.single_block = False
        self.optional_stop = False
        self.name = ""
        self.line = 0
        self.block = ""
        self.progress = 0.0
        self.checked: Checked | None = None
        self._machine = machine
        self._around = around
        self._mdi = MdiSession(around)
        self._done_frames = 0
        self._planned_frames = 0
        self._running: LoadedProgram | None = None
        self._lines: list[str] = []

    @property
    def time_left_s(self) -> float:
        """Path time left of the program that runs, at 100 %."""
        return max(0.0, self._total_s * (1.0 - self.progress)) if self.name else 0.0

    @property
    def checked_to_line(self) -> int:
        """How far the loaded program has been checked; goes on while it runs."""
        checked = 0 if self.checked is None or not self.name else self.checked.checked_to_line
        return checked if self._running is None else max(checked, self._running.plan.checked_to_line)

    @property
    def check_complete(self) -> bool:
        """Whether the loaded program has been checked to its end."""
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
        """Check a program from here, and plan it if it is short; raises ProgramNameError, GcodeError, PlanError,
        RefusedError.
        """
        program, checked = await self._load(name, line=line, speed=speed)
        program.close()
        return checked

    async def _load(self, name: str, *, line: int, speed: float) -> tuple[LoadedProgram, Checked]:
        path = self.files.path(name)
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
        try:
            checked = await loop.run_in_executor(None, program.check)
        except BaseException:
            program.close()
            raise
        self.checked = checked
        self.name, self.line, self.block, self.progress = name, 0, "", 0.0
        self._lines = _lines_of(path)
        self._machine.write_log("program_loaded", name=name, line=line, duration_s=round(checked.duration_s, 3))
        return program, checked

    # ------------------------------------------------------------------------------------------------- run

    async def run(self, who: Owner, name: str, *, line: int = 1, speed: float = 1.0) -> Job:
        """Check and start a program; raises what `load` raises, and what `Machine.start_job` raises."""
        self._machine.lease.require(who)
        program, checked = await self._load(name, line=line, speed=speed)

        async def body(job: Job) -> None:
            if tuple(self._machine.planning_start_deg) != checked.start_deg:
                raise RefusedError("the arm moved while the program was checked; start it again")
            self._done_frames = 0
            self.forget_modes()
            self._running = program
            try:
                await self._play(program.pieces())
                program.save_variables()
            finally:
                program.close()
                self.checked = program.checked_now()
                self._running = None
            self.progress = 1.0
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
            self.name, self._lines = "", []
            await self._play(iter(pieces))

        return machine.start_job(JobKind.MDI, who, body)

    # ------------------------------------------------------------------------------------------ while it runs

    async def _play(self, pieces: Iterator[Piece]) -> None:
        """Play up to each mark, act on it at rest, go on; raises StoppedError and its kin."""
        machine = self._machine
        loop = asyncio.get_running_loop()
        run = PieceRuns(pieces)
        while True:
            if machine.stream is None:
                raise StoppedError("the machine was switched off")
            first = await loop.run_in_executor(None, run.peek)
            if first:
                await machine.stream.play(run.until_mark(), self._on_progress)
                self._done_frames += self._planned_frames
            mark = run.mark
            if mark is None:
                return
            if isinstance(mark.move, ProgramEnd):
                return
            await self._act(mark.move)

    def _on_progress(self, progress: Progress) -> None:
        self._planned_frames = progress.planned_frames
        if progress.source is not None and progress.source.line:
            self._show(progress.source)
        if self._total_s > 0:
            done_s = (self._done_frames + progress.played_frames) * self._machine.frame_s
            self.progress = max(self.progress, min(1.0, done_s / self._total_s))

    def _show(self, source: Source) -> None:
        self.line = source.line
        known = 0 < source.line <= len(self._lines)
        self.block = self._lines[source.line - 1] if known else source.block

    async def _act(self, move: Move | Action | None) -> None:
        """Do what a mark asks for."""
        machine = self._machine
        match move:
            case Message(text=text, source=source) if text == STEP_MARK:
                self._show(source)
                if self.single_block:
                    await machine.wait_for_operator("step")
            case Message(text=text, source=source):
                machine.messages.append(f"{source}: {text}")
                machine.write_log("message", text=text, line=source.line)
            case Pause(kind=PauseKind.OPTIONAL):
                if self.optional_stop:
                    await machine.wait_for_operator("M1")
            case Pause(kind=kind):
                await machine.wait_for_operator(kind.value)
            case InputWait():
                await self._wait_for_input(move)
            case ExternalAction() as action:
                try:
                    await asyncio.get_running_loop().run_in_executor(None, run_external, machine.config, action)
                except UserMCodeError as failed:
                    raise StoppedError(f"{action.source}: {failed}; the arm stands at rest there") from failed
            case ProgramFault(error=error):
                raise error
            case None:
                pass
            case other:
                raise RefusedError(f"{other.source}: {type(other).__name__} is not possible on this machine")

    async def _wait_for_input(self, move: InputWait) -> None:
        """M66: wait for an input of the board, at rest; the program then sees 1, 0 or -1 after the timeout."""
        if move.analog:
            raise RefusedError(f"{move.source}: there are no analog inputs; use P")
        began = self._level(move.input)
        value = float(began)
        if move.mode != _IMMEDIATE:
            before, value = began, -1.0
            try:
                async with asyncio.timeout(move.timeout_s):
                    while True:
                        now = self._level(move.input)
                        if _wanted(move.mode, before, now):
                            value = float(now)
                            break
                        if self._machine.job is None or self._machine.state.task.value != "ON":
                            raise StoppedError(f"{move.source}: stopped while waiting for input {move.input}")
                        before = now
                        await asyncio.sleep(_INPUT_POLL_S)
            except TimeoutError:
                pass
        self._around.answer.value = value

    def _level(self, number: int) -> bool:
        status = self._machine.board_status
        return status is not None and bool(status.inputs >> number & 1)


def _lines_of(path: Path) -> list[str]:
    """The lines of a program, for showing them; none of a huge one."""
    if path.stat().st_size > _SHOWN_BYTES:
        return []
    return path.read_text("utf-8", errors="replace").splitlines()


def _wanted(mode: int, before: bool, now: bool) -> bool:
    """Whether an input that was `before` and is `now` is what M66 waits for."""
    if mode == _RISE:
        return now and not before
    if mode == _FALL:
        return before and not now
    return now if mode == _HIGH else not now

"""Playing a program: stretches of motion, what has to be done at rest between them, its override, and running back.

The path that is played (`motion.LivePath`) takes the feed override above 100 % over, from `Machine.override`; what is
below 100 % the board does by itself. While the arm is held, or a program waits for its operator, `run_back` retraces
the path; the operator's next `resume` goes forward again from there.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rm501_host.errors import RefusedError, StoppedError
from rm501_host.gcode.resolve import ExternalAction
from rm501_host.gcode.user_m import UserMCodeError
from rm501_host.machine.gcode_source import STEP_MARK, Surroundings
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.states import MachineState
from rm501_host.motion import LivePath, Missed, PieceRuns, Progress
from rm501_host.moves import InputWait, Message, Move, Pause, PauseKind, ProgramEnd, Source
from rm501_host.planner import Piece, plan_joint_move
from rm501_host.planner.pieces import Action
from rm501_host.planner.respeed import Place
from rm501_host.planner.run_back import KEPT_S
from rm501_host.preflight import ProgramFault
from rm501_host.program import run_external
from rm501_protocol.enums import HoldCause

RUN_BACK = "run back"
"""What the operator is waited for after running back."""
_SAME_DEG = 1e-6
_INPUT_POLL_S = 0.01
_IMMEDIATE, _RISE, _FALL, _HIGH = range(4)
"""M66 L0 to L3; L4 is low."""
_USERS_HOLDS = (HoldCause.USER, HoldCause.BUTTON)


@dataclass(frozen=True, slots=True)
class WayBack:
    """How far the arm will run back, in s of path time at 100 %, and what the hand and the outputs do again on the way
    forward.
    """

    seconds: float
    repeats: tuple[str, ...]


class Player:
    """Plays one program, or one block, at a time."""

    def __init__(self, machine: Machine, around: Surroundings) -> None:
        self.single_block = False
        self.optional_stop = False
        self.lines: list[str] = []
        """The program's text, for showing it."""
        self.line = 0
        self.block = ""
        self.played_s = 0.0
        """Path time that is done, at 100 %."""
        self._machine = machine
        self._around = around
        self._live: LivePath | None = None
        self._place: Place | None = None
        self._back: tuple[tuple[Piece, ...], Place] | None = None
        self._is_going_back = False
        self._farthest_s = 0.0

    def show(self, lines: list[str]) -> None:
        """Another program is loaded: `lines`."""
        self.lines = lines
        self.line, self.block, self.played_s = 0, "", 0.0

    async def play(self, pieces: Iterator[Piece]) -> None:
        """Play up to each mark, act on it at rest, go on; raises StoppedError and its kin."""
        machine = self._machine
        loop = asyncio.get_running_loop()
        run = PieceRuns(pieces)
        live = self._live = LivePath(machine.config, self._on_missed)
        live.scale = max(1.0, machine.override)
        self._back, self._is_going_back, self._place = None, False, None
        self.played_s = self._farthest_s = 0.0
        try:
            while True:
                if await loop.run_in_executor(None, run.peek):
                    live.begin(run.until_mark())
                    await self._play_run(live)
                mark = run.mark
                if mark is None or isinstance(mark.move, ProgramEnd):
                    return
                await self._act(mark.move)
        finally:
            self._live = None
            machine.follow_plan_scale(1.0)

    async def _play_run(self, live: LivePath) -> None:
        """Play to the end of the run, as often as it takes with running back."""
        machine = self._machine
        while True:
            if machine.stream is None:
                raise StoppedError("the machine was switched off")
            if await machine.stream.play(live, self._on_progress) is None:
                self._place = live.end()
                self.played_s = live.time_s(self._place)
                return
            await self._go_back(live)

    def _on_progress(self, progress: Progress) -> None:
        live, machine = self._live, self._machine
        if progress.source is not None and progress.source.line:
            self._show(progress.source)
        if live is None or not progress.ahead:
            return
        live.scale = max(1.0, machine.override)
        machine.follow_plan_scale(max(live.scale_of(planned) for planned in progress.ahead))
        planned = progress.ahead[0]
        live.playing(planned)
        place = live.place(planned, progress.frame)
        if place is not None:
            self._place = place
            live.passed(place)
            self.played_s = live.time_s(place)

    def _on_missed(self, missed: Missed) -> None:
        """A faster law did not take over."""
        machine = self._machine
        machine.write_log("override_missed", wanted=missed.scale, why=missed.why, for_good=missed.for_good)
        if missed.for_good:
            machine.messages.append(
                f"override {missed.scale:.0%} waits for the next stop of the path, until then feeds are as planned: "
                f"{missed.why}; change the override to try again"
            )

    def _show(self, source: Source) -> None:
        self.line = source.line
        known = 0 < source.line <= len(self.lines)
        self.block = self.lines[source.line - 1] if known else source.block

    # --------------------------------------------------------------------------------------------- running back

    async def run_back(self, who: Owner, seconds: float) -> WayBack:
        """Go back along the path as far as the program came in `seconds` at 100 %, while the arm is held or a program
        waits; gives how far that will be. The arm is held again there; `resume` goes forward.

        Raises RefusedError; nothing has changed then, and nothing moves.
        """
        machine, live = self._machine, self._live
        machine.lease.require_control(who)
        if not (math.isfinite(seconds) and 0.0 < seconds <= KEPT_S):
            raise RefusedError(f"{seconds} s is not above 0 and at most {KEPT_S:g}")
        if live is None or machine.job is None or machine.stream is None:
            raise RefusedError("no program is under way; only a program that is held can be run back")
        if self._back is not None or self._is_going_back:
            raise RefusedError("the arm is running back already; resume, and wait until it is there")
        place = self._held_at(live)
        if machine.override <= 0.0:
            raise RefusedError("the override is 0; raise it first, or the arm cannot go back")
        loop = asyncio.get_running_loop()
        back = await loop.run_in_executor(None, live.back, place, seconds)
        self._back = back
        stopped_s = live.time_s(place)
        self._farthest_s = max(self._farthest_s, stopped_s)
        way = WayBack(stopped_s - live.time_s(back[1]), live.actions(back[1], self._farthest_s))
        if machine.waiting_for:
            machine.go_on()
        elif not await machine.stream.break_off():
            self._back = None
            raise RefusedError("the arm is not held any more; hold it, then run back")
        machine.write_log("run_back", who=who.name, seconds=round(way.seconds, 3), line=self.line, repeats=way.repeats)
        return way

    def _held_at(self, live: LivePath) -> Place:
        """Where on the path the arm is held; raises RefusedError where it is not, or not by a user."""
        machine = self._machine
        place = self._place
        if machine.waiting_for:
            if place is None:
                raise RefusedError("the arm has not moved yet; resume first")
            return place
        under_way = None if machine.stream is None else machine.stream.under_way()
        if machine.state is not MachineState.HELD or under_way is None:
            raise RefusedError(f"the arm is {machine.state.run.value}; hold it and wait until it is at rest")
        status = machine.board_status
        cause = HoldCause.NONE if status is None else status.hold_cause
        if cause not in _USERS_HOLDS:
            raise RefusedError(f"the arm is held by {cause.name}, not by an operator; end that first")
        place = live.place(*under_way)
        if place is None:
            raise RefusedError("the place on the path is not known; resume first")
        return place

    async def _go_back(self, live: LivePath) -> None:
        """Play what `run_back` has planned, be held there, and be ready to go forward, or back once more."""
        machine = self._machine
        while self._back is not None:
            (pieces, place), self._back = self._back, None
            if machine.stream is None:
                raise StoppedError("the machine was switched off")
            self._is_going_back = True
            try:
                await machine.stream.play((*self._onto(pieces[0]), *pieces), self._on_progress)
            finally:
                self._is_going_back = False
            self._place = place
            self.played_s = live.time_s(place)
            live.go_on_from(place)
            if repeats := live.actions(place, self._farthest_s):
                machine.messages.append(f"going forward repeats: {', '.join(repeats)}; look at the hand, then resume")
            await machine.wait_for_operator(RUN_BACK)

    def _onto(self, first: Piece) -> tuple[Piece, ...]:
        """From where a hold has left the arm to where `first` starts: the segments' tolerance lies between."""
        start_deg = np.array(self._machine.planning_start_deg)
        goal_deg = first.q_deg(np.zeros(1))[0]
        if float(np.abs(goal_deg - start_deg).max()) < _SAME_DEG:
            return ()
        return plan_joint_move(self._machine.arm, self._machine.config, start_deg, goal_deg, ignore_limits=True)

    # --------------------------------------------------------------------------------------------- at rest

    async def _act(self, move: Move | Action | None) -> None:
        """Do what a mark asks for."""
        machine = self._machine
        match move:
            case Message(text=text, source=source) if text == STEP_MARK:
                self._show(source)
                if self.single_block:
                    await self._wait_for_operator("step")
            case Message(text=text, source=source):
                machine.messages.append(f"{source}: {text}")
                machine.write_log("message", text=text, line=source.line)
            case Pause(kind=PauseKind.OPTIONAL):
                if self.optional_stop:
                    await self._wait_for_operator("M1")
            case Pause(kind=kind):
                await self._wait_for_operator(kind.value)
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

    async def _wait_for_operator(self, what: str) -> None:
        """Wait for `resume`; after running back the arm comes forward to here and waits again."""
        while True:
            await self._machine.wait_for_operator(what)
            if self._back is None or self._live is None:
                return
            await self._go_back(self._live)
            await self._play_run(self._live)

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


def _wanted(mode: int, before: bool, now: bool) -> bool:
    """Whether an input that was `before` and is `now` is what M66 waits for."""
    if mode == _RISE:
        return now and not before
    if mode == _FALL:
        return before and not now
    return now if mode == _HIGH else not now

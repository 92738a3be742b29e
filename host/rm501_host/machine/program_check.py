"""What is known about a program before it runs: whether it may, how long it takes, how far that was checked.

A program that asks the outside world (M66), never ends or is very long cannot be checked to its end before the start.
It is checked as far as may be, and the same check goes on ahead of the motion as it runs (`preflight.rolling`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rm501_host.errors import RefusedError
from rm501_host.gcode.program_log import ProgramLog
from rm501_host.machine.gcode_source import ProgramReader, Surroundings
from rm501_host.machine.machine import Machine
from rm501_host.moves import Move, ProbeMove
from rm501_host.planner import Piece, Planner
from rm501_host.planner.pieces import Action
from rm501_host.preflight import ProgramCheck, RollingCheck
from rm501_host.program_plan import PlannedProgram, carry_out_notes


@dataclass(frozen=True, slots=True)
class Checked:
    """What the preflight of a program found before the start: how long it takes, how far it was checked.

    `duration_s` and `motion_s` are exact for a program that was planned to its end (up to 5,000 moves; rests in which
    play is taken up apart), an estimate from planned stretches for a longer one.
    """

    name: str
    line: int
    duration_s: float
    motion_s: float
    complete: bool
    checked_to_line: int
    start_deg: tuple[float, ...]
    speed: float


class LoadedProgram:
    """A program read, checked and planned from where the arm stands, to be played once.

    `path` from `line` and joints `start_deg` (5,), at `speed` times its feeds; `step`: with a mark at rest after every
    block that moves. `tell` is given warnings and printed texts, from any thread.
    """

    def __init__(
        self,
        machine: Machine,
        around: Surroundings,
        path: Path,
        line: int,
        start_deg: tuple[float, ...],
        speed: float,
        step: bool,
        tell: Callable[[str], None],
    ) -> None:
        check = ProgramCheck(machine.arm, machine.config, start_deg)
        self._reader = ProgramReader(
            path, machine.arm, lambda: tuple(check.q_deg.tolist()), around, start_line=line, step=step
        )
        moves = _without_probes(self._reader.moves())
        rolling = RollingCheck(check, moves, machine.config.preflight.max_blocks, tell)
        self.plan = PlannedProgram(rolling, check, Planner(machine.arm, machine.config, start_deg, speed_scale=speed))
        self._log = ProgramLog(around.logs, tell)
        self._logs = around.logs
        self._request = (path.name, line, start_deg, speed)

    def check(self) -> Checked:
        """Check it as far as may be before the start, and plan it if it is short.

        Raises GcodeError and PlanError naming file and line, RefusedError with every error of the preflight.
        """
        self.plan.start()
        self.plan.estimate(self._request[3])
        return self.checked_now()

    def checked_now(self) -> Checked:
        """How far it has been checked by now."""
        plan = self.plan
        name, line, start_deg, speed = self._request
        to_line = max(line, plan.checked_to_line)
        return Checked(name, line, plan.duration_s, plan.motion_s, plan.is_complete, to_line, start_deg, speed)

    def pieces(self) -> Iterator[Piece]:
        """What is to be played; log comments are written meanwhile, into the folder for logs alone."""
        self._logs.mkdir(parents=True, exist_ok=True)
        return carry_out_notes(self.plan.pieces(), self._log)

    def save_variables(self) -> None:
        """Keep the persistent parameters, once it has been played to its end; raises GcodeFileError."""
        self._reader.save_variables()

    def close(self) -> None:
        """Let go of its files."""
        self._log.close()
        self.plan.close()


def _without_probes(moves: Iterator[Move | Action]) -> Iterator[Move | Action]:
    for move in moves:
        if isinstance(move, ProbeMove):
            raise RefusedError(f"{move.source}: there is no probe on this machine; remove G38")
        yield move

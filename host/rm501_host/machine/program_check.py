"""What is known about a program before it runs: whether it may, how long it takes, how far that was checked.

A program that asks the outside world (M66) or never ends cannot be checked to its end. It is checked up to that
point and planned again as it runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rm501_host.errors import RefusedError
from rm501_host.gcode.errors import GcodeLimitError
from rm501_host.machine.gcode_source import Surroundings, program_moves
from rm501_host.machine.machine import Machine
from rm501_host.moves import InputWait, ProbeMove
from rm501_host.planner import Piece, PieceKind, Planner
from rm501_host.preflight import ProgramCheck

_KEPT_PIECES = 200_000


@dataclass(frozen=True, slots=True)
class Checked:
    """What the preflight of a program found: how long it takes, how far it was checked.

    `pieces` is the whole plan where it was kept, else empty.
    """

    name: str
    line: int
    duration_s: float
    motion_s: float
    complete: bool
    checked_to_line: int
    start_deg: tuple[float, ...]
    speed: float
    pieces: tuple[Piece, ...]


def check_and_plan_program(
    machine: Machine,
    around: Surroundings,
    path: Path,
    line: int,
    start_deg: tuple[float, ...],
    speed: float,
    step: bool,
) -> Checked:
    """Check and plan the program at `path` from `line` and joints `start_deg` (5,), at `speed` times its feeds.

    `step`: with a mark at rest after every block that moves. Raises GcodeError and PlanError naming file and line,
    RefusedError with every error of the preflight.
    """
    _refuse_what_the_preflight_finds(machine, around, path, line, start_deg)
    kept: list[Piece] = []
    duration_s = motion_s = 0.0
    complete, last_line = True, line
    try:
        for piece in program_pieces(machine, around, path, line, start_deg, speed, step):
            if piece.kind is PieceKind.MARK and isinstance(piece.move, InputWait):
                complete = False
                break
            if isinstance(piece.move, ProbeMove):
                raise RefusedError(f"{piece.source}: there is no probe on this machine; remove G38")
            duration_s += piece.duration_s
            motion_s += piece.motion_s
            last_line = max(last_line, piece.source.line)
            kept.append(piece)
            if len(kept) > _KEPT_PIECES:
                complete = False
                break
    except GcodeLimitError:
        complete = False
    pieces = tuple(kept) if complete else ()
    return Checked(path.name, line, duration_s, motion_s, complete, last_line, start_deg, speed, pieces)


def program_pieces(
    machine: Machine,
    around: Surroundings,
    path: Path,
    line: int,
    start_deg: tuple[float, ...],
    speed: float,
    step: bool,
) -> Iterator[Piece]:
    """The plan of a program, read as it is taken; raises GcodeError and PlanError naming file and line."""
    planner = Planner(machine.arm, machine.config, start_deg, speed_scale=speed)
    moves = program_moves(
        path,
        machine.arm,
        lambda: tuple(planner.q_deg.tolist()),
        around,
        start_line=line,
        max_blocks=machine.config.preflight.max_blocks,
        step=step,
    )
    return planner.plan(moves)


def _refuse_what_the_preflight_finds(
    machine: Machine, around: Surroundings, path: Path, line: int, start_deg: tuple[float, ...]
) -> None:
    check = ProgramCheck(machine.arm, machine.config, start_deg)
    moves = program_moves(
        path,
        machine.arm,
        lambda: tuple(check.q_deg.tolist()),
        around,
        start_line=line,
        max_blocks=machine.config.preflight.max_blocks,
        step=False,
    )
    report = check.run(moves, estimate=False, limit_error=GcodeLimitError)
    if not report.ok:
        raise RefusedError("\n".join(str(finding) for finding in report.errors))

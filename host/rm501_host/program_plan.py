"""A program, checked as a whole and planned: at once when it is short, ahead of the motion when it is long.

The preflight looks at every move first, to the end of the program or as far as it can be known. What it finds refuses
the program with all its errors. A program of up to `EAGER_MOVES` moves is then planned to its end before anything
else happens; a longer one is planned piece by piece while the arm moves, as far ahead as the board's queue asks for,
with bounded memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rm501_host.config import Config
from rm501_host.errors import RefusedError
from rm501_host.gcode.errors import GcodeLimitError
from rm501_host.gcode.program_log import ProgramLog
from rm501_host.kinematics import Arm
from rm501_host.planner import Piece, Planner
from rm501_host.preflight import PreflightReport, ProgramCheck
from rm501_host.program import read_moves

EAGER_MOVES = 5_000
"""Planned in a second or two of CPU; more would keep the operator waiting."""


@dataclass(frozen=True, slots=True)
class CheckedProgram:
    """What the preflight said, and the pieces: a tuple when planned to the end, a stream otherwise."""

    preflight: PreflightReport
    pieces: tuple[Piece, ...] | Iterator[Piece]


def check_and_plan(
    program: Path,
    arm: Arm,
    config: Config,
    start_deg: tuple[float, ...],
    on_warning: Callable[[str], None] | None = None,
) -> CheckedProgram:
    """Check `program` from joints `start_deg` (5,) and plan it.

    Raises GcodeError and PlanError naming file and line, RefusedError with every error of the preflight, or where
    nothing moves.
    """
    check = ProgramCheck(arm, config, start_deg)
    checked_moves = read_moves(program, arm, lambda: check.q_deg.tolist(), on_warning, config=config)
    report = check.run(checked_moves, estimate=False, limit_error=GcodeLimitError)
    if not report.ok:
        raise RefusedError("\n".join(str(finding) for finding in report.errors))
    if on_warning is not None:
        for finding in report.findings:
            on_warning(str(finding))
    planner = Planner(arm, config, start_deg)
    log = ProgramLog(program.resolve().parent, on_warning or (lambda text: None))
    pieces = planner.plan(read_moves(program, arm, lambda: planner.q_deg.tolist(), config=config, log=log))
    if not report.complete or report.moves > EAGER_MOVES:
        return CheckedProgram(report, pieces)
    planned = tuple(pieces)
    if not any(piece.motion_s for piece in planned):
        raise RefusedError(f"{program}: nothing in it moves; is it the right file?")
    return CheckedProgram(report, planned)

"""A program checked and planned: what may be known before the start, the rest ahead of the motion.

    read_moves ─► RollingCheck ─► Planner ─► pieces, with the log comments between them

The preflight looks at every move first, to the end of the program or as far as it can be known (`[preflight]
max_blocks`). What it finds refuses the program with all its errors. A program of up to `EAGER_MOVES` moves is then
planned to its end before anything else happens; a longer one is planned piece by piece while the arm moves, as far
ahead as the board's queue asks for, with bounded memory. The program is read once: what was checked is what is played.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from rm501_host.config import Config
from rm501_host.errors import ProgramRefusedError, RefusedError
from rm501_host.gcode.program_log import LogNote, ProgramLog
from rm501_host.kinematics import Arm
from rm501_host.moves import Move, PathModeChange, Source, ToolChange
from rm501_host.planner import Piece, PieceKind, PlanError, Planner
from rm501_host.planner.pieces import Action
from rm501_host.preflight import PreflightReport, ProgramCheck, ProgramFault, RollingCheck
from rm501_host.program import read_moves

EAGER_MOVES = 5_000
"""Planned in a few seconds of CPU (turning XYZABC moves take longer); more would keep the operator waiting."""
_TRUSTED_SHARE = 0.25
"""When so much of a program has been planned, the rest is taken to be like that."""


class PlannedProgram:
    """A program that may be started: `pieces` to play once, `preflight` as it was before the start.

    `start` has to be called first. `checked_to_line` and `is_complete` follow the check as it rolls on.
    """

    def __init__(self, rolling: RollingCheck, check: ProgramCheck, planner: Planner) -> None:
        self._rolling = rolling
        self._check = check
        self._planner = planner
        self._planned: tuple[Piece, ...] | None = None
        self._ahead: deque[Source | LogNote] = deque()
        self._planned_s = 0.0
        self._planned_motion_s = 0.0
        self._estimate_s: float | None = None
        self._estimated_moves = 0
        self.preflight = PreflightReport((), 0, False, "not checked yet", 0)

    def start(self) -> None:
        """Check as far as may be before the start, and plan a short program to its end.

        Raises GcodeError and PlanError naming file and line, RefusedError with every error of the preflight.
        """
        self.preflight = report = self._rolling.before_start()
        if not report.ok:
            raise RefusedError("\n".join(str(finding) for finding in report.errors))
        if report.complete and report.moves <= EAGER_MOVES:
            self._planned = tuple(self._count(self._with_notes()))

    @property
    def moves_anything(self) -> bool:
        """Whether something in it moves, as far as is known."""
        return self._planned is None or any(piece.motion_s for piece in self._planned)

    @property
    def waits_for(self) -> Move | Action | None:
        """The input or the probe on which depends what comes after it; None where the check came to none."""
        return self._rolling.waits_for

    @property
    def checked_to_line(self) -> int:
        """The highest line that has been checked."""
        return self._rolling.checked_to_line

    @property
    def read_to_line(self) -> int:
        """The highest line that has been read; may be asked from anywhere while the check goes on."""
        return self._check.line

    @property
    def is_complete(self) -> bool:
        """Whether all of it has been checked."""
        return self._rolling.is_complete

    @property
    def duration_s(self) -> float:
        """How long it takes: exact where it is planned, else an estimate of what has been read so far.

        At first the estimate is that of `estimate`, if that was asked for, else the moves at their feeds and the
        joints' rates; what has been planned since counts for more and more of it.
        """
        if self._planned is not None:
            return self._planned_s
        taken, read = self._rolling.taken - len(self._ahead), self._rolling.checked
        if self._estimate_s is None:
            first_s = self._check.nominal_s
        else:
            first_s = self._estimate_s * read / max(1, self._estimated_moves)
        if not (self._planned_s > 0.0 and taken > 0):
            return first_s
        trust = 1.0 if self._estimate_s is None else min(1.0, taken / (_TRUSTED_SHARE * read))
        return max(self._planned_s, trust * self._planned_s * read / taken + (1.0 - trust) * first_s)

    def estimate(self, speed_scale: float) -> None:
        """Find out about how long a program takes that has not been planned to its end (`preflight.pace`)."""
        if self._planned is None:
            self._estimate_s, self._estimated_moves = self._check.estimate_s(speed_scale), self._rolling.checked

    @property
    def motion_s(self) -> float:
        """As `duration_s`, without dwells and hand strokes."""
        return self._planned_motion_s if self._planned is not None else self.duration_s

    def pieces(self) -> Iterator[Piece]:
        """The pieces, once: planned before, or as they are taken.

        Marks and `NOTE`s apart they are the plan; a fault on the way ends them with a mark at rest.
        """
        if self._planned is not None:
            return iter(self._planned)
        return self._count(self._faults_at_rest(self._with_notes()))

    def close(self) -> None:
        """Stop reading the program."""
        self._rolling.close()

    def _count(self, pieces: Iterator[Piece]) -> Iterator[Piece]:
        for piece in pieces:
            self._planned_s += piece.duration_s
            self._planned_motion_s += piece.motion_s
            yield piece

    def _with_notes(self) -> Iterator[Piece]:
        """The plan, each log comment behind the piece in which the move before it ends.

        The planner reads ahead of what it yields, so the comments wait among the sources of the moves: a piece passes
        what comes before its first source, and, once played, all to its last one.
        """
        ahead = self._ahead

        def moves() -> Iterator[Move | Action]:
            for move in self._rolling:
                if isinstance(move, LogNote):
                    ahead.append(move)
                else:
                    if not isinstance(move, PathModeChange | ToolChange):
                        ahead.append(move.source)
                    yield move

        last: Piece | None = None
        for piece in self._planner.plan(moves()):
            first_source, last_source = _sources(piece)
            for note in _notes_to(ahead, first_source, behind=False):
                yield self._note(note, last)
            yield piece
            last = piece
            for note in _notes_to(ahead, last_source, behind=True):
                yield self._note(note, piece)
        for item in ahead:
            if isinstance(item, LogNote):
                yield self._note(item, last)

    def _note(self, note: LogNote, after: Piece | None) -> Piece:
        rest = tuple(self._planner.q_deg.tolist()) if after is None else after.rest_deg
        start_s = 0.0 if after is None else after.end_s
        return Piece(PieceKind.NOTE, note.source, start_s, 0.0, rest, move=note)

    def _faults_at_rest(self, pieces: Iterator[Piece]) -> Iterator[Piece]:
        """A plan that fails on the way comes to rest first, then says why by a mark."""
        last: Piece | None = None
        try:
            for piece in pieces:
                last = piece
                yield piece
        except PlanError as error:
            for piece in self._planner.come_to_rest():
                last = piece
                yield piece
            text = (
                f"{error}\nthe program was running: its moves had been checked to line {self.checked_to_line}, but "
                f"blends are known only once planned (before the start: up to {EAGER_MOVES} moves); the arm stands "
                "at rest on its path before it, motors on, position trusted; correct the program, then run it again"
            )
            source = error.source or Source("(program)", 0)
            rest = last.rest_deg if last is not None else tuple(self._planner.q_deg.tolist())
            fault = ProgramFault(ProgramRefusedError(text), source)
            yield Piece(PieceKind.MARK, source, 0.0, 0.0, rest, move=fault)


def _sources(piece: Piece) -> tuple[Source, Source]:
    """The first and the last block that a piece belongs to."""
    table = getattr(piece.law, "table", None)
    return (piece.source, piece.source) if table is None else (table.elements[0].source, table.elements[-1].source)


def _notes_to(ahead: deque[Source | LogNote], source: Source, *, behind: bool) -> list[LogNote]:
    """Take what comes before a source from `ahead`, with `behind` that itself and the notes next to it, too: the notes
    of it. Nothing where the source is not there.
    """
    if not any(item is source for item in ahead):
        return []
    taken: list[Source | LogNote] = []
    while ahead[0] is not source:
        taken.append(ahead.popleft())
    if behind:
        taken.append(ahead.popleft())
        taken += _leading_notes(ahead)
    return [item for item in taken if isinstance(item, LogNote)]


def _leading_notes(ahead: deque[Source | LogNote]) -> Iterator[LogNote]:
    while ahead and isinstance(note := ahead[0], LogNote):
        ahead.popleft()
        yield note


def check_and_plan(
    program: Path,
    arm: Arm,
    config: Config,
    start_deg: tuple[float, ...],
    on_warning: Callable[[str], None] | None = None,
    watched: Callable[[Iterator[Move | Action]], Iterator[Move | Action]] = lambda moves: moves,
) -> PlannedProgram:
    """Check `program` from joints `start_deg` (5,) and plan it; its moves are read through `watched`.

    Raises GcodeError and PlanError naming file and line, RefusedError with every error of the preflight, or where
    nothing moves.
    """
    check = ProgramCheck(arm, config, start_deg)
    moves = read_moves(program, arm, lambda: check.q_deg.tolist(), on_warning, config=config, with_notes=True)
    rolling = RollingCheck(check, watched(moves), config.preflight.max_blocks, on_warning)
    planned = PlannedProgram(rolling, check, Planner(arm, config, start_deg))
    planned.start()
    if on_warning is not None:
        for finding in planned.preflight.findings:
            on_warning(str(finding))
    if not planned.moves_anything:
        raise RefusedError(f"{program}: nothing in it moves; is it the right file?")
    return planned


def carry_out_notes(pieces: Iterator[Piece], log: ProgramLog) -> Iterator[Piece]:
    """The pieces without their notes: each log comment is written when what comes after it is about to be sent."""
    for piece in pieces:
        if piece.kind is PieceKind.NOTE:
            assert isinstance(piece.move, LogNote)
            log(piece.move.call)
        else:
            yield piece

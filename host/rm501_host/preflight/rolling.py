"""The check that goes ahead of the motion: every move is checked before the planner gets it, and read only once.

    interpreter ─► check ─► moves that are known to be good ─► planner ─► motion
                            `ahead` of them before the start

Before the start a program is read and checked to its end, to `ahead` moves, or to the first place that depends on the
outside world. While it runs, reading and checking go on in front of the planner. The first move that may not be played
is replaced by a `ProgramFault`: the planner brings the arm to rest at the end of the last good move, and whoever plays
the program ends it there with the error.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

from rm501_host.errors import ProgramRefusedError, Rm501Error
from rm501_host.gcode.resolve import StillReading
from rm501_host.moves import InputWait, Move, ProbeMove, Source
from rm501_host.planner.pieces import Action

from .check import MOST_REFUSALS, ProgramCheck
from .findings import PreflightReport, Severity

CHUNK = 512
"""Moves that are read and checked at once."""
AHEAD_WHILE_RUNNING = 20_000
"""Checked moves to have in hand while the program runs: minutes of motion, a few megabytes."""


@dataclass(frozen=True, slots=True)
class ProgramFault:
    """Stands in place of the first move that may not be played."""

    error: ProgramRefusedError
    source: Source


class RollingCheck:
    """Moves of a program that have been checked, in order, each once.

    `ahead`: how many moves are checked before the start (one that takes longer to check than a short line counts for as
    many as it takes, `ProgramCheck.cost`). `on_warning` is told of what is found while the program runs. Not
    thread-safe, but `checked_to_line` and `is_complete` may be read from anywhere.
    """

    def __init__(
        self,
        check: ProgramCheck,
        moves: Iterator[Move | Action],
        ahead: int,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        self._check = check
        self._moves = moves
        self._ahead = ahead
        self._on_warning = on_warning
        self._ready: deque[Move | Action] = deque()
        self._fault: ProgramFault | None = None
        self._told = 0
        self._waits = False
        """The last move read has to be played before the program can be read on."""
        self.is_complete = False
        """Whether the program has been checked to its end."""
        self.checked_to_line = 0
        """The highest line among the moves that have been checked and are good."""
        self.checked = 0
        """Moves checked so far."""
        self.waits_for: Move | Action | None = None
        """What the check before the start came to whose outcome it cannot know: an input or a probe."""
        self.taken = 0
        """Moves given away so far."""

    def before_start(self) -> PreflightReport:
        """Check as far as may be before the start. Raises GcodeError for a program that cannot be read so far."""
        silent, stopped_by = 0, ""
        moves: list[Move | Action] = []
        while not self.is_complete and not self._waits:
            if self._check.cost + silent >= self._ahead:
                stopped_by = f"more than {self._ahead} moves; the rest is checked as the program runs"
                break
            if self._check.has_enough:
                stopped_by = f"{MOST_REFUSALS} errors"
                break
            chunk = self._read()
            moves += chunk
            self._check.flush()
            silent += sum(move.blocks for move in chunk if isinstance(move, StillReading))
        if self._waits:
            self.waits_for = moves[-1]
            what = "an input" if isinstance(moves[-1], InputWait) else "a probe"
            stopped_by = f"{moves[-1].source}: what follows depends on {what}"
        self._accept(moves)
        self._told = len(self._check.findings_since(0))
        return PreflightReport(self._check.findings, self._check.line, self.is_complete, stopped_by, self.checked)

    def close(self) -> None:
        """Stop reading; where somebody reads just now, that ends with them."""
        if isinstance(self._moves, Generator):
            with contextlib.suppress(ValueError):
                self._moves.close()

    def __iter__(self) -> Iterator[Move | Action]:
        """The checked moves, and at last, if there is one, the fault."""
        while True:
            if self._may_read() and len(self._ready) < min(self._ahead, AHEAD_WHILE_RUNNING):
                self._check_on()
            if self._ready:
                self.taken += 1
                yield self._ready.popleft()
            elif self._waits:
                self._waits = False  # it has been played, or else nobody would ask for more
            elif self._fault is not None:
                yield self._fault
                return
            elif self.is_complete:
                return

    def _may_read(self) -> bool:
        return not (self.is_complete or self._waits or self._fault is not None)

    def _check_on(self) -> None:
        """Read and check another chunk; the first bad move ends the program before it."""
        before = self.checked
        failure: Rm501Error | None = None
        chunk: list[Move | Action] = []
        try:
            self._read(chunk)
        except Rm501Error as error:
            failure = error
        self._check.flush()
        self._tell()
        bad = self._check.first_bad
        if bad is not None:
            at = bad - before
            source = chunk[at].source
            self._accept(chunk[:at])
            self._waits = False
            self._fault = ProgramFault(_refusal(self._check, source), source)
        else:
            self._accept(chunk)
            if failure is not None:
                source = chunk[-1].source if chunk else Source("", 0)
                self._fault = ProgramFault(ProgramRefusedError(f"{failure}\n{_RAN}"), source)

    def _read(self, chunk: list[Move | Action] | None = None) -> list[Move | Action]:
        """Read up to CHUNK moves and give them to the check; raises GcodeError, `chunk` then holds what came before."""
        chunk = [] if chunk is None else chunk
        for move in self._moves:
            chunk.append(move)
            self._check.take(move)
            self.checked += 1
            if isinstance(move, InputWait | ProbeMove):
                # what comes next is only known when this has been played
                self._waits = True
                return chunk
            if len(chunk) >= CHUNK or isinstance(move, StillReading):
                return chunk
        self.is_complete = True
        return chunk

    def _accept(self, moves: list[Move | Action]) -> None:
        for move in moves:
            self.checked_to_line = max(self.checked_to_line, move.source.line)
            if not isinstance(move, StillReading):
                self._ready.append(move)

    def _tell(self) -> None:
        findings = self._check.findings_since(self._told)
        self._told += len(findings)
        if self._on_warning is not None:
            for finding in findings:
                if finding.severity is Severity.WARNING:
                    self._on_warning(str(finding))


_RAN = (
    "the program was running when this was found ahead of the motion; the arm stands at rest at the end of the last "
    "good move, motors on, position trusted; correct the program, then run it again"
)


def _refusal(check: ProgramCheck, source: Source) -> ProgramRefusedError:
    here = [finding for finding in check.findings if finding.severity is Severity.ERROR and finding.source == source]
    text = "\n".join(str(finding) for finding in here) or f"{source}: cannot be played"
    return ProgramRefusedError(f"{text}\n{_RAN}")

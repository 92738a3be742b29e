"""Gathers findings: the same one on the same line only counts, and an error is never crowded out."""

from __future__ import annotations

from dataclasses import replace

from rm501_host.moves import Source

from .findings import Finding, FindingKind, Severity

MOST_WARNINGS = 500
MOST_ERRORS = 500


class Collector:
    """Findings, one per file, line and kind; several moves are looked at in one go, so they come in any order."""

    def __init__(self) -> None:
        self._found: list[Finding] = []
        self._numbers: list[int] = []
        self._known: dict[tuple[str, int, FindingKind], int] = {}
        self._left = {Severity.WARNING: MOST_WARNINGS, Severity.ERROR: MOST_ERRORS}
        self._slow: dict[int, Finding] = {}
        self.first_bad: int | None = None
        """Number of the first move with an error."""
        self.errors = 0
        """How often an error was found, the same ones again counted too."""

    def is_new(self, source: Source, kind: FindingKind) -> bool:
        """Whether an error of this kind on this line would be kept: worth looking for a pose that helps."""
        return (source.file, source.line, kind) not in self._known and self._left[Severity.ERROR] > 0

    def add(self, finding: Finding, number: int) -> None:
        """Keep a finding of move `number`; the same kind on the same line again only counts."""
        if finding.severity is Severity.ERROR:
            self.errors += 1
            if self.first_bad is None or number < self.first_bad:
                self.first_bad = number
        key = (finding.source.file, finding.source.line, finding.kind)
        known = self._known.get(key)
        if known is not None:
            self._found[known] = replace(self._found[known], count=self._found[known].count + 1)
        elif self._left[finding.severity] > 0:
            self._left[finding.severity] -= 1
            self._known[key] = len(self._found)
            self._found.append(finding)
            self._numbers.append(number)

    def add_slow(self, row: int, slowest: Finding) -> None:
        """`slowest.count` more moves that limit `row` keeps below their feed; the slowest of all is kept."""
        known = self._slow.get(row)
        if known is None:
            self._slow[row] = slowest
        elif (known.amount or 0.0) > (slowest.amount or 0.0):
            self._slow[row] = replace(slowest, count=known.count + slowest.count)
        else:
            self._slow[row] = replace(known, count=known.count + slowest.count)

    def findings(self) -> tuple[Finding, ...]:
        """Errors and warnings in the order of the moves, then a summary per limit that keeps moves below their feed."""
        in_order = sorted(zip(self._numbers, range(len(self._found)), strict=True))
        return (*(self._found[place] for _, place in in_order), *self._slow.values())

    def since(self, count: int) -> tuple[Finding, ...]:
        """What has been found after the first `count` findings, summaries left out."""
        return tuple(self._found[count:])

    def __len__(self) -> int:
        return len(self._found)

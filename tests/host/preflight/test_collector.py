"""Findings come in the order of the moves, however many moves were looked at in one go."""

from __future__ import annotations

import random

from rm501_host.moves import Source
from rm501_host.preflight.collector import Collector
from rm501_host.preflight.findings import Finding, FindingKind, Severity


def finding(line: int, severity: Severity) -> Finding:
    return Finding(severity, FindingKind.OTHER, Source("a.ngc", line, ""), "text")


def test_findings_are_told_in_the_order_of_the_moves() -> None:
    lines = list(range(1, 40))
    random.Random(1).shuffle(lines)
    collector = Collector()
    for line in lines:
        collector.add(finding(line, Severity.ERROR if line % 3 == 0 else Severity.WARNING), number=line)
    assert [item.source.line for item in collector.findings()] == list(range(1, 40))
    assert [item.source.line for item in collector.since(0)] == lines, "what is new is told at once"

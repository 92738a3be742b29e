"""Reading programs and comparing listings: helpers of the interpreter's tests."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rm501_host.gcode import CanonPrinter, GcodeError, GcodeWarning, Interpreter, Settings, TextLines

SHARED = Path(__file__).resolve().parents[4] / "shared" / "gcode"
_NUMBER = re.compile(r"-?[0-9]+\.[0-9]+")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a program."""

    lines: list[str]
    error: GcodeError | None
    warnings: list[GcodeWarning]


def run_text(text: str, settings: Settings | None = None, name: str = "p.ngc") -> Outcome:
    """Listing, error and warnings of a program, by default with the peer's settings."""
    interpreter = Interpreter(TextLines(text, name), settings or Settings.as_peer(max_blocks=200_000))
    printer = CanonPrinter()
    lines: list[str] = []
    try:
        for call in interpreter.calls():
            lines += printer.lines(call)
    except GcodeError as error:
        return Outcome(lines, error, interpreter.warnings)
    return Outcome(lines, None, interpreter.warnings)


def body(text: str, settings: Settings | None = None) -> list[str]:
    """Calls of a program without numbers, prologue and the end's resets. Raises GcodeError."""
    outcome = run_text(text, settings)
    if outcome.error is not None:
        raise outcome.error
    return [line[13:] for line in outcome.lines[6:-2]]


def first_difference(got: list[str], expected: list[str], tolerance: float = 1e-4) -> str | None:
    """Where two listings differ: text exactly, numbers within a tolerance; None when they agree."""
    for index in range(max(len(got), len(expected))):
        a = got[index].strip() if index < len(got) else "<nothing>"
        b = expected[index].strip() if index < len(expected) else "<nothing>"
        if _NUMBER.sub("#", a) != _NUMBER.sub("#", b):
            return f"line {index + 1}: got {a!r}, expected {b!r}"
        for x, y in zip(_NUMBER.findall(a), _NUMBER.findall(b), strict=True):
            if abs(float(x) - float(y)) > tolerance * 1.001 * max(1.0, abs(float(y)) * 1e-6):
                return f"line {index + 1}: got {a!r}, expected {b!r}"
    return None

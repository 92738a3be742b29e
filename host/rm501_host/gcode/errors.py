"""What can be wrong with a program, and where.

GcodeError                      anything about a program; carries place, call stack and remedy
+-- GcodeSyntaxError            the text of a block cannot be read
+-- GcodeModalError             the words of a block do not go together, or one is missing or out of range
+-- GcodeMathError              an expression has no value (division by zero, root of a negative number)
+-- GcodeParameterError         a parameter that does not exist or cannot be assigned
+-- GcodeGeometryError          an arc, spline or cycle that cannot be drawn
+-- GcodeFlowError              O-words, calls, loops, the end of a program
+-- GcodeUnsupportedError       understood, but not for an arm or not configured here
+-- GcodeLimitError             a bound of the interpreter (depth, line length)
|   +-- GcodeBudgetError        the blocks that its reader allowed are read; the program may be a good one
+-- GcodeAbortError                the program itself asked to stop: (ABORT, text)
+-- GcodeStoppedError              the interpreter was asked to stop from outside
+-- GcodeFileError              a program, tool table or variable file that cannot be read or written
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from rm501_host.errors import Rm501Error


class Location(NamedTuple):
    """A block of a program: file name, line (from 1), its text and its N number, if it has one."""

    file: str
    line: int
    block: str = ""
    number: int | None = None

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@dataclass(frozen=True, slots=True)
class CallFrame:
    """One level of the call stack: which subroutine was called from where."""

    label: str
    called_from: Location


class GcodeError(Rm501Error):
    """A fault of a program: `message`, `remedy`, `location`, `column` (from 1) and `call_stack` (innermost last).

    Raised without a place by the parts and given one, once, by the interpreter.
    """

    def __init__(self, message: str, remedy: str = "", *, offset: int | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        self.offset = offset
        """Index into the block without blanks and comments, until the interpreter has turned it into `column`."""
        self.location: Location | None = None
        self.column: int | None = None
        self.call_stack: tuple[CallFrame, ...] = ()

    @property
    def file(self) -> str:
        """Name of the file the fault is in, empty when unknown."""
        return self.location.file if self.location else ""

    @property
    def line(self) -> int:
        """Line of the fault from 1, 0 when unknown."""
        return self.location.line if self.location else 0

    @property
    def block(self) -> str:
        """Text of the faulty block."""
        return self.location.block if self.location else ""

    def __str__(self) -> str:
        lines: list[str] = []
        place = ""
        if self.location is not None:
            place = f"{self.location.file}:{self.location.line}:"
            if self.column is not None:
                place += f"{self.column}:"
            place += " "
        lines.append(f"{place}{self.message}")
        if self.block:
            shown, caret = _excerpt(self.block, self.column)
            lines.append(f"    {shown}")
            if caret is not None:
                lines.append("    " + " " * caret + "^")
        for frame in reversed(self.call_stack):
            lines.append(f"  in {frame.label}, called from {frame.called_from}")
        if self.remedy:
            lines.append(f"  {self.remedy}")
        return "\n".join(lines)


def _excerpt(block: str, column: int | None, width: int = 100) -> tuple[str, int | None]:
    """Cut a long block around its column; blanks for control characters keep the caret in place."""
    text = "".join(c if c.isprintable() else " " for c in block)
    start = 0
    if len(text) > width:
        start = max(0, min((column or 1) - 1 - width // 2, len(text) - width))
        text = text[start : start + width]
    return text, None if column is None else min(max(0, column - 1 - start), len(text))


class GcodeSyntaxError(GcodeError):
    """The text of a block cannot be read."""


class GcodeModalError(GcodeError):
    """The words of a block do not go together, or one is missing or out of range."""


class GcodeMathError(GcodeError):
    """An expression has no value."""


class GcodeParameterError(GcodeError):
    """A parameter that does not exist or cannot be assigned."""


class GcodeGeometryError(GcodeError):
    """An arc, spline or cycle that cannot be drawn."""


class GcodeFlowError(GcodeError):
    """O-words, calls, loops, the end of a program."""


class GcodeUnsupportedError(GcodeError):
    """Understood, but not for an arm or not configured here."""


class GcodeLimitError(GcodeError):
    """A bound of the interpreter was reached."""


class GcodeBudgetError(GcodeLimitError):
    """`Settings.max_blocks` are read; nothing is wrong with the program so far."""


class GcodeAbortError(GcodeError):
    """The program itself asked to stop."""


class GcodeStoppedError(GcodeError):
    """The interpreter was asked to stop from outside."""


class GcodeFileError(GcodeError):
    """A file that cannot be read or written."""


@dataclass(frozen=True, slots=True)
class GcodeWarning:
    """Something the dialect accepts and that is probably a mistake."""

    message: str
    location: Location

    def __str__(self) -> str:
        return f"{self.location}: warning: {self.message}"

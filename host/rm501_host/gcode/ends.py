"""Where a program begins and ends: percent signs, the end of the file, loops that lack an end."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeFlowError, Location
from rm501_host.gcode.flow import Flow, Skip
from rm501_host.gcode.source import ProgramLines

_PERCENT = re.compile(r"\s*%\s*\Z")
_LOOKED_THROUGH = 10_000
"""Lines of the rest of a file that are looked through for something nobody waits for."""
_MOST_LOOPS = 100


def skip_to_program(flow: Flow, ctx: Context) -> bool:
    """Skip empty lines; True when the program is bracketed by percent signs. Raises GcodeFileError."""
    index = 0
    ctx.at = Location(flow.source.name, 1)
    while True:
        base, lines = flow.source.block(index)
        if not lines:
            return False
        for line in lines[index - base :]:
            stripped = line.strip()
            if stripped:
                if stripped == "%":
                    flow.pc = index + 1
                    return True
                return False
            index += 1


def require_lone_percent(text: str) -> None:
    """Raise GcodeFlowError unless the line that ends the program holds nothing but its percent sign."""
    if text.strip() != "%":
        raise GcodeFlowError("text behind a percent sign", "Only a comment-free % may end the program.")


def has_last_percent(source: ProgramLines, index: int) -> bool:
    """Whether a percent sign stands alone in a line from `index` on, among the next 10,000."""
    return _find_line(source, _PERCENT, index, missing_is=False)


def end_of_file(flow: Flow, ctx: Context, percent: bool, folders: Sequence[Path]) -> GcodeFlowError:
    """The error of a file that ended before its program; `ctx.at` becomes its place. `folders`: where subroutines
    were looked for.
    """
    if flow.skip is not Skip.NO and flow.skip_at is not None:
        what = {
            Skip.DEFINITION: ("endsub", "this subroutine"),
            Skip.SEEK: ("beginning", "the subroutine called here"),
            Skip.BRANCH: ("endif", "this branch"),
            Skip.LOOP: ("end", "this loop"),
            Skip.CONTINUE: ("end", "this loop"),
        }[flow.skip]
        ctx.at = flow.skip_at
        searched = ", ".join(str(folder) for folder in folders)
        hint = f" Folders searched: {searched or 'none'}." if flow.skip is Skip.SEEK else ""
        return GcodeFlowError(
            f"the file ended before the {what[0]} of {what[1]}: o<{flow.skip_label}>",
            f"Add it, or check the label.{hint}",
        )
    ctx.at = Location(flow.source.name, flow.pc + 1)
    if percent:
        return GcodeFlowError("file ended with no percent sign", "End the program with % or M2.")
    return GcodeFlowError("file ended with no percent sign or program end", "End the program with M2.")


def unfinished_loops(flow: Flow) -> Iterator[tuple[str, Location]]:
    """Loops of the main program that were begun but have no end in the rest of the file, which is probably a mistake:
    what to warn of, and where.
    """
    for label, known in list(flow.labels.items())[:_MOST_LOOPS]:
        if (label[0], label[1]) == (flow.source.name, "") and known.keyword in ("while", "repeat", "do"):
            ending = "while" if known.keyword == "do" else f"end{known.keyword}"
            pattern = re.compile(rf"\s*/?\s*(?:n[0-9]+\s*)?o\s*<?\s*{re.escape(label[2])}\s*>?\s*{ending}", re.I)
            if not _find_line(flow.source, pattern, known.line + 1, missing_is=True):
                yield f"missing {ending} for this {known.keyword}", known.at


def _find_line(source: ProgramLines, pattern: re.Pattern[str], index: int, *, missing_is: bool) -> bool:
    """Whether a line from `index` on matches; `missing_is` when none of those that are looked through does."""
    stop = index + _LOOKED_THROUGH
    while index < stop:
        base, lines = source.block(index)
        if not lines:
            return False
        for line in lines[index - base :]:
            if pattern.match(line):
                return True
        index = base + len(lines)
    return missing_is

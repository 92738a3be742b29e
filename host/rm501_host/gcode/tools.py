"""The tool table: LinuxCNC's text format, `T1 P1 Z0.511 D0.125 ;comment`, lengths in machine units."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

from rm501_host.gcode.errors import GcodeFileError, GcodeSyntaxError, Location

_WORD = re.compile(r"([A-Za-z])\s*([+-]?(?:\d+\.?\d*|\.\d+))")
_AXES = "XYZABC"


@dataclass(frozen=True, slots=True)
class Tool:
    """One tool: number, pocket, offset (X Y Z in machine units, A B C in deg), diameter in machine units."""

    number: int
    pocket: int
    offset: tuple[float, float, float, float, float, float] = (0.0,) * 6
    diameter: float = 0.0
    comment: str = ""


PEER_DEFAULT_TOOLS = (
    Tool(1, 1, (0.0, 0.0, 0.511, 0.0, 0.0, 0.0), 0.125),
    Tool(2, 2, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), 0.0625),
    Tool(3, 3, (0.0, 0.0, 1.273, 0.0, 0.0, 0.0), 0.201),
)
"""What the peer's stand-alone interpreter knows without a table (inches)."""


class ToolTable:
    """Tools by number."""

    def __init__(self, tools: tuple[Tool, ...] = ()) -> None:
        self._tools = {tool.number: tool for tool in tools}

    def get(self, number: int) -> Tool | None:
        """The tool, or None; tool 0 means no tool."""
        if number == 0:
            return self._tools.get(0, Tool(0, 0))
        return self._tools.get(number)

    def index(self, number: int) -> int:
        """Place of a tool in the table, from 1; 0 for tool 0. Raises KeyError for an unknown tool."""
        if number == 0:
            return 0
        for place, known in enumerate(self._tools, 1):
            if known == number:
                return place
        raise KeyError(number)

    def set_offset(self, number: int, offset: tuple[float, float, float, float, float, float], diameter: float) -> Tool:
        """Change one tool's data (G10 L1); the tool must exist."""
        tool = replace(self._tools[number], offset=offset, diameter=diameter)
        self._tools[number] = tool
        return tool

    def copy(self) -> ToolTable:
        """An independent copy."""
        return ToolTable(tuple(self._tools.values()))

    def __iter__(self) -> Iterator[Tool]:
        return iter(self._tools.values())

    def __len__(self) -> int:
        return len(self._tools)


def parse_tool_table(text: str, name: str = "<tool table>") -> ToolTable:
    """Read a table. Raises GcodeSyntaxError naming file and line."""
    tools: list[Tool] = []
    seen: dict[int, int] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        line, _, comment = raw.partition(";")
        if not line.strip():
            continue
        tool = _parse_line(line, comment, Location(name, number, raw))
        if tool.number in seen:
            _fail(f"tool {tool.number} again, first in line {seen[tool.number]}", Location(name, number, raw))
        seen[tool.number] = number
        tools.append(tool)
    return ToolTable(tuple(tools))


def _parse_line(line: str, comment: str, where: Location) -> Tool:
    words = {letter.upper(): value for letter, value in _WORD.findall(line)}
    rest = _WORD.sub("", line).strip()
    if rest:
        _fail(f"{rest!r} is not a word of a tool table", where)
    if "T" not in words:
        _fail("a tool needs a T word", where)
    try:
        number = int(words["T"])
        pocket = int(words.get("P", words["T"]))
    except ValueError:
        _fail("T and P are whole numbers", where)
    offset = tuple(float(words.get(axis, 0.0)) for axis in _AXES)
    x, y, z, a, b, c = offset
    return Tool(number, pocket, (x, y, z, a, b, c), float(words.get("D", 0.0)), comment.strip())


def _fail(message: str, where: Location) -> NoReturn:
    error = GcodeSyntaxError(message, "A line reads T1 P1 Z10.5 D3 ;comment.")
    error.location = where
    raise error


def load_tool_table(path: Path) -> ToolTable:
    """Read a file. Raises GcodeFileError, GcodeSyntaxError."""
    try:
        return parse_tool_table(path.read_text(encoding="utf-8", errors="surrogateescape"), str(path))
    except OSError as error:
        reason = error.strerror or str(error)
        raise GcodeFileError(f"cannot read {path}: {reason}", "Check the name and the permissions.") from error

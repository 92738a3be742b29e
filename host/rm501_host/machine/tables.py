"""Tool table and work offsets, read and changed as data.

Tools are kept in LinuxCNC's text format (`tool.tbl`), offsets in its variable file (`rm501.var`, #5221 on): a program
sees both as it would there. Lengths mm, angles deg. On an arm a tool's Z acts along the tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from rm501_host.errors import RefusedError
from rm501_host.gcode.parameters import G5X
from rm501_host.gcode.source import TextLines
from rm501_host.gcode.tools import Tool
from rm501_host.kinematics import Arm
from rm501_host.machine.gcode_source import Surroundings
from rm501_host.storage import write_atomic

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
_ROTATION = 9
_MAX_TOOLS = 200


def tool_list(around: Surroundings) -> list[dict[str, object]]:
    """All tools of the table; raises GcodeError naming the line of a damaged one."""
    return [_as_data(tool) for tool in around.tools()]


def set_tool(
    around: Surroundings, number: int, offset: Sequence[float], diameter_mm: float, comment: str
) -> dict[str, object]:
    """Add or replace a tool; the file is written before this returns."""
    if any(ord(letter) < 32 or letter == ";" for letter in comment):
        raise RefusedError("the comment is one line without a semicolon")
    x, y, z = offset
    tools = {tool.number: tool for tool in around.tools()}
    tools[number] = Tool(number, number, (x, y, z, 0.0, 0.0, 0.0), diameter_mm, comment)
    if len(tools) > _MAX_TOOLS:
        raise RefusedError(f"more than {_MAX_TOOLS} tools; delete some first")
    _write(around, tools)
    return _as_data(tools[number])


def delete_tool(around: Surroundings, number: int) -> None:
    """Remove a tool; raises RefusedError when there is none of that number."""
    tools = {tool.number: tool for tool in around.tools()}
    if number not in tools:
        raise RefusedError(f"there is no tool {number}; known: {', '.join(map(str, sorted(tools))) or 'none'}")
    del tools[number]
    _write(around, tools)


def offset_list(around: Surroundings, arm: Arm) -> list[dict[str, object]]:
    """The nine work coordinate systems: offset X Y Z A B C and rotation about Z."""
    numbered = around.interpreter(TextLines(""), arm, around.settings()).parameters.numbered
    found: list[dict[str, object]] = []
    for index, name in enumerate(SYSTEMS):
        first = G5X + 20 * index
        found.append(
            {"name": name, "offset": list(numbered[first : first + 6]), "rotation_deg": numbered[first + _ROTATION]}
        )
    return found


def set_offset(around: Surroundings, arm: Arm, name: str, offset: Sequence[float], rotation_deg: float) -> None:
    """Set one work coordinate system; the file is written before this returns."""
    if name not in SYSTEMS:
        raise RefusedError(f"there is no system {name!r}; use one of {', '.join(SYSTEMS)}")
    if not all(math.isfinite(value) for value in (*offset, rotation_deg)):
        raise RefusedError("give finite numbers")
    interpreter = around.interpreter(TextLines(""), arm, around.settings())
    first = G5X + 20 * SYSTEMS.index(name)
    for place, value in enumerate(offset):
        interpreter.parameters.numbered[first + place] = float(value)
    interpreter.parameters.numbered[first + _ROTATION] = float(rotation_deg)
    around.save_variables(interpreter)


def _write(around: Surroundings, tools: dict[int, Tool]) -> None:
    lines = []
    for _, tool in sorted(tools.items()):
        x, y, z = tool.offset[:3]
        lines.append(f"T{tool.number} P{tool.pocket} X{x:.6f} Y{y:.6f} Z{z:.6f} D{tool.diameter:.6f} ;{tool.comment}")
    write_atomic(around.tool_file, ("\n".join(lines) + "\n").encode())


def _as_data(tool: Tool) -> dict[str, object]:
    return {
        "number": tool.number,
        "offset_mm": list(tool.offset[:3]),
        "diameter_mm": tool.diameter,
        "comment": tool.comment,
    }

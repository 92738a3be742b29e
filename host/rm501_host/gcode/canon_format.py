"""Canonical calls as text: the peer's listing (`rs274 -g`) and one JSON object a call."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from enum import Enum
from typing import Any

from rm501_host.gcode import canon as c


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{v:.4f}" for v in values)


def _motion_mode(call: c.SetMotionControlMode) -> str:
    if call.mode is c.MotionMode.CONTINUOUS:
        return f"SET_MOTION_CONTROL_MODE(CANON_CONTINUOUS, {call.tolerance:f})"
    return f"SET_MOTION_CONTROL_MODE(CANON_{call.mode.value})"


def _tool_offset(call: c.UseToolLengthOffset) -> str:
    x, y, z, a, b, cc = (f"{v:.4f}" for v in call.offset)
    return f"USE_TOOL_LENGTH_OFFSET({x} {y} {z}, {a} {b} {cc}, 0.0000 0.0000 0.0000)"


def _output_bit(call: c.SetOutputBit) -> str:
    return f"{'SET' if call.on else 'CLEAR'}_{'MOTION' if call.synchronised else 'AUX'}_OUTPUT_BIT({call.output})"


def _output_value(call: c.SetOutputValue) -> str:
    return f"SET_{'MOTION' if call.synchronised else 'AUX'}_OUTPUT_VALUE({call.output},{call.value:f})"


def _tool_entry(call: c.SetToolTableEntry) -> str:
    offset = " ".join(f"{v:.4f}" for v in call.offset)
    return (
        f"SET_TOOL_TABLE_ENTRY({call.index}, {call.tool}, {offset} 0.0000 0.0000 0.0000, "
        f"{call.front_angle_deg:.4f}, {call.back_angle_deg:.4f}, {call.orientation})"
    )


def _user_m(call: c.UserMCode) -> str:
    words = "".join(f", {name}{value:.4f}" for name, value in (("P", call.p), ("Q", call.q)) if value is not None)
    return f"USER_M_CODE({call.number}{words})"


_TEXT: dict[type, Callable[[Any], str]] = {  # Any: each entry takes the class it stands under
    c.StraightTraverse: lambda k: f"STRAIGHT_TRAVERSE({_numbers(k.target)})",
    c.StraightFeed: lambda k: f"STRAIGHT_FEED({_numbers(k.target)})",
    c.StraightProbe: lambda k: f"STRAIGHT_PROBE({_numbers(k.target)})",
    c.ArcFeed: lambda k: f"ARC_FEED({_numbers((*k.end, *k.centre))}, {k.turns}, {_numbers((k.axis_end, *k.abc))})",
    c.NurbsFeed: lambda k: f"NURBS_FEED({len(k.control_points)}, ...)",
    c.CanonDwell: lambda k: f"DWELL({k.seconds:.4f})",
    c.SetFeedRate: lambda k: f"SET_FEED_RATE({k.rate:.4f})",
    c.SetFeedMode: lambda k: f"SET_FEED_MODE(0, {int(k.mode)})",
    c.SelectPlane: lambda k: f"SELECT_PLANE(CANON_PLANE_{k.plane.value})",
    c.UseLengthUnits: lambda k: f"USE_LENGTH_UNITS(CANON_UNITS_{k.units.value})",
    c.SetG5xOffset: lambda k: f"SET_G5X_OFFSET({k.index}, {_numbers(k.offset)})",
    c.SetG92Offset: lambda k: f"SET_G92_OFFSET({_numbers(k.offset)})",
    c.SetXyRotation: lambda k: f"SET_XY_ROTATION({k.angle_deg:.4f})",
    c.SetMotionControlMode: _motion_mode,
    c.SetNaivecamTolerance: lambda k: f"SET_NAIVECAM_TOLERANCE({k.tolerance:.4f})",
    c.SelectTool: lambda k: f"SELECT_TOOL({k.tool})",
    c.ChangeTool: lambda k: f"CHANGE_TOOL({k.index})",
    c.ChangeToolNumber: lambda k: f"CHANGE_TOOL_NUMBER({k.index})",
    c.UseToolLengthOffset: _tool_offset,
    c.SetToolTableEntry: _tool_entry,
    c.SetSpindleSpeed: lambda k: f"SET_SPINDLE_SPEED(0, {k.speed:.4f})",
    c.SetSpindleMode: lambda k: f"SET_SPINDLE_MODE(0 {k.limit:.4f})",
    c.SetOutputBit: _output_bit,
    c.SetOutputValue: _output_value,
    c.UserMCode: _user_m,
    c.Comment: lambda k: f'COMMENT("{k.text}")',
    c.OperatorMessage: lambda k: f'MESSAGE("{k.text}")',
    c.LogCall: lambda k: f'{k.action.value}("{k.text}")',
    c.SignalCall: lambda k: str(k.signal.value),
}


def format_call(call: c.CanonCall) -> str | None:
    """The call as the peer lists it, without number and label; None for what it does not list (M66, heartbeats)."""
    function = _TEXT.get(type(call))
    return None if function is None else function(call)


class CanonPrinter:
    """Numbers the calls of one listing from 1."""

    def __init__(self) -> None:
        self._count = 0

    def lines(self, call: c.CanonCall) -> tuple[str, ...]:
        """The lines of one call in the form of `rs274 -g`: `    7 N..... STRAIGHT_FEED(...)`; PRINT is plain text."""
        if isinstance(call, c.PrintText):
            return tuple(call.text.split("\n"))
        text = format_call(call)
        if text is None:
            return ()
        self._count += 1
        number = call.at.number
        label = "N..... " if number is None else f"N{number:<6}"
        return (f"{self._count:5} {label}{text}",)


def format_canon(call: c.CanonCall, printer: CanonPrinter | None = None) -> tuple[str, ...]:
    """The lines of one call; with a printer they carry running numbers, else number 1."""
    return (printer or CanonPrinter()).lines(call)


def format_canon_lines(calls: Iterable[c.CanonCall]) -> Iterator[str]:
    """The whole listing, lazily."""
    printer = CanonPrinter()
    for call in calls:
        yield from printer.lines(call)


def _plain(value: object) -> object:
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return value


def to_json(call: c.CanonCall) -> dict[str, object]:
    """The call as plain data: `op` (class name), `file`, `line`, `n` (N number), then the fields in program units."""
    out: dict[str, object] = {"op": type(call).__name__, "file": call.at.file, "line": call.at.line}
    if call.at.number is not None:
        out["n"] = call.at.number
    for field in fields(call):
        if field.name != "at":
            out[field.name] = _plain(getattr(call, field.name))
    return out

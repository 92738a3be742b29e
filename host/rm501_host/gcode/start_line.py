"""Run from line: what the lines before the start leave behind, as calls.

The lines before are executed without their calls being handed on, so every mode, offset and parameter is right; at the
start line the modes are restored by calls of their own, then one traverse goes to where those lines left the tool.
"""

from __future__ import annotations

from collections.abc import Iterable

from rm501_host.gcode import canon as c
from rm501_host.gcode.context import Context
from rm501_host.gcode.coordinates import emit_g5x, emit_g92, emit_rotation
from rm501_host.gcode.errors import GcodeFlowError
from rm501_host.gcode.motion import as_axes


def moves_machine(calls: Iterable[c.CanonCall], start_line: int) -> bool:
    """Whether calls before the start line would move. Raises GcodeFlowError for what only the machine can answer."""
    moved = False
    for call in calls:
        if isinstance(call, c.WaitInput | c.StraightProbe):
            raise GcodeFlowError(
                f"cannot start at line {start_line}: this block before it asks the machine",
                "Start before it, or remove it.",
            )
        moved = moved or isinstance(call, c.StraightFeed | c.StraightTraverse | c.ArcFeed | c.NurbsFeed)
    return moved


def restore_for_start(ctx: Context, *, moved: bool) -> None:
    """The calls that bring a machine into the state of `ctx`; `moved`: with the traverse to its position."""
    state, emit, at = ctx.state, ctx.emit, ctx.at
    emit(c.UseLengthUnits(state.units, at))
    emit(c.SelectPlane(state.plane, at))
    emit_g5x(ctx)
    emit_g92(ctx)
    emit_rotation(ctx)
    if state.current_tool:
        emit(c.SelectTool(state.current_tool, at))
        emit(c.ChangeTool(state.current_tool, ctx.tools.index(state.current_tool), at))
    if any(state.tool_offset):
        emit(c.UseToolLengthOffset(as_axes(state.tool_offset), at))
    emit(c.SetFeedRate(state.feed, at))
    emit(c.SetMotionControlMode(state.control_mode, state.control_tolerance, at))
    if state.control_mode is c.MotionMode.CONTINUOUS:
        emit(c.SetNaivecamTolerance(state.naivecam_tolerance, at))
    if state.spindle:
        emit(c.SetSpindleSpeed(state.speed, at))
        clockwise, counter = c.Signal.START_SPINDLE_CLOCKWISE, c.Signal.START_SPINDLE_COUNTERCLOCKWISE
        emit(c.SignalCall(clockwise if state.spindle > 0 else counter, at))
    for on, signal in ((state.mist, c.Signal.MIST_ON), (state.flood, c.Signal.FLOOD_ON)):
        if on:
            emit(c.SignalCall(signal, at))
    if moved:
        emit(c.StraightTraverse(as_axes(state.position), at))

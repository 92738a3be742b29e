"""Units, work coordinate systems, G92, G10, stored positions, tool length, G68."""

from __future__ import annotations

from rm501_host.gcode.canon import (
    Comment,
    SetG5xOffset,
    SetG92Offset,
    SetToolTableEntry,
    SetXyRotation,
    StraightTraverse,
    Units,
    UseLengthUnits,
    UseToolLengthOffset,
)
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeModalError, GcodeUnsupportedError
from rm501_host.gcode.expressions import to_integer
from rm501_host.gcode.motion import Words, as_axes, end_point
from rm501_host.gcode.parameters import G5X, G5X_INDEX, G28, G30, G92, G92_ACTIVE
from rm501_host.gcode.state import AXES, ProgramRotation, rotate

_ROTATION = 9
"""Offset of the rotation parameter inside a work coordinate system."""


def system_parameter(index: int) -> int:
    """First parameter of work coordinate system 1 to 9."""
    return G5X + 20 * (index - 1)


def set_units(ctx: Context, units: Units) -> None:
    """G20, G21."""
    ctx.emit(UseLengthUnits(units, ctx.at))
    tool_offset = ctx.state.tool_offset.copy()
    ctx.state.set_units(units)
    if ctx.peer_standalone:  # LinuxCNC 2.9 keeps the number of the tool offset and so changes its length
        ctx.state.tool_offset = tool_offset


def emit_g5x(ctx: Context) -> None:
    """The offset in force."""
    ctx.emit(SetG5xOffset(ctx.state.g5x_index, as_axes(ctx.state.g5x), ctx.at))


def emit_g92(ctx: Context) -> None:
    """The G92 offset in force."""
    ctx.emit(SetG92Offset(as_axes(ctx.state.g92), ctx.at))


def emit_rotation(ctx: Context) -> None:
    """The rotation in force."""
    ctx.emit(SetXyRotation(ctx.state.rotation_deg, ctx.at))


def _load_system(ctx: Context, index: int) -> None:
    """Put a system in force; the tool stays where it is."""
    state, parameters = ctx.state, ctx.parameters
    machine = state.machine_position(state.position)
    state.g5x_index = index
    first = system_parameter(index)
    state.g5x = parameters.axes(first)
    state.rotation_deg = parameters.numbered[first + _ROTATION]
    parameters.numbered[G5X_INDEX] = float(index)
    state.position = state.program_position(machine)


def _load_system_as_peer(ctx: Context, index: int) -> None:
    """G10 in the system in force, as LinuxCNC 2.9 has it: the rotation is turned about the origin without the G92
    offset, so with both in use the current position comes out wrong. Kept for comparing listings only.
    """
    state = ctx.state
    x, y = rotate(state.position[0], state.position[1], state.rotation_deg)
    x, y = x + state.g5x[0], y + state.g5x[1]
    _load_system(ctx, index)
    state.position[0], state.position[1] = rotate(x - state.g5x[0], y - state.g5x[1], -state.rotation_deg)


def select_system(ctx: Context, index: int) -> None:
    """G54 to G59.3."""
    if index == ctx.state.g5x_index:
        ctx.emit(Comment("interpreter: continuing to use same coordinate system", ctx.at))
        return
    _load_system(ctx, index)
    emit_g5x(ctx)
    emit_g92(ctx)
    emit_rotation(ctx)


def reset_to_first_system(ctx: Context) -> None:
    """What M2 does."""
    _load_system(ctx, 1)
    emit_g5x(ctx)
    emit_rotation(ctx)


# -- G92, G52


def set_g92(ctx: Context, words: Words, *, local: bool) -> None:
    """G92: the current position gets these numbers. G52 (`local`): the offset itself."""
    state = ctx.state
    state.rotation = None
    for i, axis in enumerate(AXES):
        value = words.get(axis)
        if value is None:
            continue
        if local:
            state.position[i] += state.g92[i] - value
            state.g92[i] = value
        else:
            state.g92[i] += state.position[i] - value
            state.position[i] = value
    emit_g92(ctx)
    ctx.parameters.numbered[G92_ACTIVE] = 1.0
    ctx.parameters.store_axes(G92, state.g92)


def clear_g92(ctx: Context, *, forget: bool) -> None:
    """G92.1 (`forget`), G92.2."""
    state = ctx.state
    for i in range(6):
        state.position[i] += state.g92[i]
        state.g92[i] = 0.0
    emit_g92(ctx)
    ctx.parameters.numbered[G92_ACTIVE] = 0.0
    if forget:
        for i in range(9):
            ctx.parameters.numbered[G92 + i] = 0.0


def restore_g92(ctx: Context) -> None:
    """G92.3."""
    state = ctx.state
    stored = ctx.parameters.axes(G92)
    for i in range(6):
        state.position[i] += state.g92[i] - stored[i]
        state.g92[i] = stored[i]
    emit_g92(ctx)
    ctx.parameters.numbered[G92_ACTIVE] = 1.0


# -- G10


def g10(ctx: Context, words: Words) -> None:
    """G10 L1, L2, L20. Raises GcodeModalError, GcodeUnsupportedError."""
    level = to_integer(words["l"], "L") if "l" in words else -1
    if level in (2, 20):
        _g10_system(ctx, words, level)
    elif level == 1:
        _g10_tool(ctx, words)
    elif level in (10, 11):
        raise GcodeUnsupportedError(
            f"G10 L{level} measures a tool against a fixture", "Use G10 L1 with the tool's length along the tool."
        )
    else:
        raise GcodeModalError("line with G10 does not have L1, L2, or L20", "Add the L word.")


def _g10_system(ctx: Context, words: Words, level: int) -> None:
    state, parameters = ctx.state, ctx.parameters
    if "i" in words or "j" in words:
        raise GcodeModalError(f"I J words not allowed with G10 L{level}", "Remove them.")
    number = int(words["p"]) if words.get("p", -1.0) >= 0.0 else -1
    if not 0 <= number <= 9:
        raise GcodeModalError(
            f"P value out of range (0-9) with G10 L{level}", "P 1 to 9 is G54 to G59.3, P 0 the one in force."
        )
    index = number or state.g5x_index
    first = system_parameter(index)
    offset = parameters.axes(first)
    rotation = parameters.numbered[first + _ROTATION]
    if "r" in words:
        if level == 20 and ctx.peer_standalone:
            raise GcodeModalError("R not allowed in G10 L20", "Set the rotation with G10 L2.")
        rotation = words["r"]
        parameters.numbered[first + _ROTATION] = rotation
    if level == 2:
        for i, axis in enumerate(AXES):
            if axis in words:
                offset[i] = words[axis]
    else:
        _origin_from_position(ctx, words, offset, rotation)
    parameters.store_axes(first, offset)
    if index == state.g5x_index:
        if ctx.peer_standalone:
            _load_system_as_peer(ctx, index)
        else:
            _load_system(ctx, index)
        emit_g5x(ctx)
        emit_rotation(ctx)
    else:
        ctx.emit(Comment("interpreter: setting coordinate system origin", ctx.at))


def _origin_from_position(ctx: Context, words: Words, offset: list[float], rotation: float) -> None:
    """L20: the origin that gives the current position the numbers of the words."""
    state = ctx.state
    machine = state.machine_position(state.position)
    bare = [machine[i] - state.tool_offset[i] for i in range(6)]
    x, y = rotate(bare[0] - offset[0], bare[1] - offset[1], -rotation)
    wanted = [words.get(AXES[0], x - state.g92[0]) + state.g92[0], words.get(AXES[1], y - state.g92[1]) + state.g92[1]]
    dx, dy = rotate(wanted[0], wanted[1], rotation)
    if "x" in words or "y" in words:
        offset[0], offset[1] = bare[0] - dx, bare[1] - dy
    for i in range(2, 6):
        if AXES[i] in words:
            offset[i] = bare[i] - state.g92[i] - words[AXES[i]]


def _g10_tool(ctx: Context, words: Words) -> None:
    state = ctx.state
    if "p" not in words:
        raise GcodeModalError("P word missing with G10 L1", "P is the number of the tool.")
    number = to_integer(words["p"], "P, the tool number")
    tool = ctx.tools.get(number)
    if tool is None or number == 0:
        raise GcodeModalError(f"requested tool {number} not found in the tool table", "Add it to the table first.")
    offset = list(tool.offset)
    for i, axis in enumerate(AXES):
        if axis in words:
            offset[i] = words[axis] / (state.to_program if i < 3 else 1.0)
    diameter = tool.diameter
    if "r" in words:
        diameter = 2.0 * words["r"] / state.to_program
    tool = ctx.tools.set_offset(number, as_axes(offset), diameter)
    loaded = number == state.current_tool
    if ctx.peer_standalone and state.current_tool == 0:
        loaded = number == 1  # its table starts with tool 1 in the spindle's pocket
    front, back = words.get("i", 0.0), words.get("j", 0.0)
    orientation = to_integer(words.get("q", 0.0), "Q, the orientation")
    place = ctx.tools.index(number)
    for index in (place, 0) if loaded else (place,):
        ctx.emit(SetToolTableEntry(index, tool.number, tool.offset, tool.diameter, front, back, orientation, ctx.at))


# -- tool length


def tool_length(ctx: Context, code: int, words: Words) -> None:
    """G43, G43.1, G43.2, G49. Raises GcodeModalError."""
    state = ctx.state
    offset = [0.0] * 6
    if code == 430:
        number = to_integer(words["h"], "H, the tool number") if "h" in words else state.current_tool
        offset = _table_offset(ctx, number)
    elif code == 431:
        offset = state.tool_offset.copy()
        for i, axis in enumerate(AXES):
            if axis in words:
                offset[i] = words[axis]
    elif code == 432:
        offset = state.tool_offset.copy()
        has_axes = any(axis in words for axis in AXES)
        if "h" in words and has_axes:
            raise GcodeModalError("G43.2: cannot have both H and axis words", "Use two blocks.")
        if "h" in words:
            extra = _table_offset(ctx, to_integer(words["h"], "H, the tool number"))
            offset = [a + b for a, b in zip(offset, extra, strict=True)]
        elif has_axes:
            offset = [a + words.get(axis, 0.0) for a, axis in zip(offset, AXES, strict=True)]
        else:
            raise GcodeModalError("G43.2: no axes specified and H word missing", "Add axis words or H.")
    _use_tool_offset(ctx, offset)
    state.tool_offset_active = any(offset)


def _use_tool_offset(ctx: Context, offset: list[float]) -> None:
    state = ctx.state
    before = ctx.machine_stands_at().copy()
    state.tool_unplaced = not ctx.peer_standalone and (state.tool_unplaced or offset != state.tool_offset)
    machine = state.machine_position(state.position)
    state.tool_offset = offset
    state.position = state.program_position(machine)
    ctx.mark_unfollowed(before)
    ctx.emit(UseToolLengthOffset(as_axes(offset), ctx.at))


def restore_tool_offset(ctx: Context, offset: list[float]) -> None:
    """M72: the offset that was saved (program units)."""
    _use_tool_offset(ctx, offset)
    ctx.state.tool_offset_active = any(offset)


def _table_offset(ctx: Context, number: int) -> list[float]:
    tool = ctx.tools.get(number)
    if tool is None:
        raise GcodeModalError(f"requested tool {number} not found in the tool table", "Check H and the table.")
    factor = ctx.state.to_program
    return [v * factor if i < 3 else v for i, v in enumerate(tool.offset)]


# -- stored positions


def go_home(ctx: Context, code: int, words: Words) -> None:
    """G28, G30: through the point of the words to the stored position, with the named axes only if any are named."""
    state = ctx.state
    stored = ctx.parameters.axes(G28 if code == 280 else G30)
    named = [axis in words for axis in AXES]
    via = end_point(ctx, words)
    if any(named) or ("@" not in words and "^" not in words):
        ctx.emit(StraightTraverse(as_axes(via), ctx.at))
    state.position = via
    home = state.program_position(stored)
    state.position = [home[i] if named[i] or not any(named) else via[i] for i in range(6)]
    ctx.emit(StraightTraverse(as_axes(state.position), ctx.at))


def store_home(ctx: Context, code: int) -> None:
    """G28.1, G30.1: the stored position is the current one, in machine coordinates."""
    machine = ctx.state.machine_position(ctx.state.position)
    first = G28 if code == 281 else G30
    ctx.parameters.store_axes(first, machine)
    ctx.parameters.numbered[first + 6 : first + 9] = (0.0, 0.0, 0.0)


# -- G68, G69


def rotate_program(ctx: Context, words: Words) -> None:
    """G68 X Y R: turn the program about X Y (default: the current point) by R degrees. Raises GcodeModalError."""
    state = ctx.state
    if "r" not in words:
        raise GcodeModalError("R word missing with G68", "R is the angle in degrees, counter-clockwise.")
    if not state.absolute and ("x" in words or "y" in words):
        raise GcodeModalError("the centre of G68 needs absolute distance mode", "Use G90, or leave X and Y out.")
    centre = (words.get("x", state.position[0]), words.get("y", state.position[1]))
    state.rotation = ProgramRotation(centre, words["r"])


def end_program_rotation(ctx: Context) -> None:
    """G69."""
    ctx.state.rotation = None

"""M codes other than program stops: outputs, inputs, tools, saved modes, spindle, coolant, overrides, user codes."""

from __future__ import annotations

from rm501_host.gcode import canon as c
from rm501_host.gcode import coordinates
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeModalError, GcodeUnsupportedError
from rm501_host.gcode.expressions import to_integer
from rm501_host.gcode.motion import Words
from rm501_host.gcode.parameters import G92_ACTIVE, INPUT_RESULT
from rm501_host.gcode.registry import M_COOLANT, M_IO, M_OVERRIDE, M_SPINDLE, M_TOOL, M_USER
from rm501_host.gcode.state import SavedModes


def execute_m(ctx: Context, m: dict[int, int], words: Words) -> None:
    """All M codes of a block but stops and calls, in their order. Raises GcodeError."""
    if M_IO in m and m[M_IO] < 98:
        _io(ctx, m[M_IO], words)
    if M_TOOL in m:
        _tool(ctx, m[M_TOOL], words)
    if M_SPINDLE in m:
        _spindle(ctx, m[M_SPINDLE])
    if M_COOLANT in m:
        _coolant(ctx, m[M_COOLANT])
    if M_OVERRIDE in m:
        _override(ctx, m[M_OVERRIDE], words)
    if M_USER in m:
        _user(ctx, m[M_USER], words)


def _signal(ctx: Context, signal: c.Signal) -> None:
    ctx.emit(c.SignalCall(signal, ctx.at))


def _io(ctx: Context, code: int, words: Words) -> None:
    if code in (62, 63, 64, 65):
        if "p" not in words:
            raise GcodeModalError(f"no valid P word with M{code}", "P is the number of the output.")
        output = to_integer(words["p"], "P, the output")
        ctx.emit(c.SetOutputBit(output, code in (62, 64), code in (62, 63), ctx.at))
    elif code in (67, 68):
        output = to_integer(words["e"], "E, the analog output") if "e" in words else -1
        if output < 0:
            raise GcodeModalError(f"invalid analog index with M{code}", "E is the number of the output, from 0.")
        value = words.get("q", -1.0 if ctx.peer_standalone else 0.0)
        ctx.emit(c.SetOutputValue(output, value, code == 67, ctx.at))
    else:
        _wait_input(ctx, words)


def _wait_input(ctx: Context, words: Words) -> None:
    if "p" in words and "e" in words:
        raise GcodeModalError("invalid to select both a digital and an analog input with M66", "Use P or E.")
    analog = "e" in words
    if not analog and "p" not in words:
        raise GcodeModalError("need to have either a valid P or a valid E word with M66", "Name the input.")
    index = to_integer(words["e" if analog else "p"], "the input")
    mode = to_integer(words.get("l", 0.0), "L, the kind of wait")
    timeout = words.get("q", 0.0)
    if analog and mode != 0:
        raise GcodeModalError("cannot select analog input with wait type != immediate return", "Use L0.")
    if mode != 0 and timeout <= 0.0:
        raise GcodeModalError("zero timeout with wait type != immediate return", "Give Q in seconds.")
    if index < 0 or timeout < 0.0 or mode not in range(5):
        if mode not in range(5) and ctx.peer_standalone:
            mode = 0
        else:
            raise GcodeModalError("M66 out of range", "Inputs count from 0, L is 0 to 4, Q is not negative.")
    ctx.emit(c.WaitInput(index, analog, mode, timeout, ctx.at))
    feedback, parameters = ctx.feedback, ctx.parameters

    def take_result() -> None:
        parameters.numbered[INPUT_RESULT] = feedback.input_value(index, analog, mode, timeout)

    ctx.pending = take_result


def _tool(ctx: Context, code: int, words: Words) -> None:
    state = ctx.state
    if code == 6:
        _signal(ctx, c.Signal.START_CHANGE)
        _signal(ctx, c.Signal.STOP_SPINDLE_TURNING)
        ctx.emit(c.ChangeTool(state.selected_tool, ctx.tools.index(state.selected_tool), ctx.at))
        state.current_tool = state.tool_in_spindle = state.selected_tool
        ctx.resynchronise()
        return
    number = to_integer(words["q"], "Q, the tool number") if "q" in words else -1
    if number < 0:
        raise GcodeModalError("need non-negative Q-word to specify tool number with M61", "Q is the tool.")
    if ctx.tools.get(number) is None:
        raise GcodeModalError(f"requested tool {number} not found in the tool table", "Add it, or check the number.")
    ctx.emit(c.ChangeToolNumber(number, ctx.tools.index(number), ctx.at))
    ctx.resynchronise()
    state.current_tool = number
    if not ctx.peer_standalone:
        state.tool_in_spindle = number


def _spindle(ctx: Context, code: int) -> None:
    state = ctx.state
    if code == 3:
        state.spindle = 1
        _signal(ctx, c.Signal.START_SPINDLE_CLOCKWISE)
    elif code == 4:
        state.spindle = -1
        _signal(ctx, c.Signal.START_SPINDLE_COUNTERCLOCKWISE)
    elif code == 5:
        state.spindle = 0
        _signal(ctx, c.Signal.STOP_SPINDLE_TURNING)
    elif code == 70:
        ctx.parameters.saved = save_modes(ctx, at_return=False)
    elif code == 71:
        ctx.parameters.saved = None
    elif code == 73:
        ctx.parameters.saved = save_modes(ctx, at_return=True)
    elif code == 72:
        saved = ctx.parameters.saved
        if saved is None:
            raise GcodeModalError(
                "cannot restore context from invalid stack frame", "M72 needs an M70 or M73 at this call level."
            )
        restore_modes(ctx, saved)


def _coolant(ctx: Context, code: int) -> None:
    state = ctx.state
    if code == 7:
        state.mist = True
        _signal(ctx, c.Signal.MIST_ON)
    elif code == 8:
        state.flood = True
        _signal(ctx, c.Signal.FLOOD_ON)
    else:
        state.mist = state.flood = False
        _signal(ctx, c.Signal.MIST_OFF)
        _signal(ctx, c.Signal.FLOOD_OFF)


def _override(ctx: Context, code: int, words: Words) -> None:
    state = ctx.state
    on = words.get("p", 1.0) != 0.0
    if code in (48, 49):
        on = code == 48
        state.feed_override = state.speed_override = on
        _signal(ctx, c.Signal.ENABLE_FEED_OVERRIDE if on else c.Signal.DISABLE_FEED_OVERRIDE)
        _signal(ctx, c.Signal.ENABLE_SPEED_OVERRIDE if on else c.Signal.DISABLE_SPEED_OVERRIDE)
    elif code == 50:
        state.feed_override = on
        _signal(ctx, c.Signal.ENABLE_FEED_OVERRIDE if on else c.Signal.DISABLE_FEED_OVERRIDE)
    elif code == 51:
        state.speed_override = on
        _signal(ctx, c.Signal.ENABLE_SPEED_OVERRIDE if on else c.Signal.DISABLE_SPEED_OVERRIDE)
    elif code == 52:
        state.adaptive_feed = on
        _signal(ctx, c.Signal.ENABLE_ADAPTIVE_FEED if on else c.Signal.DISABLE_ADAPTIVE_FEED)
    else:
        state.feed_hold = on
        _signal(ctx, c.Signal.ENABLE_FEED_HOLD if on else c.Signal.DISABLE_FEED_HOLD)


def _user(ctx: Context, code: int, words: Words) -> None:
    kind = ctx.user_m.get(code)
    if kind is None:
        raise GcodeUnsupportedError(
            f"unknown M code used: M{code}", f"Put an executable M{code} into the configured folder, or remove it."
        )
    p, q = words.get("p"), words.get("q")
    if kind is c.UserMKind.JOINT:
        joint = to_integer(p, "P, the joint") if p is not None else 0
        if not 1 <= joint <= 5 or q is None:
            raise GcodeModalError(f"M{code} needs P (joint 1 to 5) and Q (degrees)", f"As: M{code} P1 Q30")
    ctx.emit(c.UserMCode(code, kind, p, q, ctx.at))


# -- saved modes


def save_modes(ctx: Context, *, at_return: bool) -> SavedModes:
    """What M70 and M73 keep."""
    s = ctx.state
    return SavedModes(
        units=s.units,
        plane=s.plane,
        absolute=s.absolute,
        arc_absolute=s.arc_absolute,
        inverse_time=s.inverse_time,
        feed=s.feed,
        speed=s.speed,
        g5x_index=s.g5x_index,
        g92_active=ctx.parameters.numbered[G92_ACTIVE] != 0.0,
        tool_offset=tuple(s.tool_offset),
        control_mode=s.control_mode,
        control_tolerance=s.control_tolerance,
        naivecam_tolerance=s.naivecam_tolerance,
        retract_r=s.retract_r,
        spindle=s.spindle,
        mist=s.mist,
        flood=s.flood,
        overrides=(s.feed_override, s.speed_override, s.adaptive_feed, s.feed_hold),
        at_return=at_return,
    )


def restore_modes(ctx: Context, saved: SavedModes) -> None:
    """Bring back what differs, with the calls that go with it (M72, and the return of a subroutine with M73)."""
    s, emit, at = ctx.state, ctx.emit, ctx.at
    if saved.units is not s.units:
        coordinates.set_units(ctx, saved.units)
    if saved.inverse_time != s.inverse_time:
        s.inverse_time = saved.inverse_time
        name = "inverse time" if saved.inverse_time else "units per minute"
        emit(c.Comment(f"interpreter: feed mode set to {name}", at))
        emit(c.SetFeedMode(c.CanonFeedMode.UNITS_PER_MINUTE, at))
        if not saved.inverse_time:
            emit(c.SetFeedRate(0.0, at))
            s.feed = 0.0
    if saved.feed != s.feed and not saved.inverse_time:
        emit(c.SetFeedRate(saved.feed, at))
    s.feed = saved.feed
    if saved.speed != s.speed:
        emit(c.SetSpindleSpeed(saved.speed, at))
        s.speed = saved.speed
    if saved.spindle != s.spindle:
        _spindle(ctx, {1: 3, -1: 4, 0: 5}[saved.spindle])
    if saved.plane is not s.plane:
        s.plane = saved.plane
        emit(c.SelectPlane(s.plane, at))
    if saved.tool_offset != tuple(s.tool_offset):
        coordinates.restore_tool_offset(ctx, list(saved.tool_offset))
    if saved.g5x_index != s.g5x_index:
        coordinates.select_system(ctx, saved.g5x_index)
    if saved.g92_active != (ctx.parameters.numbered[G92_ACTIVE] != 0.0):
        if saved.g92_active:
            coordinates.restore_g92(ctx)
        else:
            coordinates.clear_g92(ctx, forget=False)
    _restore_path(ctx, saved)
    if saved.absolute != s.absolute:
        s.absolute = saved.absolute
        name = "absolute" if s.absolute else "incremental"
        emit(c.Comment(f"interpreter: distance mode changed to {name}", at))
    if saved.arc_absolute != s.arc_absolute:
        s.arc_absolute = saved.arc_absolute
        name = "absolute" if s.arc_absolute else "incremental"
        emit(c.Comment(f"interpreter: IJK distance mode changed to {name}", at))
    if saved.retract_r != s.retract_r:
        s.retract_r = saved.retract_r
        emit(c.Comment(f"interpreter: retract mode set to {'r_plane' if s.retract_r else 'old_z'}", at))
    _restore_outputs(ctx, saved)


def _restore_path(ctx: Context, saved: SavedModes) -> None:
    s = ctx.state
    now = (s.control_mode, s.control_tolerance, s.naivecam_tolerance)
    then = (saved.control_mode, saved.control_tolerance, saved.naivecam_tolerance)
    if now == then:
        return
    s.control_mode, s.control_tolerance, s.naivecam_tolerance = then
    ctx.emit(c.SetMotionControlMode(s.control_mode, s.control_tolerance, ctx.at))
    if s.control_mode is c.MotionMode.CONTINUOUS:
        ctx.emit(c.SetNaivecamTolerance(s.naivecam_tolerance, ctx.at))


def _restore_outputs(ctx: Context, saved: SavedModes) -> None:
    s = ctx.state
    if (saved.mist, saved.flood) != (s.mist, s.flood):
        if (s.mist and not saved.mist) or (s.flood and not saved.flood):
            _coolant(ctx, 9)
        if saved.mist and not s.mist:
            _coolant(ctx, 7)
        if saved.flood and not s.flood:
            _coolant(ctx, 8)
    now = (s.feed_override, s.speed_override, s.adaptive_feed, s.feed_hold)
    for code, was, is_now in zip((50, 51, 52, 53), saved.overrides, now, strict=True):
        if was != is_now:
            _override(ctx, code, {"p": 1.0 if was else 0.0})

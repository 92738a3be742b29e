"""One evaluated block, in RS274/NGC's order of execution.

Order: comment; feed mode; feed rate; speed; tool selection; outputs and inputs; tool change; saved modes; spindle;
coolant; overrides; user M codes; dwell; plane; units; tool length; work system; path control; distance modes; retract
mode; one-shot codes and offsets; motion; stop.
"""

from __future__ import annotations

from dataclasses import dataclass

from rm501_host.gcode import canon as c
from rm501_host.gcode import coordinates, splines
from rm501_host.gcode.context import Context
from rm501_host.gcode.cycles import CYCLES, cycle
from rm501_host.gcode.errors import GcodeModalError, GcodeUnsupportedError
from rm501_host.gcode.expressions import to_integer
from rm501_host.gcode.mcodes import execute_m
from rm501_host.gcode.motion import Words, arc, check_polar, probe, straight
from rm501_host.gcode.registry import (
    ARC_DISTANCE,
    CUTTER,
    DISTANCE,
    FEED_MODE,
    M_IO,
    M_OVERRIDE,
    M_STOP,
    M_TOOL,
    M_USER,
    MOTION,
    ONE_SHOT,
    PATH_CONTROL,
    PLANE,
    RETRACT,
    ROTATION,
    SPINDLE_MODE,
    TOOL_LENGTH,
    UNITS,
    WORK_OFFSET,
)
from rm501_host.gcode.state import AXES, NO_MOTION, NO_MOTION_AFTER_NURBS, State

_AXIS_USERS = {100, 280, 300, 520, 920}
_PLANES = {170: c.Plane.XY, 180: c.Plane.XZ, 190: c.Plane.YZ}
_SYSTEMS = {540: 1, 550: 2, 560: 3, 570: 4, 580: 5, 590: 6, 591: 7, 592: 8, 593: 9}
_NEED_AXES = {382, 383, 384, 385, *CYCLES}


@dataclass(slots=True)
class Evaluated:
    """A block with every value known; `motion` is what will move, None for nothing."""

    words: Words
    g: dict[int, int]
    m: dict[int, int]
    motion: int | None = None


def resolve_motion(ctx: Context, block: Evaluated) -> None:
    """Decide which code uses the axis words. Raises GcodeModalError when that is not clear."""
    state, words, g = ctx.state, block.words, block.g
    if "@" in words or "^" in words:
        check_polar(ctx, words)
    has_axes = any(axis in words for axis in AXES) or "@" in words or "^" in words
    one_shot = g.get(ONE_SHOT)
    covets = one_shot in _AXIS_USERS or g.get(TOOL_LENGTH) in (431, 432) or g.get(ROTATION) == 680
    motion = g.get(MOTION)
    if motion is not None:
        if motion == NO_MOTION:
            if has_axes and one_shot not in _AXIS_USERS:
                raise GcodeModalError("cannot use axis values with G80", "Name a motion code.")
            if one_shot == 920 and not has_axes:
                _all_axes_missing("G92")
        else:
            if has_axes and one_shot in _AXIS_USERS:
                raise GcodeModalError("cannot use two G codes that both use axis values", "Split the block.")
            if not has_axes and motion in _NEED_AXES:
                raise GcodeModalError("all axes missing with motion code", "Say where to move.")
        block.motion = motion
    elif covets:
        if not has_axes and one_shot in (520, 920):
            _all_axes_missing(f"G{one_shot // 10}")
    elif has_axes or (state.motion in (20, 30) and any(w in words for w in "ijk")):
        if state.motion in (NO_MOTION, NO_MOTION_AFTER_NURBS):
            raise GcodeModalError(
                "cannot use axis values without a G code that uses them", "No motion mode is in force: name G0, G1, ..."
            )
        block.motion = state.motion


def _all_axes_missing(name: str) -> None:
    raise GcodeModalError(f"all axes missing with {name}", "Name at least one axis.")


def _used(condition: bool, letter: str, users: str) -> None:
    if not condition:
        raise GcodeModalError(f"{letter} word with no {users} to use it", "Remove the word, or add its code.")


def check_words(state: State, block: Evaluated) -> None:
    """Every word has a code that uses it. Raises GcodeModalError."""
    w, g, m, motion = block.words, block.g, block.m, block.motion
    one_shot = g.get(ONE_SHOT)
    io, override = m.get(M_IO), m.get(M_OVERRIDE)
    is_arc, is_cycle = motion in (20, 30), motion in CYCLES
    user = M_USER in m
    if is_arc and "p" in w and to_integer(w["p"], "P, the number of turns") < 1:
        raise GcodeModalError("P value should be 1 or greater with G2 or G3", "P counts full turns begun.")
    if one_shot == 530 and (g.get(DISTANCE) == 910 or (DISTANCE not in g and not state.absolute)):
        raise GcodeModalError("cannot use G53 in incremental distance mode", "Switch to G90 first.")
    if is_cycle:
        for axis in "abc":
            if axis in w:
                raise GcodeModalError(f"cannot put an {axis} in canned cycle", "Turn the tool in a block of its own.")
    for letter in w:
        match letter:
            case "$":
                if to_integer(w["$"], "$, the spindle") not in (0, -1):
                    raise GcodeModalError("invalid spindle ($) number", "There is one spindle output, $0.")
            case "d":
                _used(False, "D", "G41 or G42")
            case "e":
                _used(io in (66, 67, 68), "E", "M66, M67 or M68")
            case "h":
                to_integer(w["h"], "H, the tool number")
                _used(g.get(TOOL_LENGTH) in (430, 432), "H", "G43 or G43.2")
            case "i" | "j":
                _used(is_arc or motion in (50, 51) or one_shot == 100, letter.upper(), "G2, G3, G5, G5.1 or G10")
            case "k":
                _used(is_arc, "K", "G2 or G3")
            case "l":
                to_integer(w["l"], "L")
                _used(
                    is_cycle or one_shot == 100 or io in (66, 98) or motion == 52, "L", "G10, cycle, M66, M98 or G5.2"
                )
            case "p":
                _used(
                    is_arc
                    or one_shot in (100, 40)
                    or g.get(PATH_CONTROL) == 640
                    or motion in (50, 52, 820, 890)
                    or override in (50, 51, 52, 53)
                    or io in (62, 63, 64, 65, 66, 98)
                    or user,
                    "P",
                    "G2, G3, G4, G5, G5.2, G10, G64, G82, G89, M50 to M53, M62 to M66, M98 or user M code",
                )
            case "q":
                _used(
                    motion in (50, 730, 830)
                    or one_shot == 100
                    or g.get(PATH_CONTROL) == 640
                    or io in (66, 67, 68)
                    or m.get(M_TOOL) == 61
                    or user,
                    "Q",
                    "G5, G10, G64, G73, G83, M61, M66 to M68 or user M code",
                )
            case "r":
                _used(is_arc or is_cycle or one_shot == 100 or g.get(ROTATION) == 680, "R", "G2, G3, G10, G68 or cycle")
            case _:
                pass


def execute(ctx: Context, block: Evaluated) -> bool:
    """Carry out a block; True when the program ends. Raises GcodeError."""
    state, words, g, m = ctx.state, block.words, block.g, block.m
    if SPINDLE_MODE in g:
        ctx.emit(c.SetSpindleMode(0.0, ctx.at))
    if FEED_MODE in g:
        _feed_mode(ctx, g[FEED_MODE])
    if "f" in words:
        _feed_rate(ctx, words["f"], block.motion)
    if "s" in words:
        if words["s"] < 0.0:
            raise GcodeModalError("negative spindle speed used", "S is not negative.")
        state.speed = words["s"]
        ctx.emit(c.SetSpindleSpeed(words["s"], ctx.at))
    if "t" in words:
        _select_tool(ctx, words["t"])
    if m:
        execute_m(ctx, m, words)
    if g:
        _modes(ctx, g, words)
        one_shot = g.get(ONE_SHOT)
        if one_shot is not None:
            _one_shot(ctx, one_shot, words)
    if block.motion is not None:
        _motion(ctx, block)
    return M_STOP in m and _stop(ctx, m[M_STOP])


def _feed_mode(ctx: Context, code: int) -> None:
    inverse = code == 930
    what = "inverse time" if inverse else "units per minute"
    ctx.emit(c.Comment(f"interpreter: feed mode set to {what}", ctx.at))
    ctx.emit(c.SetFeedMode(c.CanonFeedMode.UNITS_PER_MINUTE, ctx.at))
    if not inverse:
        ctx.emit(c.SetFeedRate(0.0, ctx.at))
        ctx.state.feed = 0.0
    ctx.state.inverse_time = inverse


def _feed_rate(ctx: Context, feed: float, motion: int | None) -> None:
    del motion
    if feed < 0.0:
        raise GcodeModalError("negative F word used", "F is not negative.")
    if not ctx.state.inverse_time:
        ctx.emit(c.SetFeedRate(feed, ctx.at))
        ctx.state.feed = feed


def _select_tool(ctx: Context, value: float) -> None:
    number = to_integer(value, "T, the tool number")
    if number < 0:
        raise GcodeModalError("negative tool number", "T is 0 (no tool) or a tool of the table.")
    if ctx.tools.get(number) is None:
        raise GcodeModalError(f"requested tool {number} not found in the tool table", "Add it, or check the number.")
    ctx.state.selected_tool = number
    ctx.emit(c.SelectTool(number, ctx.at))


def _modes(ctx: Context, g: dict[int, int], words: Words) -> None:
    state = ctx.state
    if g.get(ONE_SHOT) == 40:
        if words.get("p", -1.0) < 0.0:
            raise GcodeModalError("dwell time missing with G4", "Give P in seconds, not negative.")
        ctx.emit(c.CanonDwell(words["p"], ctx.at))
    if PLANE in g:
        state.plane = _PLANES[g[PLANE]]
        ctx.emit(c.SelectPlane(state.plane, ctx.at))
    if UNITS in g:
        coordinates.set_units(ctx, c.Units.INCH if g[UNITS] == 200 else c.Units.MM)
    if CUTTER in g:
        ctx.emit(c.Comment("interpreter: cutter radius compensation off", ctx.at))
    if TOOL_LENGTH in g:
        coordinates.tool_length(ctx, g[TOOL_LENGTH], words)
    if WORK_OFFSET in g:
        coordinates.select_system(ctx, _SYSTEMS[g[WORK_OFFSET]])
    if PATH_CONTROL in g:
        _path_control(ctx, g[PATH_CONTROL], words)
    if DISTANCE in g:
        absolute = g[DISTANCE] == 900
        if absolute != state.absolute:
            state.absolute = absolute
            name = "absolute" if absolute else "incremental"
            ctx.emit(c.Comment(f"interpreter: distance mode changed to {name}", ctx.at))
    if ARC_DISTANCE in g:
        arc_absolute = g[ARC_DISTANCE] == 901
        if arc_absolute != state.arc_absolute:
            state.arc_absolute = arc_absolute
            name = "absolute" if arc_absolute else "incremental"
            ctx.emit(c.Comment(f"interpreter: IJK distance mode changed to {name}", ctx.at))
    if RETRACT in g:
        state.retract_r = g[RETRACT] == 990
        name = "r_plane" if state.retract_r else "old_z"
        ctx.emit(c.Comment(f"interpreter: retract mode set to {name}", ctx.at))
    if ROTATION in g:
        if g[ROTATION] == 680:
            coordinates.rotate_program(ctx, words)
        else:
            coordinates.end_program_rotation(ctx)


def _path_control(ctx: Context, code: int, words: Words) -> None:
    state = ctx.state
    state.control_mode = {610: c.MotionMode.EXACT_PATH, 611: c.MotionMode.EXACT_STOP}.get(code, c.MotionMode.CONTINUOUS)
    state.control_tolerance = max(0.0, words.get("p", 0.0)) if code == 640 else 0.0
    ctx.emit(c.SetMotionControlMode(state.control_mode, state.control_tolerance, ctx.at))
    if code == 640:
        naive = words.get("q", -1.0)
        state.naivecam_tolerance = naive if naive >= 0.0 else state.control_tolerance
        ctx.emit(c.SetNaivecamTolerance(state.naivecam_tolerance, ctx.at))


def _one_shot(ctx: Context, code: int, words: Words) -> None:
    if code in (281, 301):
        coordinates.store_home(ctx, code)
    elif code in (280, 300):
        coordinates.go_home(ctx, code, words)
    elif code == 100:
        coordinates.g10(ctx, words)
    elif code in (520, 920):
        coordinates.set_g92(ctx, words, local=code == 520)
    elif code in (921, 922):
        coordinates.clear_g92(ctx, forget=code == 921)
    elif code == 923:
        coordinates.restore_g92(ctx)


def _motion(ctx: Context, block: Evaluated) -> None:
    state, words, code = ctx.state, block.words, block.motion
    machine_coordinates = block.g.get(ONE_SHOT) == 530
    if machine_coordinates and code not in (0, 10):
        raise GcodeModalError("must use G0 or G1 with G53", "G53 is for straight moves.")
    if code is None:
        return
    if code not in (52, 53):
        state.nurbs = None
    if code in (0, 10):
        straight(ctx, code, words, machine_coordinates=machine_coordinates)
    elif code in (20, 30):
        arc(ctx, code, words)
    elif code in CYCLES:
        cycle(ctx, code, words)
    elif code == NO_MOTION:
        ctx.emit(c.Comment("interpreter: motion mode set to none", ctx.at))
    elif code in (382, 383, 384, 385):
        probe(ctx, code, words)
    elif code == 50:
        splines.cubic(ctx, words)
    elif code == 51:
        splines.quadratic(ctx, words)
    elif code == 52:
        splines.nurbs_point(ctx, words)
    elif code == 53:
        splines.nurbs_end(ctx)
        state.motion = NO_MOTION_AFTER_NURBS
        return
    else:
        raise GcodeUnsupportedError(f"motion code {code / 10:g} is not supported", "See docs/gcode.md.")
    if code not in (50, 51):  # G5 and G5.1 are not modal (LinuxCNC 2.9)
        state.motion = code


def _stop(ctx: Context, code: int) -> bool:
    """M0, M1, M60; M2 and M30 end the program (True) and reset the modes."""
    emit, at = ctx.emit, ctx.at
    if code == 0:
        emit(c.SignalCall(c.Signal.PROGRAM_STOP, at))
        return False
    if code == 1:
        emit(c.SignalCall(c.Signal.OPTIONAL_PROGRAM_STOP, at))
        return False
    if code == 60:
        emit(c.SignalCall(c.Signal.PALLET_SHUTTLE, at))
        emit(c.SignalCall(c.Signal.PROGRAM_STOP, at))
        return False
    end_of_program(ctx, exchange=code == 30)
    return True


def end_of_program(ctx: Context, *, exchange: bool) -> None:
    """Reset what M2 and M30 reset, and say so."""
    state, emit, at = ctx.state, ctx.emit, ctx.at
    coordinates.reset_to_first_system(ctx)
    if state.plane is not c.Plane.XY:
        state.plane = c.Plane.XY
        emit(c.SelectPlane(c.Plane.XY, at))
    state.absolute = True
    state.inverse_time = False
    emit(c.SetFeedMode(c.CanonFeedMode.UNITS_PER_MINUTE, at))
    emit(c.SetFeedRate(0.0, at))
    state.feed = 0.0
    if not state.feed_override:
        emit(c.SignalCall(c.Signal.ENABLE_FEED_OVERRIDE, at))
        state.feed_override = True
    state.speed_override = True
    emit(c.SignalCall(c.Signal.STOP_SPINDLE_TURNING, at))
    emit(c.SetSpindleMode(0.0, at))
    state.spindle = 0
    state.motion = 10
    if state.mist:
        state.mist = False
        emit(c.SignalCall(c.Signal.MIST_OFF, at))
    if state.flood:
        state.flood = False
        emit(c.SignalCall(c.Signal.FLOOD_OFF, at))
    state.rotation = None
    if exchange:
        emit(c.SignalCall(c.Signal.PALLET_SHUTTLE, at))
    emit(c.SignalCall(c.Signal.PROGRAM_END, at))

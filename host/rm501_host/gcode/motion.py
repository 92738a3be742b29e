"""Straight moves, arcs, probing: words of a block to canonical motion.

Tolerances are LinuxCNC 2.9's, found by bisection against it; lengths in the unit of the program.
"""

from __future__ import annotations

import math

from rm501_host.gcode.canon import (
    ArcFeed,
    Axes,
    Plane,
    SetFeedRate,
    Signal,
    SignalCall,
    StraightFeed,
    StraightProbe,
    StraightTraverse,
    Units,
)
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeGeometryError, GcodeModalError
from rm501_host.gcode.expressions import to_integer
from rm501_host.gcode.parameters import PROBE, PROBE_OK
from rm501_host.gcode.state import AXES, State

Words = dict[str, float]

SPIRAL_TOLERANCE = {Units.MM: 2 * math.sqrt(2) * 0.01, Units.INCH: 2 * math.sqrt(2) * 0.001}
"""Radii at start and end may differ by this, or by 0.1 % up to 100 times this."""
SPIRAL_RELATIVE_TOLERANCE = 0.001
RADIUS_TOLERANCE = {Units.MM: 0.00127, Units.INCH: 0.00005}
"""Smallest radius, and how much too short an R may be."""
MIN_INVERSE_TIME_FEED = 0.1

PLANE_AXES = {Plane.XY: (0, 1, 2), Plane.XZ: (2, 0, 1), Plane.YZ: (1, 2, 0)}
"""First, second and normal axis of each plane."""
PLANE_OFFSETS = {Plane.XY: ("i", "j", "k"), Plane.XZ: ("k", "i", "j"), Plane.YZ: ("j", "k", "i")}


def as_axes(values: list[float]) -> Axes:
    """Six floats as a tuple."""
    x, y, z, a, b, c = values
    return (x, y, z, a, b, c)


def _place_tool(ctx: Context, words: Words) -> None:
    """After a change of tool length only a move that names X, Y and Z is certain about where an arm's tool goes."""
    state = ctx.state
    if not (state.absolute and all(axis in words for axis in "xyz")):
        ctx.warn("the first move after a change of tool length does not name X, Y and Z: they are only what they were")
    state.tool_unplaced = False


def end_point(ctx: Context, words: Words, *, machine_coordinates: bool = False) -> list[float]:
    """The target of a move in canonical coordinates. Raises GcodeModalError for bad polar words."""
    state = ctx.state
    if state.tool_unplaced:
        _place_tool(ctx, words)
    position = state.position
    if machine_coordinates:
        machine = state.machine_position(position)
        _set_words(machine, words)
        return state.program_position(machine)
    out = position.copy()
    if state.rotation is not None:
        out[0], out[1] = state.rotation.back(out[0], out[1])
    if "@" in words or "^" in words:
        _set_polar(out, state.absolute, words)
    if state.absolute:
        _set_words(out, words)
    else:
        for i, axis in enumerate(AXES):
            value = words.get(axis)
            if value is not None:
                out[i] += value
    if state.rotation is not None:
        out[0], out[1] = state.rotation.forward(out[0], out[1])
    return out


def _set_words(out: list[float], words: Words) -> None:
    for i, axis in enumerate(AXES):
        value = words.get(axis)
        if value is not None:
            out[i] = value


def check_polar(ctx: Context, words: Words) -> None:
    """What is wrong with @ and ^ wherever the tool is. Raises GcodeModalError."""
    if ctx.state.plane is not Plane.XY:
        raise GcodeModalError(
            "cannot use polar coordinate except in G17 plane", "Select the XY plane before this block."
        )
    for axis in "xy":
        if axis in words:
            raise GcodeModalError(
                f"cannot specify both polar coordinate and {axis.upper()} word", "Use @ and ^, or X and Y."
            )
    if "@" not in words:
        ctx.warn("a polar angle without a radius: the radius stays as it is")


def _set_polar(out: list[float], absolute: bool, words: Words) -> None:
    radius, angle = words.get("@"), words.get("^")
    x, y = out[0], out[1]
    if angle is None and x == 0.0 and y == 0.0:
        raise GcodeModalError(
            "must specify angle in polar coordinate if at the origin", "Add a ^ word: no direction is known here."
        )
    if not absolute and x == 0.0 and y == 0.0:
        raise GcodeModalError(
            "incremental motion with polar coordinates is indeterminate when at the origin", "Use G90 for this block."
        )
    r, theta = math.hypot(x, y), math.degrees(math.atan2(y, x))
    if absolute:
        r = r if radius is None else radius
        theta = theta if angle is None else angle
    else:
        r += radius or 0.0
        theta += angle or 0.0
    out[0] = r * math.cos(math.radians(theta))
    out[1] = r * math.sin(math.radians(theta))


def inverse_time_feed(ctx: Context, words: Words, length: float, code: str) -> None:
    """In G93 the feed of one move: its F (1/min) times its `length` in units of the
    program. Raises GcodeModalError when F is missing."""
    rate = words.get("f")
    if rate is None:
        raise GcodeModalError(
            f"F word missing with inverse time {code} move",
            "In G93 every feed move needs its own F (moves per minute).",
        )
    ctx.emit(SetFeedRate(max(MIN_INVERSE_TIME_FEED, rate * length), ctx.at, rate))


def _straight_length(start: list[float], end: list[float]) -> float:
    length = math.dist(start[:3], end[:3])
    return length if length > 0.0 else math.dist(start[3:], end[3:])


def need_feed(state: State, what: str) -> None:
    """Raises GcodeModalError at zero feed."""
    if not state.inverse_time and state.feed == 0.0:
        raise GcodeModalError(f"cannot {what} with zero feed rate", "Give an F word in this or an earlier block.")


def straight(ctx: Context, code: int, words: Words, *, machine_coordinates: bool = False) -> None:
    """G0, G1."""
    state = ctx.state
    name = "g0" if code == 0 else "g1"
    if code == 10:
        need_feed(state, "do g1")
    if not machine_coordinates and not any(w in words for w in "xyzabc@^"):
        ctx.warn(f"{name.upper()} without axis words: a move to where the tool already is")
    end = end_point(ctx, words, machine_coordinates=machine_coordinates)
    if code == 0:
        ctx.emit(StraightTraverse(as_axes(end), ctx.at))
    else:
        if state.inverse_time:
            inverse_time_feed(ctx, words, _straight_length(state.position, end), name)
        ctx.emit(StraightFeed(as_axes(end), ctx.at))
    state.position = end


def arc(ctx: Context, code: int, words: Words) -> None:
    """G2, G3 in any plane. Raises GcodeModalError, GcodeGeometryError."""
    state = ctx.state
    need_feed(state, "make arc")
    first, second, normal = PLANE_AXES[state.plane]
    first_word, second_word, normal_word = PLANE_OFFSETS[state.plane]
    plane = state.plane.value.lower()
    turns = to_integer(words.get("p", 1.0), "P, the number of turns")
    has_ijk = any(w in words for w in "ijk")
    if "r" in words and has_ijk:
        raise GcodeModalError("mixed radius and IJK format for arc", "Give either R or the centre offsets.")
    if "r" not in words and not has_ijk:
        raise GcodeModalError("R I J K words all missing for arc", "Give a radius R, or the centre with I J K.")
    if normal_word in words:
        raise GcodeModalError(
            f"{normal_word.upper()} word given for arc in {plane} plane",
            f"This plane takes {first_word.upper()} and {second_word.upper()}; select another with G17 G18 G19.",
        )
    end = end_point(ctx, words)
    if "r" in words:
        if not any(w in words for w in (AXES[first], AXES[second], "@", "^")):
            raise GcodeModalError(
                f"{AXES[first].upper()} and {AXES[second].upper()} words missing for arc in {plane} plane",
                "An arc by radius needs its end point.",
            )
        centre = _centre_from_radius(state, (first, second), end, words["r"], code)
    else:
        centre = _centre_from_offsets(state, (first, second), (first_word, second_word), end, words)
    clockwise = code == 20
    if state.inverse_time:
        inverse_time_feed(ctx, words, _arc_length(state, (first, second, normal), end, centre, clockwise, turns), "arc")
    ctx.emit(
        ArcFeed(
            (end[first], end[second]),
            centre,
            -turns if clockwise else turns,
            end[normal],
            (end[3], end[4], end[5]),
            ctx.at,
        )
    )
    state.position = end


def _centre_from_radius(
    state: State, axes: tuple[int, int], end: list[float], radius: float, code: int
) -> tuple[float, float]:
    start = state.position
    x, y = start[axes[0]], start[axes[1]]
    ex, ey = end[axes[0]], end[axes[1]]
    if x == ex and y == ey:
        raise GcodeGeometryError(
            "current point same as end point of arc", "A full circle needs the centre form with I J K."
        )
    half = math.hypot(ex - x, ey - y) / 2.0
    size = abs(radius)
    if half - size > RADIUS_TOLERANCE[state.units]:
        raise GcodeGeometryError(
            f"arc radius too small to reach end point: R is {size:g}, the points are {2 * half:g} apart",
            f"R must be at least {half:.6g}.",
        )
    across = math.sqrt(max(0.0, size * size - half * half))
    # Left of the chord for a short counter-clockwise or a long clockwise arc.
    side = 1.0 if (code == 30) == (radius > 0.0) else -1.0
    dx, dy = (ex - x) / (2.0 * half), (ey - y) / (2.0 * half)
    return (x + ex) / 2.0 - side * across * dy, (y + ey) / 2.0 + side * across * dx


def _centre_from_offsets(
    state: State, axes: tuple[int, int], offset_words: tuple[str, str], end: list[float], words: Words
) -> tuple[float, float]:
    x, y = state.position[axes[0]], state.position[axes[1]]
    first, second = offset_words
    rotation = state.rotation
    if state.arc_absolute:
        for word in offset_words:
            if word not in words:
                raise GcodeModalError(
                    f"{word.upper()} word missing in absolute center arc", "G90.1 needs both centre coordinates."
                )
        cx, cy = words[first], words[second]
        if rotation is not None:
            cx, cy = rotation.forward(cx, cy)
    else:
        dx, dy = words.get(first, 0.0), words.get(second, 0.0)
        if rotation is not None:
            ox, oy = rotation.forward(rotation.centre[0] + dx, rotation.centre[1] + dy)
            dx, dy = ox - rotation.centre[0], oy - rotation.centre[1]
        cx, cy = x + dx, y + dy
    start_radius = math.hypot(cx - x, cy - y)
    end_radius = math.hypot(cx - end[axes[0]], cy - end[axes[1]])
    least = RADIUS_TOLERANCE[state.units]
    if start_radius < least or end_radius < least:
        raise GcodeGeometryError("zero-radius arc", "The centre may not be the start or end point.")
    difference = abs(start_radius - end_radius)
    relative = difference / max(start_radius, end_radius)
    tolerance = SPIRAL_TOLERANCE[state.units]
    if difference > 100.0 * tolerance or (relative > SPIRAL_RELATIVE_TOLERANCE and difference > tolerance):
        raise GcodeGeometryError(
            f"radius to end of arc differs from radius to start: {end_radius:.6g} and {start_radius:.6g}, "
            f"{difference:.4g} apart",
            "Check the end point and I J K (G91.1: from the start point; G90.1: absolute).",
        )
    return cx, cy


def swept_angle(start: tuple[float, float], end: tuple[float, float], centre: tuple[float, float], turns: int) -> float:
    """Angle in rad an arc turns through, positive counter-clockwise; equal ends make a full turn.

    The peer's rule (`turns` as in ArcFeed): the angle to the end is taken within one turn, then full turns are added.
    Ends are equal within 1e-9 rad, also across +-180 deg: the start may be rounded, where it comes from joint angles.
    """
    a0 = math.atan2(start[1] - centre[1], start[0] - centre[0])
    a1 = math.atan2(end[1] - centre[1], end[0] - centre[0])
    whole = 2.0 * math.pi
    angle = (a1 - a0) % whole
    if angle < 1e-9 or whole - angle < 1e-9:
        angle = 0.0
    if turns < 0:
        return angle - whole + whole * (turns + 1)
    return (angle or whole) + whole * (turns - 1)


def _arc_length(
    state: State,
    axes: tuple[int, int, int],
    end: list[float],
    centre: tuple[float, float],
    clockwise: bool,
    turns: int,
) -> float:
    start = state.position
    first, second, normal = axes
    angle = swept_angle(
        (start[first], start[second]), (end[first], end[second]), centre, -turns if clockwise else turns
    )
    radius = math.hypot(centre[0] - start[first], centre[1] - start[second])
    return math.hypot(radius * angle, end[normal] - start[normal])


def probe(ctx: Context, code: int, words: Words) -> None:
    """G38.2 to G38.5; the position after it is the machine's to tell. Raises GcodeModalError."""
    state = ctx.state
    if state.feed == 0.0:
        raise GcodeModalError("cannot probe with zero feed rate", "Give an F word in G94 before the probing move.")
    end = end_point(ctx, words)
    if code in (382, 384) and math.dist(state.position, end) < 1e-9:
        raise GcodeGeometryError("start point too close to probe point", "Probe over a distance.")
    ctx.emit(SignalCall(Signal.TURN_PROBE_ON, ctx.at))
    start, target = as_axes(ctx.machine_stands_at()), as_axes(end)
    ctx.emit(StraightProbe(target, code in (382, 383), code in (382, 384), ctx.at))
    ctx.emit(SignalCall(Signal.TURN_PROBE_OFF, ctx.at))
    parameters, feedback, must_succeed = ctx.parameters, ctx.feedback, code in (382, 384)
    units = state.units

    def take_result() -> None:
        result = feedback.probe_result(start, target, units)
        state.position = list(result.stopped_at)
        parameters.numbered[PROBE : PROBE + 6] = result.contact
        parameters.numbered[PROBE_OK] = 1.0 if result.success else 0.0
        if must_succeed and not result.success and not ctx.peer_standalone:
            raise GcodeGeometryError(
                "the probing move ended without contact", "Check the probe, or use G38.3 and #5070."
            )

    ctx.pending = take_result

"""Canonical calls to moves: units, work offsets, G92 and rotation applied, in the program frame, mm and deg.

A point becomes `Rot(rotation) * (p + g92) + g5x` (see `state.py`), lengths in mm. The tool length is not part of it: on
an arm it acts along the tool, so it becomes a `ToolChange` and the kinematics lengthens the last link (design: section
10). Lazy: a call is taken when a move is wanted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from rm501_host import moves as mv
from rm501_host.gcode import canon as c
from rm501_host.gcode.errors import GcodeError, GcodeLimitError, GcodeUnsupportedError, Location
from rm501_host.gcode.motion import PLANE_AXES, swept_angle
from rm501_host.gcode.state import rotate

_ZERO = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_TRAVEL_MM = 1e-7
"""As the planner has it: below this X, Y, Z stand still and F is deg/min."""


@dataclass(frozen=True, slots=True)
class ExternalAction:
    """M100 to M199 that are executables: P and Q as given, None where missing."""

    number: int
    p: float | None
    q: float | None
    source: mv.Source


@dataclass(frozen=True, slots=True)
class StillReading:
    """The program has been read for another so many blocks without a move."""

    blocks: int
    source: mv.Source


ResolvedMove = mv.Move | ExternalAction | StillReading


@dataclass(frozen=True, slots=True)
class ResolveOptions:
    """What the machine does with calls that are not motion."""

    outputs: Mapping[c.Signal, tuple[int, bool]] = field(default_factory=dict)
    """M3 to M9: which digital output goes where, as {START_SPINDLE_CLOCKWISE: (3, True), ...}."""
    on_log: Callable[[c.CanonCall], None] | None = None
    """Takes LogCall, PrintText and LOGCLOSE."""
    on_warning: Callable[[str, Location], None] | None = None
    tells_silence: bool = False
    """Whether long silent stretches yield `StillReading`, so that whoever reads can stop."""
    max_silent_heartbeats: int = 1000
    """Heartbeats in a row before a program counts as looping for ever: ten million blocks without a move."""


_PATH_MODES = {
    c.MotionMode.EXACT_PATH: mv.PathMode.EXACT_PATH,
    c.MotionMode.EXACT_STOP: mv.PathMode.EXACT_STOP,
    c.MotionMode.CONTINUOUS: mv.PathMode.BLEND,
}
_NEED_OUTPUT = {
    c.Signal.START_SPINDLE_CLOCKWISE: "M3",
    c.Signal.START_SPINDLE_COUNTERCLOCKWISE: "M4",
    c.Signal.MIST_ON: "M7",
    c.Signal.FLOOD_ON: "M8",
}
_OVERRIDES = {
    c.Signal.DISABLE_FEED_OVERRIDE: "feed override stays enabled",
    c.Signal.DISABLE_SPEED_OVERRIDE: "there is no spindle to override",
    c.Signal.ENABLE_ADAPTIVE_FEED: "there is no adaptive feed",
    c.Signal.DISABLE_FEED_HOLD: "feed hold always works",
}
_PAUSES = {
    c.Signal.PROGRAM_STOP: mv.PauseKind.PROGRAM,
    c.Signal.OPTIONAL_PROGRAM_STOP: mv.PauseKind.OPTIONAL,
}


def source_of(at: Location) -> mv.Source:
    """The source of a move."""
    return mv.Source(at.file, at.line, at.block)


class Resolver:
    """Turns calls into moves one by one; `feed(call)` returns the moves of a call (mostly none or one)."""

    def __init__(self, options: ResolveOptions | None = None) -> None:
        self.options = options or ResolveOptions()
        self._mm = 1.0
        self._g5x = self._g92 = _ZERO
        self._rotation_deg = 0.0
        self._plane = c.Plane.XY
        self._rate = 0.0
        self._inverse: float | None = None
        self._program = _ZERO
        """Last target in canonical numbers, but with lengths in mm."""
        self._mode = c.MotionMode.CONTINUOUS
        self._blend_tolerance: float | None = None
        self._tool = 0
        self._exchange = False

    # -- points

    def _mm_axes(self, axes: c.Axes) -> c.Axes:
        k = self._mm
        return (axes[0] * k, axes[1] * k, axes[2] * k, axes[3], axes[4], axes[5])

    def _point(self, x: float, y: float, z: float) -> mv.Vector:
        """Program frame of a canonical point, all in mm."""
        px, py = rotate(x + self._g92[0], y + self._g92[1], self._rotation_deg)
        return (px + self._g5x[0], py + self._g5x[1], z + self._g92[2] + self._g5x[2])

    def _target(self, p: c.Axes) -> mv.Target:
        x, y, z = self._point(p[0], p[1], p[2])
        g5x, g92 = self._g5x, self._g92
        return (x, y, z, p[3] + g92[3] + g5x[3], p[4] + g92[4] + g5x[4], p[5] + g92[5] + g5x[5])

    def _keep_place(self, change: Callable[[], None]) -> None:
        """Offsets change, the tool stays: renumber where it is."""
        here = self._target(self._program)
        change()
        self.set_position(here)

    def set_position(self, t: mv.Target) -> None:
        """Tell where the tool centre point is (program frame, mm and deg): arcs, splines and feeds start from there.

        To be called wherever the interpreter is told (`Interpreter.set_position`): calls carry ends, not starts.
        """
        x, y = rotate(t[0] - self._g5x[0], t[1] - self._g5x[1], -self._rotation_deg)
        g5x, g92 = self._g5x, self._g92
        self._program = (
            x - g92[0],
            y - g92[1],
            t[2] - g5x[2] - g92[2],
            t[3] - g5x[3] - g92[3],
            t[4] - g5x[4] - g92[4],
            t[5] - g5x[5] - g92[5],
        )

    def _feed(self, linear: bool) -> mv.Feed:
        """F for a move; deg/min and thus without the unit of length when no length is covered."""
        if self._inverse is not None:
            return mv.Feed(self._inverse, mv.FeedMode.INVERSE_TIME)
        return mv.Feed(self._rate * self._mm if linear else self._rate)

    def _travels(self, program: c.Axes) -> bool:
        """Whether X, Y or Z move to a target: by more than the rounding of an inch."""
        return math.dist(program[:3], self._program[:3]) >= _NO_TRAVEL_MM

    # -- calls

    def feed(self, call: c.CanonCall) -> tuple[ResolvedMove, ...]:
        """The moves of one call. Raises GcodeError (a subclass) for what this machine cannot do."""
        try:
            return self._resolve(call)
        except GcodeError as error:
            if error.location is None:
                error.location = call.at
            raise

    def _resolve(self, call: c.CanonCall) -> tuple[ResolvedMove, ...]:
        match call:
            case c.StraightFeed():
                program = self._mm_axes(call.target)
                linear = self._travels(program)
                self._program = program
                return (mv.LinearMove(self._target(program), self._feed(linear), source_of(call.at)),)
            case c.StraightTraverse():
                self._program = self._mm_axes(call.target)
                return (mv.RapidMove(self._target(self._program), source_of(call.at)),)
            case c.ArcFeed():
                return (self._arc(call),)
            case c.NurbsFeed():
                return (self._nurbs(call),)
            case c.StraightProbe():
                program = self._mm_axes(call.target)
                linear = self._travels(program)
                self._program = program
                feed = self._feed(linear)
                target = self._target(program)
                return (mv.ProbeMove(target, feed, call.towards, call.must_succeed, source_of(call.at)),)
            case c.SetFeedRate():
                self._rate, self._inverse = call.rate, call.inverse_time
            case c.UseLengthUnits():
                self._mm = call.units.mm
            case c.SelectPlane():
                self._plane = call.plane
            case c.SetG5xOffset():
                self._keep_place(lambda: setattr(self, "_g5x", self._mm_axes(call.offset)))
            case c.SetG92Offset():
                self._keep_place(lambda: setattr(self, "_g92", self._mm_axes(call.offset)))
            case c.SetXyRotation():
                self._keep_place(lambda: setattr(self, "_rotation_deg", call.angle_deg))
            case _:
                return self._other(call)
        return ()

    def _arc(self, call: c.ArcFeed) -> mv.ArcMove:
        k = self._mm
        first, second, normal = PLANE_AXES[self._plane]
        start = self._program
        end = list(start)
        end[first], end[second], end[normal] = call.end[0] * k, call.end[1] * k, call.axis_end * k
        end[3], end[4], end[5] = call.abc
        centre = list(start[:3])
        centre[first], centre[second] = call.centre[0] * k, call.centre[1] * k
        angle = swept_angle(
            (start[first], start[second]), (end[first], end[second]), (centre[first], centre[second]), call.turns
        )
        axis = [0.0, 0.0, 0.0]
        axis[normal] = 1.0
        ax, ay = rotate(axis[0], axis[1], self._rotation_deg)
        self._program = (end[0], end[1], end[2], end[3], end[4], end[5])
        return mv.ArcMove(
            self._target(self._program),
            self._point(centre[0], centre[1], centre[2]),
            (ax, ay, axis[2]),
            math.degrees(angle),
            self._feed(True),
            source_of(call.at),
        )

    def _nurbs(self, call: c.NurbsFeed) -> mv.SplineMove:
        k, z = self._mm, self._program[2]
        points = tuple(self._point(x * k, y * k, z) for x, y in call.control_points)
        x, y = call.control_points[-1]
        self._program = (x * k, y * k, *self._program[2:])
        return mv.SplineMove(
            self._target(self._program),
            points,
            call.weights,
            call.knots,
            call.degree,
            self._feed(True),
            source_of(call.at),
        )

    def _other(self, call: c.CanonCall) -> tuple[ResolvedMove, ...]:
        source = source_of(call.at)
        match call:
            case c.CanonDwell():
                return (mv.Dwell(call.seconds, source),)
            case c.UserMCode():
                return (_user_move(call, source),)
            case c.SetMotionControlMode():
                self._mode = call.mode
                if call.mode is not c.MotionMode.CONTINUOUS:
                    return (mv.PathModeChange(_PATH_MODES[call.mode], None, None, source),)
                self._blend_tolerance = call.tolerance * self._mm if call.tolerance > 0.0 else None
                return ()
            case c.SetNaivecamTolerance():
                naive = call.tolerance * self._mm if call.tolerance > 0.0 else None
                if self._mode is c.MotionMode.CONTINUOUS:  # follows every G64, and the end of a cycle in any mode
                    return (mv.PathModeChange(mv.PathMode.BLEND, self._blend_tolerance, naive, source),)
            case c.UseToolLengthOffset():
                return (self._tool_change(call, source),)
            case c.ChangeTool():
                return self._change_tool(call, source)
            case c.ChangeToolNumber():
                self._tool = call.tool
            case c.SetOutputBit():
                if call.output < 0:
                    raise GcodeUnsupportedError(f"output {call.output} does not exist", "Outputs count from 0.")
                return (mv.OutputChange(call.output, call.on, call.synchronised, source),)
            case c.SetOutputValue():
                raise GcodeUnsupportedError("this machine has no analog outputs", "Remove M67 and M68.")
            case c.WaitInput():
                return (mv.InputWait(call.input, call.mode, call.timeout_s, call.analog, source),)
            case c.OperatorMessage():
                return (mv.Message(call.text, source),)
            case c.PrintText() | c.LogCall():
                self._log(call)
            case c.SignalCall():
                return self._signal(call, source)
            case _:
                pass
        return ()

    def _tool_change(self, call: c.UseToolLengthOffset, source: mv.Source) -> mv.ToolChange:
        x, y, z, a, b, cc = self._mm_axes(call.offset)
        if a or b or cc:
            raise GcodeUnsupportedError("tool offsets in A, B, C are not supported", "Use X, Y and Z (along the tool).")
        return mv.ToolChange(z, (x, y), source)

    def _change_tool(self, call: c.ChangeTool, source: mv.Source) -> tuple[ResolvedMove, ...]:
        if call.tool == self._tool:
            return ()
        self._tool = call.tool
        text = f"insert tool {call.tool}" if call.tool else "remove the tool"
        return (mv.Message(text, source), mv.Pause(mv.PauseKind.PROGRAM, source))

    def _signal(self, call: c.SignalCall, source: mv.Source) -> tuple[ResolvedMove, ...]:
        signal = call.signal
        if signal in (c.Signal.PROGRAM_END, c.Signal.FINISH):
            return (mv.ProgramEnd(source),)
        if signal is c.Signal.PALLET_SHUTTLE:
            self._exchange = True
            return ()
        pause = _PAUSES.get(signal)
        if pause is not None:
            if self._exchange:
                self._exchange = False
                pause = mv.PauseKind.EXCHANGE
            return (mv.Pause(pause, source),)
        output = self.options.outputs.get(signal)
        if output is not None:
            return (mv.OutputChange(output[0], output[1], False, source),)
        code = _NEED_OUTPUT.get(signal)
        if code is not None:
            raise GcodeUnsupportedError(
                f"{code} has no output configured", f"Configure an output for {code}, or use M64 and M65."
            )
        if signal in _OVERRIDES and self.options.on_warning is not None:
            self.options.on_warning(f"no effect: {_OVERRIDES[signal]}", call.at)
        if signal is c.Signal.LOG_CLOSE:
            self._log(call)
        return ()

    def _log(self, call: c.CanonCall) -> None:
        if self.options.on_log is not None:
            self.options.on_log(call)
        elif self.options.on_warning is not None:
            self.options.on_warning("log and print comments go nowhere here", call.at)


def _user_move(call: c.UserMCode, source: mv.Source) -> ResolvedMove:
    if call.kind is c.UserMKind.HAND:
        return mv.HandMove(call.number == 101, source)
    if call.kind is c.UserMKind.JOINT and call.p is not None and call.q is not None:
        return mv.JointMove(round(call.p) - 1, call.q, call.number == 111, source)
    return ExternalAction(call.number, call.p, call.q, source)


def resolve(
    calls: Iterable[c.CanonCall], options: ResolveOptions | None = None, *, resolver: Resolver | None = None
) -> Iterator[ResolvedMove]:
    """Moves of a stream of calls, lazily. Raises GcodeError; what came before it has been yielded.

    `resolver`: one made with the same options, for whoever has to tell it positions.
    """
    resolver = resolver or Resolver(options)
    most = resolver.options.max_silent_heartbeats
    silent = 0
    for call in calls:
        if isinstance(call, c.Heartbeat):
            silent += 1
            if silent > most:
                error = GcodeLimitError(
                    f"no move within {silent * call.blocks} blocks", "The program seems to loop for ever."
                )
                error.location = call.at
                raise error
            if resolver.options.tells_silence:
                yield StillReading(call.blocks, source_of(call.at))
            continue
        silent = 0
        yield from resolver.feed(call)

"""What a program asks for, read from its canonical calls by the judge's own arithmetic.

The interpreter gives canonical calls (that is tested against the peer elsewhere); units, work offsets, rotation, tool,
arcs, splines, feeds and joints are worked out here, without `resolve`, `rm501_host.moves` or the planner:

    x y (program frame) = Rot(rotation) (p + g92) + g5x        other axes: p + g92 + g5x

A `Way` is one move with its exact geometry over t in [0, 1]; a `Wait` is a stop with an event or a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, cos, hypot, pi, radians, sin
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline

from rm501_host.config import Config
from rm501_host.gcode import FileLines, Interpreter, Settings, canon

from .judge_arm import Array, JudgeArm, angle_between, rotation_of_rpy

PLANES = {canon.Plane.XY: (0, 1, 2), canon.Plane.XZ: (2, 0, 1), canon.Plane.YZ: (1, 2, 0)}
NOTHING = 1e-7
"""mm or deg below which a move is none."""


class UnreachableTarget(Exception):  # noqa: N818  # a judgement, not a failure
    """The judge finds no way to the target of a line (on the branch of the arm, for a path of the tool)."""


@dataclass(frozen=True, eq=False)
class Way:
    """A move: `at(t)` gives x, y, z, pitch, roll (n, 5) in the base frame, or joints for `is_joint`.

    `speed_mm_s`, `turn_deg_s`: what the feed allows the tool centre point, and pitch and roll where it stands still.
    `blend_mm` None: exact path. `line_ends`: both ends where it is straight in x, y, z. `rotation`: XYZABC's tool
    orientation at t. `length`: mm of x, y, z, or deg where only angles move. `parts`: in how many it is free of loops.
    """

    line: int
    is_joint: bool
    arm: JudgeArm
    at: Callable[[Array], Array]
    length: float
    start_deg: Array
    end_deg: Array
    blend_mm: float | None
    stops: bool
    speed_mm_s: float = np.inf
    turn_deg_s: float = np.inf
    fewest_s: float = 0.0
    is_straight: bool = False
    parts: int = 2
    rotation: Callable[[float], Array] | None = None


@dataclass(frozen=True)
class Wait:
    """Rest of at least `seconds`; `event`: ("hand", pulses) or ("output", mask, levels), `at_motion`: M62, M63."""

    line: int
    arm: JudgeArm
    seconds: float
    event: tuple[str, int, int] | None = None
    at_motion: bool = False


Item = Way | Wait


def read_program(config: Config, program: Path, start_deg: Array) -> list[Item]:
    """Everything a program asks for in order, from joints `start_deg` (5,). Raises UnreachableTarget, GcodeError."""
    source = FileLines.open(program)
    try:
        interpreter = Interpreter(source, Settings(subroutine_path=(program.resolve().parent,)))
        reader = _Reader(config, interpreter, np.array(start_deg, dtype=np.float64))
        for call in interpreter.calls():
            reader.take(call)
            if isinstance(call, canon.SignalCall) and call.signal in (canon.Signal.PROGRAM_END, canon.Signal.FINISH):
                break
        return reader.items
    finally:
        source.close()


class _Reader:
    def __init__(self, config: Config, interpreter: Interpreter, start_deg: Array) -> None:
        self.items: list[Item] = []
        self._config = config
        self._interpreter = interpreter
        self._arm = self._bare = JudgeArm.of(config)
        self._weights = 1.0 / np.array([j.max_velocity_deg_s for j in config.joints.ordered])
        self._q = start_deg
        self._mm = 1.0
        self._g5x, self._g92, self._turn = np.zeros(6), np.zeros(6), 0.0
        self._plane = canon.Plane.XY
        self._rate, self._inverse = 0.0, None
        self._mode, self._tolerance, self._merge = canon.MotionMode.EXACT_PATH, 0.0, 0.0
        self._here = np.zeros(6)
        self._told_position()

    def _told_position(self) -> None:
        position = self._arm.program_position(self._q)
        self._interpreter.set_position(position)
        self._here = np.array(position)

    def _scaled(self, axes: tuple[float, ...]) -> Array:
        return np.array(axes) * np.array([self._mm] * 3 + [1.0] * 3)

    def _frame(self, p: Array) -> Array:
        """Program frame (6,), mm and deg, of canonical numbers in mm and deg."""
        out = p + self._g92 + self._g5x
        c, s = cos(radians(self._turn)), sin(radians(self._turn))
        x, y = p[:2] + self._g92[:2]
        out[:2] = np.array((c * x - s * y, s * x + c * y)) + self._g5x[:2]
        return np.asarray(out)

    def _numbers(self, target: Array) -> Array:
        """The inverse of `_frame`."""
        out = target - self._g92 - self._g5x
        c, s = cos(radians(self._turn)), sin(radians(self._turn))
        x, y = target[:2] - self._g5x[:2]
        out[:2] = np.array((c * x + s * y, -s * x + c * y)) - self._g92[:2]
        return np.asarray(out)

    def take(self, call: canon.CanonCall) -> None:
        match call:
            case canon.UseLengthUnits():
                self._mm = call.units.mm
            case canon.SetG5xOffset():
                self._g5x = self._scaled(call.offset)
            case canon.SetG92Offset():
                self._g92 = self._scaled(call.offset)
            case canon.SetXyRotation():
                self._turn = call.angle_deg
            case canon.SelectPlane():
                self._plane = call.plane
            case canon.SetFeedRate():
                self._rate, self._inverse = call.rate, call.inverse_time
            case canon.SetMotionControlMode():
                self._mode, self._tolerance = call.mode, call.tolerance * self._mm
            case canon.UseToolLengthOffset():
                x, y, z, *_ = self._scaled(call.offset)
                self._arm = self._bare.with_tool(float(z), (float(x), float(y)))
                self._told_position()
            case canon.StraightTraverse():
                self._traverse(self._frame(self._scaled(call.target)), call.at.line)
            case canon.StraightFeed():
                self._straight(self._frame(self._scaled(call.target)), call.at.line)
            case canon.ArcFeed():
                self._arc(call)
            case canon.NurbsFeed():
                self._spline(call)
            case canon.UserMCode() if call.kind is canon.UserMKind.JOINT:
                assert call.p is not None and call.q is not None
                end = self._q.copy()
                joint = round(call.p) - 1
                end[joint] = call.q + (end[joint] if call.number == 111 else 0.0)
                if not self._bare.low[joint] - 1e-9 <= end[joint] <= self._bare.high[joint] + 1e-9:
                    raise UnreachableTarget(f"line {call.at.line}: joint {joint + 1} at {end[joint]}")
                self._joint_line(end, call.at.line)
                self._told_position()
            case _:
                self._wait(call)

    def _wait(self, call: canon.CanonCall) -> None:
        match call:
            case canon.CanonDwell():
                self.items.append(Wait(call.at.line, self._arm, call.seconds))
            case canon.UserMCode() if call.kind is canon.UserMKind.HAND:
                hand = self._config.hand
                pulses = hand.stroke_pulses if call.number == 101 else -hand.stroke_pulses
                seconds = hand.stroke_pulses / hand.pulse_rate_steps_s + hand.settle_s
                self.items.append(Wait(call.at.line, self._arm, seconds, ("hand", pulses, 0)))
            case canon.SetOutputBit():
                mask = 1 << call.output
                event = ("output", mask, mask if call.on else 0)
                self.items.append(Wait(call.at.line, self._arm, 0.0, event, call.synchronised))
            case _:
                pass

    # -- moves

    def _blend(self) -> float | None:
        return self._tolerance if self._mode is canon.MotionMode.CONTINUOUS else None

    def _add_way(self, way: Way) -> None:
        if way.length > 0.0:
            self.items.append(way)
        self._q = way.end_deg

    def _goal(self, target: Array, line: int, *, branch: bool) -> Array:
        ways = self._arm.goals(tuple(target.tolist()))
        if branch:
            ways = [q for q in ways if self._same_branch(q)]
        if not ways:
            raise UnreachableTarget(f"line {line}: {target}")
        return min(ways, key=lambda q: float((((q - self._q) * self._weights) ** 2).sum()))

    def _same_branch(self, q: Array) -> bool:
        """Elbow bent the same way, tool on the same side of the waist axis (undecided where it is on the border)."""
        bend = np.sin(np.radians((q[2], self._q[2])))
        sides = [float(self._side(x)) for x in (q, self._q)]
        return not (
            (bend[0] * bend[1] < 0.0 and np.abs(bend).min() > 1e-6)
            or (sides[0] * sides[1] < 0.0 and min(map(abs, sides)) > 1e-6)
        )

    def _side(self, q: Array) -> float:
        unturned = q.copy()
        unturned[0] = 0.0
        return float(self._arm.places(unturned[None])[0, 0])

    def _joint_line(self, end: Array, line: int) -> None:
        start, step = self._q, end - self._q
        self._add_way(
            Way(
                line,
                True,
                self._arm,
                lambda t: start + step * t[:, None],
                float(np.linalg.norm(step)),
                start,
                end,
                self._blend(),
                self._mode is canon.MotionMode.EXACT_STOP,
            )
        )

    def _traverse(self, target: Array, line: int) -> None:
        if self._config.planner.linear_rapids:
            self._straight(target, line, rapid=True)
        else:
            self._joint_line(self._goal(target, line, branch=False), line)
            self._here = target

    def _straight(self, target: Array, line: int, *, rapid: bool = False) -> None:
        here, end_deg = self._arm.task(self._q[None])[0], self._goal(target, line, branch=True)
        end = self._task_of(target, end_deg)
        step = end - here
        length = float(np.linalg.norm(step[:3]))
        angles = float(np.linalg.norm(step[3:]))
        at = lambda t: here + step * t[:, None]  # noqa: E731
        feed = {} if rapid else self._feed(length, angles)
        self._path(
            at, length if length >= NOTHING else max(length, angles), target, end_deg, line, feed, is_straight=True
        )

    def _task_of(self, target: Array, end_deg: Array) -> Array:
        """x, y, z as asked; pitch and roll as asked, or as the joints have them (XYZABC)."""
        xyz = self._arm.base_point(target[:3])
        angles = self._arm.task(end_deg[None])[0, 3:] if self._arm.has_rpy else target[3:5]
        return np.concatenate((xyz, angles))

    def _path(
        self,
        at: Callable[[Array], Array],
        length: float,
        target: Array,
        end_deg: Array,
        line: int,
        feed: dict[str, float],
        *,
        is_straight: bool = False,
        parts: int = 2,
    ) -> None:
        rotation = _turning(self._arm, self._here, target) if self._arm.has_rpy else None
        self._add_way(
            Way(
                line,
                False,
                self._arm,
                at,
                length,
                self._q,
                end_deg,
                self._blend(),
                self._mode is canon.MotionMode.EXACT_STOP,
                **feed,  # type: ignore[arg-type]
                is_straight=is_straight,
                parts=parts,
                rotation=rotation,
            )
        )
        self._here = target

    def _feed(self, length_mm: float, angle_deg: float, *, curved: bool = False) -> dict[str, float]:
        moves_tool = length_mm >= NOTHING
        if self._inverse is not None:
            seconds = 60.0 / self._inverse
            length = length_mm if moves_tool else angle_deg
            name = "speed_mm_s" if moves_tool else "turn_deg_s"
            return {name: length / seconds, "fewest_s": seconds}
        if moves_tool or curved:
            return {"speed_mm_s": self._rate * self._mm / 60.0}
        return {"turn_deg_s": self._rate / 60.0}

    def _arc(self, call: canon.ArcFeed) -> None:
        first, second, normal = PLANES[self._plane]
        start = self._numbers(self._here)
        end, centre = start.copy(), start.copy()
        end[first], end[second], end[normal] = np.array((*call.end, call.axis_end)) * self._mm
        end[3:] = call.abc
        centre[first], centre[second] = np.array(call.centre) * self._mm
        u, v = start[first] - centre[first], start[second] - centre[second]
        u1, v1 = end[first] - centre[first], end[second] - centre[second]
        angle = (atan2(v1, u1) - atan2(v, u)) % (2.0 * pi)
        if angle < 1e-9 or 2.0 * pi - angle < 1e-9:
            angle = 0.0
        if call.turns > 0:
            angle = (angle or 2.0 * pi) + 2.0 * pi * (call.turns - 1)
        else:
            angle = (angle - 2.0 * pi) + 2.0 * pi * (call.turns + 1)
        radius, radius1 = hypot(u, v), hypot(u1, v1)
        phase = atan2(v, u)
        target = self._frame(end)
        end_deg = self._goal(target, call.at.line, branch=True)
        task_start, task_end = self._arm.task(self._q[None])[0], self._task_of(target, end_deg)

        def at(t: Array) -> Array:
            points = np.repeat(start[None], len(t), axis=0)
            size = radius + (radius1 - radius) * t
            points[:, first] = centre[first] + size * np.cos(phase + angle * t)
            points[:, second] = centre[second] + size * np.sin(phase + angle * t)
            points[:, normal] = start[normal] + (end[normal] - start[normal]) * t
            moved = self._frame_at(points, offsets)
            angles = task_start[3:] + (task_end - task_start)[3:] * t[:, None]
            return np.concatenate((arm.base_point(moved), angles), axis=1)

        arm, offsets = self._arm, (self._g5x, self._g92, self._turn)
        length = hypot(0.5 * (radius + radius1) * angle, end[normal] - start[normal])
        feed = self._feed(length, 0.0, curved=True)
        self._path(at, length, target, end_deg, call.at.line, feed)

    @staticmethod
    def _frame_at(p: Array, offsets: tuple[Array, Array, float]) -> Array:
        g5x, g92, turn = offsets
        c, s = cos(radians(turn)), sin(radians(turn))
        x, y, z = (p[:, :3] + g92[:3]).T
        return np.stack((c * x - s * y, s * x + c * y, z), axis=1) + g5x[:3]

    def _spline(self, call: canon.NurbsFeed) -> None:
        start = self._numbers(self._here)
        frames = []
        for x, y in call.control_points:
            point = start.copy()
            point[:2] = x * self._mm, y * self._mm
            frames.append(self._frame(point))
        target = frames[-1]
        poles = self._arm.base_point(np.array(frames)[:, :3])
        weights = np.array(call.weights)[:, None]
        curve = BSpline(np.array(call.knots), np.concatenate((poles * weights, weights), axis=1), call.degree)
        low, high = call.knots[call.degree], call.knots[len(poles)]
        end_deg = self._goal(target, call.at.line, branch=True)
        angles = self._arm.task(self._q[None])[0, 3:]

        def at(t: Array) -> Array:
            found = curve(low + (high - low) * np.clip(t, 0.0, 1.0))
            return np.concatenate((found[:, :3] / found[:, 3:], np.repeat(angles[None], len(t), axis=0)), axis=1)

        points = at(np.linspace(0.0, 1.0, 2001))
        length = float(np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1).sum())
        self._path(at, length, target, end_deg, call.at.line, self._feed(length, 0.0, curved=True), parts=12)


def _turning(arm: JudgeArm, first: Array, last: Array) -> Callable[[float], Array]:
    """The tool's orientation in the base frame at a share of the way: about one fixed axis (thesis 4.2)."""
    from scipy.spatial.transform import Rotation

    one, two = (arm.frame @ rotation_of_rpy(*at[3:6]) for at in (first, last))
    vector = Rotation.from_matrix(one.T @ two).as_rotvec()
    assert angle_between(one @ Rotation.from_rotvec(vector).as_matrix(), two) < 1e-6
    return lambda t: np.asarray(one @ Rotation.from_rotvec(vector * t).as_matrix())

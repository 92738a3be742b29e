"""From moves to path elements: the program's geometry in the base frame, with its branch, feed and source.

A linear move, an arc or a spline is a path of the tool in task space, on the branch that the arm is on; pitch and roll
run along with it. A rapid (unless `[planner] linear_rapids`), M110 and M111 are lines in joint space.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot, inf, radians, sqrt

import numpy as np

from rm501_host.kinematics import Arm, Branch, IkResult
from rm501_host.kinematics import OrientationError as KinematicsOrientationError
from rm501_host.moves import ArcMove, Feed, FeedMode, JointMove, LinearMove, RapidMove, Source, SplineMove, Target

from .elements import Array, Element, Space, arc, line
from .errors import JointLimitError, OrientationError, PlanError, UnreachableError
from .orientation import OrientedCurve, check_residual
from .splines import SplineCurve

SHORTEST = 1e-7
"""Below this many mm or deg a move is none."""
MOST_TURN_DEG_MM = 1e3
"""A line along which the tool turns more than this is measured in deg."""
_WAIST, _ROLL = 0, 4


def task_values(arm: Arm, q_deg: Array) -> Array:
    """x, y, z (mm), pitch and roll (deg) of joints (5,), as (5,)."""
    pose = arm.fk(q_deg)
    return np.array([*pose.xyz_mm, pose.pitch_deg, pose.roll_deg])


class PathBuilder:
    """Follows the moves and turns each into one element; knows where the path has got to.

    `q_deg` (5,): joints at the end of the path so far; `branch`: the arm's branch there; `task` (5,): x, y, z,
    pitch, roll there; `rpy_deg`: the tool's roll, pitch, yaw there in the program frame (XYZABC). `speed_scale`
    multiplies the programmed feeds.

    Each move raises PlanError where its end cannot be reached. Without `checks_ends` the ends of moves wait to be
    checked, many at once: `refused_end`, `check_ends`, or where the joints are needed.
    """

    def __init__(
        self,
        arm: Arm,
        start_deg: Array,
        *,
        linear_rapids: bool,
        speed_scale: float = 1.0,
        checks_ends: bool = True,
    ) -> None:
        self.arm = arm
        self.linear_rapids = linear_rapids
        self._speed_scale = speed_scale
        self._checks_ends = checks_ends
        self._q_deg: Array = np.array(start_deg, dtype=np.float64)
        self._unchecked: list[tuple[Element, Array]] = []
        self._refused: tuple[Element, PlanError] | None = None
        self.stand_at(self._q_deg)

    @property
    def q_deg(self) -> Array:
        """Joints (5,) at the end; raises PlanError where the end of a move could not be reached."""
        self.check_ends()
        return self._q_deg

    def check_ends(self) -> None:
        """Raise PlanError for the first move whose end cannot be reached, of those not checked yet."""
        self._check_waiting()
        if self._refused is not None:
            raise self._refused[1]

    def refused_end(self) -> tuple[Element, PlanError] | None:
        """The first element whose end cannot be reached, and the error for it; told once."""
        self._check_waiting()
        refused, self._refused = self._refused, None
        return refused

    def _check_waiting(self) -> None:
        waiting, self._unchecked = self._unchecked, []
        if not waiting:
            return
        ends = np.array([end for _, end in waiting])
        q_deg, ok = self.arm.ik_batch(ends[:, :3], ends[:, 3], ends[:, 4], self.branch, float(self._q_deg[0]))
        good = len(ok) if ok.all() else int(np.argmin(ok))
        if good:
            self._q_deg = q_deg[good - 1]
        if good < len(ok):
            element, end = waiting[good]
            self._refused = element, self._end_error(end, element)

    def use_tool(self, length_mm: float, offset_mm: tuple[float, float]) -> None:
        """From here on the tool centre point is another one; the joints stay."""
        self.arm = self.arm.with_tool(length_mm, offset_mm)
        self.stand_at(self.q_deg)

    def stand_at(self, q_deg: Array) -> None:
        """The path goes on from these joints."""
        self._q_deg = np.array(q_deg, dtype=np.float64)
        self.branch: Branch = self.arm.branch_of(self._q_deg)
        self.task = task_values(self.arm, self._q_deg)
        self.rpy_deg = self._orientation()
        self._angles: tuple[float, float] | None = None
        self._angles_taken = (0.0, 0.0)

    def go_on(self, q_deg: Array, task: Array, rpy_deg: tuple[float, float, float] | None = None) -> None:
        """The path goes on from the end of moves that somebody else has followed on this branch: joints (5,), task
        values (5,) and, for XYZABC, the orientation that the program gave last.
        """
        self._q_deg, self.task, self._angles = q_deg, task, None
        if rpy_deg is not None:
            self.rpy_deg = rpy_deg

    def _orientation(self) -> tuple[float, float, float]:
        target = self.arm.program_from_joints(self._q_deg)
        return (target[3], target[4], target[5])

    def rapid(self, move: RapidMove) -> Element | None:
        """G0; None when it does not move."""
        if self.linear_rapids:
            return self._line(move.target, move.source, None)
        result = self._solve(move.target, move.source)
        assert result.best is not None
        return self._joint_line(np.array(result.best.q_deg), move.source)

    def joint(self, move: JointMove) -> Element | None:
        """M110, M111; None when it does not move. Raises JointLimitError."""
        target = self.q_deg.copy()
        target[move.joint] = move.angle_deg + (target[move.joint] if move.relative else 0.0)
        low, high = self.arm.limits_deg
        beyond = max(low[move.joint] - target[move.joint], target[move.joint] - high[move.joint])
        if beyond > 1e-9:
            raise JointLimitError(
                f"joint {move.joint + 1} would be at {target[move.joint]:g} deg, {beyond:.4g} deg beyond its range",
                source=move.source,
                amount=float(beyond),
                q_deg=tuple(self.q_deg.tolist()),
                remedy=f"stay within {low[move.joint]:g} to {high[move.joint]:g} deg",
            )
        return self._joint_line(target, move.source)

    def linear(self, move: LinearMove) -> Element | None:
        """G1; None when it does not move."""
        return self._line(move.target, move.source, move.feed)

    def arc(self, move: ArcMove) -> Element | None:
        """G2, G3; None when it does not move."""
        end = self._task_of(move.target, move.source)
        frame = self.arm.frame
        centre = frame.base_from_program(np.array(move.centre_mm))
        axis = frame.rotation @ np.array(move.axis)
        if abs(move.angle_deg) < SHORTEST:
            return None
        element = arc(self.task, end, centre, axis, radians(move.angle_deg), move.source)
        return self._with_feed(self._onto(element, end, move.target), move.feed)

    def spline(self, move: SplineMove) -> Element | None:
        """G5, G5.1, G5.2 as one element, corners inside or not; None when it does not move."""
        curve = self._spline_curve(move)
        return None if curve is None else self._along_spline(curve, curve.length_mm, move)

    def spline_parts(self, move: SplineMove) -> list[Element]:
        """G5, G5.1, G5.2 as elements that are smooth inside; none when it does not move."""
        curve = self._spline_curve(move)
        if curve is None:
            return []
        parts = [part for part in curve.smooth_parts() if part.length_mm >= SHORTEST]
        return [self._along_spline(part, curve.length_mm, move) for part in parts]

    def _along_spline(self, curve: SplineCurve, whole_mm: float, move: SplineMove) -> Element:
        end = curve.evaluate(np.array([curve.length_mm]))[0][0]
        element = Element(Space.TASK, curve.length_mm, np.zeros((4, 5)), move.source, curve=curve)
        element = self._onto(element, end, move.target)
        if move.feed.mode is FeedMode.INVERSE_TIME:
            scaled = move.feed.value / 60.0 * self._speed_scale
            return replace(self._with_feed(element, move.feed), rate=whole_mm * scaled)
        return self._with_feed(element, move.feed)

    def _spline_curve(self, move: SplineMove) -> SplineCurve | None:
        if len(move.control_points_mm) < 2:
            return None
        points = self.arm.frame.base_from_program(np.array(move.control_points_mm, dtype=np.float64))
        angles = (float(self.task[3]), float(self.task[4]))
        try:
            curve = SplineCurve(points, move.weights, move.knots, move.degree, angles)
        except ValueError as error:
            raise PlanError(
                str(error), source=move.source, remedy="give the points, weights and knots of a curve"
            ) from error
        if curve.length_mm < SHORTEST:
            return None
        apart = float(np.linalg.norm(points[0] - self.task[:3]))
        if apart > 1e-6:
            raise PlanError(f"the curve starts {apart:.4g} mm away from where the tool is", source=move.source)
        return curve

    def _line(self, target: Target, source: Source, feed: Feed | None) -> Element | None:
        end = self._task_of(target, source)
        dx, dy, dz, pitch, roll = (end - self.task).tolist()
        length, turn = sqrt(dx * dx + dy * dy + dz * dz), hypot(pitch, roll)
        if length < SHORTEST:
            end[:3] = self.task[:3]
            if turn < SHORTEST:
                return None
        is_travel = max(abs(dx), abs(dy), abs(dz)) > SHORTEST
        # next to no way for a large turn: deg are the better measure of how far it has come, F stays mm/min
        if turn > MOST_TURN_DEG_MM * length:
            length = turn
        feed_mm_s, rate = self._limits(feed, source, length, is_travel=is_travel)
        element = line(Space.TASK, self.task, end, length, source, feed_mm_s=feed_mm_s, rate=rate, branch=self.branch)
        return self._onto(element, end, target)

    def _onto(self, element: Element, end: Array, target: Target) -> Element:
        """The element on the current branch, with the orientation on the way; the path now ends at `end`."""
        if self.arm.frame.has_rpy:
            rpy = (target[3], target[4], target[5])
            curve = OrientedCurve(self.arm, self.branch, element, self.rpy_deg, rpy, self.task, float(self.q_deg[0]))
            check_residual(curve, self.arm.frame.tolerance_deg, element.source)
            element = replace(element, curve=curve, omega=0.0)
            end = np.array([*end[:3], *curve.end_angles_deg])
            self.rpy_deg = rpy
        if element.branch is not self.branch:
            element = replace(element, branch=self.branch)
        if self._checks_ends:
            q_deg, ok = self.arm.ik_batch(end[None, :3], end[3:4], end[4:5], self.branch, float(self._q_deg[0]))
            if not ok[0]:
                raise self._end_error(end, element)
            self._q_deg = q_deg[0]
        else:
            self._unchecked.append((element, end))
        self.task = end
        return element

    def _end_error(self, end: Array, element: Element) -> PlanError:
        result = self.arm.ik(end[:3], float(end[3]), float(end[4]), self._q_deg)
        where = f"X{end[0]:.3f} Y{end[1]:.3f} Z{end[2]:.3f} (base frame), pitch {end[3]:.2f} deg"
        amount = result.shortfalls[0].amount if result.shortfalls else None
        common = {"source": element.source, "place_mm": element.length, "q_deg": tuple(self._q_deg.tolist())}
        if result.best is not None:
            return UnreachableError(
                f"{where} can only be reached {_way(result.best.branch, self.branch)}: on another branch of the arm "
                "than the one it starts on, and a move of the tool keeps its branch",
                remedy="go there with a joint move (G0), which may change it",
                **common,  # type: ignore[arg-type]  # keyword arguments of PlanError, gathered
            )
        kind = JointLimitError if result.solutions else UnreachableError
        return kind(
            f"{where} cannot be reached: {result.reason}",
            amount=amount,
            remedy=self._remedy(result),
            **common,  # type: ignore[arg-type]  # keyword arguments of PlanError, gathered
        )

    def _joint_line(self, target_deg: Array, source: Source) -> Element | None:
        element = joint_line(self.q_deg, target_deg, source)
        self.stand_at(target_deg)
        return element

    def _solve(self, target: Target, source: Source) -> IkResult:
        try:
            result = self.arm.joints_from_program(target, self.q_deg)
        except KinematicsOrientationError as error:
            raise OrientationError(str(error), source=source, amount=error.residual_deg) from error
        if result.best is None:
            kind = JointLimitError if result.solutions else UnreachableError
            x, y, z = target[:3]
            raise kind(
                f"X{x:g} Y{y:g} Z{z:g} cannot be reached: {result.reason}",
                source=source,
                q_deg=tuple(self.q_deg.tolist()),
                amount=result.shortfalls[0].amount if result.shortfalls else None,
                remedy=self._remedy(result),
            )
        return result

    def _remedy(self, result: IkResult) -> str:
        """What to do about a pose that cannot be reached."""
        low, high = self.arm.limits_deg
        joints = {shortfall.joint for shortfall in result.shortfalls}
        if _WAIST in joints:
            return f"keep within the waist's range, {low[_WAIST]:g} to {high[_WAIST]:g} deg"
        if _ROLL in joints:
            return f"turn the tool the other way: the roll's range is {low[_ROLL]:g} to {high[_ROLL]:g} deg"
        return "bring the point nearer or tilt the tool"

    def _task_of(self, target: Target, source: Source) -> Array:
        """x, y, z, pitch, roll (5,) in the base frame of a target in the program frame."""
        a, b = target[3], target[4]
        if self._angles == (a, b) and self._angles_taken == (float(self.task[3]), float(self.task[4])):
            # literal pitch and roll that stay: so does the turn in which they are taken
            end = np.empty(5)
            end[:3] = self.arm.frame.base_from_program(np.array(target[:3]))
            end[3:] = self.task[3:]
            return end
        try:
            pose = self.arm.pose_from_program(target, self.q_deg)
        except KinematicsOrientationError as error:
            raise OrientationError(str(error), source=source, amount=error.residual_deg) from error
        if not self.arm.frame.has_rpy:
            # a move that is refused in the end does not get there: then these are not the task's
            self._angles, self._angles_taken = (a, b), (float(pose.pitch_deg), float(pose.roll_deg))
        return np.array([*pose.xyz_mm, pose.pitch_deg, pose.roll_deg])

    def _with_feed(self, element: Element, feed: Feed) -> Element:
        moves_tool = isinstance(element.curve, SplineCurve) or element.cosine.any()
        is_travel = moves_tool or np.abs(element.coefficients[1:, :3]).max() * element.length > SHORTEST
        feed_mm_s, rate = self._limits(feed, element.source, element.length, is_travel=bool(is_travel))
        return replace(element, feed_mm_s=feed_mm_s, rate=rate)

    def _limits(self, feed: Feed | None, source: Source, length: float, *, is_travel: bool) -> tuple[float, float]:
        """What a programmed feed (RS274 G93, G94) limits |dp/dt| and ds/dt to; nothing without one.

        mm/min along x, y, z; deg/min along A, B where x, y, z do not move; in inverse time the whole move takes
        1/F min. Raises PlanError for a feed of 0.
        """
        if feed is None:
            return inf, inf
        if not feed.value > 0.0:
            raise PlanError("a feed move without a feed", source=source, remedy="set F above 0")
        value = feed.value / 60.0 * self._speed_scale
        if feed.mode is FeedMode.INVERSE_TIME:
            return inf, length * value
        return (value, inf) if is_travel else (inf, value)


def _way(wanted: Branch, current: Branch) -> str:
    """How the arm would stand there that does not stand like that now."""
    if wanted.is_front is not current.is_front:
        return f"with the tool {'in front of' if wanted.is_front else 'behind'} the waist axis"
    return f"with the elbow {'up' if wanted.is_elbow_up else 'down'}"


def joint_line(start_deg: Array, target_deg: Array, source: Source) -> Element | None:
    """The line in joint space; s is the Euclidean distance in deg. None when it does not move."""
    length = float(np.linalg.norm(target_deg - start_deg))
    if length < SHORTEST:
        return None
    return line(Space.JOINT, start_deg, target_deg, length, source)

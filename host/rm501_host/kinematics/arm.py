"""`Arm`: the kinematics of one configured arm, everything by name in one place.

Positions in mm, angles in deg, base frame (DH, z up) unless a name says program. Immutable and free of state: an
answer depends on the arguments alone.
"""

from __future__ import annotations

import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics import batch, forward, inverse, jacobian, program_frame, rates, rotations, singularities
from rm501_host.kinematics.errors import KinematicsError, OrientationError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.inverse import InverseSolver
from rm501_host.kinematics.motors import MotorSpace
from rm501_host.kinematics.program_frame import ProgramFrame
from rm501_host.kinematics.results import (
    BoolArray,
    Branch,
    FloatArray,
    IkResult,
    IkSolution,
    IkStatus,
    Joints,
    JointsLike,
    Pose,
    Target6,
    VectorLike,
)
from rm501_host.kinematics.singularities import Ellipsoid, Singularity


class Arm:
    """The kinematics of one arm with one tool.

    `geometry`, `motors` and `frame` hold what it was built from. `with_tool` gives another arm.
    """

    __slots__ = ("_base_geometry", "_solver", "frame", "geometry", "motors")

    def __init__(
        self,
        geometry: ArmGeometry,
        motors: MotorSpace,
        frame: ProgramFrame,
        *,
        base_geometry: ArmGeometry | None = None,
    ) -> None:
        self.geometry = geometry
        self.motors = motors
        self.frame = frame
        self._base_geometry = geometry if base_geometry is None else base_geometry
        self._solver = InverseSolver(geometry)

    @classmethod
    def from_config(cls, config: Config) -> Arm:
        """The arm of a configuration, with the configured tool.

        Raises GeometryError naming the key where numbers describe no arm.
        """
        return cls(ArmGeometry.from_config(config), MotorSpace.from_config(config), ProgramFrame.from_config(config))

    def with_tool(self, length_mm: float = 0.0, offset_mm: tuple[float, float] = (0.0, 0.0)) -> Arm:
        """This arm with a tool length of the program (G43) on top of the configured tool.

        `length_mm` acts along the tool, `offset_mm` across it (tool X, Y). Not cumulative: `with_tool()` is the
        configured tool again (G49).
        """
        geometry = self._base_geometry.with_tool(length_mm, offset_mm)
        return Arm(geometry, self.motors, self.frame, base_geometry=self._base_geometry)

    @property
    def home_deg(self) -> Joints:
        """The home position, (5,) deg; the seed where none is given."""
        return self.geometry.home_deg

    @property
    def limits_deg(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest joint angles, (5,) and (5,) deg."""
        return np.array(self.geometry.min_deg), np.array(self.geometry.max_deg)

    # -- forward ----------------------------------------------------------------------------------------------------

    def fk(self, q_deg: JointsLike) -> Pose:
        """The tool's pose for joints (5,) deg (thesis 2.1). Raises KinematicsError for what is not five numbers.

        >>> pose = arm.fk((0, 0, 0, 90, 0))  # stretched out, tool level
        >>> pose.xyz_mm.round(9).tolist(), pose.pitch_deg
        ([465.0, 0.0, 230.0], 90.0)
        """
        return forward.pose(self.geometry, q_deg)

    def fk_batch(self, q_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3) mm and rotations (n, 3, 3) of the tool for joints (n, 5) deg.

        >>> positions, rotations = arm.fk_batch(np.zeros((4, 5)))
        >>> positions.shape, rotations.shape
        ((4, 3), (4, 3, 3))
        """
        return forward.positions_and_rotations(self.geometry, q_deg)

    def frames(self, q_deg: JointsLike) -> FloatArray:
        """Frames 0..5 and the tool frame, (7, 4, 4) in the base frame, lengths mm, as a product of DH matrices."""
        return forward.frames(self.geometry, q_deg)

    def branch_of(self, q_deg: JointsLike) -> Branch:
        """The branch that joints (5,) deg lie on: front where r >= 0, up where q3 <= 0 (mod 360).

        >>> arm.branch_of((0, 45, -90, 45, 0))
        <Branch.FRONT_UP: 0>
        """
        q = forward.joints_of(q_deg)
        up = (q[2] + 180.0) % 360.0 - 180.0 <= 0.0
        front = forward.radius_mm(self.geometry, q) >= 0.0
        return Branch((0 if front else 2) + (0 if up else 1))

    # -- inverse ----------------------------------------------------------------------------------------------------

    def ik(self, xyz_mm: VectorLike, pitch_deg: float, roll_deg: float, seed_deg: JointsLike | None = None) -> IkResult:
        """All joint angles that put the tip at xyz (3,) mm with that pitch (q234) and roll (q5) in deg.

        Pitch and roll are literal on every branch; q1 to q4 are turned by whole turns into their ranges where they
        can be, the roll never is: 190 is not -170. Solutions inside the limits come first, then the nearest to
        `seed_deg` (5,), the home position where it is None; distance as in `joint_distance`. The seed also gives
        the waist where the tip is on the waist axis. Raises KinematicsError for numbers that are not finite.
        Equation: thesis 2.2, corrected; see `rm501_host.kinematics.inverse`.

        >>> result = arm.ik((300, 0, 200), 0, 0)
        >>> [round(angle, 4) for angle in result.best.q_deg]
        [0.0, 39.427, -69.304, 29.877, 0.0]
        >>> arm.ik((600, 0, 200), 0, 0).reason
        'the wrist centre is 233.5 mm beyond the stretched arm (a2 + a3)'
        >>> str(arm.ik((-300, 0, 200), 0, 0).shortfalls[0])
        'waist would be at 180.0000 deg, 30 deg above its maximum 150'
        """
        x, y, z = xyz_mm.tolist() if isinstance(xyz_mm, np.ndarray) else xyz_mm
        seed = None if seed_deg is None else forward.joints_of(seed_deg)
        return self._solver.solve(float(x), float(y), float(z), float(pitch_deg), float(roll_deg), seed)

    def ik_batch(
        self,
        xyz_mm: FloatArray,
        pitch_deg: FloatArray | float,
        roll_deg: FloatArray | float,
        branch: Branch = Branch.FRONT_UP,
        waist_deg: FloatArray | float = 0.0,
    ) -> tuple[FloatArray, BoolArray]:
        """Joint angles (n, 5) deg on one branch for tips (n, 3) mm, pitch and roll (n,) or one number, deg.

        `ok` (n,) says reachable and inside the limits. A row that cannot be reached is NaN; one outside the limits
        has its angles and ok False. Along a path inside the limits no angle jumps. `waist_deg` is q1 where the tip
        is on the waist axis. Raises KinematicsError for other shapes.

        >>> q, ok = arm.ik_batch(np.array([[300, 0, 200], [600, 0, 200]]), 0.0, 0.0)
        >>> q.round(4).tolist()[0], ok.tolist()
        ([0.0, 39.427, -69.304, 29.877, 0.0], [True, False])
        """
        pitch, roll = np.asarray(pitch_deg, dtype=np.float64), np.asarray(roll_deg, dtype=np.float64)
        return batch.solve_rows(self.geometry, xyz_mm, pitch, roll, branch, waist_deg)

    def joint_distance(self, q_deg: JointsLike, other_deg: JointsLike) -> float:
        """sqrt(sum ((q_i - p_i) / vmax_i)^2) in s: how far apart two configurations (5,) deg are."""
        return inverse.joint_distance(self.geometry, forward.joints_of(q_deg), forward.joints_of(other_deg))

    # -- rates ------------------------------------------------------------------------------------------------------

    def jacobian(self, q_deg: JointsLike) -> FloatArray:
        """Geometric Jacobian (6, 5) at (5,) deg: linear mm/rad, angular rad/rad (thesis 3.1.1, corrected).

        >>> arm.jacobian((0, 0, 0, 90, 0))[:3].round(9).tolist()[2]  # what lifts the stretched arm
        [0.0, 465.0, 245.0, 95.0, -0.0]
        """
        return jacobian.geometric(self.geometry, q_deg)

    def jacobian_batch(self, q_deg: FloatArray) -> FloatArray:
        """Geometric Jacobians (n, 6, 5) at (n, 5) deg."""
        return jacobian.geometric_rows(self.geometry, q_deg)

    def task_jacobian(self, q_deg: JointsLike) -> FloatArray:
        """Task Jacobian (5, 5) at (5,) deg: rows x, y, z in mm/rad, pitch, roll in rad/rad.

        >>> arm.task_jacobian((0, 0, 0, 90, 0))[3].tolist()
        [0.0, 1.0, 1.0, 1.0, 0.0]
        """
        return jacobian.task(self.geometry, q_deg)

    def task_jacobian_batch(self, q_deg: FloatArray) -> FloatArray:
        """Task Jacobians (n, 5, 5) at (n, 5) deg."""
        return jacobian.task_rows(self.geometry, q_deg)

    def joint_rates_batch(self, q_deg: FloatArray, task_rates: FloatArray) -> FloatArray:
        """Joint rates (n, 5) deg/s for rates of x, y, z (mm/s), pitch, roll (deg/s), (n, 5), in closed form.

        Infinite or NaN at a singularity: s3 = 0 or r = 0.
        """
        return jacobian.joint_rates_of_task_rows(self.geometry, q_deg, task_rates)

    def jacobian_rate(self, q_deg: JointsLike, rates_deg_s: JointsLike) -> FloatArray:
        """dJ/dt (6, 5) at (5,) deg moving at (5,) deg/s: mm/rad/s and rad/rad/s."""
        return rates.jacobian_rate(self.geometry, q_deg, rates_deg_s)

    def task_bias_batch(self, q_deg: FloatArray, rates_deg_s: FloatArray) -> FloatArray:
        """J' q' (n, 5), mm/s2 and deg/s2: task acceleration at joint rates (n, 5) deg/s without joint acceleration.

        Joint accelerations of a path: `joint_rates_batch(q, task acceleration - bias)`.
        """
        return rates.task_bias_rows(self.geometry, q_deg, rates_deg_s)

    def rpy_jacobian(self, q_deg: JointsLike) -> FloatArray:
        """Analytical Jacobian (6, 5): rates of x, y, z (mm/rad) and the tool's roll, pitch, yaw, base frame.

        Raises KinematicsError in gimbal lock (thesis 3.1.2, corrected).
        """
        return rates.analytical_rpy(self.geometry, q_deg)

    def zxz_jacobian(self, q_deg: JointsLike) -> FloatArray:
        """Analytical Jacobian (6, 5) for zxz Euler angles; raises KinematicsError where the tool is vertical."""
        return rates.analytical_zxz(self.geometry, q_deg)

    # -- singularities ----------------------------------------------------------------------------------------------

    def manipulability(self, q_deg: JointsLike, length_mm: float = 1.0) -> float:
        """sqrt(det(J^T J)) at (5,) deg, linear rows divided by `length_mm` (1: mm and rad as they are).

        Closed form, see `singularities`. Raises KinematicsError for a length that is not above 0.

        >>> arm.manipulability((0, 40, 0, 50, 0)), round(arm.manipulability((0, 40, -60, 60, 0), 220), 4)
        (0.0, 1.0645)
        """
        return singularities.manipulability(self.geometry, q_deg, length_mm)

    def singularities(self, q_deg: JointsLike, margin: float = 0.05) -> tuple[Singularity, ...]:
        """The singularities within `margin` (of `measure`, 0..1) of (5,) deg, nearest first.

        >>> [(s.kind.value, round(s.distance, 6), s.unit) for s in arm.singularities((0, 40, -0.5, 50, 0))]
        [('elbow', 0.5, 'deg')]
        """
        return singularities.within(self.geometry, q_deg, margin)

    def ellipsoid(self, q_deg: JointsLike, length_mm: float | None = None) -> Ellipsoid:
        """Velocity ellipsoid, condition number and rank at (5,) deg; 1 rad weighs `length_mm` (None: a2)."""
        return singularities.ellipsoid(self.geometry, q_deg, self.geometry.a2_mm if length_mm is None else length_mm)

    # -- motors -----------------------------------------------------------------------------------------------------

    def motors_from_joints(self, q_deg: JointsLike) -> FloatArray:
        """Motor positions in steps, floating, waist, shoulder, elbow, right wrist, left wrist: (5,) or (n, 5) for
        joints of the same shape in deg; zero where q = 0.

        >>> arm.motors_from_joints((1, 1, 0, 0, 3)).round(5).tolist()
        [40.0, -40.0, 0.0, 79.99998, 79.99998]
        """
        return self.motors.steps_from_joints(np.asarray(q_deg, dtype=np.float64))

    def joints_from_motors(self, steps: JointsLike) -> FloatArray:
        """Joints in deg, (5,) or (n, 5), for motor positions in steps."""
        return self.motors.joints_from_steps(np.asarray(steps, dtype=np.float64))

    # -- program frame ----------------------------------------------------------------------------------------------

    def pose_from_program(self, target: Target6, seed_deg: JointsLike | None = None) -> Pose:
        """The pose (mm, deg, base frame) that X Y Z A B C ask for.

        XYZABC: of the two ways to hold the orientation, the one with the solution that `joints_from_program` puts
        first. Reachability is not judged here: ask `ik`, or `joints_from_program`. Raises OrientationError, with
        the residual angle, for an orientation that five joints cannot take there.
        """
        seed = self.home_deg if seed_deg is None else forward.joints_of(seed_deg)
        xyz, readings = self._readings(target, seed)
        result = self._solve_readings(target, xyz, readings, seed)
        if result.solutions:
            pose = self.fk(result.solutions[0].q_deg)
            return Pose(xyz, pose.pitch_deg, pose.roll_deg, pose.azimuth_deg, pose.rotation)
        waist, pitch, roll = readings[0]
        rotation = self.fk((waist, 0.0, 0.0, pitch, roll)).rotation
        return Pose(xyz, pitch, roll, waist, rotation)

    def joints_from_program(self, target: Target6, seed_deg: JointsLike | None = None) -> IkResult:
        """All joint angles (deg) for X Y Z A B C in the program frame; as `ik`, with the roll turned into its range
        where it comes from an orientation (XYZABC). Raises OrientationError as `pose_from_program` does."""
        seed = self.home_deg if seed_deg is None else forward.joints_of(seed_deg)
        xyz, readings = self._readings(target, seed)
        return self._solve_readings(target, xyz, readings, seed)

    def program_from_joints(self, q_deg: JointsLike) -> Target6:
        """X Y Z (mm) A B C (deg) in the program frame for joints (5,) deg; C is 0 for XYZAB.

        >>> arm.program_from_joints((0, 0, 0, 90, 10))[3:]
        (90.0, 10.0, 0.0)
        """
        pose = self.fk(q_deg)
        x, y, z = self.frame.program_from_base(pose.xyz_mm).tolist()
        if self.frame.has_rpy:
            return (x, y, z, *rotations.rpy_from_matrix(self.frame.rotation.T @ pose.rotation))
        return (x, y, z, pose.pitch_deg, pose.roll_deg, 0.0)

    def program_jacobian(self, q_deg: JointsLike) -> FloatArray:
        """Rates of the program's coordinates at (5,) deg, mm/rad and rad/rad: (5, 5) of X Y Z A B, (6, 5) of X to C.

        XYZABC: the analytical roll-pitch-yaw Jacobian in the program frame; raises KinematicsError in gimbal lock.
        """
        if self.frame.has_rpy:
            return rates.analytical_rpy(self.geometry, q_deg, self.frame.rotation)
        matrix = jacobian.task(self.geometry, q_deg)
        matrix[:3] = self.frame.rotation.T @ matrix[:3]
        return matrix

    def joints_from_program_batch(
        self, targets: FloatArray, branch: Branch = Branch.FRONT_UP, near_deg: JointsLike | None = None
    ) -> tuple[FloatArray, BoolArray, FloatArray]:
        """Joints (n, 5) deg on one branch, ok (n,) and residual (n,) deg for X Y Z A B C (n, 6).

        ok: reachable, inside the limits and, for XYZABC, the residual within `orientation_tolerance_deg`. With
        `near_deg` (5,) the rows are consecutive samples of a path: the roll starts at the turn nearest to it and
        never jumps by a turn; without, every roll is turned into its range by itself. XYZAB takes the roll
        literally, always.
        """
        rows = np.asarray(targets, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 6:
            raise KinematicsError(f"targets have the shape (n, 6), not {rows.shape}")
        near = self.home_deg if near_deg is None else forward.joints_of(near_deg)
        xyz = self.frame.base_from_program(rows[:, :3])
        if not self.frame.has_rpy:
            q, ok = self.ik_batch(xyz, rows[:, 3], rows[:, 4], branch, near[0])
            return q, ok, np.zeros(len(rows))
        wanted = self.frame.rotation @ rotations.matrices_from_rpy(rows[:, 3:])
        waist, pitch, roll = program_frame.read_orientation_rows(self.geometry, xyz, wanted, branch.is_front, near[0])
        if near_deg is None:
            middle = 0.5 * (self.geometry.min_deg[4] + self.geometry.max_deg[4])
            roll -= 360.0 * np.rint((roll - middle) / 360.0)
        elif len(roll):
            roll = np.unwrap(np.concatenate(((near[4],), roll)), period=360.0)[1:]
        q, ok = self.ik_batch(xyz, pitch, roll, branch, waist)
        residual = rotations.angles_between_deg(wanted, self.fk_batch(q)[1])
        with np.errstate(invalid="ignore"):
            ok &= residual <= self.frame.tolerance_deg
        return q, ok, residual

    def _readings(self, target: Target6, seed: Joints) -> tuple[FloatArray, list[tuple[float, float, float]]]:
        """The tip in the base frame and the ways to read A B C: (waist, pitch, roll) deg."""
        x, y, z, a, b, c = map(float, target)
        if (total := x + y + z + a + b + c) - total != 0.0:
            raise KinematicsError(f"a target must be six finite numbers, not {target}")
        xyz = forward.frozen(self.frame.base_from_program(np.array((x, y, z))))
        if not self.frame.has_rpy:
            waist = float(np.degrees(np.arctan2(xyz[1], xyz[0])))
            return xyz, [(waist, a, b)]
        wanted = self.frame.rotation @ rotations.matrix_from_rpy((a, b, c))
        low, high = self.geometry.min_deg, self.geometry.max_deg
        readings = []
        for reading in program_frame.read_orientation(self.geometry, xyz, wanted, seed[0]):
            roll = inverse.nearest_turn(reading.roll_deg, low[4], high[4], seed[4])
            readings.append((reading.waist_deg, reading.pitch_deg, roll))
        return xyz, readings

    def _solve_readings(
        self, target: Target6, xyz: FloatArray, readings: list[tuple[float, float, float]], seed: Joints
    ) -> IkResult:
        if not self.frame.has_rpy:
            _, pitch, roll = readings[0]
            return self.ik(xyz, pitch, roll, seed)
        wanted = self.frame.rotation @ rotations.matrix_from_rpy(target[3:])
        tolerance = self.frame.tolerance_deg
        solutions: list[IkSolution] = []
        failures: list[IkResult] = []
        least = np.inf
        for waist, pitch, roll in readings:
            result = self.ik(xyz, pitch, roll, (waist, *seed[1:]))
            kept: list[IkSolution] = []
            for side in (True, False):  # elbow up and down hold the tool alike
                same = [solution for solution in result.solutions if solution.branch.is_front is side]
                if same:
                    residual = rotations.angle_between_deg(wanted, self.fk(same[0].q_deg).rotation)
                    least = min(least, residual)
                    kept += same if residual <= tolerance else []
            solutions += kept
            if kept or not result.solutions:
                failures.append(result)
        if not solutions and least <= 180.0:
            raise OrientationError(
                least,
                tolerance,
                f"the tool cannot point that way at X{target[0]:g} Y{target[1]:g} Z{target[2]:g}: A{target[3]:g} "
                f"B{target[4]:g} C{target[5]:g} is {least:.4g} deg away from what five joints reach there "
                f"(machine.orientation_tolerance_deg is {tolerance:g}); turn the approach into the vertical plane "
                "through the waist axis",
            )
        if not solutions:
            return min(failures, key=lambda result: result.shortfalls[0].amount)
        ordered = tuple(inverse.order_by_distance(solutions, seed, self.geometry))
        if ordered[0].in_limits:
            singular = [result for result in failures if result.status is IkStatus.SINGULAR]
            at_best = next((result for result in singular if ordered[0] in result.solutions), None)
            if at_best is not None:
                return IkResult(IkStatus.SINGULAR, ordered[0], ordered, at_best.reason, at_best.shortfalls)
            return IkResult(IkStatus.OK, ordered[0], ordered)
        return inverse.out_of_limits(self.geometry, ordered)

"""Joint space and motor space: the differential wrist, steps, and limits as polytopes.

    motor_deg = M q_deg,  M = diag(signs) on waist, shoulder, elbow and the 2x2 wrist matrix (rows right, left) on
    (pitch, roll);  steps = diag(steps per deg) M q_deg, zero where q = 0.

Step limits hold per motor, so what a pair of joints can do together is a polytope {x : |A x| <= b}, not a box: with
the default wrist, |pitch rate| + |roll rate| <= the wrist motors' rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rm501_host.config import JOINT_NAMES, MOTOR_NAMES, Config
from rm501_host.kinematics.errors import GeometryError, KinematicsError
from rm501_host.kinematics.forward import frozen
from rm501_host.kinematics.results import FloatArray

_MIN_DETERMINANT = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Polytope:
    """The set {x : |matrix x| <= bounds}, x (5,) a joint rate or acceleration in deg/s or deg/s2.

    `matrix` (m, 5), `bounds` (m,) and a name for each row: five joints, then the five motors.
    """

    matrix: FloatArray
    bounds: FloatArray
    names: tuple[str, ...]

    def ratios(self, x: FloatArray) -> FloatArray:
        """|A x| / b of every row: (m,) for x (5,), (n, m) for x (n, 5)."""
        result: FloatArray = np.abs(np.asarray(x, dtype=np.float64) @ self.matrix.T) / self.bounds
        return result

    def ratio(self, x: FloatArray) -> FloatArray | float:
        """The largest ratio: at most 1 inside; a float for x (5,), (n,) for x (n, 5)."""
        worst = self.ratios(x).max(axis=-1)
        return float(worst) if worst.ndim == 0 else worst

    def worst(self, x: FloatArray) -> tuple[str, float]:
        """Name and ratio of the row that x (5,) uses most."""
        ratios = self.ratios(x)
        row = int(np.argmax(ratios))
        return self.names[row], float(ratios[row])


@dataclass(frozen=True, slots=True, eq=False)
class MotorSpace:
    """The linear map between five joints and five motors, and the limits of both.

    `motor_matrix` (5, 5): motor deg per joint deg; `step_matrix` (5, 5): steps per joint deg;
    `joint_matrix` (5, 5): joint deg per step. Arrays are read-only.
    """

    motor_matrix: FloatArray
    step_matrix: FloatArray
    joint_matrix: FloatArray
    max_rate_steps_s: FloatArray
    max_acceleration_steps_s2: FloatArray
    velocity_limits: Polytope
    """Joint and motor speed limits on q' in deg/s."""
    acceleration_limits: Polytope
    """Joint and motor acceleration limits on q'' in deg/s2."""

    @classmethod
    def from_config(cls, config: Config) -> MotorSpace:
        """The map of `[drive]` and `[motors]` with the limits of `[motors]` and `[joints]`.

        Raises GeometryError when the wrist matrix is singular.
        """
        motor_matrix = np.zeros((5, 5))
        motor_matrix[0, 0], motor_matrix[1, 1], motor_matrix[2, 2] = config.drive.signs
        wrist = np.array(config.drive.wrist_matrix, dtype=np.float64)
        if not np.isfinite(wrist).all() or abs(np.linalg.det(wrist)) < _MIN_DETERMINANT:
            raise GeometryError(
                "drive.wrist_matrix",
                f"{config.drive.wrist_matrix} is singular: two motors could not move two joints",
                "rows are the right and left motor on (pitch, roll), such as [[-1, 1], [1, 1]]",
            )
        motor_matrix[3:, 3:] = wrist
        motors, joints = config.motors.ordered, config.joints.ordered
        steps_per_deg = np.array([motor.steps_per_deg for motor in motors])
        step_matrix = steps_per_deg[:, None] * motor_matrix
        joint_matrix = np.linalg.inv(motor_matrix) / steps_per_deg
        rate = np.array([motor.max_rate_steps_s for motor in motors])
        acceleration_deg = np.array([motor.max_acceleration_deg_s2 for motor in motors])
        names = tuple(f"joint {name}" for name in JOINT_NAMES) + tuple(f"motor {name}" for name in MOTOR_NAMES)
        rows = frozen(np.vstack((np.eye(5), motor_matrix)))
        joint_speed = [joint.max_velocity_deg_s for joint in joints]
        joint_acceleration = [joint.max_acceleration_deg_s2 for joint in joints]
        return cls(
            motor_matrix=frozen(motor_matrix),
            step_matrix=frozen(step_matrix),
            joint_matrix=frozen(joint_matrix),
            max_rate_steps_s=frozen(rate),
            max_acceleration_steps_s2=frozen(acceleration_deg * steps_per_deg),
            velocity_limits=Polytope(rows, frozen(np.concatenate((joint_speed, rate / steps_per_deg))), names),
            acceleration_limits=Polytope(rows, frozen(np.concatenate((joint_acceleration, acceleration_deg))), names),
        )

    def steps_from_joints(self, q_deg: FloatArray) -> FloatArray:
        """Motor positions in steps, floating, (5,) or (n, 5), for joints of the same shape in deg."""
        return self._map(q_deg, self.step_matrix)

    def joints_from_steps(self, steps: FloatArray) -> FloatArray:
        """Joints in deg, (5,) or (n, 5), for motor positions in steps."""
        return self._map(steps, self.joint_matrix)

    def motor_deg_from_joints(self, q_deg: FloatArray) -> FloatArray:
        """Motor angles in deg, (5,) or (n, 5): the wrist's right and left in place of pitch and roll."""
        return self._map(q_deg, self.motor_matrix)

    @staticmethod
    def _map(values: FloatArray, matrix: FloatArray) -> FloatArray:
        array = np.asarray(values, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != 5:
            raise KinematicsError(f"five joints or motors are expected: shape (5,) or (n, 5), not {array.shape}")
        result: FloatArray = array @ matrix.T
        return result

"""The arm as it really stands on the bench: true link lengths, drive train and forward kinematics.

The emulator has its own truth. Nothing here is read from a host's configuration; a wrong host shows as a wrong arm.
Source of the numbers: the RM-501 retrofit's machine sheet (Denavit-Hartenberg table, steps per degree, wrist sums).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

ARM_MOTOR_COUNT = 5


class Joint(IntEnum):
    """Joints in the order of the Denavit-Hartenberg table."""

    WAIST = 0
    SHOULDER = 1
    ELBOW = 2
    PITCH = 3
    ROLL = 4


class Motor(IntEnum):
    """Motors in the order of the step generators."""

    WAIST = 0
    SHOULDER = 1
    ELBOW = 2
    RIGHT_WRIST = 3
    LEFT_WRIST = 4
    HAND = 5


@dataclass(frozen=True, slots=True)
class ArmGeometry:
    """Link lengths in mm and zero errors of the joints in deg: the arm as built, not as drawn."""

    d1_mm: float = 230.0
    a2_mm: float = 220.0
    a3_mm: float = 150.0
    d5_mm: float = 95.0

    def tcp_mm(self, q_deg: npt.ArrayLike) -> FloatArray:
        """Tool tip in the base frame, mm, for joint angles of shape (..., 5); returns (..., 3).

        Standard DH, z up: r = a2 c2 + a3 c23 + d5 s234, z = d1 + a2 s2 + a3 s23 - d5 c234.
        """
        q_rad = np.radians(np.asarray(q_deg, dtype=np.float64))
        q2 = q_rad[..., 1]
        q23 = q2 + q_rad[..., 2]
        q234 = q23 + q_rad[..., 3]
        reach_mm = self.a2_mm * np.cos(q2) + self.a3_mm * np.cos(q23) + self.d5_mm * np.sin(q234)
        height_mm = self.d1_mm + self.a2_mm * np.sin(q2) + self.a3_mm * np.sin(q23) - self.d5_mm * np.cos(q234)
        return np.stack((np.cos(q_rad[..., 0]) * reach_mm, np.sin(q_rad[..., 0]) * reach_mm, height_mm), axis=-1)


def _default_matrix() -> tuple[tuple[float, ...], ...]:
    # rows: waist, shoulder, elbow, right wrist, left wrist; columns: joints 1..5 in DH degrees
    return (
        (1.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, -1.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, -1.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, -1.0, 1.0),
        (0.0, 0.0, 0.0, 1.0, 1.0),
    )


@dataclass(frozen=True, slots=True)
class DriveTrain:
    """Gears, belts and the wrist differential between the five arm motors and the five joints.

    `motor_deg = matrix @ joint_deg` and `steps = steps_per_deg * motor_deg`, rows in motor order.
    """

    steps_per_deg: tuple[float, ...] = (40.0, 40.0, 40.0, 26.66666, 26.66666)
    matrix: tuple[tuple[float, ...], ...] = field(default_factory=_default_matrix)

    def steps_from_joints(self) -> FloatArray:
        """The 5x5 matrix from joint degrees to motor steps."""
        per_deg: FloatArray = np.asarray(self.steps_per_deg, dtype=np.float64)[:, None]
        return per_deg * np.asarray(self.matrix, dtype=np.float64)

    def joints_from_steps(self) -> FloatArray:
        """The 5x5 matrix from motor steps to joint degrees."""
        return np.linalg.inv(self.steps_from_joints()).astype(np.float64)


@dataclass(frozen=True, slots=True)
class JointRange:
    """Hard end stops of one joint, deg."""

    low_deg: float
    high_deg: float


# At least 6 deg beyond each switch and each working limit: a stop from 15 deg/s at 20 deg/s2 takes 5.6 deg.
END_STOPS: tuple[JointRange, ...] = (
    JointRange(-157.0, 157.0),
    JointRange(-37.0, 109.0),
    JointRange(-97.0, 7.0),
    JointRange(-7.0, 187.0),
    JointRange(-187.0, 187.0),
)

# Well inside every range, tool obliquely down: where the operator left the arm.
PARKED_POSE_DEG: tuple[float, ...] = (-60.0, 60.0, -60.0, 45.0, 0.0)

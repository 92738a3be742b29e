"""The values that kinematics takes and gives: poses, branches, solutions, shortfalls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Joints = tuple[float, float, float, float, float]
"""Waist, shoulder, elbow, pitch, roll in deg (DH angles)."""

JointsLike = Sequence[float] | FloatArray
VectorLike = Sequence[float] | FloatArray
Target6 = tuple[float, float, float, float, float, float]
"""X Y Z in mm and A B C in deg, program frame; what A B C mean follows from `machine.coordinates`."""


class Branch(IntEnum):
    """Which of the up to four ways the arm takes to a pose.

    FRONT, BACK: the tool tip is on the positive or the negative side of the arm's own radius (r >= 0, r < 0).
    UP, DOWN: q3 <= 0 or q3 > 0; with the wrist in front of the shoulder, UP is the elbow above the line from
    shoulder to wrist. The wrist has one way only: q4 = pitch - q2 - q3.
    """

    FRONT_UP = 0
    FRONT_DOWN = 1
    BACK_UP = 2
    BACK_DOWN = 3

    @property
    def is_front(self) -> bool:
        """Tool tip at r >= 0."""
        return self < 2

    @property
    def is_elbow_up(self) -> bool:
        """q3 <= 0."""
        return not self & 1


class IkStatus(Enum):
    """What came of an inverse kinematics question."""

    OK = "ok"
    """`best` is inside the limits and regular."""
    SINGULAR = "singular"
    """`best` is inside the limits, but at a singularity: see `shortfalls`; it may be moved to, not through."""
    OUT_OF_LIMITS = "out_of_limits"
    """The pose can be reached, but by no solution inside the joint limits."""
    UNREACHABLE = "unreachable"
    """No joint angles whatever reach the pose."""


class ShortfallKind(Enum):
    """What is wrong with a pose."""

    TOO_FAR = "too_far"
    """The wrist centre is beyond a2 + a3; amount in mm."""
    TOO_NEAR = "too_near"
    """The wrist centre is within |a2 - a3|; amount in mm."""
    INSIDE_OFFSET = "inside_offset"
    """The tip is nearer to the waist axis than its sideways offset; amount in mm."""
    JOINT_LIMIT = "joint_limit"
    """A joint would be outside its range; amount in deg."""
    WAIST_UNDETERMINED = "waist_undetermined"
    """The tip is on the waist axis (r = 0); amount |r| in mm."""
    SHOULDER_UNDETERMINED = "shoulder_undetermined"
    """The wrist centre is on the shoulder axis; amount in mm."""
    ELBOW_STRAIGHT = "elbow_straight"
    """s3 = 0, stretched or folded; amount |sin q3|, without unit."""


@dataclass(frozen=True, slots=True)
class Shortfall:
    """One thing that is wrong with a pose: what, by how much, and the joint (0..4) where it is about one."""

    kind: ShortfallKind
    amount: float
    unit: str
    joint: int | None
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, slots=True)
class IkSolution:
    """Joint angles that reach the pose, the branch they lie on, and whether every joint is inside its range."""

    q_deg: Joints
    branch: Branch
    in_limits: bool


@dataclass(frozen=True, slots=True)
class IkResult:
    """The answer of `Arm.ik`.

    `solutions`: all that exist, inside the limits first, then nearest to the seed; empty when unreachable.
    `best`: the nearest inside the limits, None when there is none. `reason`: empty when the status is OK, else one
    sentence with the amount; `shortfalls` is the same as data.
    """

    status: IkStatus
    best: IkSolution | None
    solutions: tuple[IkSolution, ...]
    reason: str = ""
    shortfalls: tuple[Shortfall, ...] = ()

    @property
    def ok(self) -> bool:
        """There is a solution inside the limits (status OK or SINGULAR)."""
        return self.best is not None


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the tool is and how it points, base frame.

    `xyz_mm` (3,) tool centre point; `pitch_deg` = q2 + q3 + q4 (0 straight down, 90 horizontal outward), never
    wrapped; `roll_deg` = q5; `azimuth_deg` = q1, the direction of the vertical plane that the arm works in;
    `rotation` (3, 3) of the tool frame, tool tilt included. Arrays are read-only.
    """

    xyz_mm: FloatArray
    pitch_deg: float
    roll_deg: float
    azimuth_deg: float
    rotation: FloatArray = field(repr=False)

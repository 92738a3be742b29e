"""Kinematics of the arm: forward, inverse, Jacobians, program frame, motor space."""

from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.errors import BranchError, GeometryError, KinematicsError, OrientationError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.motors import MotorSpace, Polytope
from rm501_host.kinematics.program_frame import ProgramFrame
from rm501_host.kinematics.results import (
    Branch,
    IkResult,
    IkSolution,
    IkStatus,
    Joints,
    JointsLike,
    Pose,
    Shortfall,
    ShortfallKind,
    Target6,
)

__all__ = [
    "Arm",
    "ArmGeometry",
    "Branch",
    "BranchError",
    "GeometryError",
    "IkResult",
    "IkSolution",
    "IkStatus",
    "Joints",
    "JointsLike",
    "KinematicsError",
    "MotorSpace",
    "OrientationError",
    "Polytope",
    "Pose",
    "ProgramFrame",
    "Shortfall",
    "ShortfallKind",
    "Target6",
]

"""Kinematics of the arm: forward, inverse, Jacobians, singularities, program frame, motor space, workspace.

`Arm` has what the rest of the host asks for; the modules hold the mathematics. The derivation is in
docs/kinematics.md, the thesis's errors in docs/errata.md.
"""

from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.errors import GeometryError, KinematicsError, OrientationError
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
from rm501_host.kinematics.singularities import Ellipsoid, Singularity, SingularityKind
from rm501_host.kinematics.solids import Capsules, Clearances, SolidRadii, capsules, clearances
from rm501_host.kinematics.tracker import BranchTracker, TrackStatus, TrackStep
from rm501_host.kinematics.velocity_control import ControlStep, VelocityController, default_damping
from rm501_host.kinematics.velocity_inverse import Damping, DampingLaw, Weights
from rm501_host.kinematics.workspace import WorkspaceMap, reachable_pitches, workspace_map

__all__ = [
    "Arm",
    "ArmGeometry",
    "Branch",
    "BranchTracker",
    "Capsules",
    "Clearances",
    "ControlStep",
    "Damping",
    "DampingLaw",
    "Ellipsoid",
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
    "Singularity",
    "SingularityKind",
    "SolidRadii",
    "Target6",
    "TrackStatus",
    "TrackStep",
    "VelocityController",
    "Weights",
    "WorkspaceMap",
    "capsules",
    "clearances",
    "default_damping",
    "reachable_pitches",
    "workspace_map",
]

"""Singularities: where the arm loses a freedom, how far that is, and how well it moves elsewhere.

With K = a2 a3 s3, r the tip's radius, r0 = r - g c234 that of the wrist centre plus the tool's length part, and
g = tx c5 - ty s5 the tool's offset in the arm's plane:

    elbow       s3 = 0                        stretched or folded; rank of J drops by 1
    shoulder    s234 = 0 and r0 = 0           the wrist centre is on the waist axis, the tool along it; rank drops by 1
    waist axis  r = 0                         the tip is on the waist axis: J may keep its rank, but the task (x, y,
                                              z, pitch, roll) loses one freedom whatever s234 is
    double      elbow and shoulder            rank 3

    det of the task Jacobian    |det| = |K r|
    manipulability              w = sqrt(det(J^T J)) = |K| sqrt(s234^2/L^4 + (r0^2 + g^2 s234^2)/L^6)

where L is the length in mm that one rad is weighed with: the linear rows are divided by it (L = 1 leaves mm and rad
mixed as they are). Without a tool offset this is a2 a3 |s3| sqrt(r^2 + s234^2) at L = 1. Sources: thesis 3.2.5 and
3.3 with the corrections of the errata (J is 6x5: J^T J; c23, not c4; the task Jacobian), and Cauchy-Binet over
the six minors of `minors`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import cos, hypot, radians, sin, sqrt

import numpy as np

from rm501_host.kinematics import forward, jacobian
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, JointsLike

RANK_TOLERANCE = 1e-9
"""Singular values below this part of the largest count as 0."""


class SingularityKind(Enum):
    """Which freedom is lost."""

    ELBOW = "elbow"
    """The tip cannot move along the line from shoulder to wrist."""
    SHOULDER = "shoulder"
    """Waist and roll turn the tool about one axis, and neither moves it sideways."""
    WAIST_AXIS = "waist_axis"
    """The waist cannot move the tip: no sideways motion."""
    DOUBLE = "double"
    """Elbow and shoulder at once."""


@dataclass(frozen=True, slots=True)
class Singularity:
    """How near a singularity is.

    `distance` in `unit`: deg of the elbow (to 0 or 180), or mm (waist axis: |r|; shoulder: sqrt(r0^2 + (reach
    s234)^2); double: the farther of the two as a ratio). `measure` is the same without unit, for margins: |s3|,
    |r| / reach, ...; 0 at the singularity, about 1 far away.
    """

    kind: SingularityKind
    distance: float
    unit: str
    measure: float


@dataclass(frozen=True, slots=True)
class _Parts:
    s3: float
    r: float
    r0: float
    s234: float
    g: float


def _parts(geometry: ArmGeometry, q_deg: JointsLike) -> _Parts:
    _, q2, q3, q4, q5 = forward.joints_of(q_deg)
    a234, a5 = radians(q2 + q3 + q4), radians(q5)
    tx, ty, tz = geometry.tcp_mm
    g = tx * cos(a5) - ty * sin(a5)
    r0 = geometry.a2_mm * cos(radians(q2)) + geometry.a3_mm * cos(radians(q2 + q3)) + tz * sin(a234)
    return _Parts(sin(radians(q3)), r0 + g * cos(a234), r0, sin(a234), g)


def distances(geometry: ArmGeometry, q_deg: JointsLike) -> tuple[Singularity, ...]:
    """All four singularities with their distance from q (5,) deg, in the order of `SingularityKind`."""
    parts = _parts(geometry, q_deg)
    q3 = forward.joints_of(q_deg)[2]
    reach = geometry.reach_mm
    elbow_deg = abs((q3 + 90.0) % 180.0 - 90.0)
    elbow = abs(parts.s3)
    shoulder_mm = hypot(parts.r0, reach * parts.s234)
    shoulder = shoulder_mm / reach
    both = max(elbow, shoulder)
    return (
        Singularity(SingularityKind.ELBOW, elbow_deg, "deg", elbow),
        Singularity(SingularityKind.SHOULDER, shoulder_mm, "mm", shoulder),
        Singularity(SingularityKind.WAIST_AXIS, abs(parts.r), "mm", abs(parts.r) / reach),
        Singularity(SingularityKind.DOUBLE, both, "", both),
    )


def within(geometry: ArmGeometry, q_deg: JointsLike, margin: float) -> tuple[Singularity, ...]:
    """Those whose measure at q (5,) deg is at most `margin`, nearest first; KinematicsError for a negative one."""
    if not margin >= 0:
        raise KinematicsError(f"a margin is 0 or more, not {margin}")
    near = [singularity for singularity in distances(geometry, q_deg) if singularity.measure <= margin]
    return tuple(sorted(near, key=lambda singularity: singularity.measure))


def manipulability(geometry: ArmGeometry, q_deg: JointsLike, length_mm: float = 1.0) -> float:
    """sqrt(det(J^T J)) at q (5,) deg in closed form, the linear rows divided by `length_mm`.

    Unit: mm^3 at `length_mm` = 1 (mm and rad mixed), else none. Raises KinematicsError for a length not above 0.
    """
    _check_length(length_mm)
    parts = _parts(geometry, q_deg)
    square = parts.s234**2 + (parts.r0**2 + (parts.g * parts.s234) ** 2) / length_mm**2
    return geometry.a2_mm * geometry.a3_mm * abs(parts.s3) * sqrt(square) / length_mm**2


def task_determinant(geometry: ArmGeometry, q_deg: JointsLike) -> float:
    """det of the task Jacobian at q (5,) deg, mm^3: -a2 a3 s3 r."""
    parts = _parts(geometry, q_deg)
    return -geometry.a2_mm * geometry.a3_mm * parts.s3 * parts.r


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """The velocity ellipsoid of the weighted Jacobian: what unit joint rates can do.

    `axes` (6, 5): one unit direction a column, linear rows in units of the length, then angular; `radii` (5,):
    largest first; `joint_axes` (5, 5): the joint rates, one a column, that give them. `condition` is the ratio of
    the largest to the smallest radius, inf at a singularity; `rank` counts the radii that are not 0.
    """

    axes: FloatArray
    radii: FloatArray
    joint_axes: FloatArray
    condition: float
    rank: int


def ellipsoid(geometry: ArmGeometry, q_deg: JointsLike, length_mm: float) -> Ellipsoid:
    """Singular values and directions of J at q (5,) deg with its linear rows divided by `length_mm`.

    Thesis 3.2.4, 3.2.5: the condition number is sigma max / sigma min (not of eigenvalues of J^T).
    """
    _check_length(length_mm)
    matrix = jacobian.geometric(geometry, q_deg)
    matrix[:3] /= length_mm
    axes, radii, joint_axes = np.linalg.svd(matrix, full_matrices=False)
    rank = int((radii > RANK_TOLERANCE * radii[0]).sum())
    condition = float(radii[0] / radii[-1]) if rank == len(radii) else float("inf")
    return Ellipsoid(axes, radii, joint_axes.T, condition, rank)


def _check_length(length_mm: float) -> None:
    if not length_mm > 0:
        raise KinematicsError(f"the length that a rad is weighed with must be above 0 mm, not {length_mm}")

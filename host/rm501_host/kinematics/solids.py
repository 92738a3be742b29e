"""The arm as simple solids, and how far they are from what they must not touch.

A capsule is a segment with a radius. Four are enough for this arm: column, upper arm, forearm, hand. The hand's
ends at the tool centre point (its cap touches it, so that a fingertip may reach a table), and nothing of the link
lengths is repeated here: they come from the geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rm501_host.config.schema import KeepOutSection
from rm501_host.kinematics import forward
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, JointsLike

SOLID_NAMES = ("column", "upper arm", "forearm", "hand")
_MOVING = slice(1, 4)


@dataclass(frozen=True, slots=True)
class SolidRadii:
    """Radii in mm. The manual gives none: these are our choice, on the generous side, to be measured on the arm."""

    column_mm: float = 100.0
    upper_arm_mm: float = 60.0
    forearm_mm: float = 50.0
    hand_mm: float = 35.0

    def __post_init__(self) -> None:
        for name, radius_mm in zip(SOLID_NAMES, self.as_tuple, strict=True):
            if not radius_mm > 0:
                raise KinematicsError(f"the radius of the {name} must be above 0 mm, not {radius_mm}")

    @property
    def as_tuple(self) -> tuple[float, float, float, float]:
        """In the order of SOLID_NAMES."""
        return (self.column_mm, self.upper_arm_mm, self.forearm_mm, self.hand_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Capsules:
    """`starts` and `ends` (n, 4, 3) of the segments in the base frame, `radii` (4,), all mm; order SOLID_NAMES."""

    starts: FloatArray
    ends: FloatArray
    radii: FloatArray


def capsules(geometry: ArmGeometry, q_deg: FloatArray, radii: SolidRadii | None = None) -> Capsules:
    """The arm's solids at joints (n, 5) deg."""
    sizes = SolidRadii() if radii is None else radii
    rows = np.radians(forward.joint_rows_of(q_deg))
    tips, _ = forward.positions_and_rotations(geometry, q_deg)
    c1, s1 = np.cos(rows[:, 0]), np.sin(rows[:, 0])
    q2, q23 = rows[:, 1], rows[:, 1] + rows[:, 2]
    elbow_r, elbow_z = geometry.a2_mm * np.cos(q2), geometry.d1_mm + geometry.a2_mm * np.sin(q2)
    wrist_r, wrist_z = elbow_r + geometry.a3_mm * np.cos(q23), elbow_z + geometry.a3_mm * np.sin(q23)
    starts, ends = np.zeros((len(rows), 4, 3)), np.zeros((len(rows), 4, 3))
    shoulder = np.array((0.0, 0.0, geometry.d1_mm))
    elbows = np.stack((c1 * elbow_r, s1 * elbow_r, elbow_z), axis=1)
    wrists = np.stack((c1 * wrist_r, s1 * wrist_r, wrist_z), axis=1)
    ends[:, 0] = shoulder
    starts[:, 1], ends[:, 1] = shoulder, elbows
    starts[:, 2], ends[:, 2] = elbows, wrists
    along = tips - wrists
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
    shortened = np.clip(1.0 - sizes.hand_mm / length, 0.0, 1.0)[:, None]
    starts[:, 3], ends[:, 3] = wrists, wrists + along * shortened
    return Capsules(starts, ends, np.array(sizes.as_tuple))


@dataclass(frozen=True, slots=True, eq=False)
class Clearances:
    """`mm` (n, m): distance between a solid and a zone, negative where they overlap; `pairs` (m,) names both."""

    mm: FloatArray
    pairs: tuple[tuple[str, str], ...]

    def worst(self) -> tuple[int, str, str, float]:
        """Row, solid, zone and distance of the nearest approach; raises KinematicsError when there is no zone."""
        if not self.pairs or not len(self.mm):
            raise KinematicsError("there is no keep-out zone to be near to")
        row, pair = np.unravel_index(int(np.argmin(self.mm)), self.mm.shape)
        solid, zone = self.pairs[int(pair)]
        return int(row), solid, zone, float(self.mm[row, pair])


def clearances(solids: Capsules, keep_out: KeepOutSection) -> Clearances:
    """How far the moving solids are from the table plane and every solid from the boxes of `[keep_out]`, mm.

    The column stands on the table, so it is left out against the plane. Inside a box the distance is minus the
    radius: the depth of a segment inside a box is not measured.
    """
    columns: list[FloatArray] = []
    pairs: list[tuple[str, str]] = []
    if keep_out.table_z_mm is not None:
        lowest = np.minimum(solids.starts[:, _MOVING, 2], solids.ends[:, _MOVING, 2]) - solids.radii[_MOVING]
        columns += list((lowest - keep_out.table_z_mm).T)
        pairs += [(name, "table") for name in SOLID_NAMES[_MOVING]]
    for box in keep_out.boxes:
        for index, name in enumerate(SOLID_NAMES):
            gap = segment_box_distance(
                solids.starts[:, index], solids.ends[:, index], np.array(box.min_mm), np.array(box.max_mm)
            )
            columns.append(gap - solids.radii[index])
            pairs.append((name, box.name))
    count = len(solids.starts)
    return Clearances(np.stack(columns, axis=1) if columns else np.empty((count, 0)), tuple(pairs))


def hand_capsule(geometry: ArmGeometry, q_deg: JointsLike) -> tuple[FloatArray, FloatArray, float]:
    """Start (3,), end (3,) and radius of the hand at joints (5,) deg, mm."""
    solids = capsules(geometry, np.array([forward.joints_of(q_deg)]))
    return solids.starts[0, 3], solids.ends[0, 3], float(solids.radii[3])


def segment_box_distance(starts: FloatArray, ends: FloatArray, low_mm: FloatArray, high_mm: FloatArray) -> FloatArray:
    """Exact distances (n,) between segments (n, 3) to (n, 3) and an axis-parallel box, 0 where they touch.

    The squared distance of a point at start + t (end - start) is convex in t and quadratic between the values of t
    at which a coordinate passes a face; so its slope is linear there, and the one change of sign is found exactly.
    """
    direction = ends - starts
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate(((low_mm - starts) / direction, (high_mm - starts) / direction), axis=1)
    crossings = np.clip(np.where(np.isfinite(crossings), crossings, 0.0), 0.0, 1.0)
    knots = np.sort(np.concatenate((np.zeros((len(starts), 1)), crossings, np.ones((len(starts), 1))), axis=1), axis=1)
    points = starts[:, None, :] + knots[:, :, None] * direction[:, None, :]
    outside = np.where(points < low_mm, points - low_mm, np.where(points > high_mm, points - high_mm, 0.0))
    slope = (outside * direction[:, None, :]).sum(axis=2)
    last = np.clip((slope <= 0.0).sum(axis=1) - 1, 0, knots.shape[1] - 2)
    rows = np.arange(len(starts))
    slope_a, slope_b = slope[rows, last], slope[rows, last + 1]
    knot_a, knot_b = knots[rows, last], knots[rows, last + 1]
    rise = slope_b - slope_a
    fraction = np.where(rise > 0.0, np.clip(-slope_a / np.where(rise > 0.0, rise, 1.0), 0.0, 1.0), 1.0)
    best = knot_a + np.where(slope_a >= 0.0, 0.0, fraction) * (knot_b - knot_a)
    nearest = starts + best[:, None] * direction
    gap = np.where(nearest < low_mm, low_mm - nearest, np.where(nearest > high_mm, nearest - high_mm, 0.0))
    return np.asarray(np.linalg.norm(gap, axis=1), dtype=np.float64)

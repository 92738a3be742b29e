"""Where the arm can work: reach of a point, and maps over radius, height and pitch.

The waist only turns the picture, so the workspace is a section: signed radius r (behind the waist axis where
r < 0) by height z, for every pitch. Joint limits count; the roll is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import BoolArray, Branch, FloatArray, VectorLike


@dataclass(frozen=True, slots=True, eq=False)
class WorkspaceMap:
    """Reach over a grid: `reachable` (n_r, n_z, n_pitch), and the best `manipulability` (n_r, n_z) over the pitches.

    The manipulability is weighed with `length_mm` and NaN where nothing is reachable.
    """

    r_mm: FloatArray
    z_mm: FloatArray
    pitch_deg: FloatArray
    reachable: BoolArray
    manipulability: FloatArray
    length_mm: float

    @property
    def pitch_span_deg(self) -> FloatArray:
        """How many degrees of pitch are reachable at each (r, z): (n_r, n_z)."""
        step = float(self.pitch_deg[1] - self.pitch_deg[0]) if len(self.pitch_deg) > 1 else 0.0
        result: FloatArray = self.reachable.sum(axis=2) * step
        return result

    @property
    def area_mm2(self) -> float:
        """Area of the section that is reachable with any pitch."""
        cell = float((self.r_mm[1] - self.r_mm[0]) * (self.z_mm[1] - self.z_mm[0]))
        return float(self.reachable.any(axis=2).sum()) * cell


def workspace_map(
    arm: Arm, r_mm: FloatArray, z_mm: FloatArray, pitch_deg: FloatArray, roll_deg: float = 0.0
) -> WorkspaceMap:
    """Ask the closed form at every (r, z, pitch); evenly spaced axes (n_r,), (n_z,), (n_pitch,), mm and deg.

    Raises KinematicsError for an axis of fewer than two values (one pitch is allowed).
    """
    if len(r_mm) < 2 or len(z_mm) < 2 or len(pitch_deg) < 1:
        raise KinematicsError("a map needs two radii, two heights and a pitch at least")
    geometry = arm.geometry
    length_mm = geometry.a2_mm
    reachable = np.zeros((len(r_mm), len(z_mm), len(pitch_deg)), dtype=np.bool_)
    best = np.full((len(r_mm), len(z_mm)), np.nan)
    heights, pitches = (axis.ravel() for axis in np.meshgrid(z_mm, pitch_deg, indexing="ij"))
    points = np.zeros((len(heights), 3))
    points[:, 2] = heights
    tx, ty, _ = geometry.tcp_mm
    roll = np.radians(roll_deg)
    g = float(tx * np.cos(roll) - ty * np.sin(roll))
    s234, c234 = np.sin(np.radians(pitches)), np.cos(np.radians(pitches))
    for index, radius in enumerate(r_mm):
        points[:, :2] = _tip_at(arm, float(radius), roll)
        r0 = radius - g * c234
        weight = np.sqrt(s234**2 + (r0**2 + (g * s234) ** 2) / length_mm**2)
        for branch in (Branch.FRONT_UP, Branch.FRONT_DOWN) if radius >= 0 else (Branch.BACK_UP, Branch.BACK_DOWN):
            q, ok = arm.ik_batch(points, pitches, roll_deg, branch)
            shape = (len(z_mm), len(pitch_deg))
            reachable[index] |= ok.reshape(shape)
            k = geometry.a2_mm * geometry.a3_mm * np.abs(np.sin(np.radians(q[:, 2])))
            value = np.where(ok, k * weight / length_mm**2, -np.inf).reshape(shape).max(axis=1)
            best[index] = np.where(value >= 0, np.fmax(best[index], value), best[index])
    return WorkspaceMap(r_mm, z_mm, pitch_deg, reachable, best, length_mm)


def _tip_at(arm: Arm, r_mm: float, roll_rad: float) -> tuple[float, float]:
    """x, y of a tip at signed radius r with the waist at 0: the tool's sideways offset is y."""
    tx, ty, _ = arm.geometry.tcp_mm
    return r_mm, float(-(tx * np.sin(roll_rad) + ty * np.cos(roll_rad)))


def reachable_pitches(arm: Arm, xyz_mm: VectorLike, roll_deg: float = 0.0, step_deg: float = 1.0) -> FloatArray:
    """The pitches (n,) in deg, on a grid of `step_deg`, with which a point (3,) mm can be reached inside the limits.

    >>> from rm501_host.config import load_config
    >>> pitches = reachable_pitches(Arm.from_config(load_config()), (300.0, 0.0, 200.0))
    >>> bool(pitches.min() <= 0.0 <= pitches.max())
    True
    """
    if not step_deg > 0:
        raise KinematicsError(f"the step must be above 0 deg, not {step_deg}")
    pitches = np.arange(-180.0, 360.0, step_deg)
    points = np.tile(np.asarray(xyz_mm, dtype=np.float64), (len(pitches), 1))
    found = np.zeros(len(pitches), dtype=np.bool_)
    for branch in Branch:
        found |= arm.ik_batch(points, pitches, roll_deg, branch)[1]
    unique: FloatArray = np.unique(np.where(pitches[found] >= 180.0, pitches[found] - 360.0, pitches[found]))
    return unique

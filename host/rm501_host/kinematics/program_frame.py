"""The program frame and the two coordinate systems of programs.

The program frame is the base frame moved by `[frame]`: p_base = F p_program + f, R_base = F R_program.

XYZAB   A = pitch (q234), B = roll (q5), literally; C is not used.
XYZABC  A, B, C = roll, pitch, yaw of the tool frame in the program frame. Five joints reach such an orientation only
        where the approach lies in the vertical plane through the waist axis and the wrist centre; the angle that is
        left otherwise is the residual.

With `configs/thesis.toml`, A0 B0 C0 is the tool straight down and C = q5 - q1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics import rotations
from rm501_host.kinematics.forward import frozen
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray

_AXIS_RADIUS_MM = 1e-3
"""Within this of the waist axis the wrist centre does not tell the waist angle: 1e-3 mm of rounding is far."""

_APPROACH_SINE = 1e-9
"""A tool this near to vertical does not tell the waist angle either."""

_IN_PLANE_SINE = 1e-6
"""An approach this far out of the plane is meant, not rounding: then the tip alone gives the plane."""

_TIP_PLANE_STEPS = 3
"""The tip's plane and the roll depend on each other through a tool offset; each step gains about two digits."""

_FLIP_RADIUS_MM = 1e-9
"""|r| below which the tip is on the waist axis, neither in front of it nor behind."""


@dataclass(frozen=True, slots=True, eq=False)
class ProgramFrame:
    """`rotation` (3, 3) and `origin_mm` (3,) of the program frame in the base frame, and what A B C mean."""

    rotation: FloatArray
    origin_mm: FloatArray
    has_rpy: bool
    tolerance_deg: float

    @classmethod
    def from_config(cls, config: Config) -> ProgramFrame:
        """The frame of `[frame]` and `[machine]`."""
        return cls(
            rotation=frozen(_clean(rotations.matrix_from_rpy(config.frame.rpy_deg))),
            origin_mm=frozen(np.array(config.frame.xyz_mm, dtype=np.float64)),
            has_rpy=config.machine.coordinates == "XYZABC",
            tolerance_deg=config.machine.orientation_tolerance_deg,
        )

    def base_from_program(self, xyz_mm: FloatArray) -> FloatArray:
        """Points (3,) or (n, 3) mm, program to base frame."""
        result: FloatArray = np.asarray(xyz_mm, dtype=np.float64) @ self.rotation.T + self.origin_mm
        return result

    def program_from_base(self, xyz_mm: FloatArray) -> FloatArray:
        """Points (3,) or (n, 3) mm, base to program frame."""
        result: FloatArray = (np.asarray(xyz_mm, dtype=np.float64) - self.origin_mm) @ self.rotation
        return result


def _clean(rotation: FloatArray) -> FloatArray:
    """Right angles exact: cos 90 deg is 0, not 6e-17, so that points of a turned frame keep their digits."""
    rounded = np.round(rotation)
    exact: FloatArray = np.where(np.abs(rotation - rounded) < 1e-15, rounded, rotation) + 0.0
    return exact


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read an orientation as waist, pitch and roll, deg; roll in (-180, 180]."""

    waist_deg: float
    pitch_deg: float
    roll_deg: float


def read_orientation(
    geometry: ArmGeometry, xyz_mm: FloatArray, tool_rotation: FloatArray, seed_waist_deg: float
) -> tuple[Reading, Reading]:
    """The two ways (waist, and waist + 180 deg) in which the arm's plane can hold a tool orientation at a tip.

    `xyz_mm` (3,), `tool_rotation` (3, 3), base frame; the tip in front of the waist axis (r >= 0) comes first. The
    rows of `read_orientation_rows`.
    """
    xyz, rotations_ = xyz_mm[None], tool_rotation[None]
    front, back = (
        Reading(*(float(part[0]) for part in read_orientation_rows(geometry, xyz, rotations_, side, seed_waist_deg)))
        for side in (True, False)
    )
    return front, back


def read_orientation_rows(
    geometry: ArmGeometry, xyz_mm: FloatArray, tool_rotations: FloatArray, front: bool, seed_waist_deg: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Waist, pitch and roll (n,) each, deg, of n tool orientations (n, 3, 3) at tips (n, 3), base frame, with the tip
    in front of (r >= 0) or behind the waist axis; roll in (-180, 180].

    The arm's plane goes through the wrist centre p - R5 (tx, ty, tz); where that is on the waist axis, through the
    approach; where that is vertical too, the seed decides. Where the approach is not in that plane, the tip alone
    gives the plane, and the approach is projected into it: whoever calls measures the residual, which is then the
    smallest that this tip allows.
    """
    return read_wrist_rows(
        geometry, xyz_mm, tool_rotations @ np.array(geometry.tilt).reshape(3, 3).T, front, seed_waist_deg
    )


def read_wrist_rows(
    geometry: ArmGeometry, xyz_mm: FloatArray, r5: FloatArray, front: bool, seed_waist_deg: FloatArray | float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As `read_orientation_rows`, of orientations (n, 3, 3) of frame 5, which the tool's tilt is left out of; the
    seed one number or (n,).
    """
    wrist = xyz_mm - r5 @ np.array(geometry.tcp_mm)
    ax, ay = r5[:, 0, 2], r5[:, 1, 2]
    waist = np.arctan2(wrist[:, 1], wrist[:, 0])
    unclear = np.hypot(wrist[:, 0], wrist[:, 1]) <= _AXIS_RADIUS_MM
    if unclear.any():
        from_approach = np.where(np.hypot(ax, ay) > _APPROACH_SINE, np.arctan2(ay, ax), np.radians(seed_waist_deg))
        waist = np.where(unclear, from_approach, waist)
    radius = xyz_mm[:, 0] * np.cos(waist) + xyz_mm[:, 1] * np.sin(waist)
    flip = (radius < -_FLIP_RADIUS_MM) if front else (radius > _FLIP_RADIUS_MM)
    waist = np.where(flip, np.where(waist > 0, waist - np.pi, waist + np.pi), waist)
    pitch, roll = _project(r5, waist)
    out_of_plane = np.abs(ax * np.sin(waist) - ay * np.cos(waist)) > _IN_PLANE_SINE
    if out_of_plane.any():
        rows = out_of_plane.nonzero()[0]
        for _ in range(_TIP_PLANE_STEPS):
            waist[rows] = _waist_of_tip(geometry, xyz_mm[rows], roll[rows], waist[rows], front)
            pitch[rows], roll[rows] = _project(r5[rows], waist[rows])
    return np.degrees(waist), np.degrees(pitch), np.degrees(roll)


def _project(r5: FloatArray, waist_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pitch and roll (n,) rad that come nearest to R5 (n, 3, 3) in the planes at `waist_rad` (n,).

    The approach projects onto (s234, -c234) in the plane, and R5^T n, with n = (s1, -c1, 0), is (s5, c5, 0) where
    the approach is in it (thesis 2.2).
    """
    c1, s1 = np.cos(waist_rad), np.sin(waist_rad)
    pitch = np.arctan2(r5[:, 0, 2] * c1 + r5[:, 1, 2] * s1, -r5[:, 2, 2])
    roll = np.arctan2(r5[:, 0, 0] * s1 - r5[:, 1, 0] * c1, r5[:, 0, 1] * s1 - r5[:, 1, 1] * c1)
    return pitch, roll


def _waist_of_tip(
    geometry: ArmGeometry, xyz_mm: FloatArray, roll_rad: FloatArray, waist_rad: FloatArray, front: bool
) -> FloatArray:
    """Waist (n,) rad of tips whose sideways offset follows from the roll; as it was where the tip does not say."""
    tx, ty, _ = geometry.tcp_mm
    v = -(tx * np.sin(roll_rad) + ty * np.cos(roll_rad))
    square = xyz_mm[:, 0] ** 2 + xyz_mm[:, 1] ** 2 - v * v
    radius = np.sqrt(np.maximum(square, 0.0)) * (1.0 if front else -1.0)
    waist = np.arctan2(xyz_mm[:, 1], xyz_mm[:, 0]) - np.arctan2(v, radius)
    clear: FloatArray = np.where(square > _AXIS_RADIUS_MM**2, waist, waist_rad)
    return clear

"""Inverse kinematics for many poses at once on one branch: the closed form of `inverse` in array arithmetic.

Rows are worked in blocks that stay in the processor's cache; no Python per row.
"""

from __future__ import annotations

import numpy as np

from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import LIMIT_TOLERANCE_DEG, ArmGeometry
from rm501_host.kinematics.inverse import AXIS_TOLERANCE_MM, REACH_TOLERANCE_MM
from rm501_host.kinematics.results import BoolArray, Branch, FloatArray

_BLOCK_ROWS = 4096
_RAD = np.pi / 180.0
_DEG = 180.0 / np.pi


def solve_rows(
    geometry: ArmGeometry,
    xyz_mm: FloatArray,
    pitch_deg: FloatArray,
    roll_deg: FloatArray,
    branch: Branch,
    waist_deg: FloatArray | float,
) -> tuple[FloatArray, BoolArray]:
    """Joint angles (n, 5) deg and `ok` (n,) for tips (n, 3) mm; see `Arm.ik_batch`."""
    xyz = np.asarray(xyz_mm, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise KinematicsError(f"positions have the shape (n, 3), not {xyz.shape}")
    count = len(xyz)
    try:
        pitch = np.broadcast_to(np.asarray(pitch_deg, dtype=np.float64), (count,))
        roll = np.broadcast_to(np.asarray(roll_deg, dtype=np.float64), (count,))
    except ValueError as error:
        raise KinematicsError(f"pitch and roll have the shape ({count},) or are one number") from error
    waist = np.broadcast_to(np.asarray(waist_deg, dtype=np.float64), (count,))
    q = np.empty((count, 5))
    ok = np.empty(count, dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        for start in range(0, count, _BLOCK_ROWS):
            rows = slice(start, min(start + _BLOCK_ROWS, count))
            _solve_block(geometry, xyz[rows], pitch[rows], roll[rows], branch, waist[rows], q[rows], ok[rows])
    return q, ok


def _solve_block(
    geometry: ArmGeometry,
    xyz: FloatArray,
    pitch: FloatArray,
    roll: FloatArray,
    branch: Branch,
    waist: FloatArray,
    q: FloatArray,
    ok: BoolArray,
) -> None:
    a2, a3 = geometry.a2_mm, geometry.a3_mm
    tx, ty, tz = geometry.tcp_mm
    x, y = np.ascontiguousarray(xyz[:, 0]), np.ascontiguousarray(xyz[:, 1])
    pitch_rad = pitch * _RAD
    c234, s234 = np.cos(pitch_rad), np.sin(pitch_rad)
    rho2 = x * x + y * y
    dz = xyz[:, 2] - geometry.d1_mm + tz * c234
    reachable: BoolArray | None = None
    q1 = np.arctan2(y, x)
    if tx or ty:
        roll_rad = roll * _RAD
        c5, s5 = np.cos(roll_rad), np.sin(roll_rad)
        g = tx * c5 - ty * s5
        v = -(tx * s5 + ty * c5)
        dz -= g * s234
        square = rho2 - v * v
        reachable = np.sqrt(rho2) >= np.abs(v) - REACH_TOLERANCE_MM
        radius = np.sqrt(np.maximum(square, 0.0))
        if not branch.is_front:
            radius = -radius
        dx = radius - g * c234 - tz * s234
        q1 -= np.arctan2(v, radius)
        undetermined = (rho2 <= AXIS_TOLERANCE_MM**2) & (np.abs(radius) <= AXIS_TOLERANCE_MM)
    else:
        radius = np.sqrt(rho2)
        if branch.is_front:
            dx = radius - tz * s234
        else:
            dx = -radius - tz * s234
            q1 -= np.copysign(np.pi, q1)
        undetermined = rho2 <= AXIS_TOLERANCE_MM**2
    q1 *= _DEG
    distance2 = dx * dx + dz * dz
    outer, inner = a2 + a3, abs(a2 - a3)
    # (2 a2 a3 s3)^2 = (outer^2 - d^2)(d^2 - inner^2), the same sum of squares that c3 has
    beyond, within = outer * outer - distance2, distance2 - inner * inner
    two_a2_a3_s3 = np.sqrt(np.maximum(beyond, 0.0) * np.maximum(within, 0.0))
    two_a2_a3_c3 = distance2 - (a2 * a2 + a3 * a3)
    limit = 2.0 * a2 * a3
    np.clip(two_a2_a3_c3, -limit, limit, out=two_a2_a3_c3)
    fits = (beyond >= -2.0 * outer * REACH_TOLERANCE_MM) & (within >= -2.0 * inner * REACH_TOLERANCE_MM)
    if reachable is not None:
        fits &= reachable
    if branch.is_elbow_up:
        np.negative(two_a2_a3_s3, out=two_a2_a3_s3)
    q3 = np.arctan2(two_a2_a3_s3, two_a2_a3_c3)
    # atan2(dz, dx) - atan2(a3 s3, a2 + a3 c3) as one angle: both pairs multiplied as complex numbers
    m = two_a2_a3_c3 + 2.0 * a2 * a2
    q2 = np.arctan2(dz * m - dx * two_a2_a3_s3, dx * m + dz * two_a2_a3_s3)
    q2 *= _DEG
    q3 *= _DEG
    if undetermined.any():
        q1[undetermined] = waist[undetermined]
    for joint, angle in ((0, q1), (1, q2), (2, q3)):
        _turn_into_range(geometry, joint, angle)
    q4 = pitch - q2
    q4 -= q3
    _turn_into_range(geometry, 3, q4)
    for joint, angle in ((0, q1), (1, q2), (2, q3), (3, q4)):
        q[:, joint] = angle
    q[:, 4] = roll
    bad = ~fits
    if bad.any():
        q[bad] = np.nan
    for joint, angle in ((0, q1), (1, q2), (2, q3), (3, q4), (4, roll)):
        fits &= angle >= geometry.min_deg[joint] - LIMIT_TOLERANCE_DEG
        fits &= angle <= geometry.max_deg[joint] + LIMIT_TOLERANCE_DEG
    ok[:] = fits


def _turn_into_range(geometry: ArmGeometry, joint: int, angle: FloatArray) -> None:
    """Add whole turns, in place, to angles more than half a turn from the middle of the joint's range."""
    low, high = geometry.min_deg[joint], geometry.max_deg[joint]
    middle = 0.5 * (low + high)
    half = max(180.0, 0.5 * (high - low))
    if angle.size == 0 or (angle.max() <= middle + half and angle.min() >= middle - half):
        return
    away = np.abs(angle - middle) > half
    angle[away] -= 360.0 * np.rint((angle[away] - middle) / 360.0)

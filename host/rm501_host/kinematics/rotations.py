"""Rotations: matrix, roll-pitch-yaw, zxz Euler angles, and the rates of both; angles in deg at every boundary.

Roll, pitch, yaw mean R = Rz(yaw) Ry(pitch) Rx(roll): turns about the fixed axes x, y, z in that order. The zxz
angles mean R = Rz(phi) Rx(theta) Rz(psi). Quaternions and angle-axis are in `quaternions`.
"""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, radians, sin

import numpy as np

from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import FloatArray, VectorLike


def matrix_from_rpy(rpy_deg: VectorLike) -> FloatArray:
    """R = Rz(yaw) Ry(pitch) Rx(roll), (3, 3), from (roll, pitch, yaw) in deg (thesis 2.1)."""
    roll, pitch, yaw = (radians(float(angle)) for angle in rpy_deg)
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    return np.array(
        (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
    )


def matrices_from_rpy(rpy_deg: FloatArray) -> FloatArray:
    """R = Rz(yaw) Ry(pitch) Rx(roll), (n, 3, 3), from (n, 3) in deg."""
    angles = np.radians(np.asarray(rpy_deg, dtype=np.float64))
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles).T, np.sin(angles).T
    result = np.empty((len(angles), 3, 3))
    result[:, 0, 0] = cy * cp
    result[:, 0, 1] = cy * sp * sr - sy * cr
    result[:, 0, 2] = cy * sp * cr + sy * sr
    result[:, 1, 0] = sy * cp
    result[:, 1, 1] = sy * sp * sr + cy * cr
    result[:, 1, 2] = sy * sp * cr - cy * sr
    result[:, 2, 0] = -sp
    result[:, 2, 1] = cp * sr
    result[:, 2, 2] = cp * cr
    return result


GIMBAL_COSINE = 1e-9
"""cos(pitch) below which roll and yaw turn about one axis; yaw is then 0 and roll takes all."""


def rpy_from_matrix(rotation: FloatArray) -> tuple[float, float, float]:
    """(roll, pitch, yaw) in deg of R (3, 3): r = atan2(r32, r33), p = atan2(-r31, hypot(r11, r21)),
    y = atan2(r21, r11).

    Thesis 2.1 prints r = atan2(r23, r33); that is the transpose. At pitch = +-90 deg (cos pitch < 1e-9) yaw is 0.
    """
    r11, r12, _, r21, r22, _, r31, r32, r33 = rotation.ravel().tolist()
    cosine = hypot(r11, r21)
    pitch = degrees(atan2(-r31, cosine))
    if cosine < GIMBAL_COSINE:
        return (degrees(atan2(r12, r22) if r31 < 0 else atan2(-r12, r22)), pitch, 0.0)
    return (degrees(atan2(r32, r33)), pitch, degrees(atan2(r21, r11)))


def angle_between_deg(rotation: FloatArray, other: FloatArray) -> float:
    """The angle in deg, 0..180, of the rotation that takes one (3, 3) into the other, exact for small angles too."""
    relative = rotation.T @ other
    sine = 0.5 * hypot(
        relative[2, 1] - relative[1, 2],
        relative[0, 2] - relative[2, 0],
        relative[1, 0] - relative[0, 1],
    )
    return degrees(atan2(sine, 0.5 * (float(np.trace(relative)) - 1.0)))


def angles_between_deg(rotations: FloatArray, others: FloatArray) -> FloatArray:
    """The angles (n,) in deg between rotations (n, 3, 3) and (n, 3, 3); NaN where either is."""
    relative = np.swapaxes(rotations, 1, 2) @ others
    skew = np.stack(
        (
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        )
    )
    sine = 0.5 * np.sqrt((skew * skew).sum(axis=0))
    cosine = 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0)
    result: FloatArray = np.degrees(np.arctan2(sine, cosine))
    return result


def matrix_from_zxz(zxz_deg: VectorLike) -> FloatArray:
    """R = Rz(phi) Rx(theta) Rz(psi), (3, 3), from (phi, theta, psi) in deg."""
    phi, theta, psi = (radians(float(angle)) for angle in zxz_deg)
    c1, s1, c2, s2, c3, s3 = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
    return np.array(
        (
            (c1 * c3 - s1 * c2 * s3, -c1 * s3 - s1 * c2 * c3, s1 * s2),
            (s1 * c3 + c1 * c2 * s3, -s1 * s3 + c1 * c2 * c3, -c1 * s2),
            (s2 * s3, s2 * c3, c2),
        )
    )


def zxz_from_matrix(rotation: FloatArray) -> tuple[float, float, float]:
    """(phi, theta, psi) in deg of R (3, 3), theta in 0..180; where sin theta < 1e-9, psi is 0."""
    r11, _, r13, r21, _, r23, r31, r32, r33 = rotation.ravel().tolist()
    sine = hypot(r31, r32)
    theta = degrees(atan2(sine, r33))
    if sine < GIMBAL_COSINE:
        return (degrees(atan2(r21, r11)), theta, 0.0)
    return (degrees(atan2(r13, -r23)), theta, degrees(atan2(r31, r32)))


def angular_from_rpy_rates(rpy_deg: VectorLike) -> FloatArray:
    """E (3, 3) with omega = E (roll', pitch', yaw'), fixed axes.

    For R = Rz(yaw) Ry(pitch) Rx(roll). Thesis 3.1.2 prints the matrix of another convention, with sin phi in (3,3)
    for cos phi (errata).
    """
    _, pitch, yaw = (radians(float(angle)) for angle in rpy_deg)
    cp, sp, cy, sy = cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    return np.array(((cy * cp, -sy, 0.0), (sy * cp, cy, 0.0), (-sp, 0.0, 1.0)))


def angular_from_zxz_rates(zxz_deg: VectorLike) -> FloatArray:
    """E (3, 3) with omega = E (phi', theta', psi'), fixed axes, for R = Rz(phi) Rx(theta) Rz(psi)."""
    phi, theta, _ = (radians(float(angle)) for angle in zxz_deg)
    c1, s1, c2, s2 = cos(phi), sin(phi), cos(theta), sin(theta)
    return np.array(((0.0, c1, s1 * s2), (0.0, s1, -c1 * s2), (1.0, 0.0, c2)))


def rates_matrix(angular: FloatArray, what: str) -> FloatArray:
    """The inverse of E (3, 3): angle rates from omega. Raises KinematicsError in gimbal lock."""
    if abs(np.linalg.det(angular)) < GIMBAL_COSINE:
        raise KinematicsError(f"{what} rates do not exist in gimbal lock: two of the three axes are one here")
    return np.asarray(np.linalg.inv(angular), dtype=np.float64)

"""Quaternions and angle-axis: what an orientation is interpolated with.

A quaternion is (w, x, y, z), unit length, w >= 0 where it comes from a matrix; q and -q are one rotation.
"""

from __future__ import annotations

from math import acos, copysign, cos, degrees, hypot, radians, sin, sqrt

import numpy as np

from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import FloatArray, VectorLike

Quaternion = tuple[float, float, float, float]

_PARALLEL_DOT = 1.0 - 1e-10
"""Above this dot product slerp's sine loses more digits than the straight line between the two."""


def quaternion_from_matrix(rotation: FloatArray) -> Quaternion:
    """(w, x, y, z) of R (3, 3), through the largest component, so that no digits are lost near half a turn.

    Source: Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1 (1978).

    >>> quaternion_from_matrix(np.eye(3))
    (1.0, 0.0, 0.0, 0.0)
    """
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = rotation.ravel().tolist()
    squares = (1 + r11 + r22 + r33, 1 + r11 - r22 - r33, 1 - r11 + r22 - r33, 1 - r11 - r22 + r33)
    largest = max(range(4), key=lambda index: squares[index])
    double = sqrt(squares[largest])
    half = 0.5 / double
    if largest == 0:
        parts = (0.5 * double, (r32 - r23) * half, (r13 - r31) * half, (r21 - r12) * half)
    elif largest == 1:
        parts = ((r32 - r23) * half, 0.5 * double, (r12 + r21) * half, (r13 + r31) * half)
    elif largest == 2:
        parts = ((r13 - r31) * half, (r12 + r21) * half, 0.5 * double, (r23 + r32) * half)
    else:
        parts = ((r21 - r12) * half, (r13 + r31) * half, (r23 + r32) * half, 0.5 * double)
    sign = copysign(1.0, parts[0])
    w, x, y, z = (sign * part for part in parts)
    return (w, x, y, z)


def matrix_from_quaternion(quaternion: Quaternion) -> FloatArray:
    """R (3, 3) of (w, x, y, z), which is normalised first. Raises KinematicsError for a quaternion of length 0."""
    length = sqrt(sum(part * part for part in quaternion))
    if not length > 0:
        raise KinematicsError(f"{quaternion} is no rotation; give a quaternion (w, x, y, z) of length above 0")
    w, x, y, z = (part / length for part in quaternion)
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )


def matrix_from_axis_angle(axis: VectorLike, angle_deg: float) -> FloatArray:
    """R (3, 3) for a turn by `angle_deg` about `axis` (3,), any length but 0 (Rodrigues).

    >>> np.round(matrix_from_axis_angle((0, 0, 2), 90.0) @ (1.0, 0.0, 0.0), 12).tolist()
    [0.0, 1.0, 0.0]
    """
    x, y, z = (float(part) for part in axis)
    length = hypot(x, y, z)
    if not length > 0:
        raise KinematicsError("a turn needs an axis: give a vector of length above 0")
    half = 0.5 * radians(angle_deg)
    scale = sin(half) / length
    return matrix_from_quaternion((cos(half), x * scale, y * scale, z * scale))


def axis_angle_from_matrix(rotation: FloatArray) -> tuple[FloatArray, float]:
    """Unit axis (3,) and angle in deg, 0..180, of R (3, 3); the axis of no turn is (0, 0, 1)."""
    w, x, y, z = quaternion_from_matrix(rotation)
    sine = hypot(x, y, z)
    if sine < 1e-300:
        return np.array((0.0, 0.0, 1.0)), 0.0
    return np.array((x, y, z)) / sine, degrees(2.0 * np.arctan2(sine, w).item())


def interpolate_rotation(start: FloatArray, end: FloatArray, fractions: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) along the shortest turn from one (3, 3) to the other, at constant rate.

    `fractions` (n,), 0 at the start and 1 at the end. Source: Shoemake, Animating rotation with quaternion curves
    (slerp), 1985. At exactly half a turn there are many shortest turns; one of them is taken.
    """
    first, last = np.array(quaternion_from_matrix(start)), np.array(quaternion_from_matrix(end))
    dot = float(first @ last)
    if dot < 0:
        last, dot = -last, -dot
    u = np.asarray(fractions, dtype=np.float64)[:, None]
    if dot > _PARALLEL_DOT:
        blend = (1 - u) * first + u * last
    else:
        angle = acos(min(dot, 1.0))
        blend = (np.sin((1 - u) * angle) * first + np.sin(u * angle) * last) / sin(angle)
    return np.array([matrix_from_quaternion(tuple(row)) for row in blend.tolist()]).reshape(-1, 3, 3)

"""Jacobians of the tool centre point, and the closed-form inverse of the task Jacobian.

With e = (c1, s1, 0) outward, t = (-s1, c1, 0) sideways and k = (0, 0, 1) up, the tip is p = r e + v t + z k
(`forward`), and each column [z(i-1) x (p - p(i-1)); z(i-1)] (thesis 3.1.1, rows 1 and 2 corrected) becomes

    joint 1   r t - v e                              angular  k
    joint 2   r k - (z - d1) e                       angular  n = (s1, -c1, 0)
    joint 3   (r - a2 c2) k - (z - d1 - a2 s2) e     angular  n
    joint 4   u k - w e                              angular  n
    joint 5   v (c234 e + s234 k) - g t              angular  (s234 c1, s234 s1, -c234)

with g, v, u, w as in `inverse`. Units: mm per rad and rad per rad. The task Jacobian has the rows x, y, z, pitch,
roll: the first three as above, then (0, 1, 1, 1, 0) and (0, 0, 0, 0, 1); its determinant is a2 a3 s3 r up to sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np

from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.forward import joint_rows_of, joints_of
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, JointsLike


def geometric(geometry: ArmGeometry, q_deg: JointsLike) -> FloatArray:
    """The geometric Jacobian (6, 5) at q (5,) deg: linear mm/rad, then angular rad/rad, base frame."""
    columns = _columns(geometry, q_deg)
    c1, s1, c234, s234 = columns[-4:]
    matrix = np.zeros((6, 5))
    matrix[:3] = np.array(columns[0]).reshape(3, 5)
    matrix[3:] = (
        (0.0, s1, s1, s1, s234 * c1),
        (0.0, -c1, -c1, -c1, s234 * s1),
        (1.0, 0.0, 0.0, 0.0, -c234),
    )
    return matrix


def task(geometry: ArmGeometry, q_deg: JointsLike) -> FloatArray:
    """The task Jacobian (5, 5) at q (5,) deg: rows x, y, z (mm/rad), pitch, roll (rad/rad)."""
    matrix = np.empty((5, 5))
    matrix[:3] = np.array(_columns(geometry, q_deg)[0]).reshape(3, 5)
    matrix[3:] = ((0.0, 1.0, 1.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0))
    return matrix


def _columns(geometry: ArmGeometry, q_deg: JointsLike) -> tuple[tuple[float, ...], float, float, float, float]:
    q1, q2, q3, q4, q5 = joints_of(q_deg)
    a1, a2, a23, a234, a5 = radians(q1), radians(q2), radians(q2 + q3), radians(q2 + q3 + q4), radians(q5)
    c1, s1, c234, s234, c5, s5 = cos(a1), sin(a1), cos(a234), sin(a234), cos(a5), sin(a5)
    tx, ty, tz = geometry.tcp_mm
    g = tx * c5 - ty * s5
    v = -(tx * s5 + ty * c5)
    u4, w4 = g * c234 + tz * s234, g * s234 - tz * c234
    u3, w3 = u4 + geometry.a3_mm * cos(a23), w4 + geometry.a3_mm * sin(a23)
    u2, w2 = u3 + geometry.a2_mm * cos(a2), w3 + geometry.a2_mm * sin(a2)
    turn = v * c234
    linear = (
        *(-s1 * u2 - c1 * v, -w2 * c1, -w3 * c1, -w4 * c1, turn * c1 + g * s1),
        *(c1 * u2 - s1 * v, -w2 * s1, -w3 * s1, -w4 * s1, turn * s1 - g * c1),
        *(0.0, u2, u3, u4, v * s234),
    )
    return linear, c1, s1, c234, s234


@dataclass(frozen=True, slots=True)
class _Plane:
    """What the columns are made of, for n configurations at once; each (n,)."""

    c1: FloatArray
    s1: FloatArray
    c2: FloatArray
    s2: FloatArray
    c23: FloatArray
    s23: FloatArray
    c234: FloatArray
    s234: FloatArray
    g: FloatArray
    v: FloatArray
    u: FloatArray
    w: FloatArray
    r: FloatArray

    @classmethod
    def of(cls, geometry: ArmGeometry, q_deg: FloatArray) -> _Plane:
        q = np.radians(joint_rows_of(q_deg))
        q23 = q[:, 1] + q[:, 2]
        q234 = q23 + q[:, 3]
        c234, s234 = np.cos(q234), np.sin(q234)
        c2, c23 = np.cos(q[:, 1]), np.cos(q23)
        tx, ty, tz = geometry.tcp_mm
        c5, s5 = np.cos(q[:, 4]), np.sin(q[:, 4])
        g = tx * c5 - ty * s5
        u = g * c234 + tz * s234
        return cls(
            c1=np.cos(q[:, 0]),
            s1=np.sin(q[:, 0]),
            c2=c2,
            s2=np.sin(q[:, 1]),
            c23=c23,
            s23=np.sin(q23),
            c234=c234,
            s234=s234,
            g=g,
            v=-(tx * s5 + ty * c5),
            u=u,
            w=g * s234 - tz * c234,
            r=geometry.a2_mm * c2 + geometry.a3_mm * c23 + u,
        )


def geometric_rows(geometry: ArmGeometry, q_deg: FloatArray) -> FloatArray:
    """Geometric Jacobians (n, 6, 5) at q (n, 5) deg."""
    plane = _Plane.of(geometry, q_deg)
    matrices = np.zeros((len(plane.c1), 6, 5))
    _fill_linear(geometry, plane, matrices)
    for joint in (1, 2, 3):
        matrices[:, 3, joint] = plane.s1
        matrices[:, 4, joint] = -plane.c1
    matrices[:, 5, 0] = 1.0
    matrices[:, 3, 4] = plane.s234 * plane.c1
    matrices[:, 4, 4] = plane.s234 * plane.s1
    matrices[:, 5, 4] = -plane.c234
    return matrices


def task_rows(geometry: ArmGeometry, q_deg: FloatArray) -> FloatArray:
    """Task Jacobians (n, 5, 5) at q (n, 5) deg."""
    plane = _Plane.of(geometry, q_deg)
    matrices = np.zeros((len(plane.c1), 5, 5))
    _fill_linear(geometry, plane, matrices)
    matrices[:, 3, 1:4] = 1.0
    matrices[:, 4, 4] = 1.0
    return matrices


def _fill_linear(geometry: ArmGeometry, plane: _Plane, matrices: FloatArray) -> None:
    c1, s1, v, g = plane.c1, plane.s1, plane.v, plane.g
    u3, w3 = plane.u + geometry.a3_mm * plane.c23, plane.w + geometry.a3_mm * plane.s23
    w2 = w3 + geometry.a2_mm * plane.s2
    matrices[:, 0, 0] = -s1 * plane.r - c1 * v
    matrices[:, 1, 0] = c1 * plane.r - s1 * v
    for joint, u, w in ((1, plane.r, w2), (2, u3, w3), (3, plane.u, plane.w)):
        matrices[:, 0, joint] = -w * c1
        matrices[:, 1, joint] = -w * s1
        matrices[:, 2, joint] = u
    turn = v * plane.c234
    matrices[:, 0, 4] = turn * c1 + g * s1
    matrices[:, 1, 4] = turn * s1 - g * c1
    matrices[:, 2, 4] = v * plane.s234


def joint_rates_of_task_rows(geometry: ArmGeometry, q_deg: FloatArray, rates: FloatArray) -> FloatArray:
    """Joint rates (n, 5) deg/s for task rates (n, 5): mm/s, mm/s, mm/s, deg/s, deg/s; the inverse in closed form.

    With the tip's rate split along e, t, k:  q1' = t.p'/r,  a2 s3 q2' = c23 R' + s23 Z',
    a3 s3 (q2' + q3') = -(c2 R' + s2 Z'),  q4' = pitch' - q2' - q3',  q5' = roll', where R', Z' are the rates of the
    wrist centre in the arm's plane. Rows at a singularity (s3 = 0 or r = 0) come out infinite or NaN: look at
    `Arm.singularities` first, or use the damped inverses.
    """
    wanted = np.asarray(rates, dtype=np.float64)
    plane = _Plane.of(geometry, q_deg)
    if wanted.shape != (len(plane.c1), 5):
        raise KinematicsError(f"task rates have the shape ({len(plane.c1)}, 5), not {wanted.shape}")
    pitch_rad, roll_rad = np.radians(wanted[:, 3]), np.radians(wanted[:, 4])
    outward = plane.c1 * wanted[:, 0] + plane.s1 * wanted[:, 1] - plane.v * plane.c234 * roll_rad
    sideways = -plane.s1 * wanted[:, 0] + plane.c1 * wanted[:, 1] + plane.g * roll_rad
    up = wanted[:, 2] - plane.v * plane.s234 * roll_rad
    s3 = plane.s23 * plane.c2 - plane.c23 * plane.s2
    with np.errstate(divide="ignore", invalid="ignore"):
        waist = sideways / plane.r
        wrist_out = outward + plane.v * waist + plane.w * pitch_rad
        wrist_up = up - plane.u * pitch_rad
        shoulder = (plane.c23 * wrist_out + plane.s23 * wrist_up) / (geometry.a2_mm * s3)
        forearm = -(plane.c2 * wrist_out + plane.s2 * wrist_up) / (geometry.a3_mm * s3)
    result = np.empty_like(wanted)
    result[:, 0] = waist
    result[:, 1] = shoulder
    result[:, 2] = forearm - shoulder
    result[:, 3] = pitch_rad - forearm
    result[:, 4] = roll_rad
    return np.degrees(result)

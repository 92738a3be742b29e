"""From a path in task space to the joints, with first and second derivatives, in closed form.

The joint angles come from `rm501_host.kinematics`; the derivatives follow by differentiating the chain twice, written
with complex numbers (plane of the floor, then the arm's vertical plane):

    x + i y = exp(i q1) (r + i v)                       v, g: the tool's sideways and forward offset, functions of q5
    r + i (z - d1) = W + exp(i q234) (g - i tz)         W = a2 exp(i q2) + a3 exp(i q23)

    q1' = (Im(exp(-i q1) w') - v') / r
    q2' = Re(conj(u3) W') / (a2 s3)                     q23' = -Re(conj(u2) W') / (a3 s3)

with w = x + i y, u2 = exp(i q2), u3 = exp(i q23), and once more for the second derivatives. They grow without bound
at r = 0 and s3 = 0, as they must.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm

Array = NDArray[np.float64]

_DEG = 180.0 / np.pi
_SMALLEST = 1e-300


def joint_derivatives(arm: Arm, q_deg: Array, y1: Array, y2: Array, xyz_mm: Array) -> tuple[Array, Array]:
    """Joint derivatives q' and q'' in deg per unit of s, (n, 5) each.

    `q_deg` (n, 5): the joints on the path; `y1`, `y2` (n, 5): derivatives of x, y, z (mm), pitch and roll (deg);
    `xyz_mm` (n, 3): the path itself. Infinite or huge at singularities, never an exception.
    """
    geometry = arm.geometry
    tx, ty, tz = geometry.tcp_mm
    a2, a3 = geometry.a2_mm, geometry.a3_mm
    q = q_deg / _DEG
    q2, q23 = q[:, 1], q[:, 1] + q[:, 2]
    tilt = q23 + q[:, 3]
    tilt1, tilt2 = y1[:, 3] / _DEG, y2[:, 3] / _DEG
    roll1, roll2 = y1[:, 4] / _DEG, y2[:, 4] / _DEG
    turn_back = np.exp(-1j * q[:, 0])
    w0 = turn_back * (xyz_mm[:, 0] + 1j * xyz_mm[:, 1])
    w1 = turn_back * (y1[:, 0] + 1j * y1[:, 1])
    w2 = turn_back * (y2[:, 0] + 1j * y2[:, 1])
    r = w0.real
    r = np.where(np.abs(r) < _SMALLEST, _SMALLEST, r)
    forward = np.exp(1j * tilt)
    if tx or ty:
        sideways = np.exp(1j * q[:, 4]) * (tx + 1j * ty)
        # g = Re(sideways), v = -Im(sideways), with tx cos - ty sin and tx sin + ty cos
        side1 = 1j * roll1 * sideways
        side2 = (1j * roll2 - roll1**2) * sideways
        g, g1, g2 = sideways.real, side1.real, side2.real
        v, v1, v2 = -sideways.imag, -side1.imag, -side2.imag
    else:
        g = g1 = g2 = v = v1 = v2 = np.zeros(len(q))
    waist1 = (w1.imag - v1) / r
    r1 = w1.real + waist1 * v
    waist2 = (w2.imag - v2 - 2.0 * waist1 * r1 + waist1**2 * v) / r
    r2 = w2.real + 2.0 * waist1 * v1 + waist2 * v + waist1**2 * w0.real
    hand = g - 1j * tz
    wrist1 = r1 + 1j * y1[:, 2] - forward * (g1 + 1j * tilt1 * hand)
    wrist2 = r2 + 1j * y2[:, 2] - forward * (g2 + 2j * tilt1 * g1 + (1j * tilt2 - tilt1**2) * hand)
    upper, fore = np.exp(1j * q2), np.exp(1j * q23)
    s3 = np.sin(q[:, 2])
    s3 = np.where(np.abs(s3) < _SMALLEST, _SMALLEST, s3)
    shoulder1 = (fore.conj() * wrist1).real / (a2 * s3)
    both1 = -(upper.conj() * wrist1).real / (a3 * s3)
    rest = wrist2 + shoulder1**2 * a2 * upper + both1**2 * a3 * fore
    shoulder2 = (fore.conj() * rest).real / (a2 * s3)
    both2 = -(upper.conj() * rest).real / (a3 * s3)
    first = np.stack((waist1, shoulder1, both1 - shoulder1, tilt1 - both1, roll1), axis=1) * _DEG
    second = np.stack((waist2, shoulder2, both2 - shoulder2, tilt2 - both2, roll2), axis=1) * _DEG
    return first, second


def tool_derivatives(arm: Arm, q_deg: Array, q1_deg: Array, q2_deg: Array) -> tuple[Array, Array]:
    """First and second derivatives of the tool centre point, (n, 3) each, from those of the joints (n, 5).

    The forward direction of the equations above; used for the feed and the TCP acceleration of joint-space paths.
    """
    geometry = arm.geometry
    tx, ty, tz = geometry.tcp_mm
    q, d1, d2 = q_deg / _DEG, q1_deg / _DEG, q2_deg / _DEG
    angle2, angle3 = q[:, 1], q[:, 1] + q[:, 2]
    rate2, rate3 = d1[:, 1], d1[:, 1] + d1[:, 2]
    bend2, bend3 = d2[:, 1], d2[:, 1] + d2[:, 2]
    tilt, tilt1, tilt2 = angle3 + q[:, 3], rate3 + d1[:, 3], bend3 + d2[:, 3]
    sideways = np.exp(1j * q[:, 4]) * (tx + 1j * ty)
    side1 = 1j * d1[:, 4] * sideways
    side2 = (1j * d2[:, 4] - d1[:, 4] ** 2) * sideways
    upper, fore = geometry.a2_mm * np.exp(1j * angle2), geometry.a3_mm * np.exp(1j * angle3)
    forward = np.exp(1j * tilt)
    hand = sideways.real - 1j * tz
    m0 = upper + fore + forward * hand
    m1 = 1j * rate2 * upper + 1j * rate3 * fore + forward * (side1.real + 1j * tilt1 * hand)
    m2 = (
        (1j * bend2 - rate2**2) * upper
        + (1j * bend3 - rate3**2) * fore
        + forward * (side2.real + 2j * tilt1 * side1.real + (1j * tilt2 - tilt1**2) * hand)
    )
    turn = np.exp(1j * q[:, 0])
    floor0 = m0.real - 1j * sideways.imag
    floor1 = m1.real - 1j * side1.imag
    floor2 = m2.real - 1j * side2.imag
    waist1, waist2 = d1[:, 0], d2[:, 0]
    xy1 = turn * (floor1 + 1j * waist1 * floor0)
    xy2 = turn * (floor2 + 2j * waist1 * floor1 + (1j * waist2 - waist1**2) * floor0)
    first = np.stack((xy1.real, xy1.imag, m1.imag), axis=1)
    second = np.stack((xy2.real, xy2.imag, m2.imag), axis=1)
    return first, second

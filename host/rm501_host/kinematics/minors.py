"""The six 5x5 minors of the geometric Jacobian, and the direction that no joint rate can give.

Removing row i from J (6x5) leaves a square matrix with determinant m_i. J loses rank exactly where all six vanish
(thesis 3.3 and appendix A):

    m1 =  K s1 s234                m4 = -K c1 (c234 r0 - g s234^2)
    m2 =  K c1 s234                m5 =  K s1 (c234 r0 - g s234^2)
    m3 =  0                        m6 = -K s234 (r0 + g c234) = -K s234 r,      K = a2 a3 s3

With no tool offset g = 0 and r0 = r, which is the appendix as printed. The vector (m1, -m2, m3, -m4, m5, -m6) is at
right angles to every column of J (each product is the determinant of a matrix with a column twice): the singular
vector. It is the wrench that moves no joint, and its length is the manipulability (Cauchy-Binet).
"""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np

from rm501_host.kinematics.forward import joints_of
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, JointsLike

_SIGNS = np.array((1.0, -1.0, 1.0, -1.0, 1.0, -1.0))


def minors(geometry: ArmGeometry, q_deg: JointsLike) -> FloatArray:
    """The determinants (6,) of J without its row 1..6 at q (5,) deg; mm^2 for rows 1 to 3, mm^3 for rows 4 to 6."""
    q1, q2, q3, q4, q5 = joints_of(q_deg)
    c1, s1 = cos(radians(q1)), sin(radians(q1))
    c234, s234 = cos(radians(q2 + q3 + q4)), sin(radians(q2 + q3 + q4))
    tx, ty, tz = geometry.tcp_mm
    g = tx * cos(radians(q5)) - ty * sin(radians(q5))
    r0 = geometry.a2_mm * cos(radians(q2)) + geometry.a3_mm * cos(radians(q2 + q3)) + tz * s234
    k = geometry.a2_mm * geometry.a3_mm * sin(radians(q3))
    across = c234 * r0 - g * s234 * s234
    return np.array(
        (
            k * s1 * s234,
            k * c1 * s234,
            0.0,
            -k * c1 * across,
            k * s1 * across,
            -k * s234 * (r0 + g * c234),
        )
    )


def singular_vector(geometry: ArmGeometry, q_deg: JointsLike) -> FloatArray:
    """The wrench (6,) with J^T n = 0 at q (5,) deg: forces, then moments; zero where J has lost rank."""
    result: FloatArray = _SIGNS * minors(geometry, q_deg)
    return result

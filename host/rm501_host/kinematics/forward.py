"""Forward kinematics: joint angles to the tool, frame by frame, one pose or many.

With t = (tx, ty, tz) the tool centre point in frame 5, seen from the wrist centre (tz includes d5), and
q23 = q2 + q3, q234 = q2 + q3 + q4, everything lives in the arm's vertical plane (radius r, height z) and one
sideways offset v:

    g = tx c5 - ty s5                     v = -(tx s5 + ty c5)
    r = a2 c2 + a3 c23 + g c234 + tz s234
    z = d1 + a2 s2 + a3 s23 + g s234 - tz c234
    x = c1 r - s1 v                       y = s1 r + c1 v

    R5 = [ s1 s5 + c234 c1 c5,  c5 s1 - c234 c1 s5,  s234 c1 ]
         [ c234 c5 s1 - c1 s5, -c1 c5 - c234 s1 s5,  s234 s1 ]
         [ s234 c5,            -s234 s5,            -c234    ]

Source: the products of the DH matrices (thesis 2.1; its T(1->2) and T(4->5) print 1 for element (3,2), which is 0),
extended by the tool offset.
"""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np

from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, Joints, JointsLike, Pose


def joints_of(q_deg: JointsLike) -> Joints:
    """Five finite floats from anything that holds five numbers; raises KinematicsError."""
    values = q_deg.tolist() if isinstance(q_deg, np.ndarray) else q_deg
    try:
        q1, q2, q3, q4, q5 = map(float, values)
    except (TypeError, ValueError) as error:
        raise KinematicsError("joint angles are five numbers in deg: waist, shoulder, elbow, pitch, roll") from error
    total = q1 + q2 + q3 + q4 + q5
    if total - total != 0.0:
        raise KinematicsError(f"joint angles must be finite numbers, not {(q1, q2, q3, q4, q5)}")
    return (q1, q2, q3, q4, q5)


def joint_rows_of(q_deg: FloatArray) -> FloatArray:
    """The array as float64 (n, 5); raises KinematicsError for another shape."""
    rows = np.asarray(q_deg, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 5:
        raise KinematicsError(f"joint angles have the shape (n, 5), not {rows.shape}")
    return rows


def frozen(array: FloatArray) -> FloatArray:
    """The array, made read-only."""
    array.flags.writeable = False
    return array


def pose(geometry: ArmGeometry, q_deg: JointsLike) -> Pose:
    """The tool's pose for joint angles (5,) in deg; mm and deg, base frame."""
    q1, q2, q3, q4, q5 = joints_of(q_deg)
    pitch_deg = q2 + q3 + q4
    a1, a2, a23, a234, a5 = radians(q1), radians(q2), radians(q2 + q3), radians(pitch_deg), radians(q5)
    c1, s1, c234, s234, c5, s5 = cos(a1), sin(a1), cos(a234), sin(a234), cos(a5), sin(a5)
    tx, ty, tz = geometry.tcp_mm
    g = tx * c5 - ty * s5
    v = -(tx * s5 + ty * c5)
    r = geometry.a2_mm * cos(a2) + geometry.a3_mm * cos(a23) + g * c234 + tz * s234
    z = geometry.d1_mm + geometry.a2_mm * sin(a2) + geometry.a3_mm * sin(a23) + g * s234 - tz * c234
    rotation = np.array(
        (
            (s1 * s5 + c234 * c1 * c5, c5 * s1 - c234 * c1 * s5, s234 * c1),
            (c234 * c5 * s1 - c1 * s5, -c1 * c5 - c234 * s1 * s5, s234 * s1),
            (s234 * c5, -s234 * s5, -c234),
        )
    )
    if geometry.tool_tilt_deg != (0.0, 0.0):
        rotation = rotation @ np.array(geometry.tilt).reshape(3, 3)
    return Pose(frozen(np.array((c1 * r - s1 * v, s1 * r + c1 * v, z))), pitch_deg, q5, q1, frozen(rotation))


def radius_mm(geometry: ArmGeometry, q_deg: Joints) -> float:
    """The signed radius r of the tool centre point in the arm's plane, mm."""
    _, q2, q3, q4, q5 = q_deg
    a234, a5 = radians(q2 + q3 + q4), radians(q5)
    tx, ty, tz = geometry.tcp_mm
    g = tx * cos(a5) - ty * sin(a5)
    planar = geometry.a2_mm * cos(radians(q2)) + geometry.a3_mm * cos(radians(q2 + q3))
    return planar + g * cos(a234) + tz * sin(a234)


def positions_and_rotations(geometry: ArmGeometry, q_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool positions (n, 3) in mm and rotations (n, 3, 3) for joint angles (n, 5) in deg."""
    rows = np.radians(joint_rows_of(q_deg))
    q1, q2, q5 = rows[:, 0], rows[:, 1], rows[:, 4]
    q23 = q2 + rows[:, 2]
    q234 = q23 + rows[:, 3]
    c1, s1, c234, s234, c5, s5 = np.cos(q1), np.sin(q1), np.cos(q234), np.sin(q234), np.cos(q5), np.sin(q5)
    tx, ty, tz = geometry.tcp_mm
    positions = np.empty((len(rows), 3))
    r = geometry.a2_mm * np.cos(q2) + geometry.a3_mm * np.cos(q23) + tz * s234
    z = geometry.d1_mm + geometry.a2_mm * np.sin(q2) + geometry.a3_mm * np.sin(q23) - tz * c234
    if tx or ty:
        g = tx * c5 - ty * s5
        v = -(tx * s5 + ty * c5)
        r += g * c234
        z += g * s234
        positions[:, 0] = c1 * r - s1 * v
        positions[:, 1] = s1 * r + c1 * v
    else:
        np.multiply(c1, r, out=positions[:, 0])
        np.multiply(s1, r, out=positions[:, 1])
    positions[:, 2] = z
    rotations = np.empty((len(rows), 3, 3))
    c234c1, c234s1 = c234 * c1, c234 * s1
    rotations[:, 0, 0] = s1 * s5 + c234c1 * c5
    rotations[:, 0, 1] = s1 * c5 - c234c1 * s5
    rotations[:, 0, 2] = s234 * c1
    rotations[:, 1, 0] = c234s1 * c5 - c1 * s5
    rotations[:, 1, 1] = -c1 * c5 - c234s1 * s5
    rotations[:, 1, 2] = s234 * s1
    rotations[:, 2, 0] = s234 * c5
    rotations[:, 2, 1] = -s234 * s5
    rotations[:, 2, 2] = -c234
    if geometry.tool_tilt_deg != (0.0, 0.0):
        rotations = rotations @ np.array(geometry.tilt).reshape(3, 3)
    return positions, rotations


def dh_matrix(theta_rad: float, d_mm: float, a_mm: float, alpha_rad: float) -> FloatArray:
    """One standard DH transform (4, 4), mm: Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    ct, st, ca, sa = cos(theta_rad), sin(theta_rad), cos(alpha_rad), sin(alpha_rad)
    return np.array(
        (
            (ct, -st * ca, st * sa, a_mm * ct),
            (st, ct * ca, -ct * sa, a_mm * st),
            (0.0, sa, ca, d_mm),
            (0.0, 0.0, 0.0, 1.0),
        )
    )


def frames(geometry: ArmGeometry, q_deg: JointsLike) -> FloatArray:
    """Frames 0..5 and the tool frame in the base frame: (7, 4, 4), lengths in mm, by multiplying DH matrices.

    This is the literal product of thesis 2.1, and the independent check of the closed form in `pose`.
    """
    q = [radians(angle) for angle in joints_of(q_deg)]
    right_rad = radians(90.0)
    links = (
        dh_matrix(q[0], geometry.d1_mm, 0.0, right_rad),
        dh_matrix(q[1], 0.0, geometry.a2_mm, 0.0),
        dh_matrix(q[2], 0.0, geometry.a3_mm, 0.0),
        dh_matrix(q[3], 0.0, 0.0, right_rad),
        dh_matrix(q[4], geometry.d5_mm, 0.0, 0.0),
        tool_matrix(geometry),
    )
    chain = np.empty((7, 4, 4))
    chain[0] = np.eye(4)
    for index, link in enumerate(links):
        chain[index + 1] = chain[index] @ link
    return chain


def tool_matrix(geometry: ArmGeometry) -> FloatArray:
    """The tool frame in frame 5, (4, 4), mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(geometry.tilt).reshape(3, 3)
    matrix[:3, 3] = geometry.tool_mm
    return matrix

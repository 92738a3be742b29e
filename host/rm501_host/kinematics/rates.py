"""Second order and analytical Jacobians: how the Jacobian changes, and the rates of roll-pitch-yaw and Euler angles."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np

from rm501_host.kinematics import forward, jacobian, rotations
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, JointsLike


def analytical_rpy(geometry: ArmGeometry, q_deg: JointsLike, frame: FloatArray | None = None) -> FloatArray:
    """Analytical Jacobian (6, 5): rates of x, y, z (mm/rad) and of roll, pitch, yaw of the tool (rad/rad).

    J_A = blockdiag(I, E^-1) J (thesis 3.1.2, E corrected). `frame` (3, 3), a rotation in the base frame, gives the
    rates in that frame instead (the program's). Raises KinematicsError in gimbal lock.
    """
    rotation = forward.pose(geometry, q_deg).rotation
    matrix = jacobian.geometric(geometry, q_deg)
    if frame is not None:
        rotation = frame.T @ rotation
        matrix[:3], matrix[3:] = frame.T @ matrix[:3], frame.T @ matrix[3:]
    angular = rotations.angular_from_rpy_rates(rotations.rpy_from_matrix(rotation))
    matrix[3:] = rotations.rates_matrix(angular, "roll-pitch-yaw") @ matrix[3:]
    return matrix


def analytical_zxz(geometry: ArmGeometry, q_deg: JointsLike) -> FloatArray:
    """Analytical Jacobian (6, 5): rates of x, y, z (mm/rad) and of the tool's zxz Euler angles (rad/rad).

    Raises KinematicsError where theta is 0 or 180 deg: the tool straight up or down.
    """
    matrix = jacobian.geometric(geometry, q_deg)
    angles = rotations.zxz_from_matrix(forward.pose(geometry, q_deg).rotation)
    angular = rotations.angular_from_zxz_rates(angles)
    matrix[3:] = rotations.rates_matrix(angular, "zxz Euler") @ matrix[3:]
    return matrix


def jacobian_rate(geometry: ArmGeometry, q_deg: JointsLike, rates_deg_s: JointsLike) -> FloatArray:
    """dJ/dt (6, 5) of the geometric Jacobian at q (5,) deg moving at (5,) deg/s: mm/rad/s and rad/rad/s.

    The product rule on J_i = [z x (p - o); z]: z' = omega x z, (p - o)' = p' - o', with the velocities of the axes'
    origins summed up joint by joint.
    """
    chain = forward.frames(geometry, q_deg)
    rates = np.radians(np.asarray(forward.joints_of(rates_deg_s)))
    tip = chain[6, :3, 3]
    axes, origins = chain[:5, :3, 2], chain[:5, :3, 3]
    omega = np.zeros((5, 3))  # of the body that carries axis i: it is turned by joints 0..i-1
    for joint in range(1, 5):
        omega[joint] = omega[joint - 1] + axes[joint - 1] * rates[joint - 1]
    origin_rates = np.array([_velocity(axes, origins, rates, origins[joint], joint) for joint in range(5)])
    tip_rate = _velocity(axes, origins, rates, tip, 5)
    axis_rates = np.cross(omega, axes)
    result = np.empty((6, 5))
    result[:3] = (np.cross(axis_rates, tip - origins) + np.cross(axes, tip_rate - origin_rates)).T
    result[3:] = axis_rates.T
    return result


def _velocity(axes: FloatArray, origins: FloatArray, rates: FloatArray, point: FloatArray, joints: int) -> FloatArray:
    """Velocity (3,) of a point that the first `joints` joints carry."""
    total = np.zeros(3)
    for joint in range(joints):
        total = total + rates[joint] * np.cross(axes[joint], point - origins[joint])
    return total


def task_bias_rows(geometry: ArmGeometry, q_deg: FloatArray, rates_deg_s: FloatArray) -> FloatArray:
    """(n, 5): the part J' q' of the task acceleration that needs no joint acceleration; mm/s2 and deg/s2.

    With p = r e + v t + z k and e' = q1' t, t' = -q1' e:
    p'' = (r'' - 2 v' q1' - r q1'^2) e + (v'' + 2 r' q1' - v q1'^2) t + z'' k, each second derivative taken at
    q'' = 0. Pitch and roll are linear in the joints, so their part is 0. Joint accelerations along a path follow as
    `joint_rates_of_task_rows(q, path acceleration - bias)`.
    """
    q = np.radians(forward.joint_rows_of(q_deg))
    rates = np.radians(forward.joint_rows_of(rates_deg_s))
    if q.shape != rates.shape:
        raise KinematicsError(f"joint angles {q.shape} and rates {rates.shape} must have one shape")
    tx, ty, tz = geometry.tcp_mm
    a2, a3 = geometry.a2_mm, geometry.a3_mm
    q2, q23 = q[:, 1], q[:, 1] + q[:, 2]
    q234 = q23 + q[:, 3]
    w1, w2, w5 = rates[:, 0], rates[:, 1], rates[:, 4]
    w23 = w2 + rates[:, 2]
    w234 = w23 + rates[:, 3]
    c, s, c5, s5 = np.cos(q234), np.sin(q234), np.cos(q[:, 4]), np.sin(q[:, 4])
    g, v = tx * c5 - ty * s5, -(tx * s5 + ty * c5)
    g_rate, v_rate = v * w5, -g * w5
    g_bias, v_bias = -g * w5 * w5, -v * w5 * w5
    u, w = g * c + tz * s, g * s - tz * c
    r = a2 * np.cos(q2) + a3 * np.cos(q23) + u
    r_rate = -a2 * np.sin(q2) * w2 - a3 * np.sin(q23) * w23 + g_rate * c - w * w234
    r_bias = (
        -a2 * np.cos(q2) * w2 * w2 - a3 * np.cos(q23) * w23 * w23 + g_bias * c - 2 * g_rate * s * w234 - u * w234 * w234
    )
    z_bias = (
        -a2 * np.sin(q2) * w2 * w2 - a3 * np.sin(q23) * w23 * w23 + g_bias * s + 2 * g_rate * c * w234 - w * w234 * w234
    )
    outward = r_bias - 2 * v_rate * w1 - r * w1 * w1
    sideways = v_bias + 2 * r_rate * w1 - v * w1 * w1
    c1, s1 = np.cos(q[:, 0]), np.sin(q[:, 0])
    result = np.zeros_like(q)
    result[:, 0] = outward * c1 - sideways * s1
    result[:, 1] = outward * s1 + sideways * c1
    result[:, 2] = z_bias
    return result


def task_rates_of_twist(q_deg: JointsLike, waist_rate_deg_s: float, omega_deg_s: FloatArray) -> tuple[float, float]:
    """Pitch and roll rates, deg/s, of a tool that turns at omega (3,) deg/s while the waist turns.

    omega = q1' k + pitch' n + roll' a, with n = (s1, -c1, 0) and the approach a at right angles to n, so
    pitch' = omega.n and roll' = (omega - q1' k).a.
    """
    q1, q2, q3, q4, _ = forward.joints_of(q_deg)
    c1, s1 = cos(radians(q1)), sin(radians(q1))
    c234, s234 = cos(radians(q2 + q3 + q4)), sin(radians(q2 + q3 + q4))
    wx, wy, wz = (float(part) for part in omega_deg_s)
    pitch_rate = wx * s1 - wy * c1
    roll_rate = wx * s234 * c1 + wy * s234 * s1 - (wz - waist_rate_deg_s) * c234
    return pitch_rate, roll_rate

"""How fast a path could be passed at best: the judge's own phase plane, nothing of the planner's time law.

Along q(t) the limits are |a_i u + b_i x| <= c_i with a = R q', b = R q'', x the squared speed of the parameter, u half
its slope; R stacks joints and motors. On a fine grid: x below the maximum velocity curve and the caps of rates and
feed; backwards the largest deceleration, forwards the largest acceleration, both by explicit steps (Bobrow, Dubowsky
and Gibson 1985). Where the maximum velocity curve itself cannot be followed this is faster than any law, so it stays a
bound.
"""

from __future__ import annotations

import numpy as np

from rm501_host.config import Config

from .judge_arm import Array, JudgeArm
from .judge_program import Way
from .plan_checker import motor_matrix


def joints_of(arm: JudgeArm, task: Array, near_deg: Array) -> Array:
    """Joints (n, 5) of x, y, z, pitch, roll (n, 5) on the branch of `near_deg` (5,), continuous from row to row."""
    tx, ty, tz = arm.tool
    pitch, roll = np.radians(task[:, 3]), np.radians(task[:, 4])
    v = -(np.sin(roll) * tx + np.cos(roll) * ty)
    unturned = near_deg.copy()
    unturned[0] = 0.0
    side = 1.0 if arm.places(unturned[None])[0, 0] >= 0.0 else -1.0
    r = side * np.sqrt(task[:, 0] ** 2 + task[:, 1] ** 2 - v * v)
    q1 = np.unwrap(np.arctan2(task[:, 1], task[:, 0]) - np.arctan2(v, r))
    along = np.cos(roll) * tx - np.sin(roll) * ty
    wr = r - np.cos(pitch) * along - np.sin(pitch) * tz
    wz = task[:, 2] - arm.d1 - np.sin(pitch) * along + np.cos(pitch) * tz
    cosine = (wr * wr + wz * wz - arm.a2**2 - arm.a3**2) / (2.0 * arm.a2 * arm.a3)
    q3 = np.arccos(np.clip(cosine, -1.0, 1.0)) * (1.0 if near_deg[2] > 0.0 else -1.0)
    q2 = np.arctan2(wz, wr) - np.arctan2(arm.a3 * np.sin(q3), arm.a2 + arm.a3 * np.cos(q3))
    first = np.degrees(q1) + 360.0 * np.round((near_deg[0] - np.degrees(q1[0])) / 360.0)
    q2, q3 = np.degrees(q2), np.degrees(q3)
    return np.stack((first, q2, q3, task[:, 3] - q2 - q3, task[:, 4]), axis=1)


def bound_s(config: Config, way: Way, count: int = 4000) -> float:
    """Seconds from rest to rest along a way under all limits and its feed, at best."""
    step = 1.0 / count
    t = np.linspace(0.0, 1.0, count + 1)
    h = 0.5 * step
    inside = np.clip(t, h, 1.0 - h)

    def joints(at: Array) -> Array:
        return way.at(at) if way.is_joint else joints_of(way.arm, way.at(at), way.start_deg)

    low, middle, high = joints(inside - h), joints(inside), joints(inside + h)
    q1, q2 = (high - low) / (2.0 * h), (high - 2.0 * middle + low) / h**2
    tool = np.linalg.norm(way.arm.places(high) - way.arm.places(low), axis=1) / (2.0 * h)
    turn = np.linalg.norm(np.stack((q1[:, 1:4].sum(axis=1), q1[:, 4]), axis=1), axis=1)
    drives, axes = config.motors.ordered, config.joints.ordered
    rows = np.concatenate((np.eye(5), motor_matrix(config)))
    rates = np.array([j.max_velocity_deg_s for j in axes] + [m.max_rate_steps_s for m in drives])
    limits = np.array(
        [j.max_acceleration_deg_s2 for j in axes] + [m.max_acceleration_deg_s2 * m.steps_per_deg for m in drives]
    )
    with np.errstate(divide="ignore"):
        cap = (1.0 / (np.abs(q1 @ rows.T) / rates).max(axis=1)) ** 2
        if np.isfinite(way.speed_mm_s):
            cap = np.minimum(cap, (way.speed_mm_s / tool) ** 2)
        if np.isfinite(way.turn_deg_s):
            cap = np.minimum(cap, (way.turn_deg_s / turn) ** 2)
    a, b = q1 @ rows.T / limits, q2 @ rows.T / limits
    top = _velocity_curve(a, b, np.minimum(cap, 1e12))
    back = np.zeros(count + 1)
    for k in range(count, 0, -1):
        slowing = _range(a[k], b[k], back[k])[0]
        back[k - 1] = min(top[k - 1], back[k] - 2.0 * step * slowing)
    x = np.zeros(count + 1)
    for k in range(count):
        x[k + 1] = min(back[k + 1], max(0.0, x[k] + 2.0 * step * _range(a[k], b[k], x[k])[1]))
    roots = np.sqrt(x)
    return float((2.0 * step / (roots[1:] + roots[:-1])).sum())


def _range(a: Array, b: Array, x: float) -> tuple[float, float]:
    """Least and largest u with |a u + b x| <= 1 for all rows (without the rows that do not see u)."""
    used = np.abs(a) > 1e-12
    middle, half = -b[used] * x / a[used], 1.0 / np.abs(a[used])
    return float((middle - half).max()), float((middle + half).min())


def _velocity_curve(a: Array, b: Array, cap: Array) -> Array:
    """The largest x (n,) at which some u is left, by bisection."""
    used = np.abs(a) > 1e-12
    safe = np.where(used, a, 1.0)
    half = np.where(used, 1.0 / np.abs(safe), np.inf)

    def is_possible(x: Array) -> Array:
        middle = np.where(used, -b * x[:, None] / safe, 0.0)
        alone = (np.abs(b * x[:, None]) <= 1.0) | used
        return np.asarray(((middle - half).max(axis=1) <= (middle + half).min(axis=1)) & alone.all(axis=1))

    low, high = np.zeros(len(cap)), cap.copy()
    fine = is_possible(high)
    low[fine] = high[fine]
    for _ in range(60):
        middle = 0.5 * (low + high)
        good = is_possible(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return low

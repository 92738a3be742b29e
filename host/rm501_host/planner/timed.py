"""Externally timed joint trajectories: positions, velocities and times, as MoveIt sends them; checked, then played.

Between two points each joint follows the cubic through their positions and velocities (the parabola-free natural
choice of ros_control), so positions and velocities are met exactly. What would break a limit anywhere is refused with
the time, the joint and the ratio; `stretched` gives the least slowing that makes it legal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import JOINT_NAMES, MOTOR_NAMES, Config
from rm501_host.kinematics import Arm
from rm501_host.moves import Source

from .elements import Array
from .errors import JointLimitError, PlanError
from .limits import Limits
from .pieces import Piece, PieceKind

TIMED_SOURCE = Source("(trajectory)", 0)
_TOLERANCE = 1e-6
START_TOLERANCE_DEG = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class TimedLaw:
    """Cubics between points: `times_s` (n,), `points_deg` (n, 5), `velocities_deg_s` (n, 5)."""

    times_s: Array
    points_deg: Array
    velocities_deg_s: Array

    def _cubics(self, time_s: Array) -> tuple[Array, Array, Array, Array, Array]:
        t = np.clip(time_s, 0.0, self.times_s[-1])
        k = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(self.times_s) - 2)
        h = np.diff(self.times_s)[k][:, None]
        tau = (t - self.times_s[k])[:, None]
        q0, q1 = self.points_deg[k], self.points_deg[k + 1]
        v0, v1 = self.velocities_deg_s[k], self.velocities_deg_s[k + 1]
        chord = (q1 - q0) / h
        c2, c3 = (3.0 * chord - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * chord) / (h * h)
        return tau, q0, v0, c2, c3

    def q_deg(self, time_s: Array) -> Array:
        """Joint angles (n, 5)."""
        tau, q0, v0, c2, c3 = self._cubics(time_s)
        return q0 + tau * (v0 + tau * (c2 + tau * c3))

    def states(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Joint angles, rates, accelerations, each (n, 5)."""
        tau, q0, v0, c2, c3 = self._cubics(time_s)
        still = (time_s > self.times_s[-1])[:, None]
        rates = np.where(still, 0.0, v0 + tau * (2.0 * c2 + 3.0 * tau * c3))
        return q0 + tau * (v0 + tau * (c2 + tau * c3)), rates, np.where(still, 0.0, 2.0 * c2 + 6.0 * tau * c3)

    def lines(self, time_s: Array) -> NDArray[np.int64]:
        """The number (from 1) of the point that is being gone to, (n,)."""
        k = np.clip(np.searchsorted(self.times_s, time_s, side="right"), 1, len(self.times_s) - 1)
        result: NDArray[np.int64] = k.astype(np.int64)
        return result

    def kinks_s(self) -> tuple[Array, Array]:
        """The inner points: accelerations may jump there."""
        inner = self.times_s[1:-1]
        return inner, np.zeros(len(inner))

    def worst(self, limits: Limits) -> tuple[float, float, str, float]:
        """Largest velocity and acceleration ratio, and what reaches the worse of them when.

        Exact: a cubic's velocity is extreme at its ends and where its acceleration is 0, its acceleration at its ends.
        """
        h = np.diff(self.times_s)[:, None]
        chord = np.diff(self.points_deg, axis=0) / h
        v0, v1 = self.velocities_deg_s[:-1], self.velocities_deg_s[1:]
        c2, c3 = (3.0 * chord - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * chord) / (h * h)
        rows = limits.rows.T
        a0, a1 = (2.0 * c2) @ rows, (2.0 * c2 + 6.0 * h * c3) @ rows
        start, end, cubic = v0 @ rows, v1 @ rows, (6.0 * c3) @ rows
        turn = np.clip(np.where(np.abs(cubic) > 1e-12, -a0 / np.where(cubic == 0.0, 1.0, cubic), 0.0), 0.0, h)
        middle = start + turn * (a0 + 0.5 * turn * cubic)
        velocity = np.maximum(np.maximum(np.abs(start), np.abs(end)), np.abs(middle)) / limits.velocity
        acceleration = np.maximum(np.abs(a0), np.abs(a1)) / limits.acceleration
        larger = np.maximum(velocity, acceleration)
        k, row = np.unravel_index(int(np.argmax(larger)), larger.shape)
        name = JOINT_NAMES[row] if row < 5 else f"{MOTOR_NAMES[row - 2]} motor"
        return float(velocity.max()), float(acceleration.max()), name, float(self.times_s[k])


def plan_timed(
    arm: Arm,
    config: Config,
    start_deg: Sequence[float] | Array,
    points_deg: Sequence[Sequence[float]] | Array,
    times_s: Sequence[float] | Array,
    velocities_deg_s: Sequence[Sequence[float]] | Array | None = None,
    *,
    source: Source = TIMED_SOURCE,
    start_s: float = 0.0,
    stretch: bool = False,
) -> tuple[Piece, ...]:
    """The piece that plays a timed trajectory from `start_deg`, from rest to rest.

    `points_deg` (n, 5) at `times_s` (n,), from 0 or later, rising; a first point at time 0 must be where the arm is.
    Without `velocities_deg_s` (n, 5) they are those of a spline at rest at both ends. `stretch`: slow an illegal
    trajectory down instead of refusing it. Raises PlanError (times, shapes, start, limits), JointLimitError.
    """
    points, times = np.array(points_deg, dtype=np.float64), np.array(times_s, dtype=np.float64)
    start = np.array(start_deg, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 5 or times.shape != (len(points),) or not len(points):
        raise PlanError("a trajectory is n points of five joints and n times", source=source)
    if not (np.isfinite(points).all() and np.isfinite(times).all()):
        raise PlanError("a trajectory holds numbers that are not finite", source=source)
    if times[0] > 0.0:
        points, times = np.concatenate((start[None], points)), np.concatenate((np.zeros(1), times))
        padded = velocities_deg_s is not None
    else:
        padded = False
    if len(times) < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
        raise PlanError("the times of a trajectory must rise from 0 or later", source=source)
    apart = float(np.abs(points[0] - start).max())
    if apart > START_TOLERANCE_DEG:
        raise PlanError(
            f"the trajectory starts {apart:.4g} deg away from where the arm is",
            source=source,
            amount=apart,
            remedy="start it at the arm's present joints",
        )
    points[0] = start
    if velocities_deg_s is None:
        from .profiles import via_spline

        columns = [via_spline(points[:, joint].tolist(), times.tolist()).evaluate(times, 1) for joint in range(5)]
        velocities = np.stack(columns, axis=1)
        velocities[[0, -1]] = 0.0
    else:
        velocities = np.array(velocities_deg_s, dtype=np.float64)
        if padded:
            velocities = np.concatenate((np.zeros((1, 5)), velocities))
        if velocities.shape != points.shape or not np.isfinite(velocities).all():
            raise PlanError("the velocities of a trajectory are as many as its points", source=source)
        if np.abs(velocities[[0, -1]]).max() > 1e-6:
            raise PlanError("a trajectory starts and ends at rest", source=source, remedy="end it with velocity 0")
    limits = Limits.from_config(config)
    law = TimedLaw(times, points, velocities)
    _check_ranges(law, limits, source)
    velocity, acceleration, name, when = law.worst(limits)
    factor = max(velocity, acceleration**0.5)
    if factor > 1.0 + _TOLERANCE:
        if not stretch:
            raise PlanError(
                f"the trajectory asks {max(velocity, acceleration):.4g} x the limit of the {name} at {when:.3f} s",
                source=source,
                amount=max(velocity, acceleration),
                remedy=f"stretch its times by {factor:.4g}",
            )
        law = TimedLaw(times * (factor * 1.000001), points, velocities / (factor * 1.000001))
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    duration = ceil(float(law.times_s[-1]) / frame_s - 1e-6) * frame_s
    slower = duration / float(law.times_s[-1])
    law = TimedLaw(law.times_s * slower, points, law.velocities_deg_s / slower)
    return (
        Piece(
            PieceKind.MOTION,
            source,
            start_s,
            duration,
            tuple(points[-1].tolist()),
            law=law,
            motion_s=duration,
            arm=arm,
        ),
    )


def _check_ranges(law: TimedLaw, limits: Limits, source: Source) -> None:
    count = max(64, int(law.times_s[-1] / 1e-3))
    t = np.unique(np.concatenate((law.times_s, np.linspace(0.0, law.times_s[-1], count))))
    q_deg = law.q_deg(t)
    beyond = np.maximum(limits.min_deg - q_deg, q_deg - limits.max_deg)
    if float(beyond.max()) <= 1e-6:
        return
    at, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    raise JointLimitError(
        f"{JOINT_NAMES[joint]} would leave its range by {beyond[at, joint]:.4g} deg at {t[at]:.3f} s",
        source=source,
        q_deg=tuple(q_deg[at].tolist()),
        amount=float(beyond[at, joint]),
        remedy="keep the trajectory within the joint limits",
    )

"""Velocity control of the tool through singularities: for commands that cannot be planned ahead (joystick, sensor).

Every step: weigh the task Jacobian, damp it, then shorten the joint rates as a whole until no joint and no motor is
above its limit. Shortening keeps the direction in joint space, so the tool slows down rather than leaving its way.
A joint that would pass the end of its range within the period stops there, alone; the others go on and the error
says what that costs. Rates are bounded here, accelerations are not: that is the business of whoever times the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rm501_host.kinematics import forward, jacobian
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.motors import Polytope
from rm501_host.kinematics.results import FloatArray, Joints, JointsLike
from rm501_host.kinematics.velocity_inverse import (
    Damping,
    DampingLaw,
    Weights,
    damped_rates,
    filtered_rates,
    pseudo_inverse_rates,
    selective_rates,
    transpose_rates,
    weighted_manipulability,
)

Inverse = Callable[[FloatArray, FloatArray], FloatArray]
"""Weighted Jacobian (m, 5) and weighted velocity (m,) to weighted joint rates (5,)."""


@dataclass(frozen=True, slots=True, eq=False)
class ControlStep:
    """One step of velocity control.

    `rates_deg_s` (5,) are inside every limit; `scale` (0..1] is how much they were shortened for that;
    `error` (5,) is what the tool does not do of what it was asked: mm/s, mm/s, mm/s, deg/s, deg/s.
    """

    rates_deg_s: FloatArray
    scale: float
    damping: float
    error: FloatArray


class VelocityController:
    """Joint rates for tool rates (x, y, z, pitch, roll), inside the limits, through singularities.

    With `damping` None the pseudo-inverse is used, which is exact and, near a singularity, slows the tool to a
    crawl. The state is the manipulability of the step before (RATE_OF_CHANGE); `reset` forgets it.
    """

    def __init__(
        self, geometry: ArmGeometry, limits: Polytope, damping: Damping | None, weights: Weights | None = None
    ) -> None:
        self._geometry = geometry
        self._limits = limits
        self._damping = damping
        self._weights = default_weights(geometry) if weights is None else weights
        self._before: float | None = None
        self._low, self._high = np.array(geometry.min_deg), np.array(geometry.max_deg)

    def reset(self) -> None:
        """Forget the step before."""
        self._before = None

    def step(self, q_deg: JointsLike, task_rates: FloatArray, period_s: float) -> ControlStep:
        """Joint rates at q (5,) deg for x', y', z' in mm/s, pitch', roll' in deg/s (5,), to be held for `period_s`.

        Raises KinematicsError for rates that are not five finite numbers, or a period that is not above 0.
        """
        if not period_s > 0:
            raise KinematicsError(f"the period must be above 0 s, not {period_s}")
        wanted = np.asarray(task_rates, dtype=np.float64)
        if wanted.shape != (5,) or not np.isfinite(wanted).all():
            raise KinematicsError(f"tool rates are five finite numbers (mm/s, deg/s), not {task_rates}")
        wanted_rad = wanted.copy()
        wanted_rad[3:] = np.radians(wanted[3:])
        matrix = jacobian.task(self._geometry, q_deg)
        a, b = self._weights.apply(matrix, wanted_rad)
        factor = 0.0
        if self._damping is not None:
            manipulability = weighted_manipulability(a)
            factor = self._damping.factor(manipulability, self._before)
            self._before = manipulability
        rates = np.degrees(self._weights.rates(damped_rates(a, b, factor)))
        ratio = float(self._limits.ratio(rates))
        scale = 1.0 if ratio <= 1.0 else 1.0 / ratio
        rates = rates * scale
        q = np.array(forward.joints_of(q_deg))
        lowest = np.minimum(self._low - q, 0.0) / period_s
        highest = np.maximum(self._high - q, 0.0) / period_s
        rates = np.clip(rates, lowest, highest)
        done = matrix @ np.radians(rates)
        done[3:] = np.degrees(done[3:])
        return ControlStep(rates, scale, factor, wanted - done)


def default_weights(geometry: ArmGeometry) -> Weights:
    """1 over reach/10 mm and 0.1 rad for the task (a tenth of the arm counts as a tenth of a rad), 1 for joints."""
    length_mm = geometry.reach_mm
    return Weights(np.array((1 / length_mm, 1 / length_mm, 1 / length_mm, 1.0, 1.0)), np.ones(5))


def default_damping() -> Damping:
    """Damping by manipulability for `default_weights`: measured on the passages of docs/kinematics.md."""
    return Damping(DampingLaw.MANIPULABILITY, largest=0.05, threshold=0.02)


def jog_damping() -> Damping:
    """Damping of jogs, whose way is known ahead and timed under every limit: a smaller zone than for blind control.

    With w0 = 0.002 it begins about 6 mm from the waist axis and 1.5 deg from the stretched arm; l0 = 0.01 bounds the
    joints to 6 deg for each mm of the way: 5 mm/s are left of a jog where the waist has to turn at 30 deg/s.
    """
    return Damping(DampingLaw.MANIPULABILITY, largest=0.01, threshold=0.002)


METHODS: dict[str, Inverse] = {
    "transpose": transpose_rates,
    "pseudo_inverse": pseudo_inverse_rates,
    "damped": lambda a, b: damped_rates(a, b, 0.05),
    "filtered": lambda a, b: filtered_rates(a, b, 0.05, 0.1),
    "selective": lambda a, b: selective_rates(a, b, np.pi / 4),
}
"""The inverses by name with settings for `default_weights`, for comparison and for `solve_iteratively`."""


@dataclass(frozen=True, slots=True)
class IterativeResult:
    """Where an iteration ended: joints (5,) deg, steps taken, and what is left: mm and deg."""

    q_deg: Joints
    steps: int
    position_error_mm: float
    angle_error_deg: float


def solve_iteratively(
    geometry: ArmGeometry,
    xyz_mm: FloatArray,
    pitch_deg: float,
    roll_deg: float,
    start_deg: JointsLike,
    inverse: Inverse,
    *,
    max_steps: int = 500,
    tolerance_mm: float = 1e-10,
) -> IterativeResult:
    """Inverse kinematics by Newton-like steps from `start_deg` (5,): the iterative methods of thesis 3.2.

    Knows nothing of the closed form, limits or branches: the independent check of `Arm.ik`, and for a target that
    cannot be reached the place where a method comes to rest.
    """
    weights = default_weights(geometry)
    q = np.array(forward.joints_of(start_deg))
    target = np.asarray(xyz_mm, dtype=np.float64)
    error = np.empty(5)
    for count in range(max_steps + 1):
        pose = forward.pose(geometry, q)
        error[:3] = target - pose.xyz_mm
        error[3:] = np.radians((pitch_deg - pose.pitch_deg, roll_deg - pose.roll_deg))
        left_mm = float(np.linalg.norm(error[:3]))
        left_deg = float(np.degrees(np.abs(error[3:]).max()))
        if (left_mm <= tolerance_mm and left_deg <= tolerance_mm) or count == max_steps:
            break
        a, b = weights.apply(jacobian.task(geometry, q), error)
        q = q + np.degrees(weights.rates(inverse(a, b)))
    return IterativeResult(forward.joints_of(q), count, left_mm, left_deg)

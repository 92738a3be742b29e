"""Textbook profiles for single joint moves (thesis 4.1 and appendix B, corrected): cubic, quintic, LSPB, splines.

Each gives q(t) of one joint from 0 to its duration. The planner itself moves by the time-optimal law; these are for
comparison, for teaching, and for whoever wants a given duration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PiecewisePolynomial:
    """q(t) = sum c_k (t - t_i)^k on pieces [t_i, t_{i+1}]; `breaks_s` (n + 1,), `coefficients` (n, degree + 1)."""

    breaks_s: Array
    coefficients: Array

    @property
    def duration_s(self) -> float:
        """The end of the last piece."""
        return float(self.breaks_s[-1])

    def evaluate(self, time_s: Array, order: int = 0) -> Array:
        """The `order`-th derivative at the times given, in deg/s^order; times are clipped to the profile."""
        t = np.clip(np.asarray(time_s, dtype=np.float64), self.breaks_s[0], self.breaks_s[-1])
        piece = np.clip(np.searchsorted(self.breaks_s, t, side="right") - 1, 0, len(self.coefficients) - 1)
        tau = t - self.breaks_s[piece]
        c = self.coefficients[piece]
        for _ in range(order):
            c = c[:, 1:] * np.arange(1, c.shape[1])
        result = np.zeros(len(t))
        for k in range(c.shape[1] - 1, -1, -1):
            result = result * tau + c[:, k]
        return result


def cubic(q0_deg: float, qf_deg: float, duration_s: float, v0: float = 0.0, vf: float = 0.0) -> PiecewisePolynomial:
    """Positions and speeds at both ends. a2 = (3 (qf - q0) - (2 v0 + vf) D) / D^2, a3 = (2 (q0 - qf) + (v0 + vf) D) /
    D^3 (appendix B prints v0 twice in a3). Raises ValueError for a duration that is not above 0.
    """
    _check(duration_s)
    d = duration_s
    step = qf_deg - q0_deg
    row = (q0_deg, v0, (3.0 * step - (2.0 * v0 + vf) * d) / d**2, (-2.0 * step + (v0 + vf) * d) / d**3)
    return PiecewisePolynomial(np.array((0.0, d)), np.array((row,)))


def quintic(
    q0_deg: float,
    qf_deg: float,
    duration_s: float,
    v0: float = 0.0,
    vf: float = 0.0,
    a0: float = 0.0,
    af: float = 0.0,
) -> PiecewisePolynomial:
    """Positions, speeds and accelerations at both ends, from the 6 x 6 system of appendix B."""
    _check(duration_s)
    d = duration_s
    matrix = np.array(
        (
            (1, 0, 0, 0, 0, 0),
            (0, 1, 0, 0, 0, 0),
            (0, 0, 2, 0, 0, 0),
            (1, d, d**2, d**3, d**4, d**5),
            (0, 1, 2 * d, 3 * d**2, 4 * d**3, 5 * d**4),
            (0, 0, 2, 6 * d, 12 * d**2, 20 * d**3),
        )
    )
    row = np.linalg.solve(matrix, np.array((q0_deg, v0, a0, qf_deg, vf, af)))
    return PiecewisePolynomial(np.array((0.0, d)), row[None])


def lspb(q0_deg: float, qf_deg: float, duration_s: float, acceleration_deg_s2: float) -> PiecewisePolynomial:
    """Linear segment with parabolic blends over a given duration (thesis 4.1.3).

    The blends last t_c = D/2 - sqrt((D^2 a - 4 |qf - q0|) / a) / 2 (printed with a 2 in the denominator under the
    root). Raises ValueError when the acceleration is too low: |a| >= 4 |qf - q0| / D^2.
    """
    _check(duration_s)
    d, step = duration_s, qf_deg - q0_deg
    rest = d * d * acceleration_deg_s2 - 4.0 * abs(step)
    if rest < -1e-12 * abs(step):
        least = 4.0 * abs(step) / d**2
        raise ValueError(f"{acceleration_deg_s2} deg/s2 is too low for {step} deg in {d} s; give {least:.6g} or more")
    blend = 0.5 * d - 0.5 * np.sqrt(max(rest, 0.0) / acceleration_deg_s2)
    a = np.copysign(acceleration_deg_s2, step)
    v = a * blend
    q1 = q0_deg + 0.5 * a * blend**2
    q2 = q1 + v * (d - 2.0 * blend)
    rows = ((q0_deg, 0.0, 0.5 * a), (q1, v, 0.0), (q2, v, -0.5 * a))
    return PiecewisePolynomial(np.array((0.0, blend, d - blend, d)), np.array(rows))


def fastest_lspb(
    q0_deg: float, qf_deg: float, velocity_deg_s: float, acceleration_deg_s2: float
) -> PiecewisePolynomial:
    """The time-optimal profile of one joint: full acceleration, full speed if it is reached, full deceleration."""
    step = abs(qf_deg - q0_deg)
    if velocity_deg_s**2 >= step * acceleration_deg_s2:
        duration = 2.0 * np.sqrt(step / acceleration_deg_s2)
    else:
        duration = step / velocity_deg_s + velocity_deg_s / acceleration_deg_s2
    return lspb(q0_deg, qf_deg, float(duration), acceleration_deg_s2)


def via_spline(points_deg: Sequence[float], times_s: Sequence[float]) -> PiecewisePolynomial:
    """The cubic spline through via points at given times, at rest at both ends, with continuous accelerations.

    The inner speeds solve the tridiagonal system of equal accelerations at every via point. Raises ValueError for
    fewer than two points or times that do not rise.
    """
    q, t = np.array(points_deg, dtype=np.float64), np.array(times_s, dtype=np.float64)
    if len(q) < 2 or len(q) != len(t) or not (np.diff(t) > 0.0).all():
        raise ValueError("via points need two or more positions and as many rising times")
    h, slope = np.diff(t), np.diff(q) / np.diff(t)
    inner = len(q) - 2
    v = np.zeros(len(q))
    if inner:
        matrix = np.zeros((inner, inner))
        right = 3.0 * (h[1:] * slope[:-1] + h[:-1] * slope[1:])
        for i in range(inner):
            matrix[i, i] = 2.0 * (h[i] + h[i + 1])
            if i:
                matrix[i, i - 1] = h[i + 1]
            if i + 1 < inner:
                matrix[i, i + 1] = h[i]
        v[1:-1] = np.linalg.solve(matrix, right)
    rows = [cubic(q[i], q[i + 1], h[i], v[i], v[i + 1]).coefficients[0] for i in range(len(h))]
    return PiecewisePolynomial(t - t[0], np.array(rows))


def _check(duration_s: float) -> None:
    if not duration_s > 0.0:
        raise ValueError(f"a duration must be above 0, not {duration_s}")

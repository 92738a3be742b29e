"""Inverse velocity: joint rates for a wanted tool velocity, by six methods.

All work on a weighted Jacobian A = Sx J Sq^-1 and a weighted velocity b = Sx v and give y = Sq q': the rows of the
task and the joints are thereby made comparable (mm with rad, a slow joint with a fast one). With A = U S V^T:

    transpose          y = a A^T b,  a = <b, A A^T b> / |A A^T b|^2           Balestrino 1984; step of Buss 2004
    pseudo-inverse     y = sum (u_i.b / s_i) v_i over s_i > tolerance         Moore-Penrose
    damped             y = (A^T A + l^2 I)^-1 A^T b = A^T (A A^T + l^2 I)^-1 b
                         = sum s_i / (s_i^2 + l^2) (u_i.b) v_i                Wampler 1986; Nakamura, Hanafusa 1986
    filtered           as damped, but l acts on directions with s_i < e only  Maciejewski, Klein 1988
    selective          each direction clamped by how much the arm would have to move for it
                                                                              Buss, Kim 2005 (SDLS)

How large l is, is chosen by a `Damping`: constant; by manipulability, l^2 = l0^2 (1 - w/w0)^2 for w < w0 (Nakamura,
Hanafusa 1986); or by its rate of change, l^2 = l0^2 (1 - w/w_before) where w/w_before is below a threshold (after
Kelmar, Khosla 1988). Thesis 3.2.1 to 3.2.4; its printed J^T (J^T + l^2 I)^-1, sigma/(sigma + l^2) and U S V^T for the
damped inverse are corrected above (errata). J is 6x5 or 5x5, so the 5x5 normal form is the small one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import FloatArray

PSEUDO_INVERSE_TOLERANCE = 1e-12
"""Singular values below this part of the largest are left out of the pseudo-inverse."""


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """`task` (m,) and `joints` (5,): factors above 0 of the rows of the task and of the joint rates.

    A row's factor is 1 over the error that counts as one unit, a joint's 1 over the rate that does.
    """

    task: FloatArray
    joints: FloatArray

    def __post_init__(self) -> None:
        for factors in (self.task, self.joints):
            if not (np.isfinite(factors).all() and (factors > 0).all()):
                raise KinematicsError(f"weights must be finite and above 0, not {factors}")

    def apply(self, jacobian: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sx J Sq^-1 (m, 5) and Sx v (m,)."""
        return self.task[:, None] * jacobian / self.joints, self.task * velocity

    def rates(self, y: FloatArray) -> FloatArray:
        """q' = Sq^-1 y (5,)."""
        return y / self.joints


def transpose_rates(a: FloatArray, b: FloatArray) -> FloatArray:
    """The Jacobian transpose's step (n,) with the length that reduces |b - A y| most; 0 where A^T b is 0."""
    direction = a.T @ b
    moved = a @ direction
    square = float(moved @ moved)
    if square == 0.0:
        return np.zeros(a.shape[1])
    result: FloatArray = float(b @ moved) / square * direction
    return result


def pseudo_inverse_rates(a: FloatArray, b: FloatArray, tolerance: float = PSEUDO_INVERSE_TOLERANCE) -> FloatArray:
    """Least squares (n,) of least length; directions with a singular value below tolerance x largest are left out."""
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    kept = s > tolerance * s[0]
    result: FloatArray = vt[kept].T @ ((u.T @ b)[kept] / s[kept])
    return result


def damped_rates(a: FloatArray, b: FloatArray, damping: float) -> FloatArray:
    """(A^T A + l^2 I)^-1 A^T b, (n,), as a least squares problem of [A; l I], whose condition is not squared."""
    if not damping >= 0:
        raise KinematicsError(f"damping is 0 or more, not {damping}")
    if damping == 0.0:
        return pseudo_inverse_rates(a, b)
    rows, columns = a.shape
    stacked = np.zeros((rows + columns, columns))
    stacked[:rows] = a
    stacked[rows:] = damping * np.eye(columns)
    right = np.zeros(rows + columns)
    right[:rows] = b
    return np.linalg.lstsq(stacked, right, rcond=None)[0]


def filtered_rates(a: FloatArray, b: FloatArray, damping: float, threshold: float) -> FloatArray:
    """Damped in weak directions only, (n,): s/(s^2 + l^2 (1 - (s/e)^2)) where s < e = `threshold`, else 1/s."""
    if not (damping > 0 and threshold > 0):
        raise KinematicsError(f"damping {damping} and threshold {threshold} must be above 0")
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    square = damping**2 * np.clip(1.0 - (s / threshold) ** 2, 0.0, None)
    result: FloatArray = vt.T @ (s / (s**2 + square) * (u.T @ b))
    return result


def selective_rates(a: FloatArray, b: FloatArray, max_rate: float) -> FloatArray:
    """Selectively damped least squares (n,), no component above `max_rate` (unit of y).

    For each direction i: N = |u_i| = 1, M = sum_j |v_ji| |a_j| / s_i (what the arm would move in all for it),
    clamp (u_i.b / s_i) v_i to min(1, N/M) max_rate; then clamp the sum. Source: Buss and Kim, Selectively damped
    least squares for inverse kinematics, J. Graphics Tools 10 (2005), with one end effector.
    """
    if not max_rate > 0:
        raise KinematicsError(f"the largest rate must be above 0, not {max_rate}")
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    lengths = np.linalg.norm(a, axis=0)
    total = np.zeros(a.shape[1])
    for sigma, direction, wanted in zip(s, vt, u.T @ b, strict=True):
        if sigma <= PSEUDO_INVERSE_TOLERANCE * s[0]:
            continue
        effort = float(np.abs(direction) @ lengths) / sigma
        total += _clamped(wanted / sigma * direction, min(1.0, 1.0 / effort) * max_rate)
    return _clamped(total, max_rate)


def _clamped(vector: FloatArray, limit: float) -> FloatArray:
    largest = float(np.abs(vector).max())
    return vector if largest <= limit else vector * (limit / largest)


class DampingLaw(Enum):
    """What the damping factor follows."""

    CONSTANT = "constant"
    MANIPULABILITY = "manipulability"
    """l^2 = l0^2 (1 - w/w0)^2 for w < w0, else 0 (Nakamura, Hanafusa 1986)."""
    RATE_OF_CHANGE = "rate_of_change"
    """l^2 = l0^2 (1 - w/w_before) where w/w_before is below a threshold, else 0 (after Kelmar, Khosla 1988)."""


@dataclass(frozen=True, slots=True)
class Damping:
    """A damping factor that may follow the manipulability of the weighted Jacobian.

    `largest`: l0. `threshold`: w0 for MANIPULABILITY (unit of w), the ratio (0..1] for RATE_OF_CHANGE.
    """

    law: DampingLaw
    largest: float
    threshold: float = 1.0

    def __post_init__(self) -> None:
        if not (self.largest > 0 and self.threshold > 0):
            raise KinematicsError(f"damping {self.largest} and its threshold {self.threshold} must be above 0")

    def factor(self, manipulability: float, before: float | None = None) -> float:
        """l, in the unit of A, for the manipulability now and, for RATE_OF_CHANGE, before (None: none yet)."""
        if self.law is DampingLaw.CONSTANT:
            return self.largest
        if self.law is DampingLaw.MANIPULABILITY:
            return self.largest * max(0.0, 1.0 - manipulability / self.threshold)
        if before is None or before <= 0.0:
            return self.largest
        ratio = manipulability / before
        return self.largest * float(np.sqrt(max(0.0, 1.0 - ratio))) if ratio < self.threshold else 0.0


def weighted_manipulability(a: FloatArray) -> float:
    """Product of the singular values of A (m, 5): sqrt(det(A^T A))."""
    return float(np.prod(np.linalg.svd(a, compute_uv=False)))

"""Quintic blends: value, slope and no curvature at both ends, for the jerk-limited mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .elements import Array


@dataclass(frozen=True, slots=True, eq=False)
class QuinticCurve:
    """y(s) = sum c_k s^k, k = 0..5; `coefficients` (6, 5)."""

    coefficients: Array

    @classmethod
    def through(cls, start: Array, start_slope: Array, end: Array, end_slope: Array, length: float) -> QuinticCurve:
        """The quintic over `length` with these values and slopes and zero second derivatives at both ends."""
        travel = end - start
        rest = travel - start_slope * length
        gain = (end_slope - start_slope) * length
        return cls(
            np.stack(
                (
                    start,
                    start_slope,
                    np.zeros_like(start),
                    (10.0 * rest - 4.0 * gain) / length**3,
                    (-15.0 * rest + 7.0 * gain) / length**4,
                    (6.0 * rest - 3.0 * gain) / length**5,
                )
            )
        )

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives, each (n, 5)."""
        c, t = self.coefficients, s[:, None]
        values = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
        slopes = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + t * 5 * c[5])))
        bends = 2 * c[2] + t * (6 * c[3] + t * (12 * c[4] + t * 20 * c[5]))
        return values, slopes, bends

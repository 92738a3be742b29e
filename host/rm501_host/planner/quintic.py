"""Quintic blends: value, slope and second derivative at both ends, for the jerk-limited mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_POWERS = np.arange(6.0)
_HERMITE = np.array(
    (
        (1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.5, 0.0, 0.0, 0.0),
        (-10.0, -6.0, -1.5, 10.0, -4.0, 0.5),
        (15.0, 8.0, 1.5, -15.0, 7.0, -1.0),
        (-6.0, -3.0, -0.5, 6.0, -3.0, 0.5),
    )
)
"""Coefficients of t^0..t^5 over [0, 1] from value, first and second derivative at 0 and at 1."""
_NO_BEND = np.zeros(5)


@dataclass(frozen=True, slots=True, eq=False)
class QuinticCurve:
    """y(s) = sum c_k s^k, k = 0..5; `coefficients` (6, 5)."""

    coefficients: Array

    @classmethod
    def through(
        cls,
        start: Array,
        start_slope: Array,
        end: Array,
        end_slope: Array,
        length: float,
        start_bend: Array = _NO_BEND,
        end_bend: Array = _NO_BEND,
    ) -> QuinticCurve:
        """The quintic over `length` with these values, slopes and second derivatives at its ends, (5,) each."""
        ends = np.empty((6, len(start)))
        ends[0], ends[1], ends[2] = start, start_slope * length, start_bend * length**2
        ends[3], ends[4], ends[5] = end, end_slope * length, end_bend * length**2
        return cls(_HERMITE @ ends / (length**_POWERS)[:, None])

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives, each (n, 5)."""
        return evaluate_quintics(self.coefficients[None], s)


def evaluate_quintics(coefficients: Array, s: Array) -> tuple[Array, Array, Array]:
    """Values, first and second derivatives, each (n, 5), of quintics (n or 1, 6, 5) at s (n,)."""
    c0, c1, c2, c3, c4, c5 = (coefficients[:, k] for k in range(6))
    t = s[:, None]
    values = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
    slopes = c1 + t * (2 * c2 + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))
    bends = 2 * c2 + t * (6 * c3 + t * (12 * c4 + t * 20 * c5))
    return values, slopes, bends

"""One segment: cubics per motor through the exact start, the ideal end, and the ideal speeds at both.

A cubic p(n) = p0 + b n + c n^2 + d n^3 over n frames, Hermite data at both ends, becomes the board's forward
differences v = b + c + d, a = 2c + 6d, j = 6d. j and a are rounded to the wire first, then v is chosen so that the
exact integer end comes as near to the ideal as the wire allows: n 2^-33 step, 4e-6 step at the longest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_protocol.segment import A_SHIFT, FRACTION_BITS, ONE_STEP, V_SHIFT
from rm501_protocol.segment_message import MotorTerm

Array = NDArray[np.float64]

_S32 = 1 << 31
STILL_STEPS = 1e-7
"""A motor that is to move by less over a segment is left out of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Cubic:
    """Coefficients per motor, (5,) each, in steps and frames: p0 + b n + c n^2 + d n^3."""

    b: Array
    c: Array
    d: Array

    def offsets(self, frames: Array) -> Array:
        """Positions relative to the start at (k,) frames: (k, 5)."""
        n = frames[:, None]
        values: Array = n * (self.b + n * (self.c + n * self.d))
        return values

    def end_speed(self, frames: int) -> Array:
        """Speed (5,) in steps/frame at the end of `frames`."""
        speed: Array = self.b + frames * (2.0 * self.c + 3.0 * frames * self.d)
        return speed


def hermite(travel: Array, first_speed: Array, last_speed: Array, frames: int) -> Cubic:
    """The cubic over `frames` that travels (5,) steps between these speeds in steps/frame."""
    mean = travel / frames
    return Cubic(
        first_speed,
        (3.0 * mean - 2.0 * first_speed - last_speed) / frames,
        (first_speed + last_speed - 2.0 * mean) / (frames * frames),
    )


def quadratic(travel: Array, first_speed: Array, frames: int) -> Cubic:
    """The parabola over `frames` that travels (5,) steps from this speed."""
    return Cubic(first_speed, (travel / frames - first_speed) / frames, np.zeros_like(travel))


def to_wire(cubic: Cubic, start_q48: Sequence[int], end_steps: Array, frames: int) -> tuple[MotorTerm, ...] | None:
    """The integer terms of the moving motors, or None when one does not fit its 32 bits."""
    pairs = frames * (frames - 1) // 2
    triples = pairs * (frames - 2) // 3
    terms = []
    for motor in range(len(end_steps)):
        b, c, d = float(cubic.b[motor]), float(cubic.c[motor]), float(cubic.d[motor])
        distance = to_q48(float(end_steps[motor])) - start_q48[motor]
        if abs(distance) < STILL_STEPS * ONE_STEP and max(abs(b), abs(c * frames)) * frames < STILL_STEPS:
            continue
        j = round(6.0 * d * ONE_STEP)
        a = round((2.0 * c + 6.0 * d) * (ONE_STEP >> A_SHIFT))
        rest = distance - pairs * (a << A_SHIFT) - triples * j
        unit = frames << V_SHIFT
        v = (2 * rest + unit) // (2 * unit)
        if not (-_S32 <= v < _S32 and -_S32 <= a < _S32 and -_S32 <= j < _S32):
            return None
        terms.append(MotorTerm(motor, v, a, j))
    return tuple(terms)


def to_q48(steps: float) -> int:
    """Steps as an integer in 2^-48 step; exact for any float."""
    numerator, denominator = steps.as_integer_ratio()
    return (numerator << FRACTION_BITS) // denominator

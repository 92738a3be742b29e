"""Corners: how one element goes over into the next: smoothly as it is, by a blend, or not without a stop.

A circular blend between two lines that turn by theta touches both at the distance d from the corner and passes it at
d tan(theta / 4) (radius d / tan(theta / 2)), so the largest d that keeps the tolerance P is P / tan(theta / 4), and
never more than half of either neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from rm501_host.kinematics import Arm
from rm501_host.moves import PathMode

from .elements import Element
from .limits import Limits

TANGENT = 1e-7
"""Relative difference of tangents that counts as none: at 30 deg/s, 3e-6 deg/s of jump."""
SHARPEST_RAD = pi - 0.02
"""Turns sharper than this are reversals: the arm stops there."""


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """What replaces a corner: `before` and `after` are cut off the two neighbours, `elements` go between."""

    before: float
    after: float
    elements: tuple[Element, ...]


SMOOTH = Corner(0.0, 0.0, ())


class CornerMaker:
    """Decides what happens between two elements."""

    def __init__(self, arm: Arm, limits: Limits) -> None:
        self._arm = arm
        self._limits = limits

    def between(
        self, first: Element, used: float, second: Element, mode: PathMode, tolerance_mm: float
    ) -> Corner | None:
        """The way from `first` (whose first `used` is taken already) into `second`; None: stop there."""
        if mode is PathMode.EXACT_STOP:
            return None
        _, end_slope = first.at(first.length)
        _, start_slope = second.at(0.0)
        if first.space is second.space and first.branch is second.branch:
            scale = max(float(np.abs(end_slope).max()), float(np.abs(start_slope).max()))
            if float(np.abs(end_slope - start_slope).max()) <= TANGENT * scale:
                return SMOOTH
        if mode is not PathMode.BLEND or tolerance_mm <= 0.0:
            return None
        return None

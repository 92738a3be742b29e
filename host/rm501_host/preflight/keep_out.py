"""Where links and hand must not be: boxes in the base frame and the table plane.

The arm is taken as capsules (`rm501_host.kinematics.solids`) with the radii of `[keep_out]`: upper arm, forearm, and
a hand whose cap just touches the tool centre point, so that a fingertip may reach the table. The column does not move
and is not checked. Blends may leave the path by the tolerance, so boxes and table grow by it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.kinematics import Arm
from rm501_host.kinematics.solids import SolidRadii, capsules, clearances

Array = NDArray[np.float64]

_COLUMN = "column"
_TOUCH_MM = 1e-9
"""Touching is not entering: what rounding may make of it."""


class KeepOut:
    """The boxes and the table of a configuration."""

    def __init__(self, config: Config) -> None:
        self._section = config.keep_out
        self._radii = SolidRadii(
            upper_arm_mm=config.keep_out.upper_arm_radius_mm,
            forearm_mm=config.keep_out.forearm_radius_mm,
            hand_mm=config.keep_out.hand_radius_mm,
        )

    @property
    def is_empty(self) -> bool:
        """Whether nothing is forbidden."""
        return not self._section.boxes and self._section.table_z_mm is None

    def first_entry(self, arm: Arm, q_deg: Array, margin_mm: float) -> tuple[int, str, float] | None:
        """The first of the joints (n, 5) at which something is entered: its index, what by what, and how deep in mm.

        Inside a box the depth counts from the solid's skin to its axis at most.
        """
        entries = self.first_entries(arm, q_deg, np.zeros(len(q_deg), dtype=np.intp), margin_mm)
        return entries[0] if entries else None

    def first_entries(
        self, arm: Arm, q_deg: Array, move: NDArray[np.intp], margin_mm: float
    ) -> list[tuple[int, str, float]]:
        """As `first_entry`, for each of the moves (n,), in rising order, that the joints (n, 5) belong to."""
        if self.is_empty or not len(q_deg):
            return []
        found = clearances(capsules(arm.geometry, q_deg, self._radii), self._section)
        moving = [column for column, (solid, _) in enumerate(found.pairs) if solid != _COLUMN]
        depth = margin_mm - found.mm[:, moving]
        rows = np.flatnonzero((depth > _TOUCH_MM).any(axis=1))
        _, firsts = np.unique(move[rows], return_index=True)
        entries = []
        for row in rows[firsts].tolist():
            worst = int(np.argmax(depth[row]))
            solid, zone = found.pairs[moving[worst]]
            what = "go below the table" if zone == "table" else f"enter {zone!r}"
            entries.append((row, f"the {solid} would {what}", float(depth[row, worst])))
        return entries

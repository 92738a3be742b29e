"""Where links and hand must not be: boxes in the base frame and the table plane.

The arm is taken as four straight lines: from the shoulder to the elbow, on to the wrist, to the end of link 5 and to
the tool centre point. A line meets a box where its parameter intervals inside the three slabs overlap; blends may
leave the path by the tolerance, so boxes and table grow by it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.kinematics import Arm

Array = NDArray[np.float64]

_LINKS = ("upper arm", "forearm", "wrist", "hand")


class KeepOut:
    """The boxes and the table of a configuration."""

    def __init__(self, config: Config) -> None:
        self._boxes = tuple(config.keep_out.boxes)
        self._table_mm = config.keep_out.table_z_mm

    @property
    def is_empty(self) -> bool:
        """Whether nothing is forbidden."""
        return not self._boxes and self._table_mm is None

    def first_entry(self, arm: Arm, q_deg: Array, margin_mm: float) -> tuple[int, str, float] | None:
        """The first of the joints (n, 5) at which something is entered: its index, what by what, and the depth in mm
        (how far below the table; 0 for boxes)."""
        points = joints_in_space(arm, q_deg)
        best: tuple[int, str, float] | None = None
        if self._table_mm is not None:
            depth = self._table_mm + margin_mm - points[:, 1:, 2]
            low = np.flatnonzero((depth > 0.0).any(axis=1))
            if len(low):
                at = int(low[0])
                part = int(np.argmax(depth[at]))
                best = (at, f"the {_LINKS[part]} would go below the table", float(depth[at, part]))
        for box in self._boxes:
            lower, upper = np.array(box.min_mm) - margin_mm, np.array(box.max_mm) + margin_mm
            for part in range(points.shape[1] - 1):
                inside = np.flatnonzero(_meets(points[:, part], points[:, part + 1], lower, upper))
                if len(inside) and (best is None or int(inside[0]) < best[0]):
                    best = (int(inside[0]), f"the {_LINKS[part]} would enter {box.name!r}", 0.0)
        return best


def joints_in_space(arm: Arm, q_deg: Array) -> Array:
    """Shoulder, elbow, wrist, end of link 5 and tool centre point (n, 5, 3) in the base frame, mm."""
    geometry = arm.geometry
    q = np.radians(q_deg)
    c1, s1 = np.cos(q[:, 0]), np.sin(q[:, 0])
    q2, q23 = q[:, 1], q[:, 1] + q[:, 2]
    q234 = q23 + q[:, 3]
    radius = [np.zeros(len(q)), geometry.a2_mm * np.cos(q2)]
    height = [np.full(len(q), geometry.d1_mm), geometry.d1_mm + geometry.a2_mm * np.sin(q2)]
    radius.append(radius[1] + geometry.a3_mm * np.cos(q23))
    height.append(height[1] + geometry.a3_mm * np.sin(q23))
    radius.append(radius[2] + geometry.d5_mm * np.sin(q234))
    height.append(height[2] - geometry.d5_mm * np.cos(q234))
    planar = np.stack([np.stack((c1 * r, s1 * r, z), axis=1) for r, z in zip(radius, height, strict=True)], axis=1)
    points: Array = np.concatenate((planar, arm.fk_batch(q_deg)[0][:, None]), axis=1)
    return points


def _meets(first: Array, second: Array, lower: Array, upper: Array) -> NDArray[np.bool_]:
    """Whether lines (n, 3) to (n, 3) meet the box (slab method)."""
    step = second - first
    parallel = np.abs(step) < 1e-12
    safe = np.where(parallel, 1.0, step)
    a, b = (lower - first) / safe, (upper - first) / safe
    outside = parallel & ((first < lower) | (first > upper))
    enter = np.where(parallel, 0.0, np.minimum(a, b)).max(axis=1)
    leave = np.where(parallel, 1.0, np.maximum(a, b)).min(axis=1)
    result: NDArray[np.bool_] = (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)) & ~outside.any(axis=1)
    return result

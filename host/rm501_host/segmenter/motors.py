"""Joints to motor steps, and the limits that a segment's polynomial is held to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.planner.limits import Limits

Array = NDArray[np.float64]


class MotorMap:
    """The linear map from joints (deg) to the five motors (steps), zero where q = 0; linear, so it maps rates too."""

    def __init__(self, config: Config) -> None:
        limits = Limits.from_config(config)
        self.limits = limits
        self._forward = limits.steps_per_deg[:, None] * limits.motor_matrix
        self._backward = np.linalg.inv(self._forward)
        self._margin = config.board.limit_margin
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6

    def steps(self, q_deg: Array) -> Array:
        """Steps (n, 5) of joints (n, 5); likewise for rates and accelerations."""
        result: Array = q_deg @ self._forward.T
        return result

    def joints(self, steps: Array) -> Array:
        """Joints (n, 5) of steps (n, 5)."""
        result: Array = steps @ self._backward.T
        return result

    def acceleration_ratio(self, steps_per_frame2: Array) -> float:
        """Largest of |acceleration| / limit over motors and joints, for (n, 5) in steps/frame^2."""
        motors = steps_per_frame2 / self._frame_s**2
        joints = self.joints(motors)
        limits = self.limits
        return max(
            float((np.abs(motors) / limits.motor_acceleration_steps_s2).max()),
            float((np.abs(joints) / limits.joint_acceleration_deg_s2).max()),
        )

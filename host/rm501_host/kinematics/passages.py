"""A velocity-controlled tool along straight lines, on ideal motors: how a controller behaves at a singularity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rm501_host.kinematics import forward
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import ArmGeometry
from rm501_host.kinematics.results import FloatArray, JointsLike
from rm501_host.kinematics.velocity_control import VelocityController


class NotArrivedError(KinematicsError):
    """The tool did not come to the end of its way in the time given: the controller is stuck at a singularity."""


GAIN_PER_S = 10.0
"""What is missing of the way is made up for within a tenth of a second."""


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A run, one row a period: `t_s` (n,), `q_deg` (n, 5), `rates_deg_s` (n, 5), `error_mm` (n,) from the line's
    present point, `wanted_mm` and `tip_mm` (n, 3), `damping` and `scale` (n,)."""

    t_s: FloatArray
    q_deg: FloatArray
    rates_deg_s: FloatArray
    error_mm: FloatArray
    wanted_mm: FloatArray
    tip_mm: FloatArray
    damping: FloatArray
    scale: FloatArray

    @property
    def largest_error_mm(self) -> float:
        """The farthest that the tip was from where it should have been."""
        return float(self.error_mm.max())


def run_passage(
    geometry: ArmGeometry,
    controller: VelocityController,
    start_deg: JointsLike,
    legs_mm: FloatArray,
    speed_mm_s: float,
    *,
    period_s: float = 1e-3,
    settle_s: float = 0.5,
    max_s: float = 120.0,
) -> Passage:
    """Drive the tip from joints (5,) deg along vectors (m, 3) mm, one after the other, pitch and roll held.

    A leg may lead out of reach. The line's point moves on at `speed_mm_s`, slower while the controller has to
    shorten its joint rates, so the arm slows down on its way instead of being left behind. Ends `settle_s` after the
    line does. Raises NotArrivedError when it takes longer than `max_s`.
    """
    q = np.array(forward.joints_of(start_deg))
    pose = forward.pose(geometry, q)
    origin, pitch_deg, roll_deg = pose.xyz_mm.copy(), pose.pitch_deg, pose.roll_deg
    lengths_mm = np.linalg.norm(legs_mm, axis=1)
    corners_mm = np.concatenate(((0.0,), np.cumsum(lengths_mm)))
    units = legs_mm / lengths_mm[:, None]
    corners = origin + np.concatenate((np.zeros((1, 3)), np.cumsum(legs_mm, axis=0)))
    controller.reset()
    done_mm, settled_s, t_s = 0.0, 0.0, 0.0
    rows: list[tuple[float, ...]] = []
    wanted = np.zeros(5)
    while settled_s < settle_s:
        if t_s > max_s:
            raise NotArrivedError(
                f"the tool was still {corners_mm[-1] - done_mm:.3g} mm from the end after {max_s:g} s"
            )
        moving = done_mm < corners_mm[-1]
        pose = forward.pose(geometry, q)
        leg = min(int(np.searchsorted(corners_mm, done_mm, side="right")), len(units)) - 1
        unit = units[leg]
        point = corners[leg] + (done_mm - corners_mm[leg]) * unit
        wanted[:3] = (speed_mm_s * unit if moving else 0.0) + GAIN_PER_S * (point - pose.xyz_mm)
        wanted[3] = GAIN_PER_S * (pitch_deg - pose.pitch_deg)
        wanted[4] = GAIN_PER_S * (roll_deg - pose.roll_deg)
        step = controller.step(q, wanted, period_s)
        error = float(np.linalg.norm(point - pose.xyz_mm))
        rows.append((t_s, error, step.damping, step.scale, *q, *step.rates_deg_s, *point, *pose.xyz_mm))
        q = q + step.rates_deg_s * period_s
        t_s += period_s
        if moving:
            done_mm = min(float(corners_mm[-1]), done_mm + speed_mm_s * step.scale * period_s)
        else:
            settled_s += period_s
    table = np.array(rows)
    return Passage(
        t_s=table[:, 0],
        error_mm=table[:, 1],
        damping=table[:, 2],
        scale=table[:, 3],
        q_deg=table[:, 4:9],
        rates_deg_s=table[:, 9:14],
        wanted_mm=table[:, 14:17],
        tip_mm=table[:, 17:20],
    )

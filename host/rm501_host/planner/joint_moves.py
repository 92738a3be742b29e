"""Joint-space moves outside programs: homing, jogging, going to a place. Also beyond the soft limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics import Arm
from rm501_host.moves import Source

from .elements import Array
from .errors import JointLimitError
from .grid import GridBuilder
from .limits import Limits
from .path import joint_line
from .pieces import Piece, PieceKind
from .window import Window

API_SOURCE = Source("(joint move)", 0)


def plan_joint_move(
    arm: Arm,
    config: Config,
    start_deg: Sequence[float] | Array,
    target_deg: Sequence[float] | Array,
    *,
    speed_scale: float = 1.0,
    max_velocity_deg_s: float | Sequence[float] | None = None,
    ignore_limits: bool = False,
    source: Source = API_SOURCE,
    start_s: float = 0.0,
) -> tuple[Piece, ...]:
    """The fastest line in joint space from rest to rest: one piece, none where nothing moves.

    `start_deg`, `target_deg`: joints (5,). `speed_scale` (0, 1] scales the joints' velocity limits,
    `max_velocity_deg_s` caps them (one number, or one per joint): a search move runs at its cap between two ramps.
    `ignore_limits`: joints may lie outside their ranges (homing). Raises JointLimitError where one would.
    """
    start, target = np.array(start_deg, dtype=np.float64), np.array(target_deg, dtype=np.float64)
    limits = Limits.from_config(config)
    if not 0.0 < speed_scale <= 1.0:
        raise ValueError(f"speed_scale must be in (0, 1], not {speed_scale}")
    if not ignore_limits:
        beyond = np.maximum(limits.min_deg - target, target - limits.max_deg)
        joint = int(np.argmax(beyond))
        if beyond[joint] > 1e-7:
            raise JointLimitError(
                f"joint {joint + 1} would be at {target[joint]:g} deg, {beyond[joint]:.4g} deg beyond its range",
                source=source,
                amount=float(beyond[joint]),
                q_deg=tuple(start.tolist()),
                remedy=f"stay within {limits.min_deg[joint]:g} to {limits.max_deg[joint]:g} deg",
            )
    element = joint_line(start, target, source)
    if element is None:
        return ()
    if max_velocity_deg_s is not None:
        caps = np.broadcast_to(np.array(max_velocity_deg_s, dtype=np.float64), (5,))
        slopes = np.abs(element.coefficients[1])
        moving = slopes > 0.0
        element = replace(element, rate=float((caps[moving] / slopes[moving]).min()))
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    builder = GridBuilder(arm, limits, check_limits=False, speed_scale=speed_scale)
    window = Window(arm, builder, frame_s)
    window.extend([element])
    stretch = window.finish()
    assert stretch is not None
    duration = stretch.law.duration_s
    rest = tuple(target.tolist())
    piece = Piece(PieceKind.MOTION, source, start_s, duration, rest, law=stretch.law, motion_s=duration, arm=arm)
    return (piece,)

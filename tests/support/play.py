"""An arm with play, to judge the compensation of backlash: segments stepped in integers, gears with a gap."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from rm501_host.config import JOINT_NAMES, Config
from rm501_host.planner import Piece
from rm501_host.segmenter import PlannedSegment
from tests.support.plan_checker import ideal_joints, motor_matrix

Array = NDArray[np.float64]


def with_backlash(
    config: Config, backlash_deg: Sequence[float], wrist_deg: tuple[float, float] = (0.0, 0.0), **planner: float
) -> Config:
    """The configuration with this play per joint and per wrist motor, and changes of `[planner]`."""
    joints = {
        name: msgspec.structs.replace(joint, backlash_deg=play)
        for name, joint, play in zip(JOINT_NAMES, config.joints.ordered, backlash_deg, strict=True)
    }
    return msgspec.structs.replace(
        config,
        joints=msgspec.structs.replace(config.joints, **joints),
        motors=msgspec.structs.replace(
            config.motors,
            right_wrist=msgspec.structs.replace(config.motors.right_wrist, backlash_deg=wrist_deg[0]),
            left_wrist=msgspec.structs.replace(config.motors.left_wrist, backlash_deg=wrist_deg[1]),
        ),
        planner=msgspec.structs.replace(config.planner, **planner),
    )


def motor_side_deg(config: Config, planned: Sequence[PlannedSegment]) -> Array:
    """Joint angles (frames + 1, 5) that the motors stand for, at every motion frame, stepping as the board does."""
    start = np.array(planned[0].start_q48[:5], dtype=np.float64) / 2.0**48
    rows = [start]
    positions = list(planned[0].start_q48)
    for item in planned:
        assert list(item.start_q48) == positions
        n = item.segment.length_frames
        block = np.tile(np.array(positions[:5], dtype=np.float64) / 2.0**48, (n, 1))
        for term in item.segment.motors:
            p, v, a = positions[term.motor], term.v << 16, term.a << 8
            for k in range(n):
                p += v
                v += a
                a += term.j
                block[k, term.motor] = p / 2.0**48
            positions[term.motor] = p
        rows.extend(block)
    steps = np.array(rows)
    result: Array = steps @ np.linalg.inv(motor_matrix(config)).T
    return result


def links_deg(motor_side: Array, backlash_deg: Sequence[float], leads_deg: Sequence[float]) -> Array:
    """Joint angles (n, 5) of links behind a gap: each stands until its motor has crossed it.

    `leads_deg`: how far the motors are ahead of the links at the start.
    """
    half = 0.5 * np.array(backlash_deg)
    links = np.empty_like(motor_side)
    links[0] = motor_side[0] - np.array(leads_deg)
    for k in range(1, len(motor_side)):
        links[k] = np.clip(links[k - 1], motor_side[k] - half, motor_side[k] + half)
    return links


def ideal_deg(config: Config, planned: Sequence[PlannedSegment], pieces: Sequence[Piece]) -> Array:
    """The law (frames + 1, 5) at every motion frame; where a tail follows a rest, the arm stands there."""
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    blocks = []
    for number, item in enumerate(planned):
        n = item.segment.length_frames
        frames = np.arange(0 if number == 0 else 1, n + 1)
        # time stands still in a tail: segments after it lie that much later than the plan says
        begin = (item.start_frame - item.piece_start_frame) * frame_s
        inside = np.clip(begin + frames * frame_s, 0.0, None) + item.piece.start_s
        latest = _end_of_run(item, pieces)
        blocks.append(ideal_joints(pieces, np.minimum(inside, latest)))
    return np.concatenate(blocks)


def _end_of_run(item: PlannedSegment, pieces: Sequence[Piece]) -> float:
    for piece in pieces:
        if piece.end_s >= item.piece.end_s - 1e-9 and piece.ends_at_rest:
            return piece.end_s - 1e-12
    return pieces[-1].end_s

"""How far the segments as the board plays them lie from the ideal law.

Both are evaluated at the same motion frames: the segments by the board's own closed form (`rm501_protocol.segment`),
the ideal law at the time of that frame. The board makes whole steps, so up to half a step of rounding comes on top at
the motor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from rm501_host.kinematics import Arm
from rm501_host.report import TrackingFigures
from rm501_host.segmenter import PlannedSegment
from rm501_protocol.segment import ONE_STEP, position_q48

_ARM_MOTORS = 5
_POINTS = 16
"""Frames looked at per segment, its first and last among them."""


def tracking_of(segments: Iterable[PlannedSegment], arm: Arm, frame_s: float) -> TrackingFigures:
    """Largest error over all segments, in steps of a motor and in mm at the tool centre point."""
    max_step_error = max_tcp_error_mm = 0.0
    for planned in segments:
        if planned.piece.law is None:
            continue
        frames = np.unique(np.linspace(0, planned.segment.length_frames, _POINTS).astype(np.int64))
        played = np.tile(np.array(planned.start_q48[:_ARM_MOTORS], dtype=np.float64), (len(frames), 1))
        for term in planned.segment.motors:
            start = planned.start_q48[term.motor]
            played[:, term.motor] = [position_q48(start, term, int(frame)) for frame in frames]
        played /= ONE_STEP
        time_s = (planned.start_frame - planned.piece_start_frame + frames) * frame_s
        q_deg = planned.piece.q_deg(np.clip(time_s, 0.0, planned.piece.duration_s))
        ideal = arm.motors_from_joints(q_deg)
        max_step_error = max(max_step_error, float(np.abs(played - ideal).max()))
        played_mm, _ = arm.fk_batch(arm.joints_from_motors(played))
        ideal_mm, _ = arm.fk_batch(q_deg)
        distances_mm = np.linalg.norm(played_mm - ideal_mm, axis=1)
        max_tcp_error_mm = max(max_tcp_error_mm, float(distances_mm.max()))
    return TrackingFigures(max_step_error, max_tcp_error_mm)

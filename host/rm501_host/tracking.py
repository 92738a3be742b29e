"""Figures of a run, gathered as it goes: times, shares of limits, distance of the segments from the ideal law.

Segments and ideal law are compared at the same motion frames: the segments by the board's own closed form
(`rm501_protocol.segment`), the ideal law at the time of that frame. The board makes whole steps, so up to half a step
of rounding comes on top at the motor.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from rm501_host.config import Config
from rm501_host.config.board import board_config_from
from rm501_host.kinematics import Arm
from rm501_host.planner import Piece, Plan
from rm501_host.report import LimitFigures, TrackingFigures
from rm501_host.segmenter import NO_OFFSETS, PlannedSegment
from rm501_protocol.segment import ONE_STEP, position_q48

_ARM_MOTORS = 5
_POINTS = 16
"""Frames looked at per segment, its first and last among them."""


class RunFigures:
    """Gathers the figures of a run from its pieces and segments; keeps the pieces only when asked to."""

    def __init__(self, arm: Arm, config: Config, *, keep_pieces: bool) -> None:
        self._arm = arm
        self._config = config
        self._frame_s = board_config_from(config).frame_us * 1e-6
        self._ratios = np.zeros(3)
        self._step_error = 0.0
        self._tcp_error_mm = 0.0
        self._keep = keep_pieces
        self.pieces: list[Piece] = []
        self.cycle_s = 0.0
        """From the first piece to the end of the last one taken, dwells and hand strokes included."""
        self.motion_s = 0.0
        self.segments = 0

    def of_pieces(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """Pass pieces on, taking their figures."""
        for piece in pieces:
            if self._keep:
                self.pieces.append(piece)
            self.cycle_s += piece.duration_s
            self.motion_s += piece.motion_s
            if piece.law is not None:
                ratios = Plan(self._arm, self._config, [piece]).limits()
                self._ratios = np.maximum(
                    self._ratios,
                    (ratios.joint_velocity_ratio, ratios.joint_acceleration_ratio, ratios.motor_rate_ratio),
                )
            yield piece

    def add_segment(self, planned: PlannedSegment) -> None:
        """Take the figures of a segment that is sent."""
        self.segments += 1
        if planned.piece.law is None:
            return
        arm = planned.piece.arm or self._arm
        frames = np.unique(np.linspace(0, planned.segment.length_frames, _POINTS).astype(np.int64))
        played = np.tile(np.array(planned.start_q48[:_ARM_MOTORS], dtype=np.float64), (len(frames), 1))
        for term in planned.segment.motors:
            start = planned.start_q48[term.motor]
            played[:, term.motor] = [position_q48(start, term, int(frame)) for frame in frames]
        played /= ONE_STEP
        if planned.offsets is not NO_OFFSETS:
            offsets_deg, _ = planned.offsets.at((planned.start_frame + frames).astype(np.float64))
            played -= arm.motors_from_joints(offsets_deg)
            self.cycle_s += planned.tail_frames * self._frame_s
        time_s = (planned.start_frame - planned.piece_start_frame + frames) * self._frame_s
        q_deg = planned.piece.q_deg(np.clip(time_s, 0.0, planned.piece.duration_s))
        # a segment may reach into the next piece of a blended chain: what lies beyond this one is not its to judge
        inside = time_s <= planned.piece.duration_s + 1e-9
        steps = np.abs(played - arm.motors_from_joints(q_deg))[inside]
        self._step_error = max(self._step_error, float(steps.max(initial=0.0)))
        played_mm, _ = arm.fk_batch(arm.joints_from_motors(played))
        ideal_mm, _ = arm.fk_batch(q_deg)
        distances_mm = np.linalg.norm(played_mm - ideal_mm, axis=1)[inside]
        self._tcp_error_mm = max(self._tcp_error_mm, float(distances_mm.max(initial=0.0)))

    @property
    def limits(self) -> LimitFigures:
        """Largest shares of the limits that the ideal law reached."""
        return LimitFigures(*(float(ratio) for ratio in self._ratios))

    @property
    def tracking(self) -> TrackingFigures:
        """Largest distances of the segments from the ideal law."""
        return TrackingFigures(self._step_error, self._tcp_error_mm)

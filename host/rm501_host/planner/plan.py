"""A whole plan in memory: all pieces of a program, to be sampled, measured and written out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.kinematics import Arm

from .limits import Limits
from .pieces import EventKind, Piece, PieceKind

Array = NDArray[np.float64]

SAMPLE_S = 1e-3
"""Spacing at which ratios are measured and files are written."""


@dataclass(frozen=True, slots=True, eq=False)
class PlanSamples:
    """The plan at equally spaced times (the last one is its end).

    `t_s` (n,), `q_deg`, `qd_deg_s`, `qdd_deg_s2` (n, 5), `tcp_mm` (n, 3) in the base frame with the tool of that
    moment, `motor_steps` (n, 6) with the hand's pulses, `line` (n,).
    """

    t_s: Array
    q_deg: Array
    qd_deg_s: Array
    qdd_deg_s2: Array
    tcp_mm: Array
    motor_steps: Array
    line: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LimitRatios:
    """Largest ratios to the planning limits that a law reaches."""

    joint_velocity_ratio: float
    joint_acceleration_ratio: float
    motor_rate_ratio: float
    motor_acceleration_ratio: float

    @property
    def worst(self) -> float:
        """The largest of all."""
        return max(
            self.joint_velocity_ratio,
            self.joint_acceleration_ratio,
            self.motor_rate_ratio,
            self.motor_acceleration_ratio,
        )


class Plan:
    """Pieces from the first to the last."""

    def __init__(self, arm: Arm, config: Config, pieces: Iterable[Piece]) -> None:
        self._arm = arm
        self._config = config
        self._limits = Limits.from_config(config)
        self.pieces: tuple[Piece, ...] = tuple(pieces)

    @property
    def duration_s(self) -> float:
        """From the first move to the last rest, with dwells and hand strokes."""
        return self.pieces[-1].end_s - self.pieces[0].start_s if self.pieces else 0.0

    @property
    def motion_s(self) -> float:
        """The time in which a joint moves."""
        return sum(piece.motion_s for piece in self.pieces)

    def sample(self, dt_s: float = SAMPLE_S) -> PlanSamples:
        """The law every `dt_s`, and at its end."""
        t_s = self._times_s(dt_s)
        n = len(t_s)
        q_deg, rates, accelerations = np.zeros((n, 5)), np.zeros((n, 5)), np.zeros((n, 5))
        tcp_mm, hand, line = np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.int64)
        pulses = 0.0
        for piece, rows, time_s in self._spans(t_s):
            if rows.stop > rows.start:
                if piece.duration_s > 0.0:
                    q_deg[rows], rates[rows], accelerations[rows] = piece.states(time_s)
                    line[rows] = piece.lines(time_s)
                    hand[rows] = pulses + _hand_pulses(piece, time_s, self._config)
                else:
                    hand[rows] = pulses
                    q_deg[rows] = piece.rest_deg
                    line[rows] = piece.source.line
                tcp_mm[rows] = (piece.arm or self._arm).fk_batch(q_deg[rows])[0]
            pulses += sum(event.value for event in piece.events if event.kind is EventKind.HAND)
        motors = np.concatenate((self._arm.motors_from_joints(q_deg), hand[:, None]), axis=1)
        return PlanSamples(t_s, q_deg, rates, accelerations, tcp_mm, motors, line)

    def limits(self, samples: PlanSamples | None = None) -> LimitRatios:
        """The largest ratios at the samples (every millisecond where none are given)."""
        if samples is not None:
            rates, accelerations = samples.qd_deg_s, samples.qdd_deg_s2
        else:
            t_s = self._times_s(SAMPLE_S)
            rates, accelerations = np.zeros((len(t_s), 5)), np.zeros((len(t_s), 5))
            for piece, rows, time_s in self._spans(t_s):
                if rows.stop > rows.start and piece.duration_s > 0.0:
                    _, rates[rows], accelerations[rows] = piece.states(time_s)
        limits = self._limits
        motor_rates = self._arm.motors_from_joints(rates)
        motor_accelerations = self._arm.motors_from_joints(accelerations)
        return LimitRatios(
            float((np.abs(rates) / limits.joint_velocity_deg_s).max()),
            float((np.abs(accelerations) / limits.joint_acceleration_deg_s2).max()),
            float((np.abs(motor_rates) / limits.motor_rate_steps_s).max()),
            float((np.abs(motor_accelerations) / limits.motor_acceleration_steps_s2).max()),
        )

    def _times_s(self, dt_s: float) -> Array:
        """Every `dt_s` from the start, and the end."""
        if not self.pieces:
            raise ValueError("an empty plan has no samples")
        t_s: Array = np.arange(int(np.floor(self.duration_s / dt_s + 1e-9)) + 1, dtype=np.float64) * dt_s
        return np.append(t_s, self.duration_s) if self.duration_s - t_s[-1] > 1e-9 else t_s

    def _spans(self, t_s: Array) -> Iterator[tuple[Piece, slice, Array]]:
        """Every piece with the rows of `t_s` that fall into it, maybe none, and the piece's own times there."""
        first = self.pieces[0].start_s
        timed = [piece for piece in self.pieces if piece.duration_s > 0.0]
        at = 0
        for piece in self.pieces:
            is_last = bool(timed) and piece is timed[-1]
            stop = len(t_s) if is_last else int(np.searchsorted(t_s, piece.end_s - first, side="left"))
            rows = slice(at, max(at, stop))
            yield piece, rows, np.minimum(t_s[rows] + first - piece.start_s, piece.duration_s)
            at = rows.stop


def _hand_pulses(piece: Piece, time_s: Array, config: Config) -> Array:
    if piece.kind is not PieceKind.HAND:
        return np.zeros(len(time_s))
    done = np.zeros(len(time_s))
    for event in piece.events:
        if event.kind is EventKind.HAND:
            made = np.floor(np.clip(time_s - event.offset_s, 0.0, None) * config.hand.pulse_rate_steps_s + 1e-6)
            done += np.sign(event.value) * np.minimum(made, abs(event.value))
    return done

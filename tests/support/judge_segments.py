"""Judge segments by the integers that go over the wire.

The forward differences of position, frame by frame, are exact integers (2^-48 step): v + k a + k (k - 1) / 2 j. Their
differences, taken across all borders of segments and from and to rest, are the accelerations that the motors really
see; a jump of speed at a border shows there as jump / frame. They may reach 1.02 of the limits (the board's margin).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from rm501_host.config import Config
from rm501_protocol.enums import EventKind, SegmentFlag
from rm501_protocol.segment import ONE_STEP, end_positions_q48, velocity_q48
from rm501_protocol.segment_message import Segment

from .judge_arm import Array
from .judge_program import Item, Wait
from .plan_checker import motor_matrix

MOST_RATIO = 1.02
MOST_REST_ERROR_STEPS = 1e-4


@dataclass
class SegmentVerdict:
    """Ratios to the limits (at most 1.02), distances from the ideal law in steps, what is wrong in words."""

    velocity: float = 0.0
    acceleration: float = 0.0
    error_steps: float = 0.0
    rest_error_steps: float = 0.0
    frames: int = 0
    events: list[tuple[int, str, int]] = field(default_factory=list)
    wrongs: list[str] = field(default_factory=list)


def judge_segments(
    config: Config,
    items: Sequence[Item],
    segments: Sequence[Segment],
    start_q48: Sequence[int],
    ideal_deg: Callable[[Array], Array],
) -> SegmentVerdict:
    """`ideal_deg(t_s)`: joints (n, 5) of the ideal law at plan times; frame 0 is its time 0."""
    verdict = SegmentVerdict()
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    total = sum(segment.length_frames for segment in segments)
    steps_q48 = np.zeros((total, 5), dtype=np.int64)
    first_frame = segments[0].start_frames if segments else 0
    positions = tuple(start_q48)
    at = 0
    rests: list[tuple[int, tuple[int, ...]]] = []
    still: list[tuple[int, int]] = []
    for segment in segments:
        n = segment.length_frames
        if segment.start_frames != (first_frame + at) & 0xFFFFFFFF:
            verdict.wrongs.append(f"a segment starts at frame {segment.start_frames}, not {first_frame + at}")
        k = np.arange(n, dtype=np.int64)
        for term in segment.motors:
            speed = (term.v << 16) + k * (term.a << 8) + k * (k - 1) // 2 * term.j
            assert int(speed[-1]) == velocity_q48(term, n - 1)
            steps_q48[at : at + n, term.motor] = speed
        ends = end_positions_q48(positions, segment)
        moved = steps_q48[at : at + n].sum(axis=0).tolist()
        if any(p + by != end for p, by, end in zip(positions[:5], moved, ends[:5], strict=True)):
            verdict.wrongs.append("the closed form and the stepping differ")
        if not segment.motors:
            still.append((at, at + n))
        for event in segment.events:
            verdict.events.append((at + event.offset_frames, event.kind.name, event.value))
        positions = ends
        at += n
        if segment.flags & SegmentFlag.ENDS_AT_REST:
            rests.append((at, positions))
    verdict.frames = total
    _limits(config, verdict, steps_q48, frame_s)
    _against_ideal(config, verdict, steps_q48, start_q48, rests, ideal_deg, frame_s)
    if segments and not segments[-1].flags & SegmentFlag.ENDS_AT_REST:
        verdict.wrongs.append("the last segment does not end at rest")
    _events(config, verdict, items, still, frame_s)
    return verdict


def _limits(config: Config, verdict: SegmentVerdict, steps_q48: Array, frame_s: float) -> None:
    joints, drives = config.joints.ordered, config.motors.ordered
    rest = np.zeros((1, 5), dtype=np.int64)
    speeds_q48 = np.concatenate((rest, steps_q48, rest))
    rates = speeds_q48 / ONE_STEP / frame_s
    accelerations = np.diff(speeds_q48, axis=0) / ONE_STEP / frame_s**2
    back = np.linalg.inv(motor_matrix(config)).T
    rate = np.array([m.max_rate_steps_s for m in drives])
    acceleration = np.array([m.max_acceleration_deg_s2 * m.steps_per_deg for m in drives])
    velocities = np.array([j.max_velocity_deg_s for j in joints])
    joint_accelerations = np.array([j.max_acceleration_deg_s2 for j in joints])
    verdict.velocity = max(float((np.abs(rates) / rate).max()), float((np.abs(rates @ back) / velocities).max()))
    verdict.acceleration = max(
        float((np.abs(accelerations) / acceleration).max()),
        float((np.abs(accelerations @ back) / joint_accelerations).max()),
    )
    if verdict.velocity > MOST_RATIO or verdict.acceleration > MOST_RATIO:
        verdict.wrongs.append(f"limits: velocity {verdict.velocity:.6f}, acceleration {verdict.acceleration:.6f}")


def _against_ideal(
    config: Config,
    verdict: SegmentVerdict,
    steps_q48: Array,
    start_q48: Sequence[int],
    rests: Sequence[tuple[int, tuple[int, ...]]],
    ideal_deg: Callable[[Array], Array],
    frame_s: float,
) -> None:
    matrix = motor_matrix(config).T
    frames = np.arange(len(steps_q48) + 1)
    track = np.concatenate((np.zeros((1, 5), dtype=np.int64), np.cumsum(steps_q48, axis=0)))
    track = (track + np.array(start_q48[:5], dtype=np.int64)) / ONE_STEP
    verdict.error_steps = float(np.abs(track - ideal_deg(frames * frame_s) @ matrix).max(initial=0.0))
    if verdict.error_steps > config.planner.tolerance_steps:
        verdict.wrongs.append(f"{verdict.error_steps:.4f} step from the ideal law")
    for frame, positions in rests:
        ideal = ideal_deg(np.array([frame * frame_s])) @ matrix
        error = float(np.abs(np.array([p / ONE_STEP for p in positions[:5]]) - ideal).max())
        verdict.rest_error_steps = max(verdict.rest_error_steps, error)
    if verdict.rest_error_steps > MOST_REST_ERROR_STEPS:
        verdict.wrongs.append(f"rests {verdict.rest_error_steps:.3g} step beside its place")


def _events(
    config: Config,
    verdict: SegmentVerdict,
    items: Sequence[Item],
    still: Sequence[tuple[int, int]],
    frame_s: float,
) -> None:
    wanted = [item for item in items if isinstance(item, Wait) and item.event is not None]
    told = []
    for item in wanted:
        assert item.event is not None
        kind, one, two = item.event
        told.append(("HAND", one) if kind == "hand" else ("OUTPUT", one << 8 | two))
    if [(kind, value) for _, kind, value in verdict.events] != told:
        verdict.wrongs.append(f"events {verdict.events} are not {told}")
        return
    stroke = config.hand.stroke_pulses / config.hand.pulse_rate_steps_s
    for frame, kind, _ in verdict.events:
        if kind != EventKind.HAND.name:
            continue
        rest = 0
        for first, stop in still:
            if first <= frame + rest < stop:
                rest = stop - frame
        if rest * frame_s < stroke - 1e-9:
            verdict.wrongs.append(f"the hand moves for {stroke} s, the arm rests {rest * frame_s:.3f} s")

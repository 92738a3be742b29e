"""Segments: exactness, events, waits, slopes, restarts."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Dwell, Feed, HandMove, JointMove, LinearMove, Move, RapidMove
from rm501_host.planner import Piece, PlanError, Planner, plan_joint_move
from rm501_host.segmenter import PlannedSegment, Segmenter, stop_horizon
from rm501_host.segmenter.fit import to_q48
from rm501_protocol.enums import EventKind, SegmentFlag
from rm501_protocol.segment import ONE_STEP, motor_states
from tests.host.planner.programs import PICK_START_DEG, at, mode, pick_and_place, target
from tests.support.plan_checker import play_segments

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
FRAME_S = 320e-6


def positions(joints: tuple[float, ...]) -> list[int]:
    return [*map(to_q48, ARM.motors_from_joints(joints).tolist()), 0]


def planned(moves: list[Move], start_frame: int = 0) -> tuple[list[Piece], list[PlannedSegment]]:
    pieces = list(Planner(ARM, CONFIG, PICK_START_DEG).plan(moves))
    return pieces, list(Segmenter(CONFIG, positions(PICK_START_DEG), start_frame).segments(pieces))


def test_the_hand_is_an_event_in_a_wait_of_its_stroke() -> None:
    _, segments = planned([HandMove(True, at(1)), Dwell(0.5, at(2)), HandMove(False, at(3))])
    assert [item.segment.length_frames for item in segments] == [2000, 1563, 2000]
    assert all(item.segment.motors == () for item in segments)
    assert all(item.segment.flags == SegmentFlag.ENDS_AT_REST for item in segments)
    opened, closed = segments[0].segment.events[0], segments[2].segment.events[0]
    assert (opened.kind, opened.offset_frames, opened.value) == (EventKind.HAND, 0, 800)
    assert closed.value == -800
    assert segments[1].segment.events == ()


def test_a_long_wait_is_cut_where_the_wire_ends() -> None:
    _, segments = planned([Dwell(50.0, at(1))])
    assert sum(item.segment.length_frames for item in segments) == 156_250
    assert max(item.segment.length_frames for item in segments) == 65_535


def test_frames_wrap_at_32_bits_but_the_count_goes_on() -> None:
    start = (1 << 32) - 700
    _, segments = planned([JointMove(0, 20.0, True, at(1))], start)
    assert segments[-1].end_frame > 1 << 32
    assert {item.segment.start_frames for item in segments} == {item.start_frame & 0xFFFFFFFF for item in segments}


def test_rest_points_are_hit_to_a_thousandth_of_a_step() -> None:
    pieces, segments = planned(pick_and_place(2800.0, None))
    ends = [piece.rest_deg for piece in pieces if piece.law is not None]
    rests = [item for item in segments if item.segment.motors and item.segment.flags & SegmentFlag.ENDS_AT_REST]
    assert len(rests) == len(ends)
    for item, joints in zip(rests, ends, strict=True):
        exact = np.array(item.end_q48[:5]) / ONE_STEP
        np.testing.assert_allclose(exact, ARM.motors_from_joints(joints), atol=1e-3)


def test_the_stepping_of_the_board_gives_the_same_ends() -> None:
    _, segments = planned(pick_and_place(6000.0, 5.0)[:4])
    for item in segments:
        for term in item.segment.motors:
            *_, last = motor_states(item.start_q48[term.motor], term, item.segment.length_frames)
            assert last.p_q48 == item.end_q48[term.motor]


def test_going_there_and_back_a_hundred_times_does_not_drift() -> None:
    segmenter = Segmenter(CONFIG, positions(PICK_START_DEG), 0)
    there = (7.3, 76.9, -77.8, 11.7, -5.9)
    for _ in range(100):
        for first, last in ((PICK_START_DEG, there), (there, PICK_START_DEG)):
            list(segmenter.segments(plan_joint_move(ARM, CONFIG, first, last)))
    drift = np.array(segmenter.positions_q48) - np.array(positions(PICK_START_DEG))
    assert np.abs(drift).max() < ONE_STEP // 1000


def test_it_starts_from_the_exact_mirror_and_from_nowhere_else() -> None:
    pieces = list(plan_joint_move(ARM, CONFIG, PICK_START_DEG, (10.0, *PICK_START_DEG[1:])))
    shifted = [p + ONE_STEP // 3 for p in positions(PICK_START_DEG)]
    segments = list(Segmenter(CONFIG, shifted, 0).segments(pieces))
    assert segments[0].start_q48 == tuple(shifted)
    end = np.array(segments[-1].end_q48[:5]) / ONE_STEP
    np.testing.assert_allclose(end, ARM.motors_from_joints((10.0, *PICK_START_DEG[1:])), atol=1e-3)
    away = [p + 3 * ONE_STEP for p in positions(PICK_START_DEG)]
    with pytest.raises(PlanError, match=r"3\.00 steps away"):
        list(Segmenter(CONFIG, away, 0).segments(pieces))


def test_slopes_keep_a_ramp_within_the_reserve() -> None:
    """At rate r and slope k: |a| r^2 + k |v| <= ratio * A on every segment, also where the ramp goes on."""
    pieces, segments = planned(pick_and_place(6000.0, 5.0))
    limits = np.array([m.max_acceleration_deg_s2 * m.steps_per_deg for m in CONFIG.motors.ordered]) * FRAME_S**2
    for item in segments:
        for term in item.segment.motors:
            n = item.segment.length_frames
            v = [abs(term.v / 2**32 + k * term.a / 2**40 + k * k / 2 * term.j / 2**48) for k in (0, n / 2, n)]
            a = [abs(term.a / 2**40 + k * term.j / 2**48) for k in (0, n / 2, n)]
            for speed, acceleration in zip(v, a, strict=True):
                for slope, ratio in (
                    (item.segment.hold_slope, CONFIG.planner.hold_acceleration_ratio),
                    (item.segment.stop_slope, CONFIG.planner.stop_acceleration_ratio),
                ):
                    used = acceleration + slope / 2**20 * speed
                    assert used <= ratio * limits[term.motor] * 1.005
        assert item.segment.stop_slope >= item.segment.hold_slope
    horizon = stop_horizon(CONFIG, segments)
    assert horizon.stop_s < horizon.hold_s
    assert horizon.lead_segments <= 32
    assert pieces


def test_segments_are_long_on_a_trapezoid() -> None:
    """A joint move is three phases: it takes few segments, and few bytes."""
    pieces = plan_joint_move(ARM, CONFIG, (0, 50, -40, 90, 0), (60, 30, -60, 110, 20))
    segments = list(Segmenter(CONFIG, positions((0, 50, -40, 90, 0)), 0).segments(pieces))
    assert len(segments) <= 8
    size = 0
    for item in segments:
        payload = bytearray()
        item.segment.encode_into(payload)
        size += len(payload)
    assert size / pieces[0].duration_s < 150
    played = play_segments(CONFIG, segments, pieces)
    assert played.largest_error_steps <= 0.1


def test_a_cartesian_line_stays_below_250_bytes_a_second() -> None:
    pieces, segments = planned(
        [mode(None), RapidMove(target(300, -100, 200), at(1)), LinearMove(target(300, 100, 200), Feed(3000.0), at(2))]
    )
    size = 0
    for item in segments:
        payload = bytearray()
        item.segment.encode_into(payload)
        size += len(payload)
    assert size / sum(piece.duration_s for piece in pieces) < 250
    assert play_segments(CONFIG, segments, pieces).largest_error_steps <= 0.1

"""Segments and the events that go with them: what the board refuses, what it keeps, when a gated one may begin."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rm501_protocol.enums import BoardState, EventKind, HandState, HoldCause, ResumeCause, SegmentFlag
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.link_events import SessionLost
from rm501_protocol.messages import Hold, Refused, Resume, SetOverride, SetPositions, Start
from rm501_protocol.segment_message import MotorTerm, Segment, SegmentEvent, hand_event, output_event
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.test_commands import DIGITAL
from tests.firmware_model.test_states import SPEED, cruise

REST = SegmentFlag.ENDS_AT_REST


@pytest.mark.parametrize(
    ("segment", "reason", "value", "limit"),
    [
        (Segment(7, 10), RefusalReason.GAP, 7, 0),
        (Segment(0xFFFFFFFF, 10), RefusalReason.OVERLAP, -1, 0),
        (Segment(0, 0), RefusalReason.LENGTH, 0, 0xFFFF),
        (Segment(0, 32_768, (MotorTerm(0, 0, 0, 1),), SegmentFlag.CUBIC), RefusalReason.LENGTH, 32_768, 32_767),
        (Segment(0, 10, hold_slope=0), RefusalReason.SLOPE, 0, 0xFFFF),
        (Segment(0, 10, hold_slope=9, stop_slope=8), RefusalReason.SLOPE, 9, 8),
        (Segment(0, 10, flags=SegmentFlag.JOG), RefusalReason.NO_LEASE, 0, 0),
        (Segment(0, 10, (MotorTerm(5, 1),)), RefusalReason.UNKNOWN_MOTOR, 5, 6),
        (Segment(0, 10, (MotorTerm(7, 1),)), RefusalReason.UNKNOWN_MOTOR, 7, 6),
        (Segment(0, 10, events=(output_event(10, 4, 4),)), RefusalReason.EVENT, 10, 10),
        (Segment(0, 10, events=(output_event(3, 1, 1),)), RefusalReason.OUTPUT_NOT_FITTED, 1, 0),
        (Segment(0, 10, events=(hand_event(0, 1201),)), RefusalReason.HAND_LIMIT, 1201, 1200),
        (Segment(0, 90, events=(hand_event(0, 40), hand_event(50, 5))), RefusalReason.HAND_BUSY, 50, 100),
        (Segment(0, 90, events=(hand_event(9, 4), hand_event(5, 5))), RefusalReason.EVENT, 5, 90),
    ],
)
def test_a_segment_is_refused_whole_and_says_why(
    segment: Segment, reason: RefusalReason, value: int, limit: int
) -> None:
    rig = Rig()
    before = rig.status()
    refused = rig.refusal(segment)
    assert (refused.message_id, refused.reason, refused.value, refused.limit) == (Segment.ID, reason, value, limit)
    after = rig.status()
    assert replace(after, refused=0) == replace(before, refused=0)
    assert after.refused == before.refused + 1


def test_rate_acceleration_jump_and_end_are_checked_to_the_last_bit() -> None:
    rig = Rig()
    layout = rig.core.layout
    jump = layout.max_speed_jump >> 16
    a_limit = layout.max_acceleration[1] >> 8
    assert rig.refusal(Segment(0, 10, (MotorTerm(1, jump + 1),))).reason is RefusalReason.VELOCITY_STEP
    assert rig.refusal(Segment(0, 10, (MotorTerm(1, 0, a_limit + 1),))).reason is RefusalReason.ACCELERATION_LIMIT
    assert rig.refusal(Segment(0, 10, (MotorTerm(1, 0, -a_limit - 1),))).limit == a_limit
    cubic = SegmentFlag.CUBIC
    late = MotorTerm(1, 0, 0, a_limit)  # acceleration reaches the limit at frame 256
    assert rig.refusal(Segment(0, 259, (late,), cubic)).reason is RefusalReason.ACCELERATION_LIMIT
    # the middle of a segment is faster than both its ends
    length = 24_000
    bump = MotorTerm(1, 0, a_limit, -((a_limit << 8) * 2 // length))
    found = rig.refusal(Segment(0, length, (bump,), cubic))
    assert found.reason is RefusalReason.RATE_LIMIT
    assert found.value > found.limit > 0
    down = replace(bump, a=-bump.a, j=-bump.j)
    assert rig.refusal(Segment(0, length, (down,), cubic)).value < 0
    assert rig.refusal(Segment(0, 3000, (MotorTerm(1, 0, a_limit // 2),), REST)).reason is RefusalReason.ENDS_AT_SPEED
    ok = Segment(0, 10, (MotorTerm(1, jump),))
    rig.messages.clear()
    rig.send(ok)
    assert not rig.got(Refused)
    # standing still from here on is a jump too
    assert rig.refusal(Segment(10, 3, (MotorTerm(1, 3 * jump),))).reason is RefusalReason.VELOCITY_STEP


def test_a_malicious_speed_is_refused_within_the_range_of_the_field() -> None:
    rig = Rig()
    term = MotorTerm(0, -(1 << 31), -(1 << 31), -(1 << 31))
    assert rig.refusal(Segment(0, 32_767, (term,), SegmentFlag.CUBIC)).value == -(1 << 31) + 1


def test_positions_stay_far_from_the_edge_of_their_range() -> None:
    rig = Rig()
    near = (1 << 31) - (1 << 16) - 1000
    rig.send(SetPositions(1, (near, 0, 0, 0, 0, 0)))
    rig.send(cruise(rig)[0])
    found = rig.refusal(Segment(2000, 20_000, (MotorTerm(0, SPEED),)))
    assert found.reason is RefusalReason.POSITION_RANGE
    assert found.limit == (1 << 31) - (1 << 16) < found.value


def test_fault_17_a_full_queue_refuses_and_keeps_playing() -> None:
    rig = Rig()
    rig.go(*[rig.segment(2000) for _ in range(32)])
    rig.run(10)
    refusals = []
    before = rig.status()
    for _ in range(3):
        # a host that ignores the window: straight into the board's command handling
        rig.board._commands.obey(Segment(rig.start_frames, 5), 9)
    rig.exchange()
    refusals = rig.got(Refused)
    assert [refused.reason for refused in refusals] == [RefusalReason.QUEUE_FULL] * 3
    assert refusals[0].limit == rig.start_frames
    rig.run(500)
    after = rig.status()
    assert (after.state, after.queue_end_frame) == (BoardState.RUNNING, before.queue_end_frame)
    assert after.motion_frame == before.motion_frame + 500


def test_the_ring_of_events_is_bounded_and_never_overwritten() -> None:
    rig = Rig(DIGITAL)
    eight = tuple(output_event(n, 4, 4 * (n & 1)) for n in range(8))
    rig.send(*[rig.segment(20, events=eight) for _ in range(4)])
    found = rig.refusal(Segment(rig.start_frames, 20, events=eight[:1]))
    assert found.reason is RefusalReason.QUEUE_FULL
    rig.send(Segment(rig.start_frames, 20, flags=REST), Start())
    rig.run(200)
    assert rig.state is BoardState.READY


def test_a_segment_may_wait_for_a_real_frame() -> None:
    rig = Rig()
    rig.run(100)
    at = rig.board.frame + 500
    gate = SegmentFlag.START_AT_REAL_FRAME
    rig.go(rig.segment(50, flags=REST | gate, real_frame=at))
    rig.run(at - rig.board.frame)
    assert (rig.state, rig.status().motion_frame) == (BoardState.RUNNING, 0)
    rig.run(1)
    assert rig.status().motion_frame == 1  # the frame `at` was the first to play
    rig.run(50)
    assert rig.state is BoardState.READY
    # behind rest it may follow at once; not behind motion, nor two of them, nor in the past
    at = rig.board.frame + 300
    rig.go(rig.segment(50, flags=REST), rig.segment(50, flags=gate | REST, real_frame=at), rig.segment(9, flags=REST))
    two = Segment(rig.start_frames, 5, flags=gate, real_frame=at + 100)
    assert rig.refusal(two).reason is RefusalReason.NOT_AT_REST
    rig.run(200)
    assert (rig.state, rig.status().rate) == (BoardState.RUNNING, 0)
    rig.run(159)
    assert rig.state is BoardState.READY
    rig.send(rig.segment(5))
    assert rig.refusal(Segment(rig.start_frames, 5, flags=gate, real_frame=rig.board.frame + 9)).reason is (
        RefusalReason.NOT_AT_REST
    )
    rig = Rig()
    past = rig.refusal(Segment(0, 5, flags=gate, real_frame=0xFFFFFFFF))
    assert (past.reason, past.value, past.limit) == (RefusalReason.REAL_FRAME, -1, 1)


def test_a_gated_start_can_be_held_and_stopped() -> None:
    rig = Rig()
    rig.send(rig.segment(500, flags=REST), Start(True, 400))
    rig.run(100)
    assert (rig.state, rig.status().motion_frame) == (BoardState.RUNNING, 0)
    rig.send(Hold())
    rig.run(2)
    assert rig.state is BoardState.HELD
    rig.run(700)
    rig.send(Resume())
    rig.run(3)
    assert (rig.state, rig.status().rate) == (BoardState.RUNNING, ONE)
    rig.run(600)
    assert rig.state is BoardState.READY
    rig.send(rig.segment(500, flags=REST))
    assert rig.refusal(Start(True, 5)).reason is RefusalReason.REAL_FRAME


def test_a_gate_does_not_open_onto_a_queue_that_is_too_short_to_stop_in() -> None:
    """Gated under override 0, the override raised while it waits: what is queued lets nothing run at that rate."""
    rig = Rig()
    at = rig.board.frame + 100
    rig.send(SetOverride(0), rig.segment(200, MotorTerm(0, 0, 1 << 20)), Start(True, at))
    rig.run(5)
    assert (rig.state, rig.status().hold_cause) == (BoardState.HELD, HoldCause.OVERRIDE)
    rig.send(SetOverride(ONE))
    assert rig.state is BoardState.RUNNING
    rig.run(200)
    status = rig.status()
    assert (status.state, status.hold_cause) == (BoardState.HELD, HoldCause.LOW_WATER)
    assert (status.motion_frame, status.fault) == (0, FaultCode.NONE)
    rig.send(rig.segment(3000, MotorTerm(0, 200 << 12)), Resume(ResumeCause.REFILLED))
    rig.run(6000)
    assert rig.state is BoardState.HELD, "low water again, on the path"
    assert rig.status().fault is FaultCode.NONE and rig.status().motion_frame > 2000


def test_events_of_unknown_kinds_never_reach_the_queue() -> None:
    # the protocol refuses them: there are two kinds
    assert {kind.name for kind in EventKind} == {"HAND", "OUTPUT"}
    assert SegmentEvent(0, EventKind.HAND, 0).value == 0
    assert HandState.UNKNOWN == 0 and SessionLost is not None

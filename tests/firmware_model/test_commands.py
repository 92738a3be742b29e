"""What each message does beyond the transition table: guards, refusals with their numbers, effects."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rm501_firmware_model import Board, QuietPins
from rm501_protocol.board_config import RM501_BOARD, InputId
from rm501_protocol.config_pages import ConfigCommit, OutputPin, OutputSource
from rm501_protocol.enums import (
    BoardState,
    Edge,
    EndCause,
    EventKind,
    HandState,
    HoldCause,
    ResumeCause,
    SegmentFlag,
    TriggerAction,
)
from rm501_protocol.errors import ConfigError
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.link_events import SessionLost
from rm501_protocol.messages import (
    ArmTrigger,
    ConfigAccepted,
    DisarmTrigger,
    Hold,
    Lease,
    MotionEnded,
    Refused,
    Reset,
    Resume,
    SetOutputs,
    SetOverride,
    SetPositions,
    SetPower,
    SetStatusPeriod,
    Start,
    Status,
    Truncate,
    Truncated,
)
from rm501_protocol.segment import end_positions_q48
from rm501_protocol.segment_message import MotorTerm, Segment, SegmentEvent, hand_event, output_event
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.test_states import SPEED, cruise, to_held, to_running

DIGITAL = replace(
    RM501_BOARD,
    pins=replace(
        RM501_BOARD.pins,
        outputs=(*RM501_BOARD.pins.outputs, OutputPin(OutputSource.DIGITAL + 2, 30, False)),
    ),
)
REST = SegmentFlag.ENDS_AT_REST


# --------------------------------------------------------------------------------------------------------- segments


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


# ------------------------------------------------------------------------------------------- start, hold, resume, rate


def test_start_waits_until_the_queue_lets_it_stop_again() -> None:
    rig = Rig()
    first, second = cruise(rig)
    rig.send(Segment(0, 100, first.motors, hold_slope=100, stop_slope=100), Start())
    rig.run(20)
    assert (rig.state, rig.status().motion_frame) == (BoardState.READY, 0)
    rig = Rig()
    first, second = cruise(rig)
    rig.send(Segment(0, 2000, first.motors, hold_slope=100, stop_slope=100), Start())
    assert rig.state is BoardState.READY
    rig.send(replace(second, hold_slope=100, stop_slope=100))
    assert rig.state is BoardState.RUNNING  # the pending start


def test_a_pending_start_is_forgotten_when_its_motion_is_dropped_or_its_session_is_over() -> None:
    for dropped in (True, False):
        rig = Rig()
        first, second = cruise(rig)
        first, second = (replace(part, hold_slope=100, stop_slope=100) for part in (first, second))
        rig.send(replace(first, length_frames=2000), Start())
        if dropped:
            rig.send(Truncate(0))
            assert rig.status().queue_used == 0
            rig.send(replace(first, length_frames=2000))
        else:
            rig.host.connect(4321, rig.now_us)
            rig.exchange()
            rig.exchange()
        rig.send(second)
        rig.run(5)
        assert (rig.state, rig.status().queue_used) == (BoardState.READY, 2)
        rig.send(Start())
        assert rig.state is BoardState.RUNNING


def test_high_water_starts_by_itself_where_configured() -> None:
    config = replace(RM501_BOARD, link=replace(RM501_BOARD.link, high_water_frames=3000))
    rig = Rig(config)
    first, second = cruise(rig)
    rig.send(first)
    assert rig.state is BoardState.READY
    rig.send(second)
    assert rig.state is BoardState.RUNNING
    assert Rig().core.layout.high_water_frames == 0  # only Start, by default


def test_override_ramps_the_rate_and_0_holds() -> None:
    rig = to_running()
    rig.send(SetOverride(ONE // 4))
    rig.run(1)
    assert ONE // 4 < rig.status().rate < ONE
    rig.run(2000)
    quarter = rig.status()
    assert (quarter.rate, quarter.state) == (ONE // 4, BoardState.RUNNING)
    rig.run(400)
    assert rig.status().motion_frame == quarter.motion_frame + 100
    rig.send(SetOverride(0))
    rig.run_to(BoardState.HELD)
    assert rig.status().hold_cause is HoldCause.OVERRIDE
    assert rig.refusal(Resume()).reason is RefusalReason.WRONG_CAUSE
    rig.send(SetOverride(ONE))
    rig.run(3000)
    assert (rig.status().rate, rig.state) == (ONE, BoardState.RUNNING)
    assert rig.refusal(SetOverride(ONE + 1)).reason is RefusalReason.OVERRIDE_RANGE
    rig.send(SetOverride(ONE // 2))
    rig.run(10)
    rig.send(SetOverride(ONE))
    rig.run(3000)
    assert rig.status().rate == ONE


def test_start_under_override_0_is_held_at_once() -> None:
    rig = Rig()
    rig.send(SetOverride(0))
    rig.go(rig.segment(100, flags=REST))
    rig.run(3)
    assert (rig.state, rig.status().motion_frame) == (BoardState.HELD, 0)
    rig.send(SetOverride(ONE // 2))
    rig.run(1000)
    assert rig.state is BoardState.READY


def test_a_pending_start_under_override_0_is_held_by_the_segment_that_lets_it_begin() -> None:
    rig = Rig()
    rig.send(SetOverride(0), rig.segment(1, MotorTerm(0, 0)), Start())
    assert rig.state is BoardState.READY
    rig.send(rig.segment(3000, MotorTerm(0, 0)))
    assert rig.state is BoardState.HOLDING
    rig.run(2)
    assert rig.state is BoardState.HELD and rig.status().hold_cause is HoldCause.OVERRIDE
    assert rig.status().fault is FaultCode.NONE
    rig.send(SetOverride(ONE))
    assert rig.state is BoardState.RUNNING


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


def test_holds_have_causes_and_each_has_its_own_way_out() -> None:
    rig = to_held()
    refused = rig.refusal(Resume(ResumeCause.REFILLED))
    assert (refused.reason, refused.limit) == (RefusalReason.WRONG_CAUSE, HoldCause.USER)
    rig.send(SetOverride(0))
    rig.send(Resume())  # the override still holds it
    assert (rig.state, rig.status().hold_cause) == (BoardState.HELD, HoldCause.OVERRIDE)
    rig.send(SetOverride(ONE))
    assert rig.state is BoardState.RUNNING
    rig.send(Hold())
    rig.run(10)
    rig.send(Resume())
    assert rig.state is BoardState.RUNNING


def test_hold_at_rest_keeps_a_program_from_starting() -> None:
    rig = Rig()
    rig.send(Hold())
    assert rig.state is BoardState.HELD
    rig.send(rig.segment(50, flags=REST))
    assert rig.refusal(Start()).reason is RefusalReason.WRONG_STATE
    rig.send(Resume())
    assert rig.state is BoardState.READY
    rig.send(Start())
    rig.run(60)
    assert rig.state is BoardState.READY
    # a start that is pending goes on after the resume
    pending = Rig()
    first, second = cruise(pending)
    pending.send(Segment(0, 2000, first.motors, hold_slope=100, stop_slope=100), Start())
    pending.send(Hold())
    pending.send(replace(second, hold_slope=100, stop_slope=100))
    pending.send(Resume())
    assert pending.state is BoardState.RUNNING


def test_a_hold_that_ends_at_a_point_of_rest_is_still_a_hold() -> None:
    rig = Rig()
    rig.go(rig.segment(400, hold=300, stop=300, flags=REST))
    rig.run(100)
    rig.send(Hold())
    rig.run_to(BoardState.HELD)
    assert (rig.status().queue_used, rig.core.resting) == (0, 1)
    rig.send(Resume())
    assert rig.state is BoardState.READY


def test_at_rest_in_mid_queue_a_short_queue_waits_there() -> None:
    rig = Rig()
    rig.go(rig.segment(300, flags=REST))
    rig.send(rig.segment(40, MotorTerm(0, 0, 1 << 20), hold=100, stop=100))
    rig.run(310)
    status = rig.status()
    assert (status.state, status.hold_cause, status.motion_frame) == (BoardState.HELD, HoldCause.LOW_WATER, 300)
    rig.send(rig.segment(10, flags=REST), Resume(ResumeCause.REFILLED))
    rig.run(2000)
    assert rig.state is BoardState.READY
    # the same while a user's hold is ramping: still the user's
    rig = Rig()
    rig.go(rig.segment(300, hold=100, stop=100, flags=REST))
    rig.send(rig.segment(40, MotorTerm(0, 0, 1 << 20), hold=100, stop=100))
    rig.run(290)
    rig.send(Hold())
    rig.run(30)
    assert (rig.status().hold_cause, rig.status().motion_frame) == (HoldCause.USER, 300)


def test_low_water_stops_before_the_queue_ends_and_the_host_goes_on() -> None:
    rig = Rig()
    rig.go(*cruise(rig, 6000))
    rig.run_to(BoardState.HELD, step=50)
    status = rig.status()
    assert (status.hold_cause, status.queue_used) == (HoldCause.LOW_WATER, 1)
    assert 0 < 8000 - status.motion_frame < 20
    rig.send(rig.segment(9000, MotorTerm(0, SPEED), hold=800, stop=1600), Resume(ResumeCause.REFILLED))
    rig.run(2000)
    assert (rig.state, rig.status().rate) == (BoardState.RUNNING, ONE)


# ------------------------------------------------------------------------------------------------------------ truncate


def three_segments() -> tuple[Rig, list[Segment]]:
    rig = Rig()
    made = [*cruise(rig, 3000), rig.segment(3000, MotorTerm(0, SPEED), hold=800, stop=1600)]
    made.append(rig.segment(3000, MotorTerm(0, SPEED), hold=800, stop=1600, events=(hand_event(100, 9),)))
    made.append(rig.segment(3000, MotorTerm(0, SPEED), hold=800, stop=1600, events=(hand_event(100, -9),)))
    rig.go(*made)
    rig.run(2500)
    return rig, made


def test_truncate_keeps_what_starts_before_and_the_next_segment_starts_there() -> None:
    rig, made = three_segments()
    rig.messages.clear()
    rig.send(Truncate(8100))  # inside the third: it stays
    assert rig.take(Truncated).end_frame == 11_000
    assert rig.core.queue.event_count == 1
    positions = (0,) * 6
    for segment in made[:4]:
        positions = end_positions_q48(positions, segment)
    assert tuple(rig.core.checker.end_position) == positions
    assert rig.refusal(Segment(14_000, 10)).reason is RefusalReason.GAP
    rig.send(Segment(11_000, 3000, (MotorTerm(0, SPEED, -(SPEED << 8) // 3000),), REST, 800, 1600))
    rig.run(20_000)
    assert (rig.state, rig.status().motion_frame) == (BoardState.READY, 14_000)
    rig.send(Truncate(20_000))  # beyond the end: nothing to drop
    assert rig.got(Truncated)[-1].end_frame == 14_000


def test_truncate_too_near_names_the_earliest_frame() -> None:
    rig, _ = three_segments()
    rig.run(2000)  # at frame 4500, 500 frames before the boundary; stopping takes 655
    refused = rig.refusal(Truncate(5000))
    assert (refused.reason, refused.value, refused.limit) == (RefusalReason.TOO_NEAR, 5000, 8000)
    assert rig.refusal(Truncate(4000)).reason is RefusalReason.TOO_NEAR
    rig.send(Truncate(8000))
    rig.run_to(BoardState.HELD, step=20)
    assert rig.status().hold_cause is HoldCause.LOW_WATER
    rig, _ = three_segments()
    rig.send(Truncate(14_000))
    assert not rig.got(Refused)
    # nothing but the last end is far enough
    short = to_running()
    short.run(18_000)
    assert short.refusal(Truncate(100)).limit == 22_000


def test_truncate_of_a_held_program_ends_it_there_with_the_exact_positions() -> None:
    rig = to_held()
    frame = rig.status().motion_frame
    rig.messages.clear()
    rig.send(Truncate(frame))
    rig.run(1)
    ended = rig.got(MotionEnded)[0]
    assert (ended.cause, ended.motion_frame, rig.state) == (EndCause.TRUNCATED, frame, BoardState.READY)
    assert rig.got(Truncated)[0].end_frame == frame
    assert ended.positions_q48 == rig.board.positions_q48
    assert ended.positions_q48[0] % (1 << 48) != 0  # in the middle of a step
    # motion goes on from exactly there
    rig.start_frames = frame
    rig.go(rig.segment(500, MotorTerm(0, 0, 1000), flags=REST))
    rig.run(600)
    assert (
        rig.board.positions_q48[0]
        == end_positions_q48(ended.positions_q48, Segment(frame, 500, (MotorTerm(0, 0, 1000),)))[0]
    )


def test_truncate_before_anything_moves_drops_all() -> None:
    rig = Rig()
    rig.send(*cruise(rig))
    rig.send(Truncate(0))  # an urgent message overtakes segments that still wait to be sent
    assert rig.got(Truncated)[0].end_frame == 0
    assert rig.status().queue_used == 0
    rest = Rig()
    rest.go(rest.segment(500, flags=REST), rest.segment(800, flags=REST))
    rest.run(100)
    rest.send(Truncate(500))
    assert rest.got(Truncated)[0].end_frame == 500
    rest.run(500)
    assert rest.state is BoardState.READY


def test_truncate_while_held_at_a_later_boundary_keeps_the_hold() -> None:
    rig, _ = three_segments()
    rig.send(Hold())
    rig.run_to(BoardState.HELD)
    rig.messages.clear()
    rig.send(Truncate(5000))
    assert (rig.take(Truncated).end_frame, rig.state) == (5000, BoardState.HELD)


def test_the_hand_is_free_once_its_pulses_are_made_however_little_motion_was_played_since() -> None:
    """A stroke runs on real frames: where motion was ended in the middle of one, motion time stands and it goes on."""
    rig = Rig()
    rig.go(rig.segment(3000, hold=0xFFFF, stop=0xFFFF, flags=REST, events=(hand_event(0, 400),)))
    rig.run(10)
    rig.send(Hold())
    rig.run_to(BoardState.HELD)
    frame = rig.status().motion_frame
    rig.send(Truncate(frame))
    rig.run(1)
    pending = rig.core.hand.pending
    assert (rig.state, pending) == (BoardState.READY, 400 - rig.core.hand.count)
    assert pending > 100
    again = Segment(frame, 9, flags=REST, events=(hand_event(0, -5),))
    assert rig.refusal(again).reason is RefusalReason.HAND_BUSY
    rig.run(3 * pending)
    rig.messages.clear()
    rig.start_frames = frame
    rig.go(again)
    rig.run(100)
    assert (rig.got(Refused), rig.core.hand.count) == ([], 395)


# ----------------------------------------------------------------------------------------------------------- jog lease


def test_a_jog_ends_with_its_lease() -> None:
    rig = Rig()
    rig.send(Lease(200))
    rig.go(*cruise(rig, jog=True))
    for _ in range(20):
        rig.run(400)
        rig.send(Lease(200))
    assert (rig.state, rig.status().lease_ms) == (BoardState.RUNNING, 200)
    rig.messages.clear()
    rig.run(700)
    assert rig.state is BoardState.STOPPING
    rig.run_to(BoardState.READY)
    ended = rig.ended()
    assert ended.cause is EndCause.LEASE
    assert ended.positions_q48 == rig.board.positions_q48
    assert rig.status().queue_used == 0
    assert rig.refusal(Segment(ended.motion_frame, 10, flags=SegmentFlag.JOG)).reason is RefusalReason.NO_LEASE


def test_lease_0_ends_a_jog_at_once_and_no_lease_matters_without_one() -> None:
    rig = Rig()
    rig.send(Lease(60_000))
    rig.go(*cruise(rig, jog=True))
    rig.run(2500)
    rig.send(Hold())
    rig.run_to(BoardState.HELD)
    rig.messages.clear()
    rig.send(Lease(0))
    rig.run(1)
    assert (rig.ended().cause, rig.state) == (EndCause.LEASE, BoardState.READY)
    rig.send(Lease(0))  # none running
    other = to_running()
    other.send(Lease(10))
    other.run(200)
    assert other.state is BoardState.RUNNING
    waiting = Rig()
    waiting.send(Lease(10), *cruise(waiting, jog=True))
    waiting.run(200)
    assert waiting.got(MotionEnded)[0].cause is EndCause.LEASE
    assert (waiting.status().queue_used, waiting.state) == (0, BoardState.READY)


# ------------------------------------------------------------------------------------------- positions, outputs, power


def test_set_positions_trusts_and_defines() -> None:
    rig = Rig()
    rig.send(SetPositions(0b100101, (7, 8, -9, 1, 1, 44)))
    status = rig.status()
    assert (status.positions_steps, status.trusted_mask) == ((7, 0, -9, 0, 0, 44), 0b100101)
    assert rig.board.positions_q48 == (7 << 48, 0, -9 << 48, 0, 0, 44 << 48)
    rig.send(rig.segment(10))
    assert rig.refusal(SetPositions(1, (0,) * 6)).reason is RefusalReason.NOT_AT_REST
    rig = Rig()
    assert rig.refusal(SetPositions(1, (0,) * 5)).reason is RefusalReason.UNKNOWN_MOTOR
    assert rig.refusal(SetPositions(0x40, (0,) * 6)).reason is RefusalReason.UNKNOWN_MOTOR
    rig.send(SetPositions(0x3F, (0,) * 6), SetPower(False))
    assert rig.status().trusted_mask == 0  # without power the arm sinks
    keeping = replace(RM501_BOARD, link=replace(RM501_BOARD.link, trust_without_power=True))
    rig = Rig(keeping)
    rig.send(SetPositions(0x3F, (0,) * 6), SetPower(False))
    assert rig.status().trusted_mask == 0x3F


def test_power_at_rest_only_and_dropping_a_held_program() -> None:
    rig = to_held()
    rig.messages.clear()
    rig.send(SetPower(False))
    rig.run(1)
    assert (rig.ended().cause, rig.state) == (EndCause.POWER_OFF, BoardState.IDLE)
    rig.send(SetPower(False))
    rig.send(SetPower(True), SetPower(True))
    assert rig.state is BoardState.READY and not rig.got(Refused)


def test_after_a_stop_power_needs_a_reset() -> None:
    rig = to_running()
    rig.messages.clear()
    rig.stop()
    rig.run_to(BoardState.IDLE)
    assert rig.ended().cause is EndCause.STOP
    assert rig.refusal(SetPower(True)).reason is RefusalReason.WRONG_STATE
    rig.send(Reset(FaultCode.NONE), SetPower(True))
    assert rig.state is BoardState.READY


def test_digital_outputs_by_message_and_by_event() -> None:
    rig = Rig(DIGITAL)
    assert rig.refusal(SetOutputs(0b101, 0b101)).value == 1
    rig.send(SetOutputs(4, 4))
    rig.run(1)
    assert rig.status().outputs == 4
    rig.go(
        rig.segment(100, flags=REST, events=(output_event(10, 4, 0), output_event(10, 4, 4), output_event(60, 4, 0)))
    )
    first = rig.board.frame
    rig.run(200)
    words = rig.pins.words()[:, 0] >> 30 & 1
    assert words[first - 1] == 1 and words[first + 59] == 1
    assert words[first + 60] == 0  # exactly at its motion frame
    assert rig.status().outputs == 0


# --------------------------------------------------------------------------------------------------- triggers, config


def test_triggers_and_inputs_that_do_not_exist() -> None:
    rig = Rig()
    assert rig.refusal(ArmTrigger(4, 0, Edge.RISING)).reason is RefusalReason.UNKNOWN_TRIGGER
    assert rig.refusal(ArmTrigger(0, 10, Edge.RISING)).reason is RefusalReason.UNKNOWN_INPUT
    assert rig.refusal(DisarmTrigger(4)).reason is RefusalReason.UNKNOWN_TRIGGER
    rig.send(ArmTrigger(2, InputId.SWITCH_ELBOW, Edge.RISING, TriggerAction.LATCH))
    assert rig.status().armed_triggers == 4
    rig.send(DisarmTrigger(2))
    assert rig.status().armed_triggers == 0


def test_configuration_page_by_page() -> None:
    rig = Rig(configured=False)
    assert rig.state is BoardState.BOOT
    assert rig.host.identify is not None and rig.host.identify.config_hash == 0
    config = replace(RM501_BOARD, timing=replace(RM501_BOARD.timing, base_period_us=50))
    rig.send(*config.pages()[:-1])
    assert rig.refusal(ConfigCommit(config.hash)).reason is RefusalReason.CONFIG_INVALID
    rig.send(config.pages()[-1])
    assert rig.refusal(ConfigCommit(config.hash ^ 1)).reason is RefusalReason.CONFIG_HASH
    rig.messages.clear()
    now_us = rig.now_us
    rig.send(ConfigCommit(config.hash))
    assert rig.take(ConfigAccepted).config_hash == config.hash
    assert (rig.state, rig.board.frame_us) == (BoardState.IDLE, 400)
    assert now_us <= rig.now_us < now_us + 400  # time goes on
    rig.connect(99)
    assert rig.host.identify.config_hash == config.hash and rig.host.identify.base_period_us == 50
    # the same again changes nothing
    rig.send(SetPower(True), SetPositions(1, (5,) * 6), SetPower(False))
    rig.send(*config.pages(), ConfigCommit(config.hash))
    assert rig.got(ConfigAccepted) and rig.status().positions_steps[0] == 5
    impossible = replace(config, timing=replace(config.timing, step_length_frames=0))
    rig.send(*impossible.pages())
    assert rig.refusal(ConfigCommit(impossible.hash)).reason is RefusalReason.CONFIG_INVALID
    assert rig.board.config == config


def test_a_board_needs_pins_and_a_possible_configuration() -> None:
    with pytest.raises(TypeError, match="pins"):
        Board()
    bad = replace(RM501_BOARD, timing=replace(RM501_BOARD.timing, step_space_frames=0))
    with pytest.raises(ConfigError):
        Board(bad, QuietPins())


def test_reset_names_the_fault_it_clears() -> None:
    rig = to_running()
    rig.pins.toggle(InputId.OVERFLOW_732)
    rig.run(5)
    assert rig.refusal(Reset(FaultCode.ESTOP)).reason is RefusalReason.WRONG_FAULT
    refused = rig.refusal(Reset(FaultCode.OVERFLOW))
    assert (refused.reason, refused.value) == (RefusalReason.STILL_ACTIVE, FaultCode.OVERFLOW)
    rig.pins.toggle(InputId.OVERFLOW_732)
    rig.run(5)
    rig.send(Reset(FaultCode.OVERFLOW))
    assert rig.state is BoardState.READY  # power was never lost


def test_status_by_period_and_on_changes() -> None:
    rig = Rig()
    rig.send(SetStatusPeriod(10))
    rig.messages.clear()
    rig.run(320, 8)  # 102.4 ms
    assert len(rig.got(Status)) in (9, 10)
    rig.send(SetStatusPeriod(0))
    rig.messages.clear()
    rig.run(1000)
    assert not rig.got(Status)
    rig.send(SetPower(False))
    assert rig.got(Status)


def test_events_of_unknown_kinds_never_reach_the_queue() -> None:
    # the protocol refuses them: there are two kinds
    assert {kind.name for kind in EventKind} == {"HAND", "OUTPUT"}
    assert SegmentEvent(0, EventKind.HAND, 0).value == 0
    assert HandState.UNKNOWN == 0 and SessionLost is not None

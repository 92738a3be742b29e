"""Start, hold, resume and the rate: when motion begins, what brings it to rest on its path, who may go on."""

from __future__ import annotations

from dataclasses import replace

from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState, HoldCause, ResumeCause, SegmentFlag
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.messages import Hold, Resume, SetOverride, Start, Truncate
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.test_states import SPEED, cruise, to_held, to_running

REST = SegmentFlag.ENDS_AT_REST


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

"""What ends motion early: a truncated queue, the end of a jog's lease."""

from __future__ import annotations

from rm501_protocol.enums import BoardState, EndCause, HoldCause, SegmentFlag
from rm501_protocol.faults import RefusalReason
from rm501_protocol.messages import Hold, Lease, MotionEnded, Refused, Truncate, Truncated
from rm501_protocol.segment import end_positions_q48
from rm501_protocol.segment_message import MotorTerm, Segment, hand_event
from tests.firmware_model.rig import Rig
from tests.firmware_model.test_states import SPEED, cruise, to_held, to_running

REST = SegmentFlag.ENDS_AT_REST


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

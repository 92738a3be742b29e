"""Motion through the whole board: queue, start, hold, resume, rest."""

from __future__ import annotations

from rm501_protocol.enums import BoardState, HoldCause, SegmentFlag
from rm501_protocol.messages import Hold, Resume
from rm501_protocol.segment_message import MotorTerm
from tests.firmware_model.rig import Rig, rest_to_rest

FAST = int(0.38 * 2**32)


def there(rig: Rig, motor: int = 0, sign: int = 1) -> None:
    """Start a trapezoid of one motor: 3800 steps in 15,000 frames."""
    terms = rest_to_rest(motor, 5000, FAST)
    segments = [
        rig.segment(
            length,
            MotorTerm(motor, sign * v, sign * a),
            flags=SegmentFlag.ENDS_AT_REST if index == 2 else SegmentFlag.NONE,
        )
        for index, (length, v, a) in enumerate(terms)
    ]
    rig.go(*segments)


def test_a_trapezoid_arrives_and_ends_ready() -> None:
    rig = Rig()
    there(rig)
    assert rig.state is BoardState.RUNNING
    rig.run(15_001)
    assert rig.state is BoardState.READY
    assert rig.status().positions_steps[0] == 3800


def test_hold_stops_on_the_path_and_resume_reaches_the_same_end() -> None:
    rig = Rig()
    there(rig)
    rig.run(7000)
    rig.send(Hold())
    rig.run_to(BoardState.HELD)
    held = rig.status()
    assert (held.hold_cause, held.rate) == (HoldCause.USER, 0)
    # rate 1 to 0 at 400/2^20 per frame takes 2621 frames, in which half as many motion frames pass
    assert abs(held.motion_frame - 7000 - 2621 / 2) < 3
    rig.run(1000)
    assert rig.status().positions_steps == held.positions_steps
    rig.send(Resume())
    rig.run_to(BoardState.READY)
    assert rig.status().positions_steps[0] == 3800

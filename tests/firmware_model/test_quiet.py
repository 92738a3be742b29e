"""The promise of silence: until then a board has nothing to say, in any state, and the reference promises nothing."""

from __future__ import annotations

import pytest

from rm501_firmware_model import Board, FastBoard
from rm501_protocol.enums import BoardState, SegmentFlag
from rm501_protocol.host_link import HostLink
from rm501_protocol.messages import Hold, Lease, SetStatusPeriod, Start, StatusRequest
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.rig import RecordingPins, Rig


def moving(board: type[Board], period_ms: int) -> Rig:
    """A board that accelerates, runs and brakes, with a status every so often."""
    rig = Rig(board=board)
    rig.send(SetStatusPeriod(period_ms))
    v = 400 * (8000 << 8) >> 16
    rig.send(
        Segment(0, 400, (MotorTerm(0, 0, 8000),)),
        Segment(400, 3000, (MotorTerm(0, v),)),
        Segment(3400, 400, (MotorTerm(0, v, -8000),), SegmentFlag.ENDS_AT_REST),
        Start(),
    )
    rig.run_to(BoardState.RUNNING)
    return rig


def said(rig: Rig, frames: int) -> list[tuple[int, bytes]]:
    """Run frame by frame without a host; when something was said, and what. Checks every promise on the way."""
    board = rig.board
    heard: list[tuple[int, bytes]] = []
    promised = board.frame
    end = board.frame + frames
    while board.frame < end:
        data = board.transmit()
        if data:
            assert board.frame >= promised, f"said something at {board.frame}, silent until {promised} was promised"
            heard.append((board.frame, data))
        promised = max(promised, board.quiet_until()) if not data else board.quiet_until()
        board.run_until(board.frame + 1)
    return heard


@pytest.mark.parametrize("period_ms", [0, 20, 100])
def test_nothing_is_said_before_the_promised_frame(period_ms: int) -> None:
    rig = moving(FastBoard, period_ms)
    heard = said(rig, 5000)
    assert heard
    assert heard == said(moving(Board, period_ms), 5000)


def test_an_idle_board_promises_a_long_silence_and_keeps_it() -> None:
    rig = Rig(board=FastBoard)
    rig.run(10)
    rig.board.transmit()
    until = rig.board.quiet_until()
    assert until > rig.board.frame + 100
    rig.board.run_until(until - 1)
    assert rig.board.transmit() == b""


def test_a_moving_and_a_holding_board_keep_their_promises() -> None:
    rig = moving(FastBoard, 0)
    rig.run(500)
    rig.board.transmit()
    assert rig.board.quiet_until() > rig.board.frame
    rig.send(Hold())
    said(rig, 3000)
    assert rig.state in (BoardState.HELD, BoardState.HOLDING)


def test_the_end_of_a_lease_bounds_the_promise_at_once() -> None:
    """A promise made right behind the message that gives the lease, before the timers have been looked at."""
    ends = []
    for kind in (FastBoard, Board):
        rig = Rig(board=kind)
        rig.send(
            Lease(50),
            Segment(0, 400, (MotorTerm(0, 0, 8000),), SegmentFlag.JOG),
            Segment(
                400, 400, (MotorTerm(0, 400 * (8000 << 8) >> 16, -8000),), SegmentFlag.JOG | SegmentFlag.ENDS_AT_REST
            ),
            Start(),
        )
        rig.run_to(BoardState.RUNNING)
        rig.send(Lease(50))
        lease_end = rig.board.frame + -(-50_000 // rig.board.frame_us)
        assert rig.board.quiet_until() <= lease_end
        heard = said(rig, 400)
        ends.append(heard)
        assert lease_end <= heard[0][0] <= lease_end + 1
    assert ends[0] == ends[1]


def test_a_changing_input_and_the_reference_promise_nothing() -> None:
    rig = Rig(board=FastBoard)
    rig.run(5)
    rig.pins.toggle(4)
    rig.board.run_until(rig.board.frame + 1)
    assert rig.board.quiet_until() == rig.board.frame
    reference = Rig(board=Board)
    reference.run(5)
    assert reference.board.quiet_until() == reference.board.frame


def test_a_busy_line_bounds_the_promise() -> None:
    """On a slow line a status waits for the one before it: the board says when it can go."""
    rig = Rig(board=FastBoard)
    slow = FastBoard(rig.pins.config, RecordingPins(), 78, bytes_per_second=2000)
    host = HostLink()
    host.connect(5, 0)
    for _ in range(400):
        now_us = slow.frame * slow.frame_us
        slow.receive(host.data_to_send(now_us))
        host.receive_data(slow.transmit(), now_us)
        slow.run_until(slow.frame + 1)
    assert host.is_open
    for _ in range(3):
        host.send(StatusRequest())
        slow.receive(host.data_to_send(slow.frame * slow.frame_us))
        slow.run_until(slow.frame + 1)
        slow.transmit()
    due = slow.next_transmit_frame()
    assert due is not None
    assert slow.frame < due
    assert slow.quiet_until() <= due
    slow.run_until(slow.quiet_until())
    assert slow.transmit() == b""

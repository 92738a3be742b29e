"""Whatever a host says, the board neither crashes nor moves unplanned, and serves an honest host afterwards."""

from __future__ import annotations

import pytest

from rm501_firmware_model import Board, FastBoard
from rm501_firmware_model.pins import inactive_inputs
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState
from rm501_protocol.host_link import HostLink
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import Reset, SegmentFlag, SetOverride, SetPower, SetStatusPeriod, Start
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.lying_host import LyingHost
from tests.firmware_model.test_memory import too_wide

SEEDS = range(4)
STEPS = 250


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_that_a_host_says_breaks_the_board(seed: int) -> None:
    lies = LyingHost(seed, FastBoard)
    for _ in range(STEPS):
        lies.step()
        assert lies.problems == [], (lies.sent, lies.problems)
        assert too_wide(lies.core) == []
    lies.judge_pins()
    assert lies.problems == []
    assert {BoardState.RUNNING, BoardState.HELD, BoardState.READY, BoardState.IDLE, BoardState.FAULT} <= lies.states


def test_both_boards_say_and_do_the_same_whatever_they_are_told() -> None:
    fast, reference = LyingHost(99, FastBoard), LyingHost(99, Board)
    for _ in range(60):
        fast.step()
        reference.step()
    assert fast.said == reference.said
    assert (fast.pins.words() == reference.pins.words()).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_an_honest_host_moves_the_arm_after_all_those_lies(seed: int) -> None:
    lies = LyingHost(seed, FastBoard)
    for _ in range(60):
        lies.step()
    board, pins = lies.board, lies.pins
    pins.inputs = inactive_inputs(board.config)
    host = HostLink()

    def exchange(frames: int = 200) -> None:
        for _ in range(3):
            board.receive(host.data_to_send(board.frame * board.frame_us))
            host.receive_data(board.transmit(), board.frame * board.frame_us)
            while host.next_event() is not None:
                pass
            board.run_until(board.frame + frames)

    host.connect(0x600D, 0)
    exchange()
    host.stop(StopKind.STOP, board.frame * board.frame_us)
    for _ in range(20):
        exchange(1000)
    assert host.is_open and not host.stopping
    if board.config.hash != RM501_BOARD.hash:
        pytest.skip("the lies were a configuration")
    host.send(Reset(lies.core.fault, True))
    host.send(SetOverride(1 << 24))
    host.send(SetStatusPeriod(100))
    exchange()
    host.send(SetPower(True))
    exchange()
    assert board.state is BoardState.READY, board.state
    before = lies.core.stepgen.count[0]
    start = lies.core.checker.end_frame
    speed = 1 << 28
    host.send(Segment(start, 400, (MotorTerm(0, 0, (speed << 8) // 400),), SegmentFlag.NONE, 400, 800))
    slowing = MotorTerm(0, speed, -(speed << 8) // 400)
    host.send(Segment((start + 400) & 0xFFFFFFFF, 400, (slowing,), SegmentFlag.ENDS_AT_REST, 400, 800))
    host.send(Start())
    exchange(1000)
    assert board.state is BoardState.READY and lies.core.stepgen.count[0] - before == 25

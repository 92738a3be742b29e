"""Rows of the list of faults, the line and the host: bytes, frames, silence, another session, another clock."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from rm501_firmware_model import Board, FastBoard, QuietPins, inactive_inputs
from rm501_protocol.board_config import RM501_BOARD, InputId
from rm501_protocol.can_transfer import TransferReceiver, TransferSender
from rm501_protocol.enums import BoardState, HoldCause
from rm501_protocol.faults import RefusalReason
from rm501_protocol.framing import PacketCodec
from rm501_protocol.host_link import HostLink
from rm501_protocol.link_events import SessionOpened
from rm501_protocol.messages import FaultReport, Hold, Refused, Resume, SetPositions, SetPower, Start, Truncated
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.test_states import SPEED, cruise, to_running
from tests.firmware_model.waves import motor_waves, timing_violations


def noisy(seed: int, rate: float) -> Rig:
    """A program streamed over a line that flips, drops, doubles and inserts bytes in both directions."""
    rng = random.Random(seed)
    rig = Rig()
    rig.send(SetPositions(0x3F, (0,) * 6))
    waiting = list(LegalMotion(rng).run(40, longest=200, hand=False))

    def spoil(data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            kind = rng.random() / rate
            if kind < 0.4:
                out.append(byte ^ 1 << rng.randrange(8))
            elif kind < 0.6:
                pass
            elif kind < 0.8:
                out += bytes((byte, byte))
            elif kind < 1.0:
                out += bytes((byte, rng.randrange(256)))
            else:
                out.append(byte)
        return bytes(out)

    for _ in range(20_000):
        while waiting and rig.host.segment_credit > 0 and rig.host.pending < 8:
            rig.host.send(waiting.pop(0))
        out = rig.host.data_to_send(rig.now_us)
        if out:
            rig.board.receive(spoil(out))
        back = rig.board.transmit()
        if back:
            rig.host.receive_data(spoil(back), rig.now_us)
        while (event := rig.host.next_event()) is not None:
            rig.events.append(event)
        if rig.state is BoardState.READY and rig.core.queue.count and not rig.host.pending:
            rig.host.send(Start())
        if rig.state is BoardState.HELD and not rig.host.pending:
            rig.host.send(Resume())
        rig.board.run_until(rig.board.frame + 10)
        if not waiting and rig.state is BoardState.READY and rig.core.queue.count == 0 and not rig.host.pending:
            break
    rig.board.run_until(rig.board.frame + 10)
    return rig


@pytest.mark.parametrize("rate", [1e-3, 6e-3])
def test_faults_1_2_18_bad_bytes_change_no_step(rate: float) -> None:
    clean, spoilt = noisy(4, 1e-12), noisy(4, rate)
    assert spoilt.core.queue.count == 0 and spoilt.state is BoardState.READY
    assert spoilt.board.link.stats.bad_frames > 0
    assert spoilt.board.positions_q48 == clean.board.positions_q48
    for motor, wave in motor_waves(spoilt.pins.words()).items():
        assert timing_violations(wave) == []
        assert wave.counts()[-1] == motor_waves(clean.pins.words())[motor].counts()[-1]


def test_fault_4_a_repeated_frame_is_not_executed_twice() -> None:
    rig = Rig()
    rig.host.send(rig.segment(100))
    data = rig.host.data_to_send(rig.now_us)
    for _ in range(5):
        rig.board.receive(data)
    rig.exchange()
    assert rig.status().queue_used == 1
    assert not rig.got(Refused)


@pytest.mark.parametrize("silence_s", [0.1, 0.9, 1.5, 60])
def test_fault_9_silence_while_moving_holds_and_latches(silence_s: float) -> None:
    rig = Rig()
    rig.send(SetPositions(0x3F, (0,) * 6))
    a = (SPEED << 8) // 2000
    rig.go(rig.segment(2000, MotorTerm(0, 0, a)), *[rig.segment(60_000, MotorTerm(0, SPEED)) for _ in range(5)])
    rig.run(2000)
    rig.cut = True
    rig.run(int(silence_s / 320e-6))
    rig.cut = False
    rig.run(40, 10)
    status = rig.status()
    if silence_s < 1:
        assert (status.state, status.hold_cause) == (BoardState.RUNNING, HoldCause.NONE)
        return
    assert status.state in (BoardState.HOLDING, BoardState.HELD)
    assert (status.hold_cause, status.trusted_mask) == (HoldCause.LINK_LOST, 0x3F)
    rig.run(20_000)
    assert rig.state is BoardState.HELD  # traffic alone resumes nothing
    rig.pins.toggle(InputId.CYCLE_START)
    rig.run(50)
    assert rig.state is BoardState.RUNNING  # a user does


def test_fault_9_cycle_start_does_nothing_while_the_link_is_gone() -> None:
    rig = to_running()
    rig.cut = True
    rig.run_to(BoardState.HELD, step=20)
    stood = rig.core.motion.motion_frame
    rig.pins.toggle(InputId.CYCLE_START)
    for _ in range(100):
        rig.run(1)
        assert rig.state is BoardState.HELD
    assert rig.core.motion.motion_frame == stood
    rig.cut = False
    rig.run(20)
    rig.send(Resume())
    assert rig.state is BoardState.RUNNING


def test_fault_9_idle_silence_switches_power_off_where_configured() -> None:
    config = replace(RM501_BOARD, link=replace(RM501_BOARD.link, idle_power_off_ms=5000))
    rig = Rig(config)
    rig.cut = True
    rig.run(15_000)
    assert rig.state is BoardState.READY
    rig.run(700)
    assert rig.state is BoardState.IDLE
    quiet = Rig()
    quiet.cut = True
    quiet.run(40_000, 1000)
    assert quiet.state is BoardState.READY  # 0: never


@pytest.mark.parametrize("board", [Board, FastBoard])
def test_fault_9_power_goes_off_after_a_hold_for_silence_too(board: type[Board]) -> None:
    config = replace(RM501_BOARD, link=replace(RM501_BOARD.link, idle_power_off_ms=5000))
    rig = Rig(config, board=board)
    rig.go(*cruise(rig))
    rig.run(3000)
    rig.cut = True
    silent_since = rig.core.real_frame
    rig.run_to(BoardState.HELD, step=20)
    rig.run(silent_since + 15_000 - rig.core.real_frame, 100)
    assert rig.state is BoardState.HELD
    rig.run(700)
    assert rig.state is BoardState.IDLE


def test_a_new_session_while_moving_holds_until_a_user_resumes() -> None:
    rig = to_running()
    rig.host.connect(4321, rig.now_us)
    rig.exchange()
    rig.exchange()
    assert any(isinstance(event, SessionOpened) for event in rig.events[1:])
    assert (rig.state, rig.status().hold_cause) == (BoardState.HOLDING, HoldCause.LINK_LOST)
    rig.run_to(BoardState.HELD)
    rig.host.connect(4322, rig.now_us)
    rig.exchange()
    rig.exchange()
    rig.send(Resume())
    assert rig.state is BoardState.RUNNING


def test_an_unknown_message_and_a_broken_one_are_refused_not_fatal() -> None:
    rig = Rig()
    rig.board._commands.obey(Truncated(5), 3)  # a message that is not for boards
    rig.exchange()
    assert rig.take(Refused).reason is RefusalReason.NOT_SUPPORTED


def test_reports_wait_for_a_session() -> None:
    rig = Rig(connect=False)
    rig.board.run_until(3)
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.board.run_until(20)
    assert rig.state is BoardState.FAULT
    rig.connect()
    assert rig.take(FaultReport).real_frame == 4


def test_fault_3_a_burst_of_silence_keeps_the_queue_playing() -> None:
    rig = to_running()
    before = rig.status()
    rig.cut = True
    rig.run(625)  # 200 ms
    rig.cut = False
    rig.run(20, 5)
    after = rig.status()
    assert (after.state, after.rate) == (BoardState.RUNNING, ONE)
    assert after.motion_frame == before.motion_frame + 645


def test_fault_5_reordered_can_frames_never_make_a_segment_of_two() -> None:
    rng = random.Random(5)
    pins = QuietPins(inactive_inputs(RM501_BOARD))
    board = Board(RM501_BOARD, pins, 9, codec=PacketCodec())
    host = HostLink(codec=PacketCodec())
    to_board, to_host = TransferSender(1, from_board=False), TransferSender(1, from_board=True)
    at_board, at_host = TransferReceiver(1, from_board=False), TransferReceiver(1, from_board=True)

    def exchange(spoil: bool) -> None:
        now_us = board.frame * board.frame_us
        frames = [frame for packet in host.packets_to_send(now_us) for frame in to_board.frames(packet)]
        if spoil and len(frames) > 2:
            first = rng.randrange(len(frames) - 1)
            frames[first], frames[first + 1] = frames[first + 1], frames[first]
        for frame in frames:
            packet = at_board.feed(frame)
            if packet is not None:
                board.receive(packet)
        for packet in board.transmit_packets():
            for frame in to_host.frames(packet):
                whole = at_host.feed(frame)
                if whole is not None:
                    host.receive_data(whole, now_us)

    host.connect(1, 0)
    for _ in range(4):
        exchange(spoil=False)
    host.send(SetPower(True))
    sent = [Segment(100 * n, 100, (MotorTerm(0, n), MotorTerm(4, -n)), hold_slope=n + 1) for n in range(20)]
    for segment in sent:
        host.send(segment)
    for turn in range(1500):
        exchange(spoil=turn < 400)
        board.run_until(board.frame + 20)
    queue = board._core.queue
    assert queue.count == 20
    for n in range(20):
        assert (queue.hold_slope[n], queue.v[n * 6] >> 16, queue.v[n * 6 + 4] >> 16) == (n + 1, n, -n)


def test_fault_7_the_board_runs_on_its_own_frames_whatever_the_host_thinks_of_time() -> None:
    rig = to_running()
    before = rig.status()
    for jump_us in (0, 1_000_000, -900_000, 50):
        for data in (rig.host.data_to_send(rig.now_us + jump_us),):
            rig.board.receive(data)
        rig.board.run_until(rig.board.frame + 100)
    assert rig.core.motion.motion_frame == before.motion_frame + 400


def test_fault_19_a_frame_without_end_is_dropped_in_bounded_memory() -> None:
    rig = to_running()
    for _ in range(256):
        rig.board.receive(b"\x55" * 256)
        rig.board.run_until(rig.board.frame + 2)
    assert rig.state is BoardState.RUNNING
    rig.board.receive(b"\x00")
    rig.host.send(Hold())
    rig.run(20)
    assert rig.state is BoardState.HOLDING  # in step again
    assert rig.status().bad_frames >= 1

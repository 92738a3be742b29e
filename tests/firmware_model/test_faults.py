"""The rows of the list of faults that concern the board, one named test each.

Rows 8 and 28 are in test_torture and test_states, row 17 in test_commands.
"""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from rm501_firmware_model import Board, FastBoard, QuietPins, inactive_inputs
from rm501_protocol.board_config import RM501_BOARD, InputId
from rm501_protocol.can_transfer import TransferReceiver, TransferSender
from rm501_protocol.config_pages import OutputSource
from rm501_protocol.enums import BoardState, Edge, EndCause, HandState, HoldCause, SegmentFlag, TriggerAction
from rm501_protocol.faults import FAULT_TEXTS, FaultCode, RefusalReason
from rm501_protocol.framing import PacketCodec
from rm501_protocol.host_link import HostLink
from rm501_protocol.link_events import GenerationAdvanced, SessionOpened, StopKind
from rm501_protocol.messages import (
    ArmTrigger,
    FaultReport,
    Hold,
    Lease,
    MotionEnded,
    Refused,
    Reset,
    Resume,
    SetOutputs,
    SetPositions,
    SetPower,
    Start,
    TriggerReport,
    Truncated,
)
from rm501_protocol.segment import FRACTION_BITS
from rm501_protocol.segment_message import MotorTerm, Segment, hand_event
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.test_states import SPEED, cruise, to_held, to_running
from tests.firmware_model.waves import hand_wave, line_level, motor_waves, timing_violations

REST = SegmentFlag.ENDS_AT_REST


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


def test_fault_6_reset_of_the_chip_trusts_nothing_and_refuses_what_was_in_flight() -> None:
    before = to_running()
    before.host.send(before.segment(100, MotorTerm(0, SPEED)))
    in_flight = before.host.data_to_send(before.now_us)
    after = Rig(connect=False, boot_epoch=4711)
    after.board.receive(in_flight)
    after.board.run_until(100)
    core = after.core
    assert (after.state, core.queue.count, core.trusted, core.power) == (BoardState.IDLE, 0, 0, 0)
    words = after.pins.words()
    assert not line_level(words, OutputSource.MOTOR_POWER).any()
    assert not any(wave.step.any() for wave in motor_waves(words).values())
    before.host.receive_data(after.board.transmit(), before.now_us)
    assert not before.host.is_open  # the host learns that its session is gone
    after.connect()
    assert after.host.identify is not None and after.host.identify.boot_id == 4711


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


def test_fault_10_a_stuck_switch_is_seen_before_homing_moves() -> None:
    rig = Rig()
    rig.pins.toggle(InputId.SWITCH_WAIST)
    rig.run(20)
    assert rig.status().inputs == 1 << InputId.SWITCH_WAIST
    rig.messages.clear()
    rig.send(ArmTrigger(0, InputId.SWITCH_WAIST, Edge.RISING, TriggerAction.LATCH_AND_STOP, level=True))
    rig.run(1)
    assert rig.take(TriggerReport).trigger == 0  # at once, nothing has moved
    # and what was sent to move towards it is refused: it belonged to an armed trigger
    rig.host.send(rig.segment(10))
    rig.exchange()
    assert rig.status().queue_used in (0, 1)


def test_fault_11_a_dead_switch_never_fires_and_motion_ends_where_the_host_bounded_it() -> None:
    rig = Rig()
    rig.send(ArmTrigger(0, InputId.SWITCH_WAIST, Edge.RISING))
    a = (SPEED << 8) // 2000
    rig.go(
        rig.segment(2000, MotorTerm(0, 0, a)),
        rig.segment(2000, MotorTerm(0, SPEED, -a), flags=REST),
    )
    rig.run(4100)
    assert rig.state is BoardState.READY
    assert not rig.got(TriggerReport) and rig.status().armed_triggers == 1


@pytest.mark.parametrize("bounce_frames", [0, 1, 3, 20, 62])
@pytest.mark.parametrize("board", [None, FastBoard])
def test_fault_12_a_bouncing_switch_is_latched_at_its_first_edge(
    bounce_frames: int, board: type[FastBoard] | None
) -> None:
    rng = random.Random(bounce_frames)
    rig = Rig() if board is None else Rig(board=board)
    rig.send(ArmTrigger(1, InputId.SWITCH_SHOULDER, Edge.RISING))
    rig.go(*cruise(rig))
    edge = 4000
    level = 1
    rig.pins.toggle_at(edge, InputId.SWITCH_SHOULDER)
    for frame in range(edge + 1, edge + bounce_frames):
        if rng.random() < 0.5 or frame % 7 == 0:
            rig.pins.toggle_at(frame, InputId.SWITCH_SHOULDER)
            level ^= 1
    if not level:
        rig.pins.toggle_at(edge + max(bounce_frames, 1), InputId.SWITCH_SHOULDER)
    rig.run(3990)
    counts = {}
    while rig.state is BoardState.RUNNING:
        counts[rig.board.frame] = tuple(rig.core.stepgen.count)
        rig.run(1)
    report = rig.got(TriggerReport)[0]
    assert (report.trigger, report.real_frame) == (1, edge)
    assert report.clock_ticks == edge * 320
    assert report.motion_frame == edge - 1  # motion started in frame 1
    assert report.positions_steps == counts[edge]
    assert rig.status().armed_triggers == 0
    rig.run_to(BoardState.READY)
    ended = rig.got(MotionEnded)[-1]
    assert ended.cause is EndCause.TRIGGER
    assert ended.positions_q48 == rig.board.positions_q48
    # it slowed down along the path: 655 motion frames at the slope given, after at most 62 + 8 frames of bounce
    assert 640 < ended.motion_frame - report.motion_frame < 655 + 75


def test_fault_12_a_single_noisy_sample_latches_nothing_then_or_later() -> None:
    rig = Rig()
    rig.send(ArmTrigger(0, InputId.SWITCH_ELBOW, Edge.RISING))
    rig.go(*cruise(rig))
    for frame in (1000, 1001, 1500, 1501, 1505, 1506):
        rig.pins.toggle_at(frame, InputId.SWITCH_ELBOW)
    rig.pins.toggle_at(2600, InputId.SWITCH_ELBOW)
    rig.run(3000)
    report = rig.got(TriggerReport)[0]
    assert report.real_frame == 2600


def test_triggers_on_the_other_edge_latching_only_and_in_mid_bounce() -> None:
    rig = Rig()
    rig.pins.toggle(InputId.SWITCH_ROLL)
    rig.run(20)
    rig.send(ArmTrigger(0, InputId.SWITCH_ROLL, Edge.RISING), ArmTrigger(3, InputId.SWITCH_ROLL, Edge.FALLING))
    rig.send(ArmTrigger(2, InputId.SWITCH_ROLL, Edge.FALLING, TriggerAction.LATCH, level=True))  # not there yet
    rig.go(*cruise(rig))
    rig.run(2500)
    rig.pins.toggle(InputId.SWITCH_ROLL)
    rig.run(4)
    rig.send(ArmTrigger(1, InputId.SWITCH_ROLL, Edge.FALLING, TriggerAction.LATCH))  # within the burst
    rig.run(20)
    reports = {report.trigger: report for report in rig.got(TriggerReport)}
    assert set(reports) == {1, 2, 3}
    assert reports[2].real_frame == reports[3].real_frame == reports[1].real_frame - 7  # confirmed 8 samples later
    assert rig.state is BoardState.STOPPING
    rig.messages.clear()
    rig.run_to(BoardState.READY)
    assert rig.status().armed_triggers == 1


@pytest.mark.parametrize("end", ["trigger", "lease", "overflow"])
def test_what_was_in_flight_when_the_board_stopped_by_itself_never_runs(end: str) -> None:
    rig = Rig()
    jog = end == "lease"
    rig.send(Lease(1000))
    rig.go(*cruise(rig, jog=jog))
    rig.send(ArmTrigger(0, InputId.SWITCH_ELBOW, Edge.RISING))
    rig.run(2500)
    if end == "lease":
        rig.send(Lease(1))
    else:
        rig.pins.toggle(InputId.SWITCH_ELBOW if end == "trigger" else InputId.OVERFLOW_724)
    rig.board.run_until(rig.board.frame + 8000)
    assert rig.state is (BoardState.FAULT if end == "overflow" else BoardState.READY)
    # the host does not know yet; what it sends now fits the end of the queue to the bit
    rig.host.send(Segment(rig.core.checker.end_frame, 100))
    rig.exchange()
    assert rig.core.queue.count == 0
    assert any(isinstance(event, GenerationAdvanced) for event in rig.events)
    assert not rig.got(Refused)  # dropped by the link, so that host and board agree on what was said since


@pytest.mark.parametrize("state", ["held", "ready"])
def test_a_trigger_at_rest_drops_the_queue(state: str) -> None:
    rig = to_held() if state == "held" else Rig()
    if state == "ready":
        rig.send(*cruise(rig))
    rig.send(ArmTrigger(0, InputId.SWITCH_ELBOW, Edge.RISING))
    rig.pins.toggle(InputId.SWITCH_ELBOW)
    rig.run(20)
    assert rig.state is BoardState.READY
    assert rig.got(MotionEnded)[-1].cause is EndCause.TRIGGER
    assert rig.status().queue_used == 0


@pytest.mark.parametrize(("line", "motors"), [(InputId.OVERFLOW_724, 0b00101), (InputId.OVERFLOW_732, 0b11010)])
def test_faults_13_15_overflow_stops_at_once_and_only_a_command_resets(line: InputId, motors: int) -> None:
    rig = Rig()
    rig.send(SetPositions(0x3F, (0,) * 6))
    rig.go(*cruise(rig))
    rig.run(3000)
    rig.messages.clear()
    rig.pins.toggle(line)
    rig.run(2)  # two samples settle it
    assert rig.state is BoardState.FAULT
    counts = list(rig.core.stepgen.count)
    report = rig.take(FaultReport)
    assert (report.fault, report.source, report.value) == (FaultCode.OVERFLOW, line, motors)
    assert report.real_frame == 3002 and report.clock_ticks == 3002 * 320
    rig.run(3000)
    status = rig.status()
    assert list(rig.core.stepgen.count) == counts
    assert status.trusted_mask == 0x3F & ~motors
    assert status.power  # the motors hold the arm
    assert not line_level(rig.pins.words(), OutputSource.MASTER_RESET).any()
    # reset without clearing the counters: the line is still there
    assert rig.refusal(Reset(FaultCode.OVERFLOW)).reason is RefusalReason.STILL_ACTIVE
    at = rig.board.frame
    rig.send(Reset(FaultCode.OVERFLOW, master_reset=True))
    rig.run(10)
    rig.send(Reset(FaultCode.NONE, master_reset=True)) if rig.state is BoardState.IDLE else None
    rig.pins.toggle(line)  # the boards answer the pulse
    rig.run(100)
    assert rig.state is BoardState.READY
    pulse = np.flatnonzero(line_level(rig.pins.words(), OutputSource.MASTER_RESET))
    assert (pulse[0], len(pulse)) == (at, 32)
    assert rig.board.positions_q48[0] == counts[0] << FRACTION_BITS  # nothing is due any more


def test_fault_13_an_overflow_that_master_reset_does_not_clear_is_a_fault_again() -> None:
    rig = to_running()
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.run(3)
    rig.send(Reset(FaultCode.OVERFLOW, master_reset=True))
    assert rig.state is BoardState.READY
    rig.run(40)
    assert rig.state is BoardState.FAULT
    assert rig.got(FaultReport)[-1].fault is FaultCode.OVERFLOW


def test_the_first_fault_is_kept_and_later_ones_are_counted() -> None:
    rig = to_running()
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.run(3)
    rig.pins.toggle(InputId.OVERFLOW_732)
    rig.run(3)
    rig.stop(StopKind.KILL)
    status = rig.status()
    assert (status.fault, status.later_faults) == (FaultCode.OVERFLOW, 2)
    assert not status.power  # a kill switches off in any state
    for _ in range(70_000):
        rig.core.latch(FaultCode.INTERNAL, 0, 0, 0)
    assert rig.status().later_faults == 0xFFFF


def test_estop_stops_switches_off_and_distrusts() -> None:
    rig = Rig()
    rig.send(SetPositions(0x3F, (0,) * 6))
    rig.go(*cruise(rig))
    rig.run(3000)
    rig.messages.clear()
    rig.pins.toggle(InputId.ESTOP)
    rig.run(2)
    assert rig.ended().cause is EndCause.ESTOP
    status = rig.status()
    assert (status.state, status.power, status.trusted_mask) == (BoardState.FAULT, False, 0)
    assert rig.refusal(Reset(FaultCode.ESTOP)).reason is RefusalReason.STILL_ACTIVE
    rig.pins.toggle(InputId.ESTOP)
    rig.run(5)
    rig.send(Reset(FaultCode.ESTOP))
    assert rig.state is BoardState.IDLE
    rig.pins.toggle(InputId.ESTOP)
    rig.run(5)
    assert rig.state is BoardState.FAULT  # also at rest and without power
    started_open = Rig(connect=False)
    started_open.pins.toggle(InputId.ESTOP)
    started_open.connect()
    started_open.run(5)
    assert started_open.state is BoardState.IDLE  # no edge: open since power-up
    assert started_open.refusal(SetPower(True)).reason is RefusalReason.STILL_ACTIVE


def test_hold_and_cycle_start_buttons() -> None:
    rig = to_running()
    rig.pins.toggle(InputId.HOLD)
    rig.run(9)
    assert (rig.state, rig.status().hold_cause) == (BoardState.HOLDING, HoldCause.BUTTON)
    rig.pins.toggle(InputId.HOLD)
    rig.run_to(BoardState.HELD)
    rig.pins.toggle(InputId.CYCLE_START)
    rig.run(9)
    assert rig.state is BoardState.RUNNING
    ready = Rig()
    ready.pins.toggle(InputId.HOLD)
    ready.run(9)
    assert ready.state is BoardState.HELD
    ready.pins.toggle(InputId.CYCLE_START)
    ready.run(9)
    assert ready.state is BoardState.READY


def test_fault_16_the_hand_is_bounded_in_pulses_and_time() -> None:
    rig = Rig()
    rig.go(rig.segment(2600, flags=REST, events=(hand_event(0, 800),)))
    at = rig.board.frame
    rig.run(2000)
    wave = hand_wave(rig.pins.words())
    rises = wave.rises()
    assert len(rises) == 800
    assert rises[-1] - at < 2000  # a full stroke within 0.64 s
    assert not wave.direction[rises].any()  # opening
    assert timing_violations(wave) == []
    assert rig.status().hand is HandState.OPEN and rig.status().positions_steps[5] == 800
    rig.run(3000)
    assert len(hand_wave(rig.pins.words()).rises()) == 800
    rig.go(rig.segment(2600, flags=REST, events=(hand_event(0, -800), hand_event(500, 0))))
    rig.run(400)
    assert rig.status().hand is HandState.CLOSING
    rig.run(300)
    wave = hand_wave(rig.pins.words())
    closing = int(wave.direction[wave.rises()].sum())
    assert 198 <= closing <= 201  # cancelled at motion frame 500
    assert rig.status().hand is HandState.UNKNOWN
    assert timing_violations(wave) == []


def test_the_hand_grips_with_the_pulses_configured_and_runs_on_through_a_hold() -> None:
    rig = Rig(replace(RM501_BOARD, hand=replace(RM501_BOARD.hand, grip_pulses=30)))
    rig.go(rig.segment(900, flags=REST, events=(hand_event(5, -100),)))
    rig.run(20)
    rig.send(Hold())
    rig.run(600)
    assert rig.status().positions_steps[5] == -130
    assert rig.status().hand is HandState.CLOSED


def test_a_hand_commanded_beyond_its_bound_holds_on_the_path_and_latches() -> None:
    rig = Rig()
    rig.go(*cruise(rig, 4000))
    rig.run(2500)
    core = rig.core
    core.hand.command(1100)
    # as if the checks of the queue had let a second stroke through
    core.queue.event_frame[0], core.queue.event_kind[0], core.queue.event_value[0] = (
        core.motion.motion_frame + 3,
        1,
        900,
    )
    core.queue.event_count = 1
    rig.run(10)
    assert rig.state is BoardState.STOPPING
    assert rig.got(FaultReport)[-1].fault is FaultCode.HAND_TIME
    rig.stop()  # a stop meanwhile does not make it less of a fault
    rig.run_to(BoardState.FAULT)
    assert rig.got(MotionEnded)[-1].cause is EndCause.FAULT
    at_rest = Rig()
    at_rest.core.soft_fault(FaultCode.HAND_TIME, 0, 0, 0)
    assert at_rest.state is BoardState.FAULT
    again = at_rest.core
    again.soft_fault(FaultCode.HAND_TIME, 0, 0, 0)
    assert again.later_faults == 1


def test_fault_24_power_is_off_until_asked_for_and_the_lines_are_safe() -> None:
    rig = Rig(power=False)
    rig.run(100)
    words = rig.pins.words()
    assert not line_level(words, OutputSource.MOTOR_POWER).any()
    assert not line_level(words, OutputSource.MASTER_RESET).any()
    heart = line_level(words, OutputSource.HEARTBEAT)
    assert (heart[1:] != heart[:-1]).all()
    rig.send(SetPower(True))
    rig.run(100)
    assert line_level(rig.pins.words()[-100:], OutputSource.MOTOR_POWER).all()
    rig.stop(StopKind.KILL)
    rig.run(100)
    after = rig.pins.words()[-100:]
    assert not line_level(after, OutputSource.MOTOR_POWER).any()
    heart = line_level(after, OutputSource.HEARTBEAT)
    assert (heart == heart[0]).all()  # no heartbeat in FAULT


@pytest.mark.parametrize("start", [0xFFFFFFFF - 2500, 0x7FFFFFFF - 2500])
def test_fault_26_counters_of_frames_wrap_in_mid_motion(start: int) -> None:
    rig = Rig()
    rig.core.motion.motion_frame = start  # 119 days of motion later
    rig.core.checker.end_frame = start
    rig.start_frames = start
    rig.go(*cruise(rig, 4000), rig.segment(2000, MotorTerm(0, SPEED, -(SPEED << 8) // 2000), flags=REST))
    rig.run(2900)
    rig.send(Hold())
    rig.run_to(BoardState.HELD)
    assert rig.status().motion_frame == rig.core.motion.motion_frame <= 0xFFFFFFFF
    rig.send(Resume())
    rig.run(12_000)
    assert (rig.state, rig.status().motion_frame) == (BoardState.READY, (start + 8000) & 0xFFFFFFFF)
    assert rig.status().positions_steps[0] == 750


def test_fault_26_real_frames_wrap_too() -> None:
    rig = Rig()
    late = (1 << 32) - 100
    rig.core.real_frame = late  # 15.9 days after boot
    rig.pins.frames = late
    rig.core.heard()
    rig.host.connect(5, rig.now_us)
    rig.run(1, 1)
    rig.go(rig.segment(20, flags=REST | SegmentFlag.START_AT_REAL_FRAME, real_frame=50))
    rig.run(140)
    assert (rig.state, rig.status().motion_frame) == (BoardState.RUNNING, 0)
    rig.run(40)
    assert (rig.state, rig.status().real_frame) == (BoardState.READY, 81)


def test_fault_27_the_board_says_what_it_is_and_refuses_without_a_configuration() -> None:
    rig = Rig(configured=False)
    identify = rig.host.identify
    assert identify is not None
    assert (identify.config_hash, identify.queue_depth, identify.max_step_rate) == (0, 32, 1562)
    for message in (SetPower(True), Segment(0, 10), Start(), SetOutputs(0, 0)):
        assert rig.refusal(message).reason is RefusalReason.NOT_CONFIGURED


def test_an_unknown_message_and_a_broken_one_are_refused_not_fatal() -> None:
    rig = Rig()
    rig.board._commands.obey(Truncated(5), 3)  # a message that is not for boards
    rig.exchange()
    assert rig.take(Refused).reason is RefusalReason.NOT_SUPPORTED


def test_faults_found_below_the_model_stop_the_board() -> None:
    for fault in (FaultCode.CLOCK, FaultCode.CONFIG_CORRUPT, FaultCode.INTERNAL, FaultCode.POSITION_RANGE):
        rig = Rig()
        rig.send(SetPositions(0x3F, (0,) * 6))
        rig.go(*cruise(rig))
        rig.run(3000)
        rig.board.raise_fault(fault, 1, 2, 3)
        rig.run(3)
        status = rig.status()
        assert (status.state, status.fault) == (BoardState.FAULT, fault)
        assert status.trusted_mask == (0x3F & ~2 if fault is FaultCode.POSITION_RANGE else 0)
        assert status.power == (fault is not FaultCode.CONFIG_CORRUPT)
        rig.board.raise_fault(fault)
        assert rig.status().later_faults == 1


def test_a_step_generator_that_falls_behind_is_found() -> None:
    rig = to_running()
    rig.core.stepgen.count[0] -= 5  # as a flipped bit in memory would
    rig.run(3)
    report = rig.got(FaultReport)[-1]
    assert (report.fault, report.source) == (FaultCode.STEP_LATE, 0)
    assert 3.4 < report.value / 65536 < 5.6


def test_a_queue_that_runs_dry_at_speed_is_a_fault_though_the_account_forbids_it() -> None:
    rig = Rig()
    rig.go(*cruise(rig, 4000))
    rig.run(2500)
    rig.core.queue.room = 1 << 40  # as a flipped bit in memory would
    rig.run(6000)
    assert rig.got(FaultReport)[-1].fault is FaultCode.MOTION_UNDERRUN
    assert rig.status().trusted_mask == 0


def test_every_fault_code_has_its_text_and_its_part_in_the_documentation() -> None:
    from pathlib import Path

    page = (Path(__file__).parents[2] / "docs" / "faults.md").read_text(encoding="utf-8")
    for code in FaultCode:
        text = FAULT_TEXTS[code]
        if code is FaultCode.NONE:
            continue
        assert f"## {int(code)} {code.name}" in page
        for part in (text.cause, text.effect, text.remedy):
            assert part in page
    for reason in RefusalReason:
        assert f"| {int(reason)} | {reason.name} |" in page


def test_reports_wait_for_a_session() -> None:
    rig = Rig(connect=False)
    rig.board.run_until(3)
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.board.run_until(20)
    assert rig.state is BoardState.FAULT
    rig.connect()
    assert rig.take(FaultReport).real_frame == 4


def test_a_quiet_environment_for_measurements() -> None:
    pins = QuietPins(5)
    pins.write_frame(0, [])
    assert pins.read_inputs(3) == 5 and pins.inputs_stable_until(9) > 1 << 40
    pins.write_block(0, np.zeros((1, 8), dtype=np.uint32))
    assert ONE == 1 << 24


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

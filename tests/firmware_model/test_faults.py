"""The rows of the list of faults that concern the board itself, one named test each: hand, power, counters, generator.

The line and the inputs: test_faults_link, test_faults_inputs. Rows 8 and 28: test_torture, test_states; 17:
test_segment_commands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rm501_firmware_model import QuietPins
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.config_pages import OutputSource
from rm501_protocol.enums import BoardState, EndCause, HandState, SegmentFlag
from rm501_protocol.faults import FAULT_TEXTS, FaultCode, RefusalReason
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import FaultReport, Hold, MotionEnded, Resume, SetOutputs, SetPositions, SetPower, Start
from rm501_protocol.segment_message import MotorTerm, Segment, hand_event
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.test_states import SPEED, cruise, to_running
from tests.firmware_model.waves import hand_wave, line_level, motor_waves, timing_violations

REST = SegmentFlag.ENDS_AT_REST


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


def test_a_quiet_environment_for_measurements() -> None:
    pins = QuietPins(5)
    pins.write_frame(0, [])
    assert pins.read_inputs(3) == 5 and pins.inputs_stable_until(9) > 1 << 40
    pins.write_block(0, np.zeros((1, 8), dtype=np.uint32))
    assert ONE == 1 << 24

"""Rows of the list of faults, the inputs: switches that stick, fail or bounce, overflow, emergency stop, buttons."""

from __future__ import annotations

import random

import numpy as np
import pytest

from rm501_firmware_model import FastBoard
from rm501_protocol.board_config import InputId
from rm501_protocol.config_pages import OutputSource
from rm501_protocol.enums import BoardState, Edge, EndCause, HoldCause, SegmentFlag, TriggerAction
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.link_events import GenerationAdvanced, StopKind
from rm501_protocol.messages import (
    ArmTrigger,
    FaultReport,
    Lease,
    MotionEnded,
    Refused,
    Reset,
    SetPositions,
    SetPower,
    TriggerReport,
)
from rm501_protocol.segment import FRACTION_BITS
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.rig import Rig
from tests.firmware_model.test_states import SPEED, cruise, to_held, to_running
from tests.firmware_model.waves import line_level

REST = SegmentFlag.ENDS_AT_REST


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

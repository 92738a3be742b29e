"""What each message about the board itself does: positions, outputs, power, triggers, configuration, reset, status.

Segments, holds and ends have files of their own: test_segment_commands, test_hold_commands, test_ending_commands.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from rm501_firmware_model import Board, QuietPins
from rm501_protocol.board_config import RM501_BOARD, InputId
from rm501_protocol.config_pages import ConfigCommit, OutputPin, OutputSource
from rm501_protocol.enums import BoardState, Edge, EndCause, SegmentFlag, TriggerAction
from rm501_protocol.errors import ConfigError
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.messages import (
    ArmTrigger,
    ConfigAccepted,
    DisarmTrigger,
    Refused,
    Reset,
    SetOutputs,
    SetPositions,
    SetPower,
    SetStatusPeriod,
    Status,
)
from rm501_protocol.segment_message import output_event
from tests.firmware_model.rig import Rig
from tests.firmware_model.test_states import to_held, to_running

DIGITAL = replace(
    RM501_BOARD,
    pins=replace(
        RM501_BOARD.pins,
        outputs=(*RM501_BOARD.pins.outputs, OutputPin(OutputSource.DIGITAL + 2, 30, False)),
    ),
)
REST = SegmentFlag.ENDS_AT_REST


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

"""Corners of the board that no program of the other tests happens to turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rm501_firmware_model
from rm501_firmware_model import BoardLayout, FastBoard, inactive_inputs
from rm501_firmware_model.limits import pyramid, turning_frame
from rm501_firmware_model.segment_queue import triangle
from rm501_protocol.board_config import RM501_BOARD, BoardConfig, InputId
from rm501_protocol.config_pages import ConfigTable, OutputSource, SlotSource, SlotSources
from rm501_protocol.enums import BoardState, Edge, HoldCause, SegmentFlag, TriggerAction
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.framing import PacketCodec
from rm501_protocol.header import FLAG_OPEN, FLAG_SEQUENCED, HEADER
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import (
    ArmTrigger,
    Hold,
    Lease,
    Refused,
    Reset,
    Resume,
    SetOverride,
    SetPositions,
    SetPower,
    SetStatusPeriod,
    Start,
    TriggerReport,
    Truncate,
)
from rm501_protocol.segment import motor_extremes, velocity_q48
from rm501_protocol.segment_message import MotorTerm, Segment, hand_event, output_event
from tests.firmware_model.rig import Rig
from tests.firmware_model.test_commands import DIGITAL
from tests.firmware_model.test_states import SPEED, cruise, to_held, to_holding, to_running
from tests.firmware_model.torture import Torture
from tests.firmware_model.waves import motor_waves, timing_violations
from tests.support.pin_decoder import decode
from tests.support.waveform import check_words

REST = SegmentFlag.ENDS_AT_REST


def test_the_package_exports_what_it_says() -> None:
    assert rm501_firmware_model.__all__ == sorted(
        rm501_firmware_model.__all__, key=lambda name: (name != "RULES", name)
    )
    for name in rm501_firmware_model.__all__:
        assert hasattr(rm501_firmware_model, name)


def test_products_of_consecutive_integers_without_division() -> None:
    for n in (*range(200), 32_767, 65_535):
        assert triangle(n) == n * (n - 1) // 2
        assert pyramid(n) == n * (n - 1) * (n - 2) // 6


def test_the_turning_frame_finds_the_extreme_of_the_speed() -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        length = int(rng.integers(1, 3000))
        v, a, j = (int(rng.integers(-(1 << 30), 1 << 30)) for _ in range(3))
        term = MotorTerm(0, v, a, j)
        speeds = [velocity_q48(term, n) for n in range(length + 1)]
        at = turning_frame(a << 8, j, length)
        assert max(map(abs, (speeds[0], speeds[at], speeds[-1]))) == max(map(abs, speeds))
        assert motor_extremes(term, length)[:2] == (min(speeds), max(speeds))


def test_the_machine_sheets_own_reading_of_the_pins_agrees() -> None:
    """The decoder and the rules written from the machine sheet alone, and the ones used here."""
    run = Torture(seed=11)
    run.batch(40)
    words = run.pins.words()
    flat = words.reshape(-1).tolist()
    assert check_words(flat) == []
    found = decode(flat)
    waves = motor_waves(words)
    for name, motor in (("waist", 0), ("shoulder", 1), ("elbow", 2), ("right wrist", 3), ("left wrist", 4)):
        assert found.counts[name] == waves[motor].counts()[-1] == run.rig.core.stepgen.count[motor]
    assert sum(abs(count) for count in found.counts.values()) > 10
    assert found.heartbeat_edges >= len(words) - 1


def shuffled_table() -> BoardConfig:
    """Four entries only, other order, other places: two slots of two motors each and none for hand or fifth motor."""
    # address: strobe | slot << 1 | selects | next << 6, in the order 0 -> 3 -> 1 -> 2 -> 0
    entries = (
        1 << 1 | 1 << 3 | 3 << 6,
        0 << 1 | 1 << 4 | 2 << 6,
        1 | 0 << 1 | 1 << 4 | 0 << 6,
        1 | 1 << 1 | 1 << 3 | 1 << 6,
    )
    step, direction = SlotSource.STEP, SlotSource.DIR
    slots = (
        SlotSources(step + 3, direction + 3, step + 0, direction + 0),
        SlotSources(step + 1, direction + 1, step + 2, direction + 2),
    )
    motors = (*RM501_BOARD.motors.motors[:4],)
    inputs = tuple(replace(pin, motors=pin.motors & 0xF) for pin in RM501_BOARD.inputs.inputs)
    return replace(
        RM501_BOARD,
        table=ConfigTable(entries),
        slots=replace(RM501_BOARD.slots, slots=slots),
        motors=replace(RM501_BOARD.motors, motors=motors),
        inputs=replace(RM501_BOARD.inputs, inputs=inputs),
        hand=replace(RM501_BOARD.hand, motor=255, pulse_rate_hz=0),
        pins=replace(
            RM501_BOARD.pins,
            outputs=tuple(pin for pin in RM501_BOARD.pins.outputs if pin.source < OutputSource.SLOT),
        ),
    )


def test_another_table_with_another_order_and_length() -> None:
    config = shuffled_table()
    assert config.problems() == ()
    layout = BoardLayout(config)
    assert (layout.periods, layout.frame_us, layout.max_step_rate) == (4, 160, 3125)
    run = Torture(seed=3, config=config)
    run.batch(200)
    assert run.found.timing_violations == run.found.wrong_counts == run.found.disagreements == 0, (
        run.found.first_problem
    )
    assert run.found.worst_lag <= 0.54 and run.found.steps > 100
    assert len(run.rig.board.positions_q48) == 4 and len(run.rig.status().positions_steps) == 4
    run.rig.start_frames = run.motion.frame
    refused = run.rig.refusal(Segment(run.motion.frame, 9, events=(hand_event(0, 5),)))
    assert refused.reason is RefusalReason.HAND_LIMIT


def test_hand_with_slow_pulses_turns_round_within_the_timings() -> None:
    timing = replace(
        RM501_BOARD.timing, step_length_frames=2, step_space_frames=2, dir_setup_frames=3, dir_hold_frames=9
    )
    motors = tuple(replace(m, max_rate_steps_s=min(m.max_rate_steps_s, 780)) for m in RM501_BOARD.motors.motors)
    config = replace(
        RM501_BOARD,
        timing=timing,
        motors=replace(RM501_BOARD.motors, motors=motors),
        hand=replace(RM501_BOARD.hand, pulse_rate_hz=780),
    )
    from tests.firmware_model.waves import hand_wave

    rig = Rig(config)
    rig.go(rig.segment(400, flags=REST, events=(hand_event(0, 3), hand_event(12, -3), hand_event(30, 2))))
    rig.run(100)
    rig.core.hand.command(-1)
    rig.core.hand.command(3)  # strokes add up
    rig.run(200)
    wave = hand_wave(rig.pins.words())
    assert timing_violations(wave, config) == []
    assert rig.core.hand.count == 3 - 3 + 2 - 1 + 3
    assert len(wave.rises()) > 4 and len(wave.rises()) % 2 == 0


def test_timers_with_status_due_first() -> None:
    rig = Rig()
    rig.send(SetStatusPeriod(4), Lease(100))
    rig.run(20)
    assert rig.status().lease_ms > 0
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.run(3)
    rig.send(Reset(FaultCode.OVERFLOW, master_reset=True))
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.run(5)
    rig.send(SetPower(False), Reset(FaultCode.NONE, master_reset=True))  # prolongs the pulse
    rig.run(31)
    assert rig.core.master_reset_end
    rig.run(40)
    assert not rig.core.master_reset_end


def test_silence_while_stopping_or_without_power_changes_nothing() -> None:
    rig = Rig()
    rig.go(*[replace(segment, hold_slope=40, stop_slope=40) for segment in cruise(rig, 60_000)])
    rig.run(3000)
    rig.stop()
    rig.cut = True
    rig.run(4000)
    assert rig.state is BoardState.STOPPING
    config = replace(RM501_BOARD, link=replace(RM501_BOARD.link, idle_power_off_ms=100))
    idle = Rig(config, power=False)
    idle.cut = True
    idle.run(1000)
    assert idle.state is BoardState.IDLE


def test_a_lease_that_ends_while_stopping_changes_nothing() -> None:
    rig = Rig()
    rig.send(Lease(1000))
    rig.go(*cruise(rig, jog=True))
    rig.run(2500)
    rig.stop()
    rig.send(Lease(0))
    assert rig.state is BoardState.STOPPING
    rig.run_to(BoardState.IDLE)


def test_override_while_stopping_after_an_override_hold() -> None:
    rig = to_running()
    rig.send(SetOverride(0))
    rig.run(10)
    rig.send(ArmTrigger(0, InputId.SWITCH_ELBOW, Edge.FALLING, TriggerAction.LATCH_AND_STOP, level=True))
    assert rig.state is BoardState.STOPPING
    rig.send(SetOverride(1 << 24))
    assert rig.state is BoardState.STOPPING
    rig.run_to(BoardState.READY)


def test_link_lost_while_a_hold_is_ramping_needs_the_user_too() -> None:
    rig = Rig()
    rig.go(*[replace(segment, hold_slope=100, stop_slope=800) for segment in cruise(rig, 60_000)])
    rig.run(3000)
    rig.send(Hold())
    rig.cut = True
    rig.run(4000)
    assert rig.core.shown_cause() == HoldCause.LINK_LOST
    rig.cut = False
    rig.run(10)
    rig.send(Resume())
    assert rig.state is BoardState.RUNNING


def test_truncate_keeps_output_events_before_the_cut() -> None:
    rig = Rig(DIGITAL)
    rig.go(
        rig.segment(500, flags=REST, events=(output_event(400, 4, 4),)),
        rig.segment(500, flags=REST, events=(output_event(100, 4, 0),)),
    )
    rig.run(100)
    rig.send(Truncate(500))
    rig.run(600)
    assert rig.status().outputs == 4


def test_reset_of_a_fault_without_configuration_leads_back_to_boot() -> None:
    rig = Rig(configured=False)
    rig.stop(StopKind.KILL)
    assert rig.state is BoardState.FAULT
    rig.send(Reset(FaultCode.KILLED))
    assert rig.state is BoardState.BOOT
    rig.core.enter(BoardState.BOOT)  # staying is always allowed
    assert rig.state is BoardState.BOOT


def test_a_message_that_means_nothing_is_refused_by_the_link_and_named() -> None:
    rig = Rig()
    rig.host.data_to_send(rig.now_us)
    header = HEADER.pack(0x7E, FLAG_OPEN | FLAG_SEQUENCED, 2, 0, rig.board.link.epoch, rig.board.link.generation, 0)
    from rm501_protocol.framing import StreamCodec

    rig.messages.clear()
    rig.board.receive(StreamCodec().encode(header))
    rig.host.receive_data(rig.board.transmit(), rig.now_us)
    events = []
    while (event := rig.host.next_event()) is not None:
        events.append(event)
    refused = [event.message for event in events if isinstance(getattr(event, "message", None), Refused)]
    assert [(item.message_id, item.reason) for item in refused] == [(0x7E, RefusalReason.MALFORMED)]


def test_packets_instead_of_a_stream() -> None:
    from rm501_firmware_model import Board
    from rm501_protocol.host_link import HostLink

    pins = rm501_firmware_model.QuietPins(inactive_inputs(RM501_BOARD))
    board = Board(RM501_BOARD, pins, 5, codec=PacketCodec())
    assert board.next_transmit_frame() is None
    host = HostLink(codec=PacketCodec())
    host.connect(3, 0)
    for packet in host.packets_to_send(0):
        board.receive(packet)
    packets = board.transmit_packets()
    assert packets
    for packet in packets:
        host.receive_data(packet, 0)
    assert host.is_open
    board.run_until(400)
    board.raise_fault(FaultCode.INTERNAL)
    board.transmit()
    assert (board.next_transmit_frame() or 0) > board.frame


def test_reports_that_find_no_room_are_sent_later() -> None:
    rig = to_running()
    for trigger in range(3):
        rig.send(ArmTrigger(trigger, InputId.SWITCH_ELBOW, Edge.RISING, TriggerAction.LATCH))
    rig.cut = True
    for _ in range(90):
        rig.board._commands.refuse(1, 1, RefusalReason.NOT_SUPPORTED)  # fills the outbox
    rig.pins.toggle(InputId.SWITCH_ELBOW)
    rig.board.run_until(rig.board.frame + 20)
    rig.pins.toggle(InputId.OVERFLOW_724)
    rig.board.run_until(rig.board.frame + 5)
    assert rig.state is BoardState.FAULT and rig.core.fired == 7
    rig.cut = False
    rig.messages.clear()
    rig.run(4000, 10)
    assert {report.trigger for report in rig.got(TriggerReport)} == {0, 1, 2}
    assert rig.core.reports == 0


def test_steps_that_settle_without_motion() -> None:
    """A segment that ends with a step due, or with STEP high, is finished by the frames that follow."""
    for length in range(1, 12):
        rig = Rig(board=FastBoard if length % 2 else rm501_firmware_model.Board)
        a = int(0.9 * rig.core.layout.max_acceleration[0]) >> 8
        rig.send(SetPositions(1, (0,) * 6))
        rig.go(
            rig.segment(100, MotorTerm(0, 0, a)),
            rig.segment(60 + length, MotorTerm(0, (a * 100) >> 8)),
            rig.segment(100, MotorTerm(0, (a * 100) >> 8, -a), flags=REST),
        )
        rig.run(400)
        words = rig.pins.words()
        wave = motor_waves(words)[0]
        position = rig.board.positions_q48[0]
        assert wave.counts()[-1] == (position + (1 << 47)) >> 48
        assert not wave.step[-1]
    held = to_held()
    counts = list(held.core.stepgen.count)
    held.core.stepgen.position[0] += 3 << 48  # steps that have become due
    assert held.core.stepgen.busy() == 1
    held.core.stepgen.silence()
    assert list(held.core.stepgen.count) == counts


def test_a_configuration_without_hand_status_and_with_a_start_in_ready() -> None:
    holding = to_holding()
    holding.send(Hold(), SetOverride(1 << 23))
    assert holding.status().override == 1 << 23
    with pytest.raises(AssertionError):
        holding.go(Segment(0, 5))
    assert SPEED > 0 and Start is not None


def test_a_hand_that_turns_round_within_the_space_of_a_pulse() -> None:
    config = replace(RM501_BOARD, timing=replace(RM501_BOARD.timing, step_space_frames=6))
    motors = tuple(replace(m, max_rate_steps_s=min(m.max_rate_steps_s, 400)) for m in config.motors.motors)
    hand = replace(config.hand, pulse_rate_hz=400)
    config = replace(config, motors=replace(config.motors, motors=motors), hand=hand)
    from tests.firmware_model.waves import hand_wave

    rig = Rig(config)
    rig.core.hand.command(5)
    rig.run(10)
    rig.core.hand.command(-9)
    rig.run(200)
    wave = hand_wave(rig.pins.words())
    assert timing_violations(wave, config) == []
    assert rig.core.hand.count == -4


def test_the_step_generator_alone() -> None:
    from rm501_firmware_model.stepgen import StepGenerator

    timing = replace(RM501_BOARD.timing, dir_hold_frames=4)
    generator = StepGenerator(BoardLayout(replace(RM501_BOARD, timing=timing)))
    generator.position[0] = 1 << 48  # due at once
    assert generator.busy() == 1
    generator.levels()
    assert (generator.count[0], generator.busy()) == (1, 1)  # STEP is high
    generator.position[0] = 0  # due the other way while DIR is held
    levels = []
    while generator.busy():
        generator.levels()
        levels.append((generator.dir_level[0], generator.count[0]))
    assert levels == [(0, 1), (0, 1), (0, 1), (1, 1), (1, 0), (1, 0)]
    generator.position[0] = 3 << 48
    rises = []
    for frame in range(12):
        before = generator.count[0]
        generator.levels()
        if generator.count[0] != before:
            rises.append(frame)
    assert len(rises) == 3 and np.diff(rises).tolist() == [2, 2]  # late steps: one every other frame
    generator.silence()
    generator.position[0] = 8 << 48
    assert generator.busy() == 0  # nothing rises any more
    generator.levels()
    assert generator.count[0] == 3

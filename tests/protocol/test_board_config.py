"""The board's configuration: the RM-501's numbers after machine.md, pages and hash, every contradiction named."""

from dataclasses import replace

import pytest

from rm501_protocol.board_config import (
    INPUT_LINES,
    OUTPUT_LINES,
    RM501_BOARD,
    BoardConfig,
    InputId,
    Motor,
    input_bit,
    output_bit,
)
from rm501_protocol.config_pages import (
    ConfigHand,
    ConfigInputs,
    ConfigMotors,
    ConfigPins,
    ConfigSlots,
    ConfigTable,
    InputPin,
    InputRole,
    MotorLimits,
    OutputPin,
    OutputSource,
    SlotSources,
)
from rm501_protocol.declaration import decode_payload, encode_payload
from rm501_protocol.errors import ConfigError

# machine.md, "The driver boards and the two parallel ports": port.pin of every line
OUTPUT_PINS = {
    "STEP_1": "0.2", "DIR_1": "0.3", "STROBE": "0.4", "ELBOW_SELECT": "0.5", "WAIST_SELECT": "0.6", "HAND_1": "0.7",
    "HAND_2": "0.8", "HAND_3": "0.9", "HEARTBEAT": "0.14", "MOTOR_POWER": "0.16", "MASTER_RESET": "0.17",
    "STEP_2": "1.1", "DIR_2": "1.3", "SHOULDER_SELECT": "1.4", "RIGHT_WRIST_SELECT": "1.5", "LEFT_WRIST_SELECT": "1.6",
    "HAND_DIRECTION": "1.8", "HAND_POWER": "1.9",
}  # fmt: skip
INPUT_PINS = {
    "OVERFLOW_724": "0.10", "SWITCH_ELBOW": "0.11", "SWITCH_WAIST": "0.12", "OVERFLOW_732": "1.10",
    "SWITCH_SHOULDER": "1.11", "SWITCH_ROLL": "1.12", "SWITCH_PITCH": "1.13", "ESTOP": "0.15", "HOLD": "0.13",
    "CYCLE_START": "1.15",
}  # fmt: skip


def test_the_pins_are_those_of_the_machine() -> None:
    assert {line.name: f"{line.port}.{line.pin}" for line in OUTPUT_LINES} == OUTPUT_PINS
    assert {line.name: f"{line.port}.{line.pin}" for line in INPUT_LINES} == INPUT_PINS
    assert all(line.inverted for line in OUTPUT_LINES)
    assert [line.name for line in INPUT_LINES] == [member.name for member in InputId]
    for lines in (OUTPUT_LINES, INPUT_LINES):
        assert len({line.bit for line in lines}) == len(lines)


def test_the_table_is_the_one_of_the_thesis() -> None:
    config = RM501_BOARD
    assert config.table.entries == (0x048, 0x089, 0x0D2, 0x113, 0x164, 0x1A5, 0x1C6, 0x007)
    assert config.table_order == tuple(range(8))
    assert (config.frame_periods, config.frame_us, config.max_step_rate) == (8, 320, 1562)
    assert config.motor_count == len(Motor) == 6
    assert config.problems() == ()


def test_limits_are_those_of_the_thesis() -> None:
    steps_deg = (40, 40, 40, 80 / 3, 80 / 3)
    for limits, scale, acceleration_deg in zip(
        RM501_BOARD.motors.motors, steps_deg, (200, 21, 21, 21, 21), strict=False
    ):
        assert limits.max_rate_steps_s == 1250
        assert limits.max_acceleration_steps_s2 == round(scale * acceleration_deg)
    hand = RM501_BOARD.hand
    assert (hand.stroke_pulses, hand.stroke_pulses / hand.pulse_rate_hz) == (800, 0.64)


def test_lines_that_are_not_fitted_are_not_found() -> None:
    assert [pin.bit for pin in RM501_BOARD.outputs_from(OutputSource.MOTOR_POWER)] == [output_bit(0, 16)]
    assert RM501_BOARD.inputs_with(InputRole.ESTOP) == (InputId.ESTOP,)
    bare = replace(
        RM501_BOARD,
        pins=ConfigPins(tuple(pin for pin in RM501_BOARD.pins.outputs if pin.source != OutputSource.MOTOR_POWER)),
        inputs=ConfigInputs(tuple(pin for pin in RM501_BOARD.inputs.inputs if pin.role != InputRole.ESTOP)),
    )
    assert bare.outputs_from(OutputSource.MOTOR_POWER) == () and bare.inputs_with(InputRole.ESTOP) == ()
    assert bare.problems() == ()


def test_a_configuration_survives_its_pages() -> None:
    pages = [decode_payload(page.ID, encode_payload(page)) for page in RM501_BOARD.pages()]
    again = BoardConfig.from_pages(pages)  # type: ignore[arg-type]
    assert again == RM501_BOARD and again.hash == RM501_BOARD.hash
    assert [page.ID for page in pages] == sorted(page.ID for page in pages)
    with pytest.raises(ConfigError, match="ConfigTable is missing"):
        BoardConfig.from_pages(pages[:1] + pages[2:])  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="ConfigTiming comes twice"):
        BoardConfig.from_pages([*pages, pages[0]])  # type: ignore[list-item]


def test_the_hash_sees_every_field() -> None:
    from dataclasses import fields

    seen = {RM501_BOARD.hash}
    for page_field in fields(BoardConfig):
        page = getattr(RM501_BOARD, page_field.name)
        for field in fields(page):
            value = getattr(page, field.name)
            changed = value[:-1] if isinstance(value, tuple) else (not value if isinstance(value, bool) else value + 1)
            seen.add(replace(RM501_BOARD, **{page_field.name: replace(page, **{field.name: changed})}).hash)
    assert len(seen) == 1 + sum(len(fields(getattr(RM501_BOARD, f.name))) for f in fields(BoardConfig))


def test_other_orders_and_lengths_of_the_table_are_allowed() -> None:
    entries = RM501_BOARD.table.entries
    low = [entry & 0x3F for entry in entries]
    swapped = [low[2], low[3], low[0], low[1], *low[4:]]
    table = ConfigTable(tuple(entry | ((n + 1) % 8) << 6 for n, entry in enumerate(swapped)))
    assert replace(RM501_BOARD, table=table).problems() == ()
    idle = [*low, 0x00, 0x00]
    longer = ConfigTable(tuple(entry | ((n + 1) % 10) << 6 for n, entry in enumerate(idle)))
    config = replace(RM501_BOARD, table=longer)
    assert (config.frame_periods, config.frame_us, config.max_step_rate) == (10, 400, 1250)
    assert config.problems() == ()


def _motors(**changes: int) -> ConfigMotors:
    first = replace(RM501_BOARD.motors.motors[0], **changes)
    return replace(RM501_BOARD.motors, motors=(first, *RM501_BOARD.motors.motors[1:]))


def _input(**changes: int) -> ConfigInputs:
    return ConfigInputs((replace(RM501_BOARD.inputs.inputs[0], **changes), *RM501_BOARD.inputs.inputs[1:]))


def _slots(**changes: int) -> ConfigSlots:
    return ConfigSlots((replace(RM501_BOARD.slots.slots[0], **changes), *RM501_BOARD.slots.slots[1:]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"timing": replace(RM501_BOARD.timing, base_period_us=4)}, "base_period_us = 4"),
        ({"timing": replace(RM501_BOARD.timing, step_length_frames=0)}, "step_length_frames = 0"),
        ({"timing": replace(RM501_BOARD.timing, dir_hold_frames=33)}, "dir_hold_frames = 33"),
        ({"table": ConfigTable(())}, "is empty"),
        ({"table": ConfigTable((0x048, 0x009, 0x0D2, 0x113))}, "never reached"),
        ({"table": ConfigTable((0x049, 0x043))}, "leads to 1"),
        ({"table": ConfigTable((0x048, 0x009))}, "slot 1 is never strobed"),
        ({"slots": ConfigSlots(RM501_BOARD.slots.slots[:3])}, "slot 3 of the table has no sources"),
        ({"slots": _slots(step_1=0x19)}, "no such source"),
        ({"slots": _slots(dir_1=0x30)}, "no such source"),
        ({"slots": _slots(step_1=0x10)}, "motor 0 is stepped in 2 places"),
        ({"slots": ConfigSlots((SlotSources(0, 0, 0, 0),) * 4)}, "motor 1 is stepped in 0 places"),
        ({"pins": ConfigPins((OutputPin(0, 32, True),))}, "bit 32"),
        ({"pins": ConfigPins((OutputPin(0, 3, True), OutputPin(1, 3, True)))}, "used twice"),
        ({"pins": ConfigPins((OutputPin(0x2F, 3, True),))}, "unknown source 0x2f"),
        ({"pins": ConfigPins((OutputPin(0x44, 3, True),))}, "unknown source 0x44"),
        ({"pins": ConfigPins((OutputPin(0x68, 3, True),))}, "unknown source 0x68"),
        ({"inputs": _input(bit=32)}, "bit = 32"),
        ({"inputs": _input(role=5)}, "role = 5"),
        ({"inputs": _input(debounce_frames=0)}, "debounce_frames = 0"),
        ({"inputs": _input(motors=0x40)}, "names motors beyond 5"),
        ({"motors": _motors(max_rate_steps_s=1563)}, "the step timings allow 1562"),
        ({"motors": _motors(max_acceleration_steps_s2=0)}, "must be positive"),
        ({"motors": replace(RM501_BOARD.motors, margin_permille=201)}, "margin_permille = 201"),
        ({"hand": replace(RM501_BOARD.hand, motor=6)}, "hand.motor = 6"),
        ({"hand": replace(RM501_BOARD.hand, pulse_rate_hz=0)}, "pulse_rate_hz = 0"),
        ({"hand": replace(RM501_BOARD.hand, max_pulses=799)}, "below hand.stroke_pulses"),
        ({"hand": replace(RM501_BOARD.hand, max_pulses=40000)}, "max_pulses = 40000"),
    ],
)
def test_every_contradiction_is_named(changes: dict[str, object], words: str) -> None:
    problems = replace(RM501_BOARD, **changes).problems()
    assert any(words in problem for problem in problems), problems


def test_a_board_without_hand_or_with_digital_outputs_is_fine() -> None:
    pins = ConfigPins((*RM501_BOARD.pins.outputs, OutputPin(OutputSource.DIGITAL + 7, 31, False)))
    config = replace(RM501_BOARD, hand=ConfigHand(motor=255, pulse_rate_hz=0), pins=pins)
    assert config.problems() == ()
    silent = replace(config, table=ConfigTable(()), motors=ConfigMotors((MotorLimits(0, 0),)), slots=ConfigSlots(()))
    assert "table.entries is empty" in silent.problems()
    assert replace(silent, hand=ConfigHand()).problems()


def test_pins_that_do_not_exist_are_refused() -> None:
    for function, port, pin in ((output_bit, 0, 10), (output_bit, 2, 2), (input_bit, 0, 2), (input_bit, 2, 10)):
        with pytest.raises(ValueError, match=f"port {port} pin {pin}"):
            function(port, pin)
    assert InputPin(0, 1, True, 2).motors == 0

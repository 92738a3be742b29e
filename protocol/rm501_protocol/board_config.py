"""What the board has to know, as one value: `BoardConfig`, with the RM-501's own as `RM501_BOARD`.

It is the set of its pages (`config_pages`) and nothing else; its hash is the CRC-32 over their canonical encodings,
in order of message id, each preceded by its id. The pin numbers are fixed by the tables here: host, firmware and
emulator share them.

Output word, one bit per output pin of the two parallel ports; input word likewise::

    port 0 outputs  pin 1 2 3 4 5 6 7 8 9 14 16 17  ->  bits 0..11      port 1 likewise -> bits 16..27
    port 0 inputs   pin 10 11 12 13 15              ->  bits 0..4       port 1 likewise -> bits 8..12
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum

from .config_pages import (
    ConfigHand,
    ConfigInputs,
    ConfigLink,
    ConfigMotors,
    ConfigPage,
    ConfigPins,
    ConfigSlots,
    ConfigTable,
    ConfigTiming,
    InputPin,
    InputRole,
    MotorLimits,
    OutputPin,
    OutputSource,
    SlotSource,
    SlotSources,
)
from .declaration import encode_payload
from .errors import ConfigError

__all__ = [
    "DEFAULT_TABLE",
    "INPUT_LINES",
    "OUTPUT_LINES",
    "PAGE_TYPES",
    "RM501_BOARD",
    "BoardConfig",
    "InputId",
    "InputLine",
    "Motor",
    "OutputLine",
    "input_bit",
    "output_bit",
]

_OUTPUT_PINS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 14, 16, 17)
_INPUT_PINS = (10, 11, 12, 13, 15)


class Motor(IntEnum):
    """Motor numbers of the RM-501."""

    WAIST = 0
    SHOULDER = 1
    ELBOW = 2
    RIGHT_WRIST = 3
    LEFT_WRIST = 4
    HAND = 5


class InputId(IntEnum):
    """Input numbers of the RM-501: places in `INPUT_LINES`."""

    OVERFLOW_724 = 0
    SWITCH_ELBOW = 1
    SWITCH_WAIST = 2
    OVERFLOW_732 = 3
    SWITCH_SHOULDER = 4
    SWITCH_ROLL = 5
    SWITCH_PITCH = 6
    ESTOP = 7
    HOLD = 8
    CYCLE_START = 9


def output_bit(port: int, pin: int) -> int:
    """Bit of an output pin in the output word; raises ValueError for a pin that is no output."""
    if port not in (0, 1) or pin not in _OUTPUT_PINS:
        raise ValueError(f"port {port} pin {pin} is no output of a parallel port: use port 0 or 1, pins {_OUTPUT_PINS}")
    return 16 * port + _OUTPUT_PINS.index(pin)


def input_bit(port: int, pin: int) -> int:
    """Bit of an input pin in the input word; raises ValueError for a pin that is no input."""
    if port not in (0, 1) or pin not in _INPUT_PINS:
        raise ValueError(f"port {port} pin {pin} is no input of a parallel port: use port 0 or 1, pins {_INPUT_PINS}")
    return 8 * port + _INPUT_PINS.index(pin)


@dataclass(frozen=True, slots=True)
class OutputLine:
    """One row of the output pin table; every port output is inverted (active low)."""

    name: str
    port: int
    pin: int
    source: int
    inverted: bool = True

    @property
    def bit(self) -> int:
        """Bit in the output word."""
        return output_bit(self.port, self.pin)


@dataclass(frozen=True, slots=True)
class InputLine:
    """One row of the input pin table."""

    name: str
    port: int
    pin: int
    role: InputRole
    inverted: bool
    debounce_frames: int
    motors: int = 0

    @property
    def bit(self) -> int:
        """Bit in the input word."""
        return input_bit(self.port, self.pin)


_TABLE_STROBE = OutputSource.TABLE_BIT + 0
_SELECT_A = OutputSource.TABLE_BIT + 3
_SELECT_B = OutputSource.TABLE_BIT + 4
_SELECT_C = OutputSource.TABLE_BIT + 5

OUTPUT_LINES: tuple[OutputLine, ...] = (
    OutputLine("STEP_1", 0, 2, OutputSource.STEP_1),
    OutputLine("DIR_1", 0, 3, OutputSource.DIR_1),
    OutputLine("STROBE", 0, 4, _TABLE_STROBE),
    OutputLine("ELBOW_SELECT", 0, 5, _SELECT_A),
    OutputLine("WAIST_SELECT", 0, 6, _SELECT_B),
    OutputLine("HAND_1", 0, 7, OutputSource.STEP_1),
    OutputLine("HAND_2", 0, 8, OutputSource.DIR_1),
    OutputLine("HAND_3", 0, 9, OutputSource.STEP_1),
    OutputLine("HEARTBEAT", 0, 14, OutputSource.HEARTBEAT),
    OutputLine("MOTOR_POWER", 0, 16, OutputSource.MOTOR_POWER),
    OutputLine("MASTER_RESET", 0, 17, OutputSource.MASTER_RESET),
    OutputLine("STEP_2", 1, 1, OutputSource.STEP_2),
    OutputLine("DIR_2", 1, 3, OutputSource.DIR_2),
    OutputLine("SHOULDER_SELECT", 1, 4, _SELECT_A),
    OutputLine("RIGHT_WRIST_SELECT", 1, 5, _SELECT_C),
    OutputLine("LEFT_WRIST_SELECT", 1, 6, _SELECT_B),
    OutputLine("HAND_DIRECTION", 1, 8, _SELECT_C),
    OutputLine("HAND_POWER", 1, 9, OutputSource.SLOT + 3),
)
"""Output lines of the retrofit; wrist selects as in the .hal (the printed pin table swaps them)."""

_SWITCH_DEBOUNCE = (
    8  # 2.56 ms of equal samples: a bounce of up to 20 ms restarts the count, the edge is stamped at its first sample
)
_LINE_DEBOUNCE = 2

INPUT_LINES: tuple[InputLine, ...] = (
    InputLine("OVERFLOW_724", 0, 10, InputRole.OVERFLOW, True, _LINE_DEBOUNCE, 1 << Motor.ELBOW | 1 << Motor.WAIST),
    InputLine("SWITCH_ELBOW", 0, 11, InputRole.GENERAL, False, _SWITCH_DEBOUNCE),
    InputLine("SWITCH_WAIST", 0, 12, InputRole.GENERAL, False, _SWITCH_DEBOUNCE),
    InputLine(
        "OVERFLOW_732",
        1,
        10,
        InputRole.OVERFLOW,
        True,
        _LINE_DEBOUNCE,
        1 << Motor.SHOULDER | 1 << Motor.RIGHT_WRIST | 1 << Motor.LEFT_WRIST,
    ),
    InputLine("SWITCH_SHOULDER", 1, 11, InputRole.GENERAL, False, _SWITCH_DEBOUNCE),
    InputLine("SWITCH_ROLL", 1, 12, InputRole.GENERAL, False, _SWITCH_DEBOUNCE),
    InputLine("SWITCH_PITCH", 1, 13, InputRole.GENERAL, False, _SWITCH_DEBOUNCE),
    InputLine("ESTOP", 0, 15, InputRole.ESTOP, True, _LINE_DEBOUNCE),
    InputLine("HOLD", 0, 13, InputRole.HOLD, False, _SWITCH_DEBOUNCE),
    InputLine("CYCLE_START", 1, 15, InputRole.CYCLE_START, False, _SWITCH_DEBOUNCE),
)
"""Input lines, in the order of `InputId`."""

DEFAULT_TABLE = (0x048, 0x089, 0x0D2, 0x113, 0x164, 0x1A5, 0x1C6, 0x007)
"""The thesis's self-driving select/strobe table."""


def _slot(step_1: int, dir_1: int, step_2: int, dir_2: int) -> SlotSources:
    return SlotSources(step_1, dir_1, step_2, dir_2)


_STEP, _DIR = SlotSource.STEP, SlotSource.DIR

_DEFAULT_SLOTS = (
    _slot(_STEP + Motor.ELBOW, _DIR + Motor.ELBOW, _STEP + Motor.SHOULDER, _DIR + Motor.SHOULDER),
    _slot(_STEP + Motor.WAIST, _DIR + Motor.WAIST, _STEP + Motor.LEFT_WRIST, _DIR + Motor.LEFT_WRIST),
    _slot(SlotSource.HAND_DIR, SlotSource.HIGH, _STEP + Motor.RIGHT_WRIST, _DIR + Motor.RIGHT_WRIST),
    _slot(SlotSource.HAND_PULSE, SlotSource.LOW, SlotSource.LOW, SlotSource.LOW),
)

_DEFAULT_MOTORS = (
    MotorLimits(1250, 8000),  # waist: 200 deg/s2 at 40 steps/deg
    MotorLimits(1250, 840),  # shoulder: 21 deg/s2
    MotorLimits(1250, 840),  # elbow
    MotorLimits(1250, 560),  # right wrist: 21 deg/s2 of the motor at 26.667 steps/deg
    MotorLimits(1250, 560),  # left wrist
    MotorLimits(0, 0),  # hand: moved by events
)


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """Everything the board is told; the default is the RM-501 of the thesis's retrofit with the added lines fitted."""

    timing: ConfigTiming = field(default_factory=ConfigTiming)
    table: ConfigTable = field(default_factory=lambda: ConfigTable(DEFAULT_TABLE))
    slots: ConfigSlots = field(default_factory=lambda: ConfigSlots(_DEFAULT_SLOTS))
    pins: ConfigPins = field(
        default_factory=lambda: ConfigPins(
            tuple(OutputPin(line.source, line.bit, line.inverted) for line in OUTPUT_LINES)
        )
    )
    motors: ConfigMotors = field(default_factory=lambda: ConfigMotors(_DEFAULT_MOTORS))
    inputs: ConfigInputs = field(
        default_factory=lambda: ConfigInputs(
            tuple(
                InputPin(line.role, line.bit, line.inverted, line.debounce_frames, line.motors) for line in INPUT_LINES
            )
        )
    )
    hand: ConfigHand = field(default_factory=ConfigHand)
    link: ConfigLink = field(default_factory=ConfigLink)

    @classmethod
    def from_pages(cls, pages: Iterable[ConfigPage]) -> BoardConfig:
        """The configuration made of exactly these pages; raises ConfigError when one is missing or comes twice."""
        found: dict[type[ConfigPage], ConfigPage] = {}
        problems = []
        for page in pages:
            if type(page) in found:
                problems.append(f"page {type(page).__name__} comes twice")
            found[type(page)] = page
        problems += [f"page {kind.__name__} is missing" for kind in PAGE_TYPES if kind not in found]
        if problems:
            raise ConfigError(tuple(problems))
        # PAGE_TYPES has the order of the fields
        return cls(*(found[kind] for kind in PAGE_TYPES))  # type: ignore[arg-type]

    def pages(self) -> tuple[ConfigPage, ...]:
        """The pages, in order of message id."""
        return (
            self.timing,
            self.table,
            self.slots,
            self.pins,
            self.motors,
            self.inputs,
            self.hand,
            self.link,
        )

    @property
    def hash(self) -> int:
        """CRC-32 over id and payload of every page; 0 is never a hash (it stands for "no configuration")."""
        crc = 0
        for page in self.pages():
            crc = zlib.crc32(bytes((page.ID,)) + encode_payload(page), crc)
        return crc or 1

    @property
    def table_order(self) -> tuple[int, ...]:
        """Addresses of the table in the order in which they are put out during one frame, from entry 0."""
        order: list[int] = []
        address = 0
        entries = self.table.entries
        while address < len(entries) and address not in order:
            order.append(address)
            address = entries[address] >> 6
        return tuple(order)

    @property
    def frame_periods(self) -> int:
        """Base periods in a frame."""
        return len(self.table_order)

    @property
    def frame_us(self) -> int:
        """Length of a frame in microseconds."""
        return self.frame_periods * self.timing.base_period_us

    @property
    def max_step_rate(self) -> int:
        """Largest step rate in steps/s that the step timings allow, rounded down."""
        frames = self.timing.step_length_frames + self.timing.step_space_frames
        return 1_000_000 // (self.frame_us * frames)

    @property
    def motor_count(self) -> int:
        """Motors, the hand included."""
        return len(self.motors.motors)

    def outputs_from(self, source: int) -> tuple[OutputPin, ...]:
        """The pins that carry `source`; empty when the line is not fitted."""
        return tuple(pin for pin in self.pins.outputs if pin.source == source)

    def inputs_with(self, role: InputRole) -> tuple[int, ...]:
        """Numbers of the inputs with `role`; empty when none is fitted."""
        return tuple(number for number, pin in enumerate(self.inputs.inputs) if pin.role == role)

    def problems(self) -> tuple[str, ...]:
        """Every contradiction found, in words; empty when the board can run with it."""
        from .board_config_check import find_problems

        return find_problems(self)


PAGE_TYPES: tuple[type[ConfigPage], ...] = (
    ConfigTiming,
    ConfigTable,
    ConfigSlots,
    ConfigPins,
    ConfigMotors,
    ConfigInputs,
    ConfigHand,
    ConfigLink,
)
"""The pages of a configuration, in order of message id and of the fields of `BoardConfig`."""

RM501_BOARD = BoardConfig()
"""The RM-501 as the thesis wired it, with the lines that the retrofit adds."""

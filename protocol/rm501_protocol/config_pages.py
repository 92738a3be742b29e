"""The pages of the board's configuration, as messages. `board_config` puts them together, checks them and has the
defaults.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

from .declaration import Direction, Message, message
from .wire_types import U8, U16, U32, Bool, Record, Vector

__all__ = [
    "ConfigCommit",
    "ConfigHand",
    "ConfigInputs",
    "ConfigLink",
    "ConfigMotors",
    "ConfigPage",
    "ConfigPins",
    "ConfigSlots",
    "ConfigTable",
    "ConfigTiming",
    "InputPin",
    "InputRole",
    "MotorLimits",
    "OutputPin",
    "OutputSource",
    "SlotSource",
    "SlotSources",
]


class OutputSource(IntEnum):
    """Where an output pin's level comes from; TABLE_BIT, SLOT and DIGITAL are bases to which a number is added."""

    STEP_1 = 0x00  # step multiplexer 1
    DIR_1 = 0x01
    STEP_2 = 0x02
    DIR_2 = 0x03
    MASTER_RESET = 0x10
    MOTOR_POWER = 0x11
    HEARTBEAT = 0x12
    TABLE_BIT = 0x20  # + bit of the table entry (0 strobe, 3..5 selects)
    SLOT = 0x40  # + slot: active while that slot is put out
    DIGITAL = 0x60  # + number of the digital output, 0..7


class SlotSource(IntEnum):
    """What a multiplexer input carries in one slot; STEP and DIR are bases to which a motor number is added."""

    LOW = 0x00
    HIGH = 0x01
    HAND_DIR = 0x02
    HAND_PULSE = 0x03
    STEP = 0x10  # + motor
    DIR = 0x20  # + motor


class InputRole(IntEnum):
    """What the firmware does with an input by itself, beyond reporting it."""

    GENERAL = 0  # switches and sensors: acts only through an armed trigger
    OVERFLOW = 1  # fault OVERFLOW for the motors in its mask
    ESTOP = 2  # active = emergency stop open
    HOLD = 3
    CYCLE_START = 4


class ConfigPage(Message):
    """Base of the pages that make up a configuration; sent only at rest, in force after ConfigCommit."""

    __slots__ = ()


@message(0x60, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigTiming(ConfigPage):
    """Scan and step timing. The four step timings are counted in frames at the latch."""

    base_period_us: Annotated[int, U16("us", "one table entry is put out per base period")] = 40
    step_length_frames: Annotated[int, U8("frames", "STEP stays high at least so long")] = 1
    step_space_frames: Annotated[int, U8("frames", "STEP stays low at least so long")] = 1
    dir_setup_frames: Annotated[int, U8("frames", "DIR is latched so long before its step")] = 1
    dir_hold_frames: Annotated[int, U8("frames", "DIR stays so long after the step's rising edge")] = 1


@message(0x61, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigTable(ConfigPage):
    """The self-driving select/strobe table: bit 0 strobe, 1-2 slot, 3-5 selects, 6-15 address of the next entry; it
    starts at entry 0.
    """

    entries: Annotated[tuple[int, ...], Vector(U16(), 64, "", "table entries")]


@dataclass(frozen=True, slots=True)
class SlotSources:
    """What the four multiplexers carry in one slot, each a SlotSource plus motor number."""

    step_1: int
    dir_1: int
    step_2: int
    dir_2: int


_SLOT = Record(SlotSources, (("step_1", U8()), ("dir_1", U8()), ("step_2", U8()), ("dir_2", U8())))


@message(0x62, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigSlots(ConfigPage):
    """What each of the slots 0..3 carries."""

    slots: Annotated[tuple[SlotSources, ...], Vector(_SLOT, 4, "", "sources per slot, see SlotSource")]


@dataclass(frozen=True, slots=True)
class OutputPin:
    """One output: an OutputSource (plus number), the bit in the output word, and whether the pin is active low."""

    source: int
    bit: int
    inverted: bool


_OUTPUT = Record(OutputPin, (("source", U8()), ("bit", U8()), ("inverted", Bool())))


@message(0x63, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigPins(ConfigPage):
    """The output pins. A line that is not listed is not fitted."""

    outputs: Annotated[tuple[OutputPin, ...], Vector(_OUTPUT, 32, "", "pins, see OutputSource")]


@dataclass(frozen=True, slots=True)
class MotorLimits:
    """What one motor may be asked to do by segments; rate 0 for one that segments do not move (the hand)."""

    max_rate_steps_s: int
    max_acceleration_steps_s2: int


_MOTOR = Record(MotorLimits, (("max_rate_steps_s", U16()), ("max_acceleration_steps_s2", U32())))


@message(0x64, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigMotors(ConfigPage):
    """Limits per motor; a segment beyond `limit x (1 + margin)` is refused whole."""

    motors: Annotated[tuple[MotorLimits, ...], Vector(_MOTOR, 8, "", "limits per motor")]
    margin_permille: Annotated[int, U16("1/1000", "allowance for the rounding of segments")] = 20
    velocity_step_steps_s: Annotated[int, U16("steps/s", "largest jump of speed where segments join")] = 20


@dataclass(frozen=True, slots=True)
class InputPin:
    """One input, numbered by its place in the list; active level after `inverted`; `motors` is the mask that an
    OVERFLOW line concerns.
    """

    role: int
    bit: int
    inverted: bool
    debounce_frames: int
    motors: int = 0


_INPUT = Record(
    InputPin, (("role", U8()), ("bit", U8()), ("inverted", Bool()), ("debounce_frames", U8()), ("motors", U8()))
)


@message(0x65, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigInputs(ConfigPage):
    """The inputs; an input's number is its place here."""

    inputs: Annotated[tuple[InputPin, ...], Vector(_INPUT, 32, "", "inputs, see InputRole")]


@message(0x66, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigHand(ConfigPage):
    """The hand: power pulses at a rate, bounded in number."""

    motor: Annotated[int, U8("", "motor number under which it is reported, 255 for none")] = 5
    pulse_rate_hz: Annotated[int, U16("Hz", "power pulses per second")] = 1250
    stroke_pulses: Annotated[int, U16("pulses", "full stroke")] = 800
    max_pulses: Annotated[int, U16("pulses", "most that one event may ask for")] = 1200
    grip_pulses: Annotated[int, U16("pulses", "added by the firmware when closing: force")] = 0


@message(0x67, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigLink(ConfigPage):
    """Timeouts and thresholds."""

    link_timeout_ms: Annotated[int, U16("ms", "silence while moving that holds and latches")] = 1000
    idle_power_off_ms: Annotated[int, U16("ms", "silence at rest that switches motor power off, 0: never")] = 0
    high_water_frames: Annotated[int, U32("motion frames", "queued motion that starts by itself, 0: only Start")] = 0
    status_period_ms: Annotated[int, U16("ms", "period of Status")] = 100
    trust_without_power: Annotated[bool, Bool("", "positions stay trusted while motor power is off")] = False


@message(0x68, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigCommit(Message):
    """Put the pages in force if they are all there, agree with each other and with this hash. Answered by
    ConfigAccepted or Refused.
    """

    config_hash: Annotated[int, U32("", "CRC-32 over the pages, see BoardConfig.hash")]

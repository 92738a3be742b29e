"""The cable between the microcontroller's port pins and the terminals of the driver boards.

Every terminal hangs on one port bit through an inverter (all outputs of this machine are active low). What can go
wrong on a bench can be set here: two wires swapped, an inverter forgotten, a line stuck at a level, a wire to another
pin. The driver boards see levels only through this table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import numpy.typing as npt

from rm501_sim_board.errors import BenchConfigError

WordArray = npt.NDArray[np.uint32]
BoolArray = npt.NDArray[np.bool_]


class Terminal(Enum):
    """Inputs of the three driver boards and of the relay board, by the signal names of the pin table."""

    STEP_1 = "STEP_1"
    DIR_1 = "DIR_1"
    STEP_2 = "STEP_2"
    DIR_2 = "DIR_2"
    STROBE_724 = "STROBE_724"
    STROBE_732 = "STROBE_732"
    STROBE_727 = "STROBE_727"
    ELBOW_SELECT = "ELBOW_SELECT"
    WAIST_SELECT = "WAIST_SELECT"
    SHOULDER_SELECT = "SHOULDER_SELECT"
    LEFT_WRIST_SELECT = "LEFT_WRIST_SELECT"
    RIGHT_WRIST_SELECT = "RIGHT_WRIST_SELECT"
    HAND_DIRECTION = "HAND_DIRECTION"
    HAND_POWER = "HAND_POWER"
    HAND_1 = "HAND_1"
    HAND_2 = "HAND_2"
    HAND_3 = "HAND_3"
    MASTER_RESET = "MASTER_RESET"
    MOTOR_POWER = "MOTOR_POWER"
    HEARTBEAT = "HEARTBEAT"


@dataclass(frozen=True, slots=True)
class Wire:
    """One terminal: the port bit it hangs on, whether an inverter sits in between, and a level it is stuck at."""

    bit: int
    inverted: bool = True
    stuck: bool | None = None

    def levels(self, words: WordArray) -> BoolArray:
        """Logical level at the terminal for each port word, shape like `words`."""
        if self.stuck is not None:
            return np.full(words.shape, self.stuck, dtype=np.bool_)
        high: BoolArray = (words & np.uint32(1 << self.bit)) != 0
        return ~high if self.inverted else high

    def level(self, word: int) -> bool:
        """Logical level at the terminal for one port word."""
        if self.stuck is not None:
            return self.stuck
        return bool(word >> self.bit & 1) != self.inverted


@dataclass(frozen=True, slots=True)
class Wiring:
    """All wires of the bench. Optional terminals (relay, charge pump) may be missing."""

    wires: Mapping[Terminal, Wire]

    def __post_init__(self) -> None:
        optional = {Terminal.MOTOR_POWER, Terminal.HEARTBEAT}
        missing = [terminal.value for terminal in Terminal if terminal not in self.wires and terminal not in optional]
        if missing:
            raise BenchConfigError(f"wiring: no pin for {', '.join(missing)}; give every terminal a port bit")
        for terminal, wire in self.wires.items():
            if not 0 <= wire.bit < 32:
                raise BenchConfigError(f"wiring: {terminal.value} on bit {wire.bit}; port words have bits 0 to 31")

    def swapped(self, first: Terminal, second: Terminal) -> Wiring:
        """The same bench with two wires exchanged at the connector."""
        wires = dict(self.wires)
        wires[first], wires[second] = self.wires[second], self.wires[first]
        return Wiring(wires)

    def without_inverter(self, terminal: Terminal) -> Wiring:
        """The same bench with the inverter of one line forgotten (or one too many fitted)."""
        wire = self.wires[terminal]
        return Wiring({**self.wires, terminal: replace(wire, inverted=not wire.inverted)})

    def stuck(self, terminal: Terminal, level: bool) -> Wiring:
        """The same bench with one terminal stuck at a logical level."""
        return Wiring({**self.wires, terminal: replace(self.wires[terminal], stuck=level)})

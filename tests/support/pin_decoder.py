"""An independent reading of the port words: what the three driver boards must have latched.

Written from the machine sheet alone, one base period at a time, with no product code: it is the judge of both the
firmware's output and the emulator's vectorised decoding. Pins are active low. Bits of a port word: port 0 pins
1 2 3 4 5 6 7 8 9 14 16 17 are bits 0..11, the same pins of port 1 bits 16..27.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

PIN_ORDER = (1, 2, 3, 4, 5, 6, 7, 8, 9, 14, 16, 17)

PINS: dict[str, tuple[int, int]] = {
    "STEP_1": (0, 2),
    "DIR_1": (0, 3),
    "STROBE": (0, 4),
    "ELBOW SELECT": (0, 5),
    "WAIST SELECT": (0, 6),
    "HAND_1": (0, 7),
    "HAND_2": (0, 8),
    "HAND_3": (0, 9),
    "HEARTBEAT": (0, 14),
    "MOTOR_POWER": (0, 16),
    "MASTER RESET": (0, 17),
    "STEP_2": (1, 1),
    "DIR_2": (1, 3),
    "SHOULDER SELECT": (1, 4),
    "RIGHT WRIST SELECT": (1, 5),
    "LEFT WRIST SELECT": (1, 6),
    "HAND DIRECTION": (1, 8),
    "HAND POWER": (1, 9),
}
MOTORS = ("waist", "shoulder", "elbow", "right wrist", "left wrist")
# motor: select line, step line, direction line
REGISTERS: dict[str, tuple[str, str, str]] = {
    "waist": ("WAIST SELECT", "STEP_1", "DIR_1"),
    "shoulder": ("SHOULDER SELECT", "STEP_2", "DIR_2"),
    "elbow": ("ELBOW SELECT", "STEP_1", "DIR_1"),
    "right wrist": ("RIGHT WRIST SELECT", "STEP_2", "DIR_2"),
    "left wrist": ("LEFT WRIST SELECT", "STEP_2", "DIR_2"),
}


def bit_of(signal: str) -> int:
    """Bit of a signal in the port word."""
    port, pin = PINS[signal]
    return 16 * port + PIN_ORDER.index(pin)


class Latch(NamedTuple):
    """One strobe edge at a selected register: base period, latched step and direction levels (logical)."""

    period: int
    step: bool
    direction: bool


@dataclass(slots=True)
class DecodedRun:
    """What the boards latched, per motor, and what followed from it."""

    latches: dict[str, list[Latch]] = field(default_factory=lambda: {m: [] for m in MOTORS})
    steps: dict[str, list[tuple[int, int]]] = field(default_factory=lambda: {m: [] for m in MOTORS})
    hand_pulses: list[tuple[int, int]] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(MOTORS, 0))
    master_reset_periods: list[int] = field(default_factory=list)
    power_changes: list[tuple[int, bool]] = field(default_factory=list)
    heartbeat_edges: int = 0
    periods: int = 0


def decode(words: Iterable[int], first_period: int = 0) -> DecodedRun:
    """Run the three boards over port words, one per base period, starting from all lines inactive.

    A line is active while its bit is 0. Only the strobe, and the lines that act by themselves, are looked at in every
    period; data and selects matter at the strobe's edge alone.
    """
    run = DecodedRun()
    strobe, reset = 1 << bit_of("STROBE"), 1 << bit_of("MASTER RESET")
    power, heartbeat = 1 << bit_of("MOTOR_POWER"), 1 << bit_of("HEARTBEAT")
    watched = reset | power | heartbeat
    hand_direction_select, hand_power_select = 1 << bit_of("HAND DIRECTION"), 1 << bit_of("HAND POWER")
    hand_1 = 1 << bit_of("HAND_1")
    registers = [
        (motor, 1 << bit_of(select), 1 << bit_of(step), 1 << bit_of(direction), run.latches[motor], run.steps[motor])
        for motor, (select, step, direction) in REGISTERS.items()
    ]
    step_level = dict.fromkeys(MOTORS, False)
    hand_direction = hand_power = False
    before = ~0
    period = first_period
    for word in map(int, words):
        if (before ^ word) & watched:
            if before & reset and not word & reset:
                run.master_reset_periods.append(period)
            if (before ^ word) & power:
                run.power_changes.append((period, not word & power))
            run.heartbeat_edges += bool((before ^ word) & heartbeat)
        if before & strobe and not word & strobe:
            for motor, select, step, direction, latches, steps in registers:
                if word & select:
                    continue
                level, negative = not word & step, not word & direction
                latches.append(Latch(period, level, negative))
                if level and not step_level[motor]:
                    sign = -1 if negative else 1
                    steps.append((period, sign))
                    run.counts[motor] += sign
                step_level[motor] = level
            if not word & hand_direction_select:
                hand_direction = not word & hand_1
            if not word & hand_power_select:
                pulse = not word & hand_1
                if pulse and not hand_power:
                    run.hand_pulses.append((period, -1 if hand_direction else 1))
                hand_power = pulse
        before = word
        period += 1
    run.periods = period - first_period
    return run

"""An independent reading of the port words: what the three driver boards must have latched.

Written from the machine sheet alone, one base period at a time, with no product code: it is the judge of both the
firmware's output and the emulator's vectorised decoding. Pins are active low. Bits of a port word: port 0 pins
1 2 3 4 5 6 7 8 9 14 16 17 are bits 0..11, the same pins of port 1 bits 16..27.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

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


@dataclass(frozen=True, slots=True)
class Latch:
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
    """Run the three boards over port words, one per base period, starting from all lines inactive."""
    run = DecodedRun()
    shift = {name: bit_of(name) for name in PINS}
    active: dict[str, bool] = dict.fromkeys(PINS, False)
    step_level = dict.fromkeys(MOTORS, False)
    hand_direction = hand_power = False
    period = first_period
    for word in words:
        before = active
        word = int(word)
        active = {name: not word >> bit & 1 for name, bit in shift.items()}
        if active["MASTER RESET"] and not before["MASTER RESET"]:
            run.master_reset_periods.append(period)
        if active["MOTOR_POWER"] != before["MOTOR_POWER"]:
            run.power_changes.append((period, active["MOTOR_POWER"]))
        run.heartbeat_edges += active["HEARTBEAT"] != before["HEARTBEAT"]
        if active["STROBE"] and not before["STROBE"]:
            for motor, (select, step, direction) in REGISTERS.items():
                if not active[select]:
                    continue
                latch = Latch(period, active[step], active[direction])
                run.latches[motor].append(latch)
                if latch.step and not step_level[motor]:
                    sign = -1 if latch.direction else 1
                    run.steps[motor].append((period, sign))
                    run.counts[motor] += sign
                step_level[motor] = latch.step
            if active["HAND DIRECTION"]:
                hand_direction = active["HAND_1"]
            if active["HAND POWER"]:
                if active["HAND_1"] and not hand_power:
                    run.hand_pulses.append((period, -1 if hand_direction else 1))
                hand_power = active["HAND_1"]
        period += 1
    run.periods = period - first_period
    return run

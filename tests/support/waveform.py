"""Checks recorded port words against the machine's timing rules, independently of every product package.

All rules are counted in whole frames at the latch: a STEP stays latched high for `step_length`, low for `step_space`,
its direction is latched `dir_setup` frames before and unchanged `dir_hold` frames after it. On the pins: data and
select lines do not move while the strobe is active, and in the period in which it becomes active.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tests.support.pin_decoder import MOTORS, Latch, bit_of, decode


@dataclass(frozen=True, slots=True)
class TimingRules:
    """Least durations in frames at the latch."""

    step_length: int = 1
    step_space: int = 1
    dir_setup: int = 1
    dir_hold: int = 1


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken rule."""

    period: int
    where: str
    rule: str
    found: int
    needed: int


def check_motor(motor: str, latches: Sequence[Latch], rules: TimingRules) -> list[Violation]:
    """Rules of one register's latched levels, one latch a frame."""
    found: list[Violation] = []
    last_rise: int | None = None
    last_fall: int | None = None
    last_turn: int | None = None
    for index in range(1, len(latches)):
        before, now = latches[index - 1], latches[index]
        if now.direction != before.direction:
            last_turn = index
            if last_rise is not None and index - last_rise < rules.dir_hold:
                found.append(Violation(now.period, motor, "dir_hold", index - last_rise, rules.dir_hold))
        if now.step and not before.step:
            if last_fall is not None and index - last_fall < rules.step_space:
                found.append(Violation(now.period, motor, "step_space", index - last_fall, rules.step_space))
            if last_turn is not None and index - last_turn < rules.dir_setup:
                found.append(Violation(now.period, motor, "dir_setup", index - last_turn, rules.dir_setup))
            last_rise = index
        if before.step and not now.step:
            if last_rise is not None and index - last_rise < rules.step_length:
                found.append(Violation(now.period, motor, "step_length", index - last_rise, rules.step_length))
            last_fall = index
    return found


def check_bus(words: Sequence[int]) -> list[Violation]:
    """Nothing but the strobe may move while data are being taken over."""
    strobe = 1 << bit_of("STROBE")
    shared = 0
    for name in ("STEP_1", "DIR_1", "STEP_2", "DIR_2", "HAND_1", "HAND_2", "HAND_3"):
        shared |= 1 << bit_of(name)
    for name in ("ELBOW", "WAIST", "SHOULDER", "RIGHT WRIST", "LEFT WRIST"):
        shared |= 1 << bit_of(f"{name} SELECT")
    shared |= 1 << bit_of("HAND DIRECTION") | 1 << bit_of("HAND POWER")
    found: list[Violation] = []
    for period in range(1, len(words)):
        before, now = int(words[period - 1]), int(words[period])
        if not now & strobe and (before ^ now) & shared:
            found.append(Violation(period, "bus", "data moved under the strobe", (before ^ now) & shared, 0))
    return found


def check_words(words: Sequence[int], rules: TimingRules | None = None, first_period: int = 0) -> list[Violation]:
    """Every violation in a recording."""
    rules = rules or TimingRules()
    run = decode(words, first_period)
    found = check_bus(words)
    for motor in MOTORS:
        found += check_motor(motor, run.latches[motor], rules)
    return found

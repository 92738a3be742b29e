"""Checks of a board configuration that the types of its fields cannot express."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .config_pages import OutputSource, SlotSource

if TYPE_CHECKING:
    from .board_config import BoardConfig

__all__ = ["find_problems"]


def find_problems(config: BoardConfig) -> tuple[str, ...]:
    """Every contradiction in `config`, naming the page and what to change; empty when there is none."""
    return (
        *_timing_problems(config),
        *_table_problems(config),
        *_slot_problems(config),
        *_pin_problems(config),
        *_input_problems(config),
        *_motor_problems(config),
        *_hand_problems(config),
    )


def _timing_problems(config: BoardConfig) -> list[str]:
    found = []
    timing = config.timing
    if not 5 <= timing.base_period_us <= 1000:
        found.append(f"timing.base_period_us = {timing.base_period_us}: must be 5..1000")
    for name in ("step_length_frames", "step_space_frames", "dir_setup_frames", "dir_hold_frames"):
        if not 1 <= getattr(timing, name) <= 32:
            found.append(f"timing.{name} = {getattr(timing, name)}: must be 1..32")
    return found


def _table_problems(config: BoardConfig) -> list[str]:
    found = []
    entries = config.table.entries
    if not entries:
        return ["table.entries is empty"]
    order = config.table_order
    if len(order) != len(entries):
        unreached = sorted(set(range(len(entries))) - set(order))
        found.append(f"table.entries: entries {unreached} are never reached from entry 0")
    if entries[order[-1]] >> 6 != 0:
        found.append(f"table.entries[{order[-1]}] leads to {entries[order[-1]] >> 6}: the loop must close at entry 0")
    strobed = {entries[address] >> 1 & 3 for address in order if entries[address] & 1}
    for slot in range(len(config.slots.slots)):
        if slot not in strobed:
            found.append(f"table.entries: slot {slot} is never strobed, so its boards would latch nothing")
    for slot in sorted(strobed):
        if slot >= len(config.slots.slots):
            found.append(f"slots: slot {slot} of the table has no sources")
    return found


def _slot_problems(config: BoardConfig) -> list[str]:
    found = []
    count = config.motor_count
    seen: dict[int, int] = {}
    for number, slot in enumerate(config.slots.slots):
        for name in ("step_1", "dir_1", "step_2", "dir_2"):
            source = getattr(slot, name)
            base, motor = source & 0xF0, source & 0x0F
            fixed = source <= SlotSource.HAND_PULSE
            if not fixed and (base not in (SlotSource.STEP, SlotSource.DIR) or motor >= count):
                found.append(f"slots[{number}].{name} = 0x{source:02x}: no such source")
            elif base == SlotSource.STEP:
                seen[motor] = seen.get(motor, 0) + 1
    for motor, limits in enumerate(config.motors.motors):
        if limits.max_rate_steps_s and seen.get(motor, 0) != 1:
            found.append(f"slots: motor {motor} is stepped in {seen.get(motor, 0)} places, must be 1")
    return found


def _pin_problems(config: BoardConfig) -> list[str]:
    found = []
    bits: set[int] = set()
    fixed = {
        OutputSource.STEP_1,
        OutputSource.DIR_1,
        OutputSource.STEP_2,
        OutputSource.DIR_2,
        OutputSource.MASTER_RESET,
        OutputSource.MOTOR_POWER,
        OutputSource.HEARTBEAT,
    }
    for pin in config.pins.outputs:
        if pin.bit > 31 or pin.bit in bits:
            found.append(f"pins: bit {pin.bit} is above 31 or used twice")
        bits.add(pin.bit)
        base, number = pin.source & 0xE0, pin.source & 0x1F
        known = (
            pin.source in fixed
            or (base == OutputSource.TABLE_BIT and number < 6)
            or (base == OutputSource.SLOT and number < 4)
            or (base == OutputSource.DIGITAL and number < 8)
        )
        if not known:
            found.append(f"pins: bit {pin.bit} has the unknown source 0x{pin.source:02x}")
    return found


def _input_problems(config: BoardConfig) -> list[str]:
    found = []
    for number, pin in enumerate(config.inputs.inputs):
        if pin.bit > 31:
            found.append(f"inputs[{number}].bit = {pin.bit}: must be 0..31")
        if pin.role > 4:
            found.append(f"inputs[{number}].role = {pin.role}: no such role")
        if pin.debounce_frames == 0:
            found.append(f"inputs[{number}].debounce_frames = 0: must be 1..255")
        if pin.motors >> config.motor_count:
            found.append(f"inputs[{number}].motors = 0x{pin.motors:02x}: names motors beyond {config.motor_count - 1}")
    return found


def _motor_problems(config: BoardConfig) -> list[str]:
    found = []
    fastest = 0 if config.frame_us == 0 else config.max_step_rate
    for motor, limits in enumerate(config.motors.motors):
        if limits.max_rate_steps_s > fastest:
            found.append(
                f"motors[{motor}].max_rate_steps_s = {limits.max_rate_steps_s}: the step timings allow {fastest}"
            )
        if limits.max_rate_steps_s and not limits.max_acceleration_steps_s2:
            found.append(f"motors[{motor}].max_acceleration_steps_s2 = 0: must be positive")
    if config.motors.margin_permille > 200:
        found.append(f"motors.margin_permille = {config.motors.margin_permille}: must be 0..200")
    return found


def _hand_problems(config: BoardConfig) -> list[str]:
    found = []
    hand = config.hand
    if hand.motor != 255:
        if hand.motor >= config.motor_count:
            found.append(f"hand.motor = {hand.motor}: no such motor, 255 for none")
        if not 0 < hand.pulse_rate_hz <= (config.max_step_rate if config.frame_us else 0):
            found.append(f"hand.pulse_rate_hz = {hand.pulse_rate_hz}: must be positive and within the step timings")
        if hand.max_pulses < hand.stroke_pulses:
            found.append("hand.max_pulses is below hand.stroke_pulses")
        if hand.max_pulses > 32767:
            found.append(f"hand.max_pulses = {hand.max_pulses}: must be 0..32767")
    return found

"""From the host's configuration to what the board has to know: the pages that the handshake sends."""

from __future__ import annotations

import math
from dataclasses import replace

from rm501_host.config.schema import Config, MotorSection
from rm501_protocol.board_config import INPUT_LINES, OUTPUT_LINES, RM501_BOARD, BoardConfig, output_bit
from rm501_protocol.config_pages import (
    ConfigHand,
    ConfigInputs,
    ConfigLink,
    ConfigMotors,
    ConfigPins,
    ConfigTable,
    ConfigTiming,
    InputPin,
    InputRole,
    MotorLimits,
    OutputPin,
    OutputSource,
)

_HAND_LIMITS = MotorLimits(0, 0)
_SWAPPED_SELECTS = {"RIGHT_WRIST_SELECT": "LEFT_WRIST_SELECT", "LEFT_WRIST_SELECT": "RIGHT_WRIST_SELECT"}
_SWAPPED_SWITCHES = {"SWITCH_ROLL": "SWITCH_PITCH", "SWITCH_PITCH": "SWITCH_ROLL"}


def board_config_from(config: Config) -> BoardConfig:
    """The board's configuration that belongs to `config`; raises nothing, `load_config` has checked the values."""
    board = config.board
    return replace(
        RM501_BOARD,
        timing=ConfigTiming(
            base_period_us=board.base_period_us,
            step_length_frames=board.step.length_frames,
            step_space_frames=board.step.space_frames,
            dir_setup_frames=board.step.dir_setup_frames,
            dir_hold_frames=board.step.dir_hold_frames,
        ),
        table=ConfigTable(board.table),
        pins=_pins(config),
        motors=ConfigMotors(
            (*map(_limits, config.motors.ordered), _HAND_LIMITS),
            margin_permille=round(1000 * (board.limit_margin - 1)),
        ),
        inputs=_inputs(config),
        hand=ConfigHand(
            pulse_rate_hz=round(config.hand.pulse_rate_steps_s),
            stroke_pulses=config.hand.stroke_pulses,
            max_pulses=config.hand.stroke_pulses * 3 // 2,
        ),
        link=ConfigLink(link_timeout_ms=board.link_timeout_ms, idle_power_off_ms=board.idle_power_off_ms),
    )


def _limits(motor: MotorSection) -> MotorLimits:
    acceleration_steps_s2 = motor.max_acceleration_deg_s2 * motor.steps_per_deg
    return MotorLimits(math.ceil(motor.max_rate_steps_s), math.ceil(acceleration_steps_s2))


def _pins(config: Config) -> ConfigPins:
    wiring = config.board.wiring
    by_name = {line.name: line for line in OUTPUT_LINES}
    fitted = []
    for line in OUTPUT_LINES:
        if line.source == OutputSource.MOTOR_POWER and not wiring.motor_power:
            continue
        if line.source == OutputSource.HEARTBEAT and not wiring.heartbeat:
            continue
        where = by_name[_SWAPPED_SELECTS[line.name]] if _swapped(wiring.swap_wrist_selects, line.name) else line
        inverted = line.inverted if wiring.outputs_active_low else not line.inverted
        fitted.append(OutputPin(line.source, where.bit, inverted))
    for number, name in enumerate(config.board.digital_outputs):
        port, pin = name.split(".")
        fitted.append(
            OutputPin(OutputSource.DIGITAL + number, output_bit(int(port), int(pin)), wiring.outputs_active_low)
        )
    return ConfigPins(tuple(fitted))


def _swapped(swap: bool, name: str) -> bool:
    return swap and (name in _SWAPPED_SELECTS or name in _SWAPPED_SWITCHES)


def _inputs(config: Config) -> ConfigInputs:
    """Inputs keep their numbers: a button or line that is not fitted becomes a general input, which only reports."""
    wiring = config.board.wiring
    by_name = {line.name: line for line in INPUT_LINES}
    fitted = {
        InputRole.ESTOP: wiring.estop,
        InputRole.HOLD: wiring.buttons,
        InputRole.CYCLE_START: wiring.buttons,
    }
    pins = []
    for line in INPUT_LINES:
        where = by_name[_SWAPPED_SWITCHES[line.name]] if _swapped(wiring.swap_wrist_switches, line.name) else line
        role = line.role if fitted.get(line.role, True) else InputRole.GENERAL
        debounce = config.board.debounce_frames if line.name.startswith("SWITCH_") else line.debounce_frames
        pins.append(InputPin(role, where.bit, line.inverted, debounce, line.motors))
    return ConfigInputs(tuple(pins))

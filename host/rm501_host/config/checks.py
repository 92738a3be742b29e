"""Checks that span several keys of a configuration: each complaint names a key, what is wrong, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

from rm501_host.config.schema import JOINT_NAMES, MOTOR_NAMES, Config, JointSection
from rm501_protocol.board_config import OUTPUT_LINES, output_bit

_SWITCH_INPUTS = ("SWITCH_ELBOW", "SWITCH_WAIST", "SWITCH_SHOULDER", "SWITCH_ROLL", "SWITCH_PITCH")
_MIN_DETERMINANT = 1e-6
MOST_BACKLASH_DEG = 3.0
"""Homing turns round within 10 deg of a switch and has to have taken up the play by the time it latches."""


@dataclass(frozen=True, slots=True)
class Complaint:
    """What is wrong with the value at `key` (dotted, as in the file) and how to put it right."""

    key: str
    message: str
    remedy: str


def complaints_about(config: Config) -> list[Complaint]:
    """Everything that the types alone cannot see; empty when the configuration can be used."""
    found: list[Complaint] = []
    for name, joint in zip(JOINT_NAMES, config.joints.ordered, strict=True):
        found += _about_joint(f"joints.{name}", joint)
    sequences = [joint.home.sequence for joint in config.joints.ordered]
    if sorted(sequences) != list(range(len(sequences))):
        found.append(
            Complaint(
                "joints.waist.home.sequence",
                f"the home sequence is {sequences} for {', '.join(JOINT_NAMES)}",
                "number the joints 0 to 4 in the order in which they shall home",
            )
        )
    inputs = [joint.home.input for joint in config.joints.ordered]
    for name, joint in zip(JOINT_NAMES, config.joints.ordered, strict=True):
        if inputs.count(joint.home.input) > 1:
            found.append(
                Complaint(
                    f"joints.{name}.home.input",
                    f"{joint.home.input} is the switch of more than one joint",
                    "give every joint its own switch",
                )
            )
    for name, motor in zip(MOTOR_NAMES, config.motors.ordered, strict=True):
        if motor.backlash_deg > (MOST_BACKLASH_DEG if name.endswith("_wrist") else 0.0):
            found.append(
                Complaint(
                    f"motors.{name}.backlash_deg",
                    f"{motor.backlash_deg} deg: at most {MOST_BACKLASH_DEG} for the wrist's motors, 0 for the others",
                    "give the play of waist, shoulder and elbow as that of their joints",
                )
            )
    found += _about_drive(config)
    found += _about_board(config)
    if config.planner.stop_acceleration_ratio < config.planner.hold_acceleration_ratio:
        found.append(
            Complaint(
                "planner.stop_acceleration_ratio",
                "a stop would be gentler than a hold",
                "make it at least hold_acceleration_ratio",
            )
        )
    for code, (output, _) in config.gcode.outputs.items():
        if output >= len(config.board.digital_outputs):
            found.append(
                Complaint(
                    f"gcode.outputs.{code}",
                    f"there is no output {output}",
                    "list its pin in board.digital_outputs",
                )
            )
    for index, box in enumerate(config.keep_out.boxes):
        if any(low >= high for low, high in zip(box.min_mm, box.max_mm, strict=True)):
            found.append(
                Complaint(
                    f"keep_out.boxes[{index}].min_mm",
                    f"box {box.name!r} is empty or inside out",
                    "make every number of min_mm smaller than that of max_mm",
                )
            )
    return found


def _about_joint(key: str, joint: JointSection) -> list[Complaint]:
    found: list[Complaint] = []
    home = joint.home
    if joint.min_deg >= joint.max_deg:
        found.append(
            Complaint(f"{key}.min_deg", f"{joint.min_deg} is not below max_deg {joint.max_deg}", "swap the limits")
        )
        return found
    if not joint.min_deg <= home.home_deg <= joint.max_deg:
        found.append(
            Complaint(
                f"{key}.home.home_deg",
                f"{home.home_deg} is outside {joint.min_deg} to {joint.max_deg}",
                "put the home position inside the joint's range",
            )
        )
    if joint.backlash_deg > MOST_BACKLASH_DEG:
        found.append(
            Complaint(
                f"{key}.backlash_deg",
                f"{joint.backlash_deg} deg is no play any more (at most {MOST_BACKLASH_DEG})",
                "mend the joint; give the whole play between both directions, in deg of the joint",
            )
        )
    if home.input not in _SWITCH_INPUTS:
        found.append(
            Complaint(f"{key}.home.input", f"{home.input!r} is no switch input", f"use one of {_SWITCH_INPUTS}")
        )
    towards = -1.0 if home.active == "below" else 1.0
    if (home.home_deg - home.switch_deg) * towards >= 0 and not home.ignore_limits:
        found.append(
            Complaint(
                f"{key}.home.ignore_limits",
                f"the home position {home.home_deg} lies where the switch at {home.switch_deg} is active",
                "set it, or put the home position on the open side of the switch",
            )
        )
    if home.search_deg_s * towards <= 0:
        found.append(
            Complaint(
                f"{key}.home.search_deg_s",
                f"{home.search_deg_s} deg/s leads away from a switch that is active {home.active}",
                "change the sign of the search or the active side",
            )
        )
    if home.latch_deg_s * towards >= 0:
        found.append(
            Complaint(
                f"{key}.home.latch_deg_s",
                "search and latch have the same direction",
                "give the latch the opposite sign: switch_deg is the angle at the release edge",
            )
        )
    return found


def _about_drive(config: Config) -> list[Complaint]:
    (a, b), (c, d) = config.drive.wrist_matrix
    if abs(a * d - b * c) < _MIN_DETERMINANT:
        return [
            Complaint(
                "drive.wrist_matrix",
                "the matrix is singular: two motors could not move two joints",
                "rows are the right and left motor on (pitch, roll), such as [[-1, 1], [1, 1]]",
            )
        ]
    return []


def _about_board(config: Config) -> list[Complaint]:
    found: list[Complaint] = []
    board = config.board
    if not 2 <= len(board.table) <= 16:
        found.append(Complaint("board.table", f"{len(board.table)} entries", "give 2 to 16 entries"))
        return found
    taken = {f"{line.port}.{line.pin}" for line in OUTPUT_LINES}
    for index, name in enumerate(board.digital_outputs):
        try:
            output_bit(*(int(part) for part in name.split(".")))
            free = name not in taken and board.digital_outputs.count(name) == 1
        except ValueError:
            free = False
        if not free:
            found.append(
                Complaint(
                    f"board.digital_outputs[{index}]",
                    f"{name} is no free output pin",
                    "use each of 0.1, 1.2, 1.7, 1.14, 1.16, 1.17 once at most",
                )
            )
    frame_us = board.base_period_us * len(board.table)
    step_frames = board.step.length_frames + board.step.space_frames
    fastest_steps_s = 1e6 / (frame_us * step_frames)
    for name, motor in zip(MOTOR_NAMES, config.motors.ordered, strict=True):
        if motor.max_rate_steps_s > fastest_steps_s:
            found.append(
                Complaint(
                    f"motors.{name}.max_rate_steps_s",
                    f"{motor.max_rate_steps_s} steps/s, but base period and step timing allow {fastest_steps_s:.1f}",
                    "lower it, or shorten board.base_period_us",
                )
            )
    if config.hand.pulse_rate_steps_s > fastest_steps_s:
        found.append(
            Complaint(
                "hand.pulse_rate_steps_s",
                f"the step timing allows {fastest_steps_s:.1f} steps/s",
                "lower it",
            )
        )
    return found

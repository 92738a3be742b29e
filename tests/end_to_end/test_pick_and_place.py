"""The thesis's program from G-code to pin edges, judged by decoders that know the machine sheet alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from rm501_host.config import Config
from tests.support.arm_sheet import joints_from_motors, motors_from_joints, thesis_point, tip_mm
from tests.support.cell import CellRun, run_in_cell
from tests.support.pin_decoder import MOTORS, DecodedRun
from tests.support.waveform import Violation, check_bus, check_motor

pytestmark = pytest.mark.xdist_group("thesis")
PERIODS = 8
PROGRAM_POINTS = [
    (210, 0, -150),
    (0, 210, -150),
    (0, 340, -30),
    (0, 340, 30),
    (0, 340, -30),
    (0, 210, -150),
    (210, 0, -150),
    (290, 0, -30),
    (290, 0, 30),
]


def positions_by_frame(run: DecodedRun, first_steps: tuple[float, ...]) -> npt.NDArray[np.float64]:
    """Motor positions (frames, 5) in steps from decoded edges and the pose at power-up."""
    frames = run.periods // PERIODS
    made = np.zeros((frames, len(MOTORS)))
    for column, motor in enumerate(MOTORS):
        for period, sign in run.steps[motor]:
            made[period // PERIODS, column] += sign
    return np.array(first_steps) + np.cumsum(made, axis=0)


def test_the_run_is_within_every_limit_and_without_a_fault(thesis_run: CellRun) -> None:
    report = thesis_run.result.report
    assert report.result == "ok"
    assert report.faults == []
    assert 0.5 < report.limits.joint_acceleration_ratio <= 1.0 + 1e-6
    assert report.limits.joint_velocity_ratio <= 1.0 + 1e-6
    assert report.limits.motor_rate_ratio <= 1.0 + 1e-6
    assert report.tracking.max_step_error <= 0.1
    assert report.wire.retransmits == 0
    assert thesis_run.watched.phases[:2] == ["planning", "connecting"]
    assert thesis_run.watched.phases[-1] == "running"
    frames = thesis_run.watched.progress_frames
    assert frames == sorted(frames)


def test_every_programmed_point_is_passed_in_order_at_the_pins(thesis_run: CellRun, thesis_pins: DecodedRun) -> None:
    """G64 P0.5 may cut a corner by 0.5 mm; a step of a motor moves the tip by up to 0.25 mm."""
    positions = positions_by_frame(thesis_pins, motors_from_joints(thesis_run.first_truth.joint_deg))
    moved = np.flatnonzero(np.any(np.diff(positions, axis=0) != 0, axis=1)) + 1
    tips = np.array([tip_mm(joints_from_motors(tuple(row))) for row in positions[moved].tolist()])
    at = 0
    for point in PROGRAM_POINTS:
        target = np.array(tip_mm(thesis_point(*point)))
        distance_mm = np.linalg.norm(tips[at:] - target, axis=1)
        near = np.flatnonzero(distance_mm <= 0.5 + 0.25)
        assert near.size, f"after {at}: {point} is passed {distance_mm.min():.2f} mm away"
        at += int(near[0])
    assert np.abs(positions[-1] - np.array(motors_from_joints(thesis_point(290, 0, 30)))).max() <= 1.0


def test_with_exact_stops_every_line_ends_within_one_step_of_its_point(thesis: Config, tmp_path: Path) -> None:
    from tests.end_to_end.conftest import PROGRAM
    from tests.support.pin_decoder import decode

    exact = tmp_path / "exact.ngc"
    exact.write_text(PROGRAM.read_text().replace("G64 P0.5", "G61.1"))
    run = run_in_cell(exact, thesis)
    positions = positions_by_frame(decode(run.words.tolist()), motors_from_joints(run.first_truth.joint_deg))
    at = 0
    for point in PROGRAM_POINTS:
        distance = np.abs(positions[at:] - np.array(motors_from_joints(thesis_point(*point)))).max(axis=1)
        near = np.flatnonzero(distance <= 1.0)
        assert near.size, f"{point}: {distance.min():.2f} steps at best"
        at += int(near[0])
    assert near[-1] == len(distance) - 1


def test_no_pulse_breaks_a_timing_rule(thesis_run: CellRun, thesis_pins: DecodedRun) -> None:
    from tests.support.waveform import TimingRules

    found: list[Violation] = check_bus(thesis_run.words)
    for motor in MOTORS:
        assert len(thesis_pins.steps[motor]) > 1000, motor
        found += check_motor(motor, thesis_pins.latches[motor], TimingRules())
    assert found == []


def test_the_hand_strokes_after_arriving_and_before_leaving(thesis: Config, tmp_path: Path) -> None:
    """Without the G4 lines, from the pins alone: no arm step between the first and last power pulse."""
    from tests.end_to_end.conftest import PROGRAM
    from tests.support.pin_decoder import decode

    bare = tmp_path / "bare.ngc"
    bare.write_text("".join(line for line in PROGRAM.read_text().splitlines(True) if not line.startswith("G4 ")))
    run = run_in_cell(bare, thesis)
    pins = decode(run.words.tolist())
    pulses = np.array([period for period, _ in pins.hand_pulses])
    signs = [sign for _, sign in pins.hand_pulses]
    assert len(pulses) == 1600
    assert signs == [-1] * 800 + [1] * 800
    arm_steps = np.sort(np.array([period for motor in MOTORS for period, _ in pins.steps[motor]]))
    positions = positions_by_frame(pins, motors_from_joints(run.first_truth.joint_deg))
    for stroke, point in ((pulses[:800], (0, 340, 30)), (pulses[800:], (290, 0, 30))):
        inside = np.searchsorted(arm_steps, stroke[-1]) - np.searchsorted(arm_steps, stroke[0])
        assert inside == 0
        here = positions[stroke[0] // PERIODS]
        assert np.abs(here - np.array(motors_from_joints(thesis_point(*point)))).max() <= 1.0
        assert 0.63 <= (stroke[-1] - stroke[0]) * 40e-6 <= 0.65


def test_two_runs_are_the_same_to_the_byte(thesis: Config, thesis_run: CellRun) -> None:
    from dataclasses import replace

    from tests.end_to_end.conftest import PROGRAM

    again = run_in_cell(PROGRAM, thesis)
    assert again.wire == thesis_run.wire
    assert again.emulator.recording.pin_hash == thesis_run.emulator.recording.pin_hash
    assert replace(again.result.report, speed_ratio=0.0) == replace(thesis_run.result.report, speed_ratio=0.0)

"""M62 and M63 at the pins: the edge within a frame of the moment at which the arm passes the corner."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rm501_host.config import load_config
from rm501_protocol.board_config import output_bit
from tests.support.arm_sheet import joints_from_motors, motors_from_joints
from tests.support.cell import run_in_cell
from tests.support.pin_decoder import MOTORS, decode
from tests.support.plan_checker import tool_positions

ROOT = Path(__file__).parents[2]
PERIODS = 8
FRAME_S = 320e-6
CONFIGURED = 25_000
"""One second."""
PROGRAM = """G21 G90 G94 G64 P2 F3000
G0 X280 Y-60 Z200 A0 B0
G4 P0.2
G1 X340 Y-60
M62 P0
G1 X340 Y0
M63 P0
M62 P1
G1 X280 Y0
M2
"""
CORNERS = ((340.0, -60.0, 200.0), (340.0, 0.0, 200.0))


def edges(words: np.ndarray, port: int, pin: int) -> list[int]:
    """Base periods in which a pin changes, once the board has its configuration."""
    levels = (words >> output_bit(port, pin)) & 1
    return [int(at) + 1 for at in np.flatnonzero(np.diff(levels.astype(np.int8))) if at > CONFIGURED]


def test_edges_are_within_a_frame_of_the_corner_and_the_arm_does_not_stop(tmp_path: Path) -> None:
    text = f'extends = "{ROOT / "configs" / "rm501.toml"}"\n[board]\ndigital_outputs = ["0.1", "1.2"]\n'
    (tmp_path / "c.toml").write_text(text)
    config = load_config(tmp_path / "c.toml")
    (tmp_path / "x.ngc").write_text(PROGRAM)
    run = run_in_cell(tmp_path / "x.ngc", config)
    assert run.result.report.result == "ok"
    first, second = edges(run.words, 0, 1), edges(run.words, 1, 2)
    assert len(first) == 2, "on at the first corner, off at the second"
    assert len(second) == 1
    assert second[0] == first[1], "both at the same place: in the same base period"

    # which motion it is: the last one, and where its time 0 lies at the pins
    pins = decode(run.words.tolist())
    made = np.zeros((pins.periods // PERIODS, len(MOTORS)))
    for column, motor in enumerate(MOTORS):
        for period, sign in pins.steps[motor]:
            made[period // PERIODS, column] += sign
    positions = np.array(motors_from_joints(run.first_truth.joint_deg)) + np.cumsum(made, axis=0)
    # nothing but the counts at the pins: the tip where the edge is, against where the program has its corners
    for period, corner in zip(first, CORNERS, strict=True):
        joints = np.array([joints_from_motors(tuple(positions[period // PERIODS]))])
        tip = tool_positions(config, joints)[0]
        assert np.linalg.norm(tip - np.array(corner)) <= 2.0 + 0.5, "P and two steps"
        nearest = np.linalg.norm(
            tool_positions(config, np.array([joints_from_motors(tuple(p)) for p in positions[::20]])) - corner, axis=1
        )
        assert np.linalg.norm(tip - np.array(corner)) <= nearest.min() + 0.5
    # and the time between the two edges is that of the ideal law, to a frame
    piece = next(piece for piece in run.result.plan.pieces if len(piece.events) == 2)
    ideal = piece.events[1].offset_s - piece.events[0].offset_s
    assert abs((first[1] - first[0]) / PERIODS - ideal / FRAME_S) <= 1.0
    rates = np.abs(piece.qd_deg_s(np.array([event.offset_s for event in piece.events]))).max(axis=1)
    assert (rates > 0.5).all(), "the arm is moving there"


def test_a_change_before_every_short_line_fills_no_queue(tmp_path: Path) -> None:
    """300 changes 0.4 mm apart: more than the board's ring of events holds, in segments that could carry more."""
    text = f'extends = "{ROOT / "configs" / "rm501.toml"}"\n[board]\ndigital_outputs = ["0.1"]\n'
    (tmp_path / "c.toml").write_text(text)
    rows = ["G21 G90 G94 G64 P0.5 F3000", "G0 X280 Y-60 Z200 A0 B0"]
    for number in range(300):
        rows += [f"M{62 + number % 2} P0", f"G1 Y{-60 + 0.4 * (number + 1):.1f}"]
    (tmp_path / "x.ngc").write_text("\n".join([*rows, "M2", ""]))
    run = run_in_cell(tmp_path / "x.ngc", load_config(tmp_path / "c.toml"))
    assert run.result.report.result == "ok"
    assert run.result.report.faults == []
    assert len(edges(run.words, 0, 1)) == 300

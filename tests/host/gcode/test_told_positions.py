"""Arcs, splines and feeds begin where the arm stands, also where no block says so: at the start, after joint moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rm501_host import moves as mv
from rm501_host.config import load_config
from rm501_host.gcode.motion import swept_angle
from rm501_host.kinematics import Arm
from rm501_host.program import read_moves

ARM = Arm.from_config(load_config())
START_DEG = (20.0, 45.0, -60.0, 40.0, 10.0)


def moves_of(tmp_path: Path, text: str) -> list[object]:
    """The moves of a text, the joints following its joint moves alone."""
    program = tmp_path / "p.ngc"
    program.write_text(text)
    q_deg = list(START_DEG)
    found: list[object] = []
    for move in read_moves(program, ARM, lambda: q_deg):
        if isinstance(move, mv.JointMove):
            q_deg[move.joint] = move.angle_deg
        found.append(move)
    return found


@pytest.mark.parametrize("before", ["", "M110 P1 Q-30\n", "M110 P2 Q60\nG91\n", "G54 G10 L2 P1 X5 Y-3 R30\n"])
@pytest.mark.parametrize("plane", ["G17 G2 I10 J5", "G18 G3 I10 K-5", "G19 G2 J10 K5"])
def test_a_full_circle_is_full_from_wherever_the_arm_stands(tmp_path: Path, before: str, plane: str) -> None:
    (arc,) = [m for m in moves_of(tmp_path, f"F100\n{before}{plane}\nM2\n") if isinstance(m, mv.ArcMove)]
    assert abs(arc.angle_deg) == pytest.approx(360.0, abs=1e-9)
    radius = np.linalg.norm(np.array(arc.target[:3]) - np.array(arc.centre_mm))
    assert radius == pytest.approx(np.hypot(10.0, 5.0), abs=1e-9)


def test_a_spline_starts_at_the_height_of_the_arm(tmp_path: Path) -> None:
    text = "M110 P2 Q60\nF100 G91\nG5 I1 J1 P-1 Q1 X10 Y0\nM2\n"
    (spline,) = [m for m in moves_of(tmp_path, text) if isinstance(m, mv.SplineMove)]
    here = ARM.fk((20.0, 60.0, -60.0, 40.0, 10.0)).xyz_mm
    np.testing.assert_allclose(spline.control_points_mm[0], here, atol=1e-9)
    np.testing.assert_allclose([point[2] for point in spline.control_points_mm], here[2], atol=1e-9)


def test_degrees_know_no_inch_after_a_joint_move(tmp_path: Path) -> None:
    (turn,) = [m for m in moves_of(tmp_path, "G20 F10\nM110 P1 Q0\nG91 G1 B5\nM2\n") if isinstance(m, mv.LinearMove)]
    assert turn.feed == mv.Feed(10.0)


def test_degrees_know_no_inch_though_inches_are_rounded(tmp_path: Path) -> None:
    moves = moves_of(tmp_path, "G21 F300\nG91 G1 X0.1 Y0.3 Z0.7\nG20 F10\nG1 B5\nG1 X1\nM2\n")
    assert [m.feed.value for m in moves if isinstance(m, mv.LinearMove)] == [300.0, 10.0, pytest.approx(254.0)]


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_equal_ends_make_a_full_turn_whatever_the_rounding(clockwise: bool, side: float) -> None:
    for first in (-1e-14, 0.0, 1e-14):
        for last in (-1e-14, 0.0, 1e-14):
            angle = swept_angle((-10.0 * side, first), (-10.0 * side, last), (0.0, 0.0), -1 if clockwise else 1)
            assert angle == pytest.approx(-2 * np.pi if clockwise else 2 * np.pi, abs=1e-12)

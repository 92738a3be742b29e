"""Paths past full stretch, past, to and through the waist axis, and across the elbow's limit, as a user writes them.

The judge looks at law, path and segments; the preflight has to say the same as the planner, before anything moves.
"""

from __future__ import annotations

from math import cos, hypot, pi, sin, sqrt
from pathlib import Path

import msgspec
import numpy as np
import pytest

from rm501_host.config import Config, load_config
from rm501_host.kinematics import Arm
from rm501_host.preflight import FindingKind
from tests.support.judge_text import Judgement, judge_program, preflight

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
STRETCH_MM = 465.0
"""a2 + a3 + d5, the tool level with the shoulder."""
GAPS_MM = [5.0, 1.0, 0.1, 0.001]
OVER_DEG = (0.0, 92.0, -8.0, 90.0, 0.0)
"""The tool nearly above the shoulder."""
OVER = ARM.fk(OVER_DEG)
Z, PITCH = float(OVER.xyz_mm[2]), float(OVER.pitch_deg)
Joints = tuple[float, ...]


def joints(x: float, y: float, z: float, pitch: float, seed: Joints | None = None) -> Joints:
    best = ARM.ik((x, y, z), pitch, 0.0, seed).best
    assert best is not None
    return best.q_deg


def judge(tmp_path: Path, start: Joints, *blocks: str, config: Config = CONFIG) -> Judgement:
    """Plan and judge; the preflight must agree."""
    program = tmp_path / "p.ngc"
    program.write_text("\n".join(("G21 G90 G94 F6000", *blocks, "M2", "")))
    found = judge_program(config, program, start)
    report = preflight(config, program, start)
    assert report.ok == (found.refused is None), (found.refused, report.errors)
    if found.refused is None:
        assert found.law is not None
        assert found.wrongs == []
    else:
        assert found.refused.source is not None and found.refused.remedy
        assert report.errors[0].source.line == found.refused.source.line
    return found


def motion_s(found: Judgement) -> float:
    assert found.plan is not None, found.refused
    return found.plan.motion_s


def chord(gap_mm: float) -> tuple[Joints, str]:
    """60 mm to either side, both ends `gap_mm` from full stretch."""
    x = sqrt((STRETCH_MM - gap_mm) ** 2 - 60.0**2)
    return joints(x, -60, 230, 90), f"G1 X{x:.9f} Y60 Z230 A90 B0"


def past_axis(gap_mm: float) -> tuple[Joints, str]:
    """A line 60 mm long that passes the waist axis at `gap_mm`, over the shoulder."""
    start = joints(gap_mm, -30, Z, PITCH, (-90.0, *OVER_DEG[1:]))
    return start, f"G1 X{gap_mm:.12f} Y30 Z{Z:.12f} A{PITCH:.12f} B0"


def arc_past_axis(gap_mm: float) -> tuple[Joints, str]:
    radius = 20.0 - gap_mm
    start = joints(20.0, -radius, Z, PITCH, (-45.0, *OVER_DEG[1:]))
    return start, f"G2 X20 Y{radius:.12f} Z{Z:.12f} A{PITCH:.12f} B0 I0 J{radius:.12f}"


def arc_at_stretch(gap_mm: float) -> tuple[Joints, str]:
    radius = STRETCH_MM - gap_mm
    end = f"X{radius * cos(0.5):.9f} Y{radius * sin(0.5):.9f}"
    return joints(radius, 0, 230, 90), f"G3 {end} Z230 A90 B0 I{-radius:.9f} J0"


@pytest.mark.parametrize(
    ("way", "mode"),
    [(chord, "G64 P1"), (past_axis, "G61.1"), (arc_past_axis, "G64 P1"), (arc_at_stretch, "G61.1")],
)
def test_near_a_singularity_it_is_legal_and_the_nearer_the_slower(tmp_path: Path, way, mode: str) -> None:  # type: ignore[no-untyped-def]
    times = []
    for gap_mm in GAPS_MM:
        start, block = way(gap_mm)
        back = "G1 X300 Y0 Z300 A45" if mode == "G64 P1" and way in (chord, arc_at_stretch) else ""
        times.append(motion_s(judge(tmp_path, start, mode, block, back)))
    assert times == sorted(times)


@pytest.mark.parametrize("gap_mm", GAPS_MM)
def test_a_line_up_past_full_stretch(tmp_path: Path, gap_mm: float) -> None:
    """To a point `gap_mm` from the stretched arm, and on at an angle that bends the elbow again."""
    wrist = 370.0 - gap_mm
    low = sqrt(370.0**2 - 60.0**2) - 2.0
    found = judge(
        tmp_path, joints(95 + low, 0, 170, 90), "G61.1", f"G1 X{95 + wrist:.9f} Y0 Z230 A90 B0", f"G1 X{95 + low} Z290"
    )
    assert motion_s(found) > 2.0


@pytest.mark.parametrize("gap_mm", [1e-6, 0.0])
@pytest.mark.parametrize(("way", "mode"), [(past_axis, "G64 P1"), (arc_past_axis, "G61.1")])
def test_through_the_waist_axis_is_refused_by_planner_and_preflight(
    tmp_path: Path,
    way,  # type: ignore[no-untyped-def]
    gap_mm: float,
    mode: str,
) -> None:
    start, block = way(gap_mm)
    found = judge(tmp_path, start, mode, block)
    assert found.refused is not None and "singularity" in str(found.refused)
    report = preflight(CONFIG, tmp_path / "p.ngc", start)
    (error,) = report.errors
    assert error.kind is FindingKind.SINGULARITY
    half = 30.0 if way is past_axis else 0.5 * pi * (20.0 - gap_mm)
    assert error.place_mm == pytest.approx(half, abs=1.0)


def test_to_the_waist_axis_and_beyond_it_is_refused(tmp_path: Path) -> None:
    """Along a radius no joint would have to jump, but behind the axis is another branch of the arm."""
    start, _ = past_axis(0.0)
    assert judge(tmp_path, start, f"G1 X0 Y0 Z{Z:.12f} A{PITCH:.12f}").refused is not None
    behind = judge(tmp_path, OVER_DEG, f"G1 X-{OVER.xyz_mm[0] / 4:.6f} Y0 Z{Z:.12f} A{PITCH:.12f} B0")
    assert behind.refused is not None and "another branch" in str(behind.refused)


@pytest.mark.parametrize("beyond_mm", [0.001, 1.0])
def test_beyond_reach_is_refused_with_the_distance_missing(tmp_path: Path, beyond_mm: float) -> None:
    x = STRETCH_MM + beyond_mm
    for start, block in (
        (joints(400, 0, 230, 90), f"G1 X{x} Y0 Z230 A90"),
        (joints(400, 0, 230, 90), f"G3 X0 Y{x} Z230 A90 R{0.5 * hypot(x, x) + 60}"),
        (joints(400, 0, 230, 90), f"G0 X{x} Y0 Z230 A90"),
    ):
        found = judge(tmp_path, start, "G61.1", block)
        assert found.refused is not None
        assert found.refused.amount == pytest.approx(beyond_mm, abs=2e-6)
        (error,) = preflight(CONFIG, tmp_path / "p.ngc", start).errors
        assert error.amount == pytest.approx(beyond_mm, abs=2e-6)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("mode", ["G61.1", "G64 P20"])
def test_a_rapid_whose_chord_crosses_the_elbows_limit(tmp_path: Path, linear: bool, mode: str) -> None:
    """Taken in joint space, or refused where rapids are lines of the tool (LinuxCNC overshoots the limit by 20 deg)."""
    planner = msgspec.structs.replace(CONFIG.planner, linear_rapids=linear)
    config = msgspec.structs.replace(CONFIG, planner=planner)
    for start, block in (
        (joints(300, 0, 200, 0), "G0 X0 Y-300 Z200 A0 B0"),
        (ARM.home_deg, "G0 X210 Y0 Z310 A0 B0"),
    ):
        found = judge(tmp_path, start, mode, block, "G91 G1 Z2", config=config)
        assert (found.refused is not None) is linear
        if found.plan is not None:
            assert np.all(found.plan.sample().q_deg[:, 2] >= -90.01 - 1e-6)
        else:
            assert found.refused is not None and "elbow" in str(found.refused)

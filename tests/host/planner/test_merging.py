"""G64 Q: near-collinear lines become one, within the tolerance."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.planner import Plan, Planner
from rm501_host.planner.law import PathLaw
from tests.host.planner.programs import lines, mode
from tests.support.plan_checker import judge_samples, path_deviation_mm, programmed_points

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)


def planned(points: list[tuple[float, ...]], blend_mm: float, merge_mm: float | None) -> tuple[Plan, int]:
    start = ARM.ik(points[0][:3], 0.0, 0.0).best
    assert start is not None
    moves = [mode(blend_mm, merge_mm=merge_mm), *lines(points[1:], 12000.0)]
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan(moves))
    samples = plan.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    path = programmed_points(np.array(points[0]), moves)
    assert path_deviation_mm(samples.tcp_mm, path) <= blend_mm + 1e-6
    np.testing.assert_allclose(samples.tcp_mm[-1], points[-1][:3], atol=1e-6)
    elements = sum(1 for piece in plan.pieces if isinstance(piece.law, PathLaw) for _ in np.unique(piece.law.element))
    return plan, elements


def test_a_noisy_line_becomes_one() -> None:
    rng = np.random.default_rng(2)
    points = [(300.0 + float(rng.uniform(-0.02, 0.02)), -40.0 + 0.4 * i, 200.0) for i in range(200)]
    noisy, many = planned(points, 0.2, None)
    smooth, few = planned(points, 0.2, 0.1)
    assert few == 1
    assert many > 100
    assert smooth.motion_s < noisy.motion_s


def test_a_curve_is_merged_into_chords_within_the_tolerance() -> None:
    points = [(300 + 30 * cos(a), 30 * sin(a), 200.0) for a in np.linspace(0, 3, 400)]
    _, few = planned(points, 0.2, 0.05)
    _, many = planned(points, 0.2, None)
    assert 5 < few < many / 4


def test_a_corner_is_not_merged_away() -> None:
    points = [(300.0, 0.0, 200.0), (300.0, 20.0, 200.0), (320.0, 20.0, 200.0)]
    _, count = planned(points, 0.5, 0.2)
    # two lines and the blend between them
    assert count == 3

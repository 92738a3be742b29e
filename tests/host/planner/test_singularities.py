"""Lines and arcs past full stretch and past the waist axis: legal, slower near it, refused where they must be."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import ArcMove, Feed, LinearMove, Move, RapidMove
from rm501_host.planner import JointLimitError, Plan, PlanError, Planner, UnreachableError
from tests.host.planner.programs import at, target
from tests.support.plan_checker import judge_samples

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
REACH_MM = 465.0
"""a2 + a3 + d5 with the tool level with the shoulder."""
FEED = Feed(6000.0)


def planned(start: tuple[float, ...], move: Move) -> Plan:
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start).plan([move]))
    samples = plan.sample()
    judged = judge_samples(CONFIG, samples.t_s, samples.q_deg)
    assert judged.worst <= 1.0 + 1e-6
    assert judged.lowest_margin_deg >= -1e-6
    assert plan.limits(samples).worst <= 1.0 + 1e-6
    return plan


def joints(x: float, y: float, z: float, pitch: float, seed: tuple[float, ...] | None = None) -> tuple[float, ...]:
    best = ARM.ik((x, y, z), pitch, 0.0, seed).best
    assert best is not None
    return best.q_deg


@pytest.mark.parametrize("gap_mm", [5.0, 1.0, 0.1, 0.001])
def test_a_line_to_nearly_full_stretch(gap_mm: float) -> None:
    plan = planned(joints(400, 0, 230, 90), LinearMove(target(REACH_MM - gap_mm, 0, 230, 90), FEED, at(1)))
    samples = plan.sample()
    np.testing.assert_allclose(samples.tcp_mm[-1], (REACH_MM - gap_mm, 0, 230), atol=1e-6)


@pytest.mark.parametrize("gap_mm", [5.0, 1.0, 0.1, 0.001])
def test_a_chord_whose_ends_nearly_stretch_the_arm(gap_mm: float) -> None:
    x = sqrt((REACH_MM - gap_mm) ** 2 - 60.0**2)
    plan = planned(joints(x, -60, 230, 90), LinearMove(target(x, 60, 230, 90), FEED, at(1)))
    assert plan.motion_s > 120.0 / 100.0


def test_the_nearer_to_full_stretch_the_slower() -> None:
    times = []
    for gap_mm in (5.0, 1.0, 0.1, 0.001):
        x = sqrt((REACH_MM - gap_mm) ** 2 - 60.0**2)
        times.append(planned(joints(x, -60, 230, 90), LinearMove(target(x, 60, 230, 90), FEED, at(1))).motion_s)
    assert times == sorted(times)


@pytest.mark.parametrize("gap_mm", [5.0, 1.0, 0.1, 0.001])
def test_an_arc_at_nearly_full_stretch(gap_mm: float) -> None:
    radius = REACH_MM - gap_mm
    start, end = (radius, 0.0), (radius * np.cos(0.5), radius * np.sin(0.5))
    move = ArcMove(target(end[0], end[1], 230, 90), (0, 0, 230), (0, 0, 1), float(np.degrees(0.5)), FEED, at(1))
    planned(joints(start[0], start[1], 230, 90), move)


@pytest.mark.parametrize("gap_mm", [5.0, 1.0, 0.1, 0.001])
def test_a_line_past_the_waist_axis_slows_down(gap_mm: float) -> None:
    over = (0.0, 92.0, -8.0, 90.0, 0.0)
    z = float(ARM.fk(over).xyz_mm[2])
    pitch = ARM.fk(over).pitch_deg
    start = joints(gap_mm, -30, z, pitch, (-90.0, *over[1:]))
    plan = planned(start, LinearMove(target(gap_mm, 30, z, pitch), FEED, at(1)))
    samples = plan.sample()
    speed = np.linalg.norm(np.diff(samples.tcp_mm, axis=0), axis=1) / 1e-3
    nearest = int(np.argmin(np.abs(samples.tcp_mm[:-1, 1])))
    # on the axis the waist alone decides: its 30 deg/s times the distance
    assert speed[nearest] <= np.radians(30.0) * gap_mm * 1.01 + 0.6
    assert speed.max() > 30.0


def test_a_line_through_the_waist_axis_is_refused() -> None:
    over = (0.0, 92.0, -8.0, 90.0, 0.0)
    z, pitch = float(ARM.fk(over).xyz_mm[2]), ARM.fk(over).pitch_deg
    start = joints(0, -30, z, pitch, (-90.0, *over[1:]))
    with pytest.raises(PlanError, match="singularity") as caught:
        planned(start, LinearMove(target(0, 30, z, pitch), FEED, at(3)))
    assert caught.value.source == at(3)
    assert caught.value.place_mm == pytest.approx(30.0, abs=0.2)
    assert caught.value.remedy


@pytest.mark.parametrize("beyond_mm", [0.001, 1.0, 35.0])
def test_beyond_reach_is_refused_with_the_distance_missing(beyond_mm: float) -> None:
    planner = Planner(ARM, CONFIG, joints(400, 0, 230, 90))
    move = LinearMove(target(REACH_MM + beyond_mm, 0, 230, 90), FEED, at(7))
    with pytest.raises(UnreachableError) as caught:
        list(planner.plan([move]))
    assert caught.value.amount == pytest.approx(beyond_mm, abs=1e-6)
    assert caught.value.source == at(7)


def test_a_line_that_leaves_the_elbows_range_on_the_way_is_refused_and_a_rapid_is_not() -> None:
    """Both ends are inside the limits; the chord is not (LinuxCNC overshoots by 20 deg)."""
    start = joints(0, -300, 200, 0)
    goal = target(-200, -250, 200, 0)
    rapid = planned(start, RapidMove(goal, at(1)))
    np.testing.assert_allclose(rapid.sample().tcp_mm[-1], goal[:3], atol=1e-6)
    # from home, the straight line to the neutral pose leaves the elbow's limit at once
    home_to_neutral = LinearMove(target(210, 0, 310, 0), FEED, at(4))
    with pytest.raises(JointLimitError) as caught:
        list(Planner(ARM, CONFIG, ARM.home_deg).plan([home_to_neutral]))
    assert caught.value.amount is not None and caught.value.amount > 0.1
    planned(ARM.home_deg, RapidMove(home_to_neutral.target, at(1)))

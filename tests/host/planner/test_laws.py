"""Jerk-limited laws, timed trajectories, running back, textbook profiles."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.planner import (
    JointLimitError,
    Plan,
    PlanError,
    Planner,
    cubic,
    fastest_lspb,
    lspb,
    plan_run_back,
    plan_timed,
    quintic,
    via_spline,
)
from rm501_host.segmenter import Segmenter
from rm501_host.segmenter.fit import to_q48
from tests.host.planner.programs import PICK_START_DEG, pick_and_place
from tests.support.plan_checker import judge_samples, path_deviation_mm, play_segments, programmed_points

CONFIG = load_config()
SOFT = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
ARM = Arm.from_config(CONFIG)
JERK = np.array([joint.max_jerk_deg_s3 for joint in CONFIG.joints.ordered])
START = (0.0, 50.0, -40.0, 90.0, 0.0)


@pytest.mark.parametrize(("feed", "blend"), [(2800.0, None), (2800.0, 5.0), (6000.0, 5.0)])
def test_the_jerk_limited_mode_keeps_the_jerk_and_everything_else(feed: float, blend: float | None) -> None:
    moves = pick_and_place(feed, blend)
    plan = Plan(ARM, SOFT, Planner(ARM, SOFT, PICK_START_DEG).plan(moves))
    samples = plan.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    jerks = np.abs(np.diff(samples.q_deg, 3, axis=0))[:-1] / 1e-9
    assert (jerks / JERK).max() <= 1.0 + 1e-3
    path = programmed_points(samples.tcp_mm[0], moves)
    assert path_deviation_mm(samples.tcp_mm, path) <= (blend or 0.0) + 1e-5
    hard = Plan(ARM, CONFIG, Planner(ARM, CONFIG, PICK_START_DEG).plan(moves))
    assert plan.motion_s >= hard.motion_s
    hard_samples = hard.sample()
    assert (np.abs(np.diff(hard_samples.q_deg, 3, axis=0))[:-1] / 1e-9 / JERK).max() > 10.0


def test_segments_follow_a_jerk_limited_law() -> None:
    plan = Plan(ARM, SOFT, Planner(ARM, SOFT, PICK_START_DEG).plan(pick_and_place(6000.0, 5.0)))
    positions = [*map(to_q48, ARM.motors_from_joints(PICK_START_DEG).tolist()), 0]
    planned = list(Segmenter(SOFT, positions, 0).segments(plan.pieces))
    played = play_segments(SOFT, planned, plan.pieces)
    assert played.largest_error_steps <= 0.1
    assert played.worst <= 1.02


def test_a_timed_trajectory_is_played_through_its_points() -> None:
    times = [0.0, 2.0, 4.0, 6.0]
    points = np.array(
        [START, (5.0, 52.0, -42.0, 92.0, 3.0), (9.0, 50.0, -45.0, 95.0, 9.0), (10.0, 49.0, -45.0, 96.0, 8.0)]
    )
    (piece,) = plan_timed(ARM, CONFIG, START, points, times)
    scale = piece.duration_s / 6.0
    np.testing.assert_allclose(piece.q_deg(np.array(times) * scale), points, atol=1e-9)
    t = np.arange(0.0, piece.duration_s, 1e-3)
    assert judge_samples(CONFIG, t, piece.q_deg(t)).worst <= 1.0 + 1e-6
    positions = [*map(to_q48, ARM.motors_from_joints(START).tolist()), 0]
    played = play_segments(CONFIG, list(Segmenter(CONFIG, positions, 0).segments([piece])), [piece])
    assert played.largest_error_steps <= 0.1


def test_an_illegal_trajectory_is_refused_or_stretched() -> None:
    points = [START, (0.0, 70.0, -40.0, 90.0, 0.0)]
    with pytest.raises(PlanError, match="stretch its times by") as caught:
        plan_timed(ARM, CONFIG, START, points, [0.0, 1.0])
    # a rest-to-rest cubic over 20 deg in 1 s accelerates at 6 * 20 = 120 deg/s2, six times the limit
    assert caught.value.amount == pytest.approx(6.0, rel=1e-6)
    (piece,) = plan_timed(ARM, CONFIG, START, points, [0.0, 1.0], stretch=True)
    assert piece.duration_s == pytest.approx(np.sqrt(6.0), rel=1e-3)
    with pytest.raises(JointLimitError):
        plan_timed(ARM, CONFIG, START, [START, (0.0, 101.0, -40.0, 90.0, 0.0)], [0.0, 60.0])
    with pytest.raises(PlanError, match="away from where the arm is"):
        plan_timed(ARM, CONFIG, START, [(1.0, *START[1:]), START], [0.0, 5.0])
    with pytest.raises(PlanError, match="must rise"):
        plan_timed(ARM, CONFIG, START, [START, START, START], [0.0, 2.0, 2.0])


@pytest.mark.parametrize("stopped_s", [3.0, 9.7, 16.0])
def test_running_back_retraces_the_path(stopped_s: float) -> None:
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, PICK_START_DEG).plan(pick_and_place(2800.0, 5.0)))
    back = plan_run_back(CONFIG, plan.pieces, stopped_s, 30.0)
    samples = plan.sample()
    here = samples.q_deg[round(stopped_s * 1000)]
    np.testing.assert_allclose(back[0].q_deg(np.zeros(1))[0], here, atol=1e-6)
    np.testing.assert_allclose(back[-1].rest_deg, PICK_START_DEG, atol=1e-6)
    retraced = Plan(ARM, CONFIG, back).sample()
    assert judge_samples(CONFIG, retraced.t_s, retraced.q_deg).worst <= 1.0 + 1e-6
    assert path_deviation_mm(retraced.tcp_mm, samples.tcp_mm[: round(stopped_s * 1000) + 2]) <= 2e-3


def test_cubic_and_quintic_meet_their_ends() -> None:
    t = np.array((0.0, 3.0))
    p = cubic(10.0, 25.0, 3.0, 2.0, -1.0)
    np.testing.assert_allclose(p.evaluate(t), (10.0, 25.0), atol=1e-12)
    np.testing.assert_allclose(p.evaluate(t, 1), (2.0, -1.0), atol=1e-12)
    p = quintic(10.0, 25.0, 3.0, 2.0, -1.0, 0.5, -4.0)
    for order, ends in enumerate(((10.0, 25.0), (2.0, -1.0), (0.5, -4.0))):
        np.testing.assert_allclose(p.evaluate(t, order), ends, atol=1e-10)


def test_lspb_is_continuous_and_the_fastest_one_uses_both_limits() -> None:
    p = lspb(5.0, 45.0, 4.0, 15.0)
    t = np.linspace(0.0, 4.0, 4001)
    np.testing.assert_allclose(np.gradient(p.evaluate(t), t)[1:-1], p.evaluate(t, 1)[1:-1], atol=0.02)
    assert np.abs(np.diff(p.evaluate(t, 1))).max() < 0.02
    np.testing.assert_allclose(p.evaluate(t[[0, -1]]), (5.0, 45.0), atol=1e-9)
    with pytest.raises(ValueError, match="give 10 or more"):
        lspb(5.0, 45.0, 4.0, 9.0)
    fast = fastest_lspb(0.0, -60.0, 30.0, 20.0)
    assert fast.duration_s == pytest.approx(60.0 / 30.0 + 30.0 / 20.0)
    assert fast.evaluate(np.linspace(0, fast.duration_s, 999), 1).min() == pytest.approx(-30.0)


def test_a_via_spline_has_continuous_accelerations() -> None:
    times = [0.0, 1.0, 2.5, 3.0, 5.0]
    p = via_spline([0.0, 10.0, -5.0, 4.0, 4.0], times)
    np.testing.assert_allclose(p.evaluate(np.array(times)), [0.0, 10.0, -5.0, 4.0, 4.0], atol=1e-12)
    for t in times[1:-1]:
        before, after = p.evaluate(np.array((t - 1e-9, t + 1e-9)), 2)
        assert before == pytest.approx(after, abs=1e-4)

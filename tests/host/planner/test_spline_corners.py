"""Splines with corners inside: each is a stop or a blend, as between any two moves."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, event, given, settings
from hypothesis import strategies as st

from rm501_host.config import Config, load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, FeedMode, Move, PathMode, PathModeChange, SplineMove
from rm501_host.planner import Plan, PlanError, Planner
from rm501_host.planner.splines import SplineCurve
from tests.host.planner.programs import at, lines, mode, target
from tests.support.plan_checker import judge_samples, path_deviation_mm

CONFIG = load_config()
SOFT = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
ARM = Arm.from_config(CONFIG)
CORNER = np.array((300.0, 0.0, 150.0))
KINKED = ((0, 0), (10, 0), (20, 0), (20, 10), (20, 20))
"""Quadratic with a double knot at (20, 0): a right angle there."""
KINKED_KNOTS = (0.0, 0, 0, 1, 1, 2, 2, 2)


def spline(points: tuple[tuple[float, float], ...], knots: tuple[float, ...], degree: int, feed: Feed) -> SplineMove:
    places = tuple((300.0 + x, float(y), 150.0) for x, y in points)
    return SplineMove(target(*places[-1]), places, (1.0,) * len(points), knots, degree, feed, at(3))


def kinked(feed: Feed | None = None) -> SplineMove:
    return spline(KINKED, KINKED_KNOTS, 2, feed or Feed(6000.0))


def planned(moves: list[Move], config: Config = CONFIG) -> Plan:
    start = ARM.ik(tuple(CORNER.tolist()), 0.0, 0.0).best
    assert start is not None
    return Plan(ARM, config, Planner(ARM, config, start.q_deg).plan(moves))


def dense(move: SplineMove, count: int = 100_001) -> np.ndarray:
    """Points of the curve by scipy's B-splines (homogeneous)."""
    from scipy.interpolate import BSpline

    weights = np.array(move.weights)[:, None]
    poles = np.concatenate((np.array(move.control_points_mm) * weights, weights), axis=1)
    knots = np.array(move.knots, dtype=float)
    u = np.linspace(knots[move.degree], knots[-move.degree - 1], count)
    values = BSpline(knots, poles, move.degree)(u)
    return np.asarray(values[:, :3] / values[:, 3:])


@pytest.mark.parametrize("config", [CONFIG, SOFT], ids=["fast", "soft"])
def test_an_inner_corner_is_a_stop_in_exact_path_mode(config: Config) -> None:
    exact = PathModeChange(PathMode.EXACT_PATH, None, None, at(1))
    plan = planned([exact, kinked()], config)
    assert [piece.ends_at_rest for piece in plan.pieces] == [True, True]
    np.testing.assert_allclose(ARM.fk(plan.pieces[0].rest_deg).xyz_mm, CORNER + np.array((20.0, 0.0, 0.0)), atol=1e-6)
    two = planned([exact, *lines([(320, 0, 150), (320, 20, 150)], 6000.0)], config)
    # both halves are straight lines here
    assert plan.motion_s == pytest.approx(two.motion_s, rel=2e-3)
    samples = plan.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    assert path_deviation_mm(samples.tcp_mm, dense(kinked())) < 1e-6


def test_an_inner_corner_is_blended_within_the_tolerance() -> None:
    plan = planned([mode(1.0), kinked()])
    assert len(plan.pieces) == 1
    samples = plan.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    assert 0.3 < path_deviation_mm(samples.tcp_mm, dense(kinked())) <= 1.0 + 1e-6


def test_inverse_time_is_the_time_of_the_whole_curve() -> None:
    exact = PathModeChange(PathMode.EXACT_PATH, None, None, at(1))
    plan = planned([exact, kinked(Feed(2.0, FeedMode.INVERSE_TIME))])
    # 1/2 min, plus a second or less for two starts and stops
    assert 30.0 <= plan.motion_s < 31.5


def test_a_polygon_given_as_a_spline_of_degree_1_is_the_polygon() -> None:
    move = spline(((0, 0), (30, 0), (30, 30)), (0.0, 0, 1, 2, 2), 1, Feed(6000.0))
    for blend in (None, 2.0):
        plan = planned([mode(blend), move])
        other = planned([mode(blend), *lines([(330, 0, 150), (330, 30, 150)], 6000.0)])
        assert plan.motion_s == pytest.approx(other.motion_s, rel=0.02)
        assert len(plan.pieces) == len(other.pieces)


@pytest.mark.parametrize(
    ("points", "knots", "degree", "parts"),
    [
        (((0, 0), (30, 30), (0, 30), (30, 0)), (0.0, 0, 0, 0, 1, 1, 1, 1), 3, 2),  # a cusp in the middle
        (
            ((0, 0), (10, 0), (10, 0), (10, 0), (10, 20), (0, 20)),
            (0.0, 0, 0, 0, 1, 2, 3, 3, 3, 3),
            3,
            0,
        ),  # triple point
        (((0, 0), (0, 0), (20, 10), (30, 0)), (0.0, 0, 0, 0, 1, 1, 1, 1), 3, 1),  # coincident at the start
        (((0, 0), (10, 20), (30, 20), (40, -20)), (0.0, 0, 0, 1, 2, 2, 2), 2, 2),  # curvature jumps
        (((0, 0), (10, 20), (30, 20), (40, 0)), (0.0, 0, 0, 0, 2, 2, 2, 2), 3, 1),  # smooth
    ],
    ids=["cusp", "triple", "start", "jump", "smooth"],
)
@pytest.mark.parametrize("config", [CONFIG, SOFT], ids=["fast", "soft"])
def test_awkward_curves_are_cut_where_needed_and_legal(
    points: tuple[tuple[float, float], ...], knots: tuple[float, ...], degree: int, parts: int, config: Config
) -> None:
    move = spline(points, knots, degree, Feed(6000.0))
    curve = SplineCurve(np.array(move.control_points_mm), move.weights, move.knots, degree, (0.0, 0.0))
    found = curve.smooth_parts()
    assert len(found) == parts or (not parts and len(found) > 1)
    assert sum(part.length_mm for part in found) == pytest.approx(curve.length_mm, rel=1e-9)
    for one, two in pairwise(found):
        np.testing.assert_allclose(one.evaluate(np.array([one.length_mm]))[0], two.evaluate(np.zeros(1))[0], atol=1e-9)
    for tolerance in (None, 0.5):
        try:
            plan = planned([mode(tolerance), move], config)
        except PlanError as error:
            # a curvature without bound, where control points coincide at an end: refused, not broken
            assert "singular" in str(error) or "bends too sharply" in str(error)
            continue
        samples = plan.sample()
        assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
        assert path_deviation_mm(samples.tcp_mm, dense(move)) <= (tolerance or 0.0) + 1e-5


@st.composite
def random_splines(draw: st.DrawFn) -> SplineMove:
    """Degrees 1 to 3, 3 to 7 points, some of them and some knots repeated."""
    degree = draw(st.integers(1, 3))
    count = draw(st.integers(degree + 1, 7))
    points = [(0.0, 0.0)]
    while len(points) < count:
        if len(points) > 1 and draw(st.integers(0, 5)) == 0:
            points.append(points[-1])
        else:
            points.append((draw(st.floats(-25, 25)), draw(st.floats(-25, 25))))
    inner: list[float] = []
    while len(inner) < count - degree - 1:
        step = draw(st.sampled_from([0.0, 1.0, 1.0, 0.3]))
        value = (inner[-1] if inner else 0.0) + (step if inner else 1.0)
        if inner.count(value) < degree:
            inner.append(value)
    last = (inner[-1] if inner else 0.0) + 1.0
    knots = (0.0,) * (degree + 1) + tuple(inner) + (last,) * (degree + 1)
    move = spline(tuple(points), knots, degree, Feed(6000.0))
    return replace(move, weights=tuple(draw(st.floats(0.3, 3.0)) for _ in points))


@settings(
    max_examples=10,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
@given(random_splines(), st.sampled_from([None, 0.3, 3.0]))
def test_random_curves_are_legal_and_within_the_tolerance(move: SplineMove, tolerance_mm: float | None) -> None:
    try:
        plan = planned([mode(tolerance_mm), move])
    except PlanError as error:
        event(f"refused: {str(error)[:40]}")
        return
    event("planned")
    if plan.duration_s < 0.004:
        return
    samples = plan.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    # the judge's vertices are a few um apart, and where the curve crosses itself it may look at the other branch
    assert path_deviation_mm(samples.tcp_mm, dense(move)) <= (tolerance_mm or 0.0) + 5e-3

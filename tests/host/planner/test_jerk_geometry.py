"""Runs of short lines with the jerk limit: points are evened within their share, and touching blends bend alike."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, LinearMove, Move, PathMode
from rm501_host.planner import Plan, Planner
from rm501_host.planner.bends import TouchingBlend, joined
from rm501_host.planner.corners import CornerMaker
from rm501_host.planner.elements import Element, Space, line
from rm501_host.planner.limits import Limits
from rm501_host.planner.smoothing import LineSmoother
from tests.host.planner.programs import at, mode, target
from tests.support.plan_checker import path_deviation_mm, programmed_points

CONFIG = load_config()
SOFT = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
ARM = Arm.from_config(CONFIG)


def ring(count: int, size_mm: float, digits: int, radius_mm: float = 20.0) -> np.ndarray:
    """Points of a circle about (300, 0), rounded."""
    angles = np.arange(count + 1) * size_mm / radius_mm
    xy = np.stack((300.0 + radius_mm * np.cos(angles), radius_mm * np.sin(angles)), axis=1)
    return np.concatenate((xy.round(digits), np.full((count + 1, 1), 150.0), np.zeros((count + 1, 2))), axis=1)


def elements(points: np.ndarray) -> list[Element]:
    return [
        line(Space.TASK, a, b, float(np.linalg.norm((b - a)[:3])), at(k + 2))
        for k, (a, b) in enumerate(pairwise(points))
    ]


@pytest.mark.parametrize("count", [1, 2, 5, 95, 96, 97, 300])
def test_points_of_a_run_are_evened_within_their_share_and_its_ends_stay(count: int) -> None:
    points = ring(count, 0.2, 3)
    smoother = LineSmoother()
    smoother.tolerance_mm = 0.1
    found = [item for element in elements(points) for item in smoother.add(element)] + smoother.take()
    assert [item.source.line for item in found] == list(range(2, count + 2))
    ends = np.array([item.at(0.0)[0] for item in found] + [found[-1].at(found[-1].length)[0]])
    np.testing.assert_allclose(ends[[0, -1]], points[[0, -1]], atol=1e-12)
    for before, after in pairwise(found):
        np.testing.assert_allclose(before.at(before.length)[0], after.at(0.0)[0], atol=1e-12)
    moved = np.linalg.norm(ends - points, axis=1)
    assert moved.max() <= 0.025 + 1e-12
    assert all(item.merged_mm >= moved[k : k + 2].max() - 1e-12 for k, item in enumerate(found))
    if count >= 95:
        middle = slice(20, -20)
        rough, even = (np.linalg.norm(np.diff(rows, 2, axis=0), axis=1)[middle] for rows in (points, ends))
        assert np.ptp(even) < 0.1 * np.ptp(rough)


def test_corners_and_long_lines_end_a_run_and_nothing_moves_without_a_tolerance() -> None:
    points = np.concatenate(
        (ring(20, 0.2, 4), ring(20, 0.2, 4)[-1] + np.array([[0.1 * k, 0, 0, 0, 0] for k in (1, 2, 3, 40)]))
    )
    smoother = LineSmoother()
    smoother.tolerance_mm = 0.5
    found = [item for element in elements(points) for item in smoother.add(element)] + smoother.take()
    np.testing.assert_allclose(found[20].at(0.0)[0], points[20], atol=1e-12)
    np.testing.assert_allclose(found[-1].at(0.0)[0], points[-2], atol=1e-12)
    smoother.tolerance_mm = 0.0
    assert all(smoother.add(element) == [element] for element in elements(points))


def test_blends_that_touch_have_one_curvature_there_close_to_the_circles_own() -> None:
    made = elements(ring(3, 0.5, 12))
    corners = CornerMaker(ARM, Limits.from_config(SOFT), jerk_limited=True)
    blends = []
    for first, second in pairwise(made):
        corner = corners.between(first, 0.5 * first.length, second, PathMode.BLEND, 0.1)
        assert corner is not None
        assert corner.before == pytest.approx(0.5 * first.length) and corner.after == pytest.approx(0.5 * second.length)
        blend = TouchingBlend.of(corner.elements, corner.spare_mm)
        assert blend is not None
        blends.append(blend)
    before, touching = joined(blends[0], blends[1])
    after = touching.finished()
    bend = before.evaluate(np.array([before.length]))[2][0]
    np.testing.assert_allclose(bend, after.evaluate(np.zeros(1))[2][0], atol=1e-9)
    assert np.linalg.norm(bend) == pytest.approx(1.0 / 20.0, rel=3e-4)
    tight = TouchingBlend.of([blends[1].element], 0.0)
    assert tight is not None
    unbent, _ = joined(blends[0], tight)
    assert np.abs(unbent.evaluate(np.array([unbent.length]))[2]).max() < 1e-9


def test_a_rounded_circle_is_passed_nearly_as_fast_as_without_the_limit_and_within_the_tolerance() -> None:
    moves: list[Move] = [mode(0.1)]
    for k, (x, y, *_) in enumerate(ring(200, 0.2, 3)[1:], 2):
        moves.append(LinearMove(target(x, y, 150.0), Feed(6000.0), at(k)))
    best = ARM.ik((320.0, 0.0, 150.0), 0.0, 0.0).best
    assert best is not None
    fast, soft = (Plan(ARM, config, Planner(ARM, config, best.q_deg).plan(moves)) for config in (CONFIG, SOFT))
    assert soft.motion_s < 1.5 * fast.motion_s
    samples = soft.sample()
    assert path_deviation_mm(samples.tcp_mm, programmed_points(samples.tcp_mm[0], moves)) <= 0.1

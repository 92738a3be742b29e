"""Whether a corner is blended or stopped at: what the rough grid settles, and what that costs and saves."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Move, PathMode, Source
from rm501_host.planner import Plan, Planner
from rm501_host.planner import corners as corners_module
from rm501_host.planner.corners import CornerMaker
from rm501_host.planner.elements import Element, Space, line
from rm501_host.planner.grid import FINE, GridBuilder
from rm501_host.planner.limits import Limits
from tests.host.planner.programs import lines, mode
from tests.support.plan_checker import judge_samples

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
LIMITS = Limits.from_config(CONFIG)
AT = Source("corners.ngc", 1)


def corners(count: int) -> list[tuple[Element, float, Element, float]]:
    """Two lines that meet, how much of the first a corner before has taken, and the tolerance."""
    draw = np.random.default_rng(1)
    found = []
    for _ in range(count):
        place = np.array((draw.uniform(200, 360), draw.uniform(-150, 150), draw.uniform(80, 250), 0.0, 0.0))
        lengths = 10.0 ** draw.uniform(-1.0, 1.5, 2)
        ways = draw.normal(size=(2, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        start, end = place.copy(), place.copy()
        start[:3] -= lengths[0] * ways[0]
        end[:3] += lengths[1] * ways[1]
        feed = float(draw.choice((10.0, 50.0, 100.0)))
        first = replace(line(Space.TASK, start, place, float(lengths[0]), AT), feed_mm_s=feed)
        second = replace(line(Space.TASK, place, end, float(lengths[1]), AT), feed_mm_s=feed)
        found.append((first, float(draw.choice((0.0, 0.5))) * first.length, second, 10.0 ** draw.uniform(-1.3, 1.0)))
    return found


def test_what_the_rough_grid_settles_the_finer_ones_say_too(monkeypatch: pytest.MonkeyPatch) -> None:
    maker = CornerMaker(ARM, LIMITS)
    blended = 0
    for first, used, second, tolerance_mm in corners(60):
        asked = [maker.between(first, used, second, PathMode.BLEND, tolerance_mm)]
        with monkeypatch.context() as always:
            always.setattr(corners_module, "CLEARLY_FASTER", 0.0)
            always.setattr(corners_module, "CLEARLY_SLOWER", np.inf)
            asked.append(maker.between(first, used, second, PathMode.BLEND, tolerance_mm))
        assert (asked[0] is None) == (asked[1] is None)
        blended += asked[0] is not None
    assert 15 <= blended <= 55


def zigzag(count: int, leg_mm: float, turn_deg: float, blend_mm: float | None) -> list[Move]:
    """Legs that turn back by `turn_deg` again and again, on their way in y."""
    half = radians(180.0 - turn_deg) / 2.0
    points, x, y = [], 300.0, 0.0
    for i in range(count):
        x += leg_mm * cos(half) * (1 if i % 2 == 0 else -1)
        y += leg_mm * sin(half)
        points.append((x, y, 150.0))
    return [mode(blend_mm), *lines(points, 6000.0)]


@pytest.mark.parametrize(("leg_mm", "turn_deg"), [(0.2, 175.0), (0.2, 90.0), (1.0, 135.0)])
def test_a_zigzag_is_legal_and_never_slower_than_stopping(leg_mm: float, turn_deg: float) -> None:
    start = ARM.ik((300.0, 0.0, 150.0), 0.0, 0.0).best
    assert start is not None
    blended, stopping = (
        Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan(zigzag(12, leg_mm, turn_deg, blend)))
        for blend in (0.5, None)
    )
    assert blended.motion_s <= stopping.motion_s
    samples = blended.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6


def test_tiny_sharp_blends_lose_little_by_their_coarser_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    start = ARM.ik((300.0, 0.0, 150.0), 0.0, 0.0).best
    assert start is not None
    moves = zigzag(6, 0.2, 135.0, 0.5)
    quick = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan(moves)).motion_s
    monkeypatch.setattr(
        GridBuilder, "_tolerances", lambda _, table: np.full(len(table), FINE.bend_tolerance), raising=True
    )
    exact = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan(moves)).motion_s
    assert exact - 2e-3 <= quick <= 1.006 * exact

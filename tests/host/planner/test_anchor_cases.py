"""The cases of the issue, judged from samples of q alone."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Move
from rm501_host.planner import Plan, Planner
from rm501_host.segmenter import Segmenter
from rm501_host.segmenter.fit import to_q48
from tests.host.planner.programs import PICK_START_DEG, POLYLINE_START_DEG, pick_and_place, polyline
from tests.support.plan_checker import (
    judge_samples,
    path_deviation_mm,
    play_segments,
    programmed_points,
    tool_positions,
)

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)

CASES = {
    "pick, stopping, F2800": (pick_and_place(2800.0, None), PICK_START_DEG, 36.2, 35.5, 0.0),
    "pick, stopping, F6000": (pick_and_place(6000.0, None), PICK_START_DEG, 24.4, 23.9, 0.0),
    "pick, P0.5, F2800": (pick_and_place(2800.0, 0.5), PICK_START_DEG, 35.5, 30.0, 0.5),
    "pick, P5, F2800": (pick_and_place(2800.0, 5.0), PICK_START_DEG, 35.5, 28.0, 5.0),
    "pick, P0.5, F6000": (pick_and_place(6000.0, 0.5), PICK_START_DEG, 23.9, 20.0, 0.5),
    "pick, P5, F6000": (pick_and_place(6000.0, 5.0), PICK_START_DEG, 23.9, 19.0, 5.0),
    "polyline, stopping": (polyline(None), POLYLINE_START_DEG, 14.13, 13.853, 0.0),
    "polyline, 5 mm": (polyline(2.0711), POLYLINE_START_DEG, 13.07, 12.817, 2.0711),
}


@pytest.mark.parametrize("name", CASES)
def test_case_is_legal_fast_and_on_its_path(name: str) -> None:
    moves, start, most_s, least_s, tolerance_mm = CASES[name]
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start).plan(moves))
    assert least_s * 0.999 <= plan.motion_s <= most_s
    samples = plan.sample()
    judged = judge_samples(CONFIG, samples.t_s, samples.q_deg)
    assert judged.worst <= 1.0 + 1e-6
    assert judged.lowest_margin_deg >= -1e-6
    tcp = tool_positions(CONFIG, samples.q_deg)
    np.testing.assert_allclose(tcp, samples.tcp_mm, atol=1e-9)
    path = programmed_points(tcp[0], moves)
    assert path_deviation_mm(tcp, path) <= tolerance_mm + 1e-5
    np.testing.assert_allclose(tcp[-1], path[-1], atol=1e-6)


@pytest.mark.parametrize("name", ["pick, stopping, F6000", "pick, P0.5, F2800", "polyline, 5 mm"])
def test_segments_follow_the_law_exactly(name: str) -> None:
    moves, start, *_ = CASES[name]
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start).plan(moves))
    positions = [*map(to_q48, ARM.motors_from_joints(start).tolist()), 0]
    planned = list(Segmenter(CONFIG, positions, 12345).segments(plan.pieces))
    played = play_segments(CONFIG, planned, plan.pieces)
    assert played.largest_error_steps <= CONFIG.planner.tolerance_steps
    assert played.largest_rest_error_steps <= 1e-4
    assert played.worst <= 1.02
    assert played.largest_speed_jump_steps_s <= 0.01


def test_faster_feeds_and_larger_tolerances_are_never_slower() -> None:
    def motion(moves: list[Move]) -> float:
        return Plan(ARM, CONFIG, Planner(ARM, CONFIG, PICK_START_DEG).plan(moves)).motion_s

    stopping = motion(pick_and_place(2800.0, None))
    assert motion(pick_and_place(2800.0, 0.5)) <= stopping
    assert motion(pick_and_place(2800.0, 5.0)) <= motion(pick_and_place(2800.0, 0.5))
    assert motion(pick_and_place(6000.0, 0.5)) <= motion(pick_and_place(2800.0, 0.5))

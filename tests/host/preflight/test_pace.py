"""The time of a long program, estimated from planned stretches of it, beside the time of its whole plan."""

from __future__ import annotations

import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Dwell, Feed, LinearMove, Move, RapidMove
from rm501_host.planner import Planner
from rm501_host.preflight import ProgramCheck
from tests.host.planner.programs import PICK_START_DEG, at, target

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
BLOCKS = 900
"""More than the first stretches: most of it has to be estimated."""


def zigzag(leg_mm: float) -> list[Move]:
    """Corners of 90 deg, which cost far more time than the lines at their feed; a dwell in the middle."""
    moves: list[Move] = [RapidMove(target(300, -40, 200), at(1))]
    for k in range(1, BLOCKS):
        x, y = leg_mm * (k % 2), leg_mm * (k // 2 % 60)
        moves.append(LinearMove(target(300 + x, -40 + y, 200), Feed(2000.0), at(k + 1)))
    moves.insert(BLOCKS // 2, Dwell(5.0, at(BLOCKS // 2)))
    return moves


@pytest.mark.parametrize("speed_scale", [1.0, 0.5])
def test_the_estimate_is_near_the_plan_where_the_feeds_are_not(speed_scale: float) -> None:
    moves = zigzag(0.5)
    check = ProgramCheck(ARM, CONFIG, PICK_START_DEG)
    assert check.run(moves, max_moves=10**6, estimate=False).ok
    planner = Planner(ARM, CONFIG, PICK_START_DEG, speed_scale=speed_scale)
    planned_s = sum(piece.duration_s for piece in planner.plan(moves))
    assert check.estimate_s(speed_scale) == pytest.approx(planned_s, rel=0.1)
    assert check.nominal_s < 0.6 * planned_s, "the feeds alone would do for this program"

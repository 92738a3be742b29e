"""`[planner] blend = "parabolic"`: the corner is a parabola, within P, as smooth as a circle and never illegal."""

from __future__ import annotations

from math import cos, radians, sin

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from rm501_host.config import Config, load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Move
from rm501_host.planner import Plan, PlanError, Planner
from tests.host.planner.programs import POLYLINE_START_DEG, lines, mode, polyline, quarter
from tests.support.plan_checker import judge_samples, path_deviation_mm, programmed_points

ROUND = load_config()
PARABOLIC = msgspec.structs.replace(ROUND, planner=msgspec.structs.replace(ROUND.planner, blend="parabolic"))
ARM = Arm.from_config(ROUND)
CENTRE = np.array((300.0, 20.0, 150.0))


def planned(config: Config, moves: list[Move], start: tuple[float, ...]) -> Plan:
    return Plan(ARM, config, Planner(ARM, config, start).plan(moves))


def test_between_two_lines_it_is_a_parabola() -> None:
    plan = planned(PARABOLIC, polyline(2.0711), POLYLINE_START_DEG)
    blends = [e for piece in plan.pieces if piece.law is not None for e in piece.law.table.elements if e.is_blend]
    assert len(blends) == 6
    for blend in blends:
        # a parabola's second derivative is constant and not 0
        _, _, bends = blend.evaluate(np.linspace(0.0, blend.length, 5))
        assert np.ptp(bends, axis=0).max() < 1e-9
        assert np.abs(bends).max() > 1e-3
    assert not any(
        e.is_blend and not e.omega
        for piece in planned(ROUND, polyline(2.0711), POLYLINE_START_DEG).pieces
        for e in piece.law.table.elements  # type: ignore[union-attr]  # a polyline has laws only
    )


@pytest.mark.parametrize("tolerance_mm", [0.5, 2.0711, 5.0])
def test_polyline_a_is_on_its_path_and_not_slower_than_stopping(tolerance_mm: float) -> None:
    moves = polyline(tolerance_mm)
    plan = planned(PARABOLIC, moves, POLYLINE_START_DEG)
    samples = plan.sample()
    assert judge_samples(PARABOLIC, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    off_mm = path_deviation_mm(samples.tcp_mm, programmed_points(samples.tcp_mm[0], moves))
    assert 0.3 * tolerance_mm < off_mm <= tolerance_mm + 1e-6
    assert plan.motion_s <= planned(ROUND, polyline(None), POLYLINE_START_DEG).motion_s


@st.composite
def corners(draw: st.DrawFn) -> tuple[list[Move], float]:
    """Two or three moves through the centre of the work space, each a line or an arc about the waist axis, P."""
    tolerance = draw(st.floats(0.01, 8.0))
    here = CENTRE
    moves: list[Move] = [mode(tolerance)]
    for number in range(draw(st.integers(2, 3))):
        if draw(st.booleans()):
            angle = draw(st.floats(1.0, 20.0)) * draw(st.sampled_from([-1, 1]))
            turn = radians(angle)
            x, y, z = here
            here = np.array((x * cos(turn) - y * sin(turn), x * sin(turn) + y * cos(turn), z))
            moves.append(quarter(*here, angle, 6000.0, number + 2))
        else:
            way = draw(st.floats(0, 6.28)), draw(st.floats(-0.5, 0.5)), draw(st.floats(1, 40))
            here = here + way[2] * np.array((cos(way[0]), sin(way[0]), way[1]))
            tilt = draw(st.sampled_from([0.0, 0.0, 5.0]))
            moves += lines([(*here, tilt)], 6000.0, number + 2)
    return moves, tolerance


@settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(corners())
def test_random_corners_stay_within_the_tolerance(case: tuple[list[Move], float]) -> None:
    moves, tolerance_mm = case
    start = ARM.ik(tuple(CENTRE.tolist()), 0.0, 0.0).best
    assert start is not None
    try:
        plan = planned(PARABOLIC, moves, start.q_deg)
    except PlanError:
        event("refused")
        return
    samples = plan.sample()
    assert judge_samples(PARABOLIC, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    path = programmed_points(samples.tcp_mm[0], moves)
    assert path_deviation_mm(samples.tcp_mm, path) <= tolerance_mm + 2e-6

"""The time law against closed forms, linear programs and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.planner import plan_joint_move
from rm501_host.planner.timelaw import (
    IntervalLines,
    IntervalTable,
    backward_pass,
    fastest_speeds,
    law_duration,
    solve_lines,
    strips,
)
from tests.support.plan_checker import judge_samples

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(-60, 60)] * 2), st.floats(-80, 80))
def test_a_joint_move_takes_the_time_of_the_closed_form(wrist: tuple[float, float], waist: float) -> None:
    """Trapezoid of the joint line under the binding joint or motor: T = L/v + v/a, or 2 sqrt(L/a)."""
    start = np.array((0.0, 50.0, -40.0, 90.0, 0.0))
    step = np.round((waist, 0.0, 0.0, *wrist), 6)
    if np.abs(step).max() < 2.0:
        return
    (piece,) = plan_joint_move(ARM, CONFIG, start, start + step)
    both = abs(step[3]) + abs(step[4])
    velocity = min(
        [limit / abs(d) for limit, d in ((30.0, step[0]), (45.0, step[3]), (45.0, step[4])) if d]
        + ([1250.0 / 26.66666 / both] if both else [])
    )
    acceleration = min(
        [limit / abs(d) for limit, d in ((200.0, step[0]), (20.0, step[3]), (20.0, step[4])) if d]
        + ([21.0 / both] if both else [])
    )
    exact = 1.0 / velocity + velocity / acceleration if velocity**2 < acceleration else 2.0 / np.sqrt(acceleration)
    assert exact * (1 - 1e-9) <= piece.duration_s <= exact * 1.012 + 2e-3
    t = np.arange(0.0, piece.duration_s, 1e-3)
    assert judge_samples(CONFIG, t, piece.q_deg(t)).worst <= 1.0 + 1e-6


def test_a_search_move_runs_at_its_cap_and_may_leave_the_range() -> None:
    start = (-140.0, 50.0, -40.0, 90.0, 0.0)
    with pytest.raises(Exception, match="beyond its range"):
        plan_joint_move(ARM, CONFIG, start, (-153.0, *start[1:]))
    (piece,) = plan_joint_move(ARM, CONFIG, start, (-153.0, *start[1:]), ignore_limits=True, max_velocity_deg_s=5.0)
    rates = piece.qd_deg_s(np.linspace(0.2, piece.duration_s - 0.2, 50))
    np.testing.assert_allclose(rates[:, 0], -5.0, rtol=1e-3)
    np.testing.assert_allclose(piece.q_deg(np.array([piece.duration_s]))[0], (-153.0, *start[1:]), atol=1e-9)


def random_lines(
    seed: int, count: int = 12, rows: int = 4, *, regular: bool = False
) -> tuple[IntervalTable, IntervalLines]:
    """Strips with random coefficients; `regular`: without zero-inertia points (a keeps its sign and outweighs b)."""
    rng = np.random.default_rng(seed)
    shape = (rows, count)
    length = rng.uniform(0.05, 0.3, count)
    # neighbours share their common point, as the grid's intervals do
    a = rng.normal(size=(rows, count + 1))
    b = rng.normal(size=(rows, count + 1))
    if regular:
        a = rng.uniform(0.8, 1.5, size=(rows, count + 1)) * rng.choice([-1.0, 1.0], size=(rows, 1))
        b = rng.uniform(-1.0, 1.0, size=(rows, count + 1))
    limit = rng.uniform(0.5, 2.0, shape)
    cap = rng.uniform(0.3, 4.0, count + 1)
    table = strips(length, a[:, :-1], b[:, :-1], a[:, 1:], b[:, 1:], limit, cap[:-1], cap[1:])
    return table, solve_lines(table)


@pytest.mark.parametrize("seed", range(40))
def test_the_backward_pass_is_the_linear_program(seed: int) -> None:
    """reach_k = max x over {(x, y): strips, 0 <= x <= X, 0 <= y <= min(Y, reach_{k+1})}, by an independent solver."""
    table, lines = random_lines(seed)
    reach = backward_pass(lines, 0.0)
    expected = 0.0
    for k in range(len(table.length) - 1, -1, -1):
        rows = np.stack((table.p[:, k], table.q[:, k]), axis=1)
        solved = linprog(
            c=(-1.0, 0.0),
            A_ub=np.concatenate((rows, -rows)),
            b_ub=np.concatenate((table.c[:, k], table.c[:, k])),
            bounds=[(0, table.x_cap[k]), (0, min(table.y_cap[k], expected))],
        )
        assert solved.status == 0
        expected = -solved.fun
        assert reach[k] == pytest.approx(min(expected, table.y_cap[k - 1] if k else np.inf), abs=2e-7)


@pytest.mark.parametrize("seed", range(40))
def test_no_law_of_the_grid_is_faster(seed: int) -> None:
    """Away from zero-inertia points the law is the largest of all profiles at once (Pham and Pham 2018, theorem 1),
    so one linear program over the whole grid cannot find a larger sum.
    """
    table, lines = random_lines(seed, regular=True)
    speeds = fastest_speeds(lines)
    n = len(table.length)
    left, right = [], []
    for k in range(n):
        for row in range(len(table.p)):
            line = np.zeros(n + 1)
            line[k], line[k + 1] = table.p[row, k], table.q[row, k]
            left += [line, -line]
            right += [table.c[row, k]] * 2
    caps = np.minimum(np.append(table.x_cap, np.inf), np.append(np.inf, table.y_cap))
    caps[0] = caps[-1] = 0.0
    solved = linprog(c=-np.ones(n + 1), A_ub=np.array(left), b_ub=right, bounds=[(0, cap) for cap in caps])
    assert solved.status == 0
    # the fastest profile dominates every feasible one point by point, hence also in this sum
    np.testing.assert_allclose(speeds.sum(), -solved.fun, rtol=1e-6, atol=1e-7)
    assert (speeds >= solved.x - 1e-6).all()


def test_a_double_integrator_is_bang_bang() -> None:
    count = 400
    length = np.full(count, 10.0 / count)
    one, none = np.ones((1, count)), np.zeros((1, count))
    cap = np.full(count, 1e6)
    speeds = fastest_speeds(solve_lines(strips(length, one, none, one, none, 4.0 * one, cap, cap)))
    assert law_duration(length, speeds) == pytest.approx(2.0 * np.sqrt(10.0 / 4.0), rel=1e-9)
    assert np.sqrt(speeds.max()) == pytest.approx(np.sqrt(10.0 * 4.0), rel=1e-9)

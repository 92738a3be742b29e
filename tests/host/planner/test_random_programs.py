"""Random programs hold every invariant, judged from samples of q and from the integers of the segments."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, JointMove, LinearMove, Move, RapidMove
from rm501_host.planner import Plan, PlanError, Planner
from rm501_host.segmenter import Segmenter
from rm501_host.segmenter.fit import to_q48
from tests.host.planner.programs import at, mode, quarter
from tests.support.plan_checker import (
    judge_samples,
    path_deviation_mm,
    play_segments,
    programmed_points,
    tool_positions,
)

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
EXAMPLES = int(os.environ.get("RM501_MOVE_EXAMPLES", "300"))
"""The 2,000 are those of test_judged_programs, which are written as text and judged by more."""


@dataclass(frozen=True)
class Program:
    start_deg: tuple[float, ...]
    moves: tuple[Move, ...]
    tolerance_mm: float
    is_cartesian: bool


@st.composite
def programs(draw: st.DrawFn) -> Program:
    """A few moves near a random pose: lines of 0.05 to 60 mm, arcs about the waist, rapids, joint moves."""
    start = (
        draw(st.floats(-120, 120)),
        draw(st.floats(0, 80)),
        draw(st.floats(-85, -8)),
        draw(st.floats(10, 120)),
        draw(st.floats(-100, 100)),
    )
    blend = draw(st.sampled_from([None, 0.02, 0.5, 3.0]))
    moves: list[Move] = [mode(blend)]
    here = np.array(ARM.program_from_joints(start))
    size = draw(st.sampled_from([0.1, 2.0, 15.0, 40.0]))
    cartesian = True
    for line in range(draw(st.integers(1, 4))):
        feed = draw(st.sampled_from([300.0, 2000.0, 12000.0]))
        kind = draw(st.sampled_from(["line", "line", "line", "arc", "rapid", "joint"]))
        if kind == "arc":
            angle = draw(st.floats(2, 25)) * draw(st.sampled_from([-1, 1]))
            turned = np.radians(angle)
            x, y = here[:2]
            here = here.copy()
            here[0], here[1] = x * np.cos(turned) - y * np.sin(turned), x * np.sin(turned) + y * np.cos(turned)
            arc = quarter(here[0], here[1], here[2], angle, feed, line + 2)
            moves.append(type(arc)(tuple(here.tolist()), arc.centre_mm, arc.axis, arc.angle_deg, arc.feed, arc.source))
            continue
        if kind == "joint":
            if cartesian and line == 0:
                moves.append(JointMove(draw(st.integers(0, 4)), draw(st.floats(-8, 8)), True, at(line + 2)))
                cartesian = False
                break
            continue
        step = np.array([draw(st.floats(-1, 1)) for _ in range(5)] + [0.0])
        here = here + step * np.array([size, size, size, 4.0, 4.0, 0.0]) * (1.0 if step[:3].any() else 0.0)
        goal = tuple(float(v) for v in here)
        if kind == "rapid":
            moves.append(RapidMove(goal, at(line + 2)))
            cartesian = False
        else:
            moves.append(LinearMove(goal, Feed(feed), at(line + 2)))
    return Program(start, tuple(moves), blend or 0.0, cartesian)


def plan_of(program: Program) -> Plan | None:
    try:
        return Plan(ARM, CONFIG, Planner(ARM, CONFIG, program.start_deg).plan(program.moves))
    except PlanError as error:
        assert error.source is not None
        assert error.remedy
        return None


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
@given(programs())
def test_the_law_of_a_random_program_is_legal_and_on_its_path(program: Program) -> None:
    plan = plan_of(program)
    if plan is None:
        event("refused")
        return
    event("planned")
    if not plan.pieces or plan.duration_s < 0.004:
        return
    samples = plan.sample()
    judged = judge_samples(CONFIG, samples.t_s, samples.q_deg)
    assert judged.worst <= 1.0 + 1e-6
    assert judged.lowest_margin_deg >= -1e-6
    ratios = plan.limits(samples)
    assert ratios.worst <= 1.0 + 1e-6
    if program.is_cartesian:
        tcp = tool_positions(CONFIG, samples.q_deg)
        spacing = 0.02 if samples.t_s[-1] < 3.0 else 0.1
        path = programmed_points(tcp[0], program.moves, spacing)
        # the judge's own polyline of an arc of radius R is off by spacing^2 / 8 R
        sag = spacing**2 / (8.0 * np.hypot(path[:, 0], path[:, 1]).min())
        assert path_deviation_mm(tcp, path) <= program.tolerance_mm + 1e-6 + sag


@settings(max_examples=max(1, EXAMPLES // 3), deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(programs())
def test_the_segments_of_a_random_program_follow_it(program: Program) -> None:
    plan = plan_of(program)
    if plan is None or not plan.pieces:
        return
    positions = [*map(to_q48, ARM.motors_from_joints(program.start_deg).tolist()), 0]
    planned = list(Segmenter(CONFIG, positions, 7).segments(plan.pieces))
    played = play_segments(CONFIG, planned, plan.pieces)
    assert played.largest_error_steps <= CONFIG.planner.tolerance_steps
    assert played.largest_rest_error_steps <= 1e-4
    assert played.worst <= 1.02 + 1e-9
    assert played.largest_speed_jump_steps_s <= 0.2


def test_the_judge_sees_what_it_is_for() -> None:
    """A law that is one per cent too fast, and one that jumps in speed, are caught."""
    t = np.arange(0, 1.0, 1e-3)
    q = np.zeros((len(t), 5))
    q[:, 1] = 50.0 + 0.5 * 20.2 * t**2
    assert judge_samples(CONFIG, t, q).joint_acceleration == pytest.approx(1.01, abs=1e-3)
    q[:, 1] = 50.0 + np.abs(t - 0.5)
    assert judge_samples(CONFIG, t, q).joint_acceleration > 50

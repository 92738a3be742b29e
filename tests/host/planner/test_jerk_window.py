"""Jerk-limited laws that stream: legal across the window's borders, and hardly slower than planned as a whole."""

from __future__ import annotations

from math import cos, sin

import msgspec
import numpy as np
import pytest

import rm501_host.planner.jerk_window as jerk_window_module
import rm501_host.planner.planner as planner_module
from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, LinearMove, Move, OutputChange
from rm501_host.planner import Plan, Planner
from rm501_host.planner.jerk_window import JerkWindow
from rm501_host.segmenter import Segmenter
from rm501_host.segmenter.fit import to_q48
from tests.host.planner.programs import at, mode, target
from tests.support.plan_checker import judge_samples, path_deviation_mm, play_segments, programmed_points

CONFIG = load_config()
SOFT = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
ARM = Arm.from_config(CONFIG)
JERK = np.array([joint.max_jerk_deg_s3 for joint in CONFIG.joints.ordered])
LINES = 150


def spiral(count: int) -> list[Move]:
    """Lines of 0.3 mm on a spiral about (300, 0), with a change of an output in each of its thirds."""
    moves: list[Move] = [mode(0.5)]
    angle = 0.0
    for i in range(count):
        radius = 10.0 + 10.0 * i / count
        angle += 0.3 / radius
        place = target(300.0 + radius * cos(angle), radius * sin(angle), 150.0)
        if i % (count // 3) == count // 6:
            moves.append(OutputChange(0, i < count // 2, True, at(i)))
        moves.append(LinearMove(place, Feed(6000.0), at(i + 2)))
    return moves


def start() -> tuple[float, ...]:
    best = ARM.ik((310.0, 0.0, 150.0), 0.0, 0.0).best
    assert best is not None
    return best.q_deg


def streamed(monkeypatch: pytest.MonkeyPatch, chunk: int) -> Plan:
    monkeypatch.setattr(planner_module, "CHUNK_ELEMENTS", chunk)
    return Plan(ARM, SOFT, Planner(ARM, SOFT, start()).plan(spiral(LINES)))


def check_legal(plan: Plan) -> None:
    samples = plan.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    jerks = np.abs(np.diff(samples.q_deg, 3, axis=0))[:-1] / 1e-9
    assert (jerks / JERK).max() <= 1.0 + 1e-3
    path = programmed_points(samples.tcp_mm[0], spiral(LINES))
    assert path_deviation_mm(samples.tcp_mm, path) <= 0.5 + 1e-6
    last = spiral(LINES)[-1]
    assert isinstance(last, LinearMove)
    np.testing.assert_allclose(samples.tcp_mm[-1], last.target[:3], atol=1e-6)


def test_windows_are_legal_and_hardly_slower_than_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = streamed(monkeypatch, 48)
    assert len(plan.pieces) > 2
    assert [piece.ends_at_rest for piece in plan.pieces] == [False] * (len(plan.pieces) - 1) + [True]
    check_legal(plan)
    events = [piece.start_s + event.offset_s for piece in plan.pieces for event in piece.events]
    whole = streamed(monkeypatch, 100_000)
    assert len(whole.pieces) == 1
    assert plan.motion_s <= 1.06 * whole.motion_s
    assert len(events) == len(whole.pieces[0].events) == 3
    assert events == sorted(events)
    positions = [*map(to_q48, ARM.motors_from_joints(start()).tolist()), 0]
    played = play_segments(SOFT, list(Segmenter(SOFT, positions, 0).segments(plan.pieces)), plan.pieces)
    assert played.largest_error_steps <= 0.1
    assert played.worst <= 1.02
    assert played.largest_speed_jump_steps_s <= 0.2


def failing(monkeypatch: pytest.MonkeyPatch, *, with_known_stop: bool) -> None:
    """Every fourth search for a law that leaves the known stop at once finds none; nor do others, if told so."""
    calls = 0
    solve = JerkWindow._solve

    def sometimes(self: JerkWindow, followed: int = 0) -> object:
        nonlocal calls
        calls += not followed
        return None if calls % 4 == 3 and not followed else solve(self, followed)

    monkeypatch.setattr(JerkWindow, "_solve", sometimes)
    monkeypatch.setattr(JerkWindow, "_solve_gently", lambda self: None)
    if not with_known_stop:
        monkeypatch.setattr(JerkWindow, "_solve_from_known_stop", lambda self: None)


def test_where_no_legal_law_is_found_the_arm_stops_as_planned_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    failing(monkeypatch, with_known_stop=False)
    plan = streamed(monkeypatch, 32)
    assert sum(piece.ends_at_rest for piece in plan.pieces) > 1
    check_legal(plan)
    assert sum(len(piece.events) for piece in plan.pieces) == 3


@pytest.mark.parametrize("shares", [(0.25, 0.5, 0.75, 1.0), (1.0,)])
def test_the_known_stop_is_followed_a_while_where_it_cannot_be_left_at_once(
    monkeypatch: pytest.MonkeyPatch, shares: tuple[float, ...]
) -> None:
    failing(monkeypatch, with_known_stop=True)
    monkeypatch.setattr(jerk_window_module, "_FOLLOWED", shares)
    plan = streamed(monkeypatch, 32)
    assert [piece.ends_at_rest for piece in plan.pieces] == [False] * (len(plan.pieces) - 1) + [True]
    check_legal(plan)
    assert sum(len(piece.events) for piece in plan.pieces) == 3


def test_a_window_that_has_grown_to_its_bound_yields_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jerk_window_module, "MOST_INTERVALS", 500)
    monkeypatch.setattr(jerk_window_module, "_KEPT_WINDOWS", 1e3)
    plan = streamed(monkeypatch, 32)
    assert len(plan.pieces) > 2
    assert [piece.ends_at_rest for piece in plan.pieces] == [False] * (len(plan.pieces) - 1) + [True]
    check_legal(plan)

"""The preflight finds what would go wrong, says where and by how much, and what helps."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.config.schema import BoxSection, Config
from rm501_host.kinematics import Arm
from rm501_host.moves import Dwell, Feed, InputWait, LinearMove, Move, RapidMove, ToolChange
from rm501_host.planner import Plan, Planner
from rm501_host.preflight import FindingKind, KeepOut, PreflightReport, Severity, check_program, suggest_via
from rm501_host.preflight.keep_out import joints_in_space
from tests.host.planner.programs import PICK_START_DEG, at, pick_and_place, target

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
FEED = Feed(1000.0)


def check(*moves: Move, start: tuple[float, ...] = PICK_START_DEG, config: Config = CONFIG) -> PreflightReport:
    return check_program(ARM, config, moves, start)


def test_a_good_program_passes_with_the_planners_times() -> None:
    moves = pick_and_place(2800.0, 0.5)
    report = check(*moves)
    assert report.ok
    assert report.complete
    assert report.checked_to_line == moves[-1].source.line
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, PICK_START_DEG).plan(moves))
    assert report.motion_s == pytest.approx(plan.motion_s)
    assert report.cycle_s == pytest.approx(plan.duration_s)
    assert report.stop_horizon_s is not None and 0.05 < report.stop_horizon_s < 1.0
    assert report.needed_lead_s is not None and report.needed_lead_s > report.stop_horizon_s
    assert report.needed_lead_segments is not None and report.needed_lead_segments <= 32


def test_an_unreachable_goal_names_the_distance_missing() -> None:
    report = check(RapidMove(target(300, 0, 200), at(1)), LinearMove(target(465, 0, 230), FEED, at(2)))
    (finding,) = report.errors
    assert finding.kind is FindingKind.UNREACHABLE
    assert finding.source.line == 2
    # straight down the wrist is d5 above the tip: hypot(465, 230 + 95 - 230) - 370
    assert finding.amount == pytest.approx(np.hypot(465, 95) - 370, abs=1e-6)
    assert finding.unit == "mm"
    assert finding.q_deg is not None


def test_a_point_on_the_way_is_found_though_both_ends_are_good() -> None:
    """A chord through the arm's inner void: the elbow would have to fold beyond its limit."""
    report = check(RapidMove(target(300, 0, 200), at(1)), LinearMove(target(0, -300, 200), FEED, at(2)))
    (finding,) = report.errors
    assert finding.kind is FindingKind.JOINT_LIMIT
    assert "elbow" in finding.text
    assert finding.place_mm is not None and 1.0 < finding.place_mm < 300.0
    assert finding.amount is not None and finding.amount > 0.5


def test_the_suggested_via_makes_the_refused_line_feasible() -> None:
    report = check(
        RapidMove(target(300, 0, 200), at(1)),
        LinearMove(target(0, -300, 200), FEED, at(2)),
    )
    (finding,) = report.errors
    assert finding.via is not None
    by_way = check(
        RapidMove(target(300, 0, 200), at(1)),
        LinearMove(finding.via.target, FEED, at(2)),
        LinearMove(target(0, -300, 200), FEED, at(3)),
    )
    assert by_way.ok, by_way.findings


def test_no_via_where_there_is_none() -> None:
    goal = np.array((1000.0, 0.0, 200.0, 0.0, 0.0))
    assert suggest_via(ARM, PICK_START_DEG, goal) is None


def test_several_faults_are_found_in_one_run() -> None:
    report = check(
        RapidMove(target(300, 0, 200), at(1)),
        LinearMove(target(600, 0, 200), FEED, at(2)),
        LinearMove(target(300, 30, 200), FEED, at(3)),
        RapidMove(target(300, 0, 900), at(4)),
        LinearMove(target(0, -300, 200), FEED, at(5)),
    )
    assert [finding.source.line for finding in report.errors] == [2, 4, 5]
    assert not report.ok
    assert report.cycle_s is None


def test_near_a_singularity_it_warns_with_the_speed_left() -> None:
    start = ARM.ik((400.0, 0.0, 230.0), 90.0, 0.0).best
    assert start is not None
    report = check(LinearMove(target(464.99, 0, 230, 90), Feed(6000.0), at(1)), start=start.q_deg)
    assert report.ok
    (warning,) = [f for f in report.findings if f.kind is FindingKind.SINGULARITY]
    assert warning.severity is Severity.WARNING
    assert warning.amount is not None and warning.amount < 10.0


def test_a_feed_that_a_motor_cannot_follow_is_named_once() -> None:
    moves = [RapidMove(target(300, 0, 200), at(1))]
    moves += [LinearMove(target(300 + 5 * (i % 2), 0, 200), Feed(60000.0), at(2 + i)) for i in range(1, 30)]
    report = check(*moves)
    slow = [f for f in report.findings if f.kind is FindingKind.MOTOR_RATE]
    assert len(slow) == 1
    assert slow[0].count > 20


def test_an_input_ends_the_check_there() -> None:
    report = check(
        RapidMove(target(300, 0, 200), at(1)),
        Dwell(0.5, at(2)),
        InputWait(0, 3, 1.0, False, at(3)),
        LinearMove(target(900, 0, 200), FEED, at(4)),
    )
    assert report.ok
    assert not report.complete
    assert report.checked_to_line == 2
    assert "test.ngc:3" in report.stopped_by


def test_so_does_the_bound() -> None:
    moves = [RapidMove(target(300, i % 3, 200), at(i + 1)) for i in range(100)]
    report = check_program(ARM, CONFIG, moves, PICK_START_DEG, max_moves=10)
    assert not report.complete
    assert report.moves == 10


def test_a_tool_changes_what_is_reached() -> None:
    far = LinearMove(target(345, 0, 200), FEED, at(3))
    assert check(RapidMove(target(300, 0, 200), at(1)), far).ok
    longer = ToolChange(60.0, (0.0, 0.0), at(2))
    assert not check(RapidMove(target(300, 0, 200), at(1)), longer, LinearMove(target(345, 0, 330), FEED, at(3))).ok


def guarded(*boxes: BoxSection, table_z_mm: float | None = None) -> Config:
    return msgspec.structs.replace(
        CONFIG, keep_out=msgspec.structs.replace(CONFIG.keep_out, boxes=boxes, table_z_mm=table_z_mm)
    )


def test_the_hand_below_the_table() -> None:
    config = guarded(table_z_mm=100.0)
    good = check(RapidMove(target(300, 0, 150), at(1)), LinearMove(target(300, 0, 101), FEED, at(2)), config=config)
    assert good.ok
    report = check(RapidMove(target(300, 0, 150), at(1)), LinearMove(target(300, 0, 60), FEED, at(2)), config=config)
    (finding,) = report.errors
    assert finding.kind is FindingKind.KEEP_OUT
    assert finding.source.line == 2
    assert finding.place_mm == pytest.approx(51.0, abs=1.01)


def test_a_link_enters_a_box_though_the_tip_stays_out() -> None:
    """The box stands where the forearm passes, in front of the arm; a rapid sweeps through it."""
    box = BoxSection(name="post", min_mm=(140.0, 60.0, 250.0), max_mm=(170.0, 100.0, 500.0))
    moves = (RapidMove(target(300, 0, 200), at(1)), RapidMove(target(212, 212, 200), at(2)))
    assert check(*moves).ok
    report = check(*moves, config=guarded(box))
    (finding,) = report.errors
    assert finding.kind is FindingKind.KEEP_OUT
    assert "post" in finding.text
    assert "hand" not in finding.text
    assert finding.q_deg is not None


def test_links_are_where_the_dh_frames_are() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = rng.uniform(*ARM.limits_deg)
        frames = ARM.frames(q)
        points = joints_in_space(ARM, q[None])[0]
        np.testing.assert_allclose(points[0], frames[1][:3, 3], atol=1e-9)
        np.testing.assert_allclose(points[1], frames[2][:3, 3], atol=1e-9)
        np.testing.assert_allclose(points[2], frames[3][:3, 3], atol=1e-9)
        np.testing.assert_allclose(points[4], frames[6][:3, 3], atol=1e-9)


def test_box_entry_agrees_with_dense_points_on_the_links() -> None:
    rng = np.random.default_rng(7)
    box = BoxSection(name="cube", min_mm=(100.0, -60.0, 150.0), max_mm=(220.0, 60.0, 330.0))
    keep_out = KeepOut(guarded(box))
    q = rng.uniform(*ARM.limits_deg, size=(300, 5))
    points = joints_in_space(ARM, q)
    shares = np.linspace(0, 1, 600)[:, None]
    for row in range(len(q)):
        dense = np.concatenate([points[row, i] + (points[row, i + 1] - points[row, i]) * shares for i in range(4)])
        inside = ((dense > np.array(box.min_mm)) & (dense < np.array(box.max_mm))).all(axis=1).any()
        found = keep_out.first_entry(ARM, q[row : row + 1], 0.0) is not None
        # a link that only grazes an edge may fall between the dense points
        assert found or not inside
        if found and not inside:
            grown = ((dense > np.array(box.min_mm) - 1) & (dense < np.array(box.max_mm) + 1)).all(axis=1).any()
            assert grown

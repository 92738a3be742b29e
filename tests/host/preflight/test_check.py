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


def test_box_entry_agrees_with_dense_points_on_the_links() -> None:
    rng = np.random.default_rng(7)
    box = BoxSection(name="cube", min_mm=(100.0, -60.0, 150.0), max_mm=(220.0, 60.0, 330.0))
    low, high = np.array(box.min_mm), np.array(box.max_mm)
    keep_out = KeepOut(guarded(box))
    shares = np.linspace(0, 1, 600)[:, None]
    seen = {True: 0, False: 0}
    for q in rng.uniform(*ARM.limits_deg, size=(300, 5)):
        frames = ARM.frames(q)
        shoulder, elbow, wrist, tip = (frames[index][:3, 3] for index in (1, 2, 3, 6))
        palm = tip - (tip - wrist) * 35.0 / np.linalg.norm(tip - wrist)
        nearest = min(
            np.linalg.norm(points - np.clip(points, low, high), axis=1).min() - radius_mm
            for points, radius_mm in (
                (shoulder + (elbow - shoulder) * shares, 60.0),
                (elbow + (wrist - elbow) * shares, 50.0),
                (wrist + (palm - wrist) * shares, 35.0),
            )
        )
        found = keep_out.first_entry(ARM, q[None], 0.0) is not None
        seen[found] += 1
        if abs(nearest) > 0.2:  # between the dense points
            assert found == (nearest < 0.0)
    assert min(seen.values()) > 30


def test_a_link_is_as_thick_as_configured() -> None:
    """Beside the stretched-out forearm: the gap decides, and it is measured from the skin."""
    q = np.array([[0.0, 45.0, -45.0, 90.0, 0.0]])
    elbow_z = 230.0 + 220.0 * np.sin(np.pi / 4)
    elbow_x = 220.0 * np.cos(np.pi / 4)
    for gap, entered in ((0.5, False), (-0.5, True)):
        side = 50.0 + gap
        box = BoxSection(
            name="wall", min_mm=(elbow_x + 65.0, side, elbow_z - 5.0), max_mm=(elbow_x + 75.0, 300.0, elbow_z + 5.0)
        )
        entry = KeepOut(guarded(box)).first_entry(ARM, q, 0.0)
        assert (entry is not None) is entered
        if entry is not None:
            assert entry[1] == "the forearm would enter 'wall'"
            assert entry[2] == pytest.approx(0.5)

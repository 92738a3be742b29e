"""Following a path: never a silent change of branch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, Branch, BranchTracker, KinematicsError, TrackStatus

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)


def wide_arm() -> Arm:
    """An arm whose elbow bends both ways, so that branches meet inside the limits."""
    geometry = replace(
        ARM.geometry,
        min_deg=(-150.0, -100.0, -120.0, -180.0, -180.0),
        max_deg=(150.0, 190.0, 120.0, 180.0, 180.0),
        home_deg=(0.0, 60.0, -60.0, 0.0, 0.0),
    )
    return Arm(geometry, ARM.motors, ARM.frame)


def test_a_plain_path_is_followed_on_its_branch() -> None:
    start = ARM.ik((330.0, -100.0, 200.0), 0.0, 10.0).best
    assert start is not None
    tracker = BranchTracker(ARM, start.q_deg, max_step_deg=1.0)
    for y in np.arange(-100.0, 100.0, 2.0):
        step = tracker.step((330.0, y, 200.0), 0.0, 10.0)
        assert step.status is TrackStatus.FOLLOWED
        assert step.branch is Branch.FRONT_UP
        np.testing.assert_allclose(ARM.fk(tracker.q_deg).xyz_mm, (330.0, y, 200.0), atol=1e-9)


def test_through_the_waist_axis_it_crosses_and_says_so() -> None:
    arm = ARM
    start = arm.ik((20.0, 0.0, 650.0), 225.0, 0.0).best
    assert start is not None
    tracker = BranchTracker(arm, start.q_deg, max_step_deg=1.0)
    statuses = []
    for x in np.arange(20.0, -20.5, -0.5):
        step = tracker.step((x, 0.0, 650.0), 225.0, 0.0)
        statuses.append(step.status)
        assert step.q_deg[0] == 0.0  # the waist never swings round
    assert statuses.count(TrackStatus.CROSSED) == 1
    assert set(statuses) == {TrackStatus.FOLLOWED, TrackStatus.CROSSED}
    assert tracker.branch is Branch.BACK_UP


def test_beside_the_waist_axis_it_stops_instead_of_swinging() -> None:
    start = ARM.ik((20.0, 0.2, 650.0), 225.0, 0.0).best
    assert start is not None
    tracker = BranchTracker(ARM, start.q_deg, max_step_deg=5.0)
    statuses = []
    for x in np.arange(20.0, -20.5, -0.5):
        before = tracker.q_deg
        step = tracker.step((x, 0.2, 650.0), 225.0, 0.0)
        statuses.append(step.status)
        if step.status not in (TrackStatus.FOLLOWED, TrackStatus.CROSSED):
            assert tracker.q_deg == before
            assert step.alternative is not None
            assert step.largest_move_deg > 5.0
            break
    assert statuses[-1] is TrackStatus.JUMP
    assert "5" in step.reason


def test_when_only_another_branch_is_left_it_says_so_and_waits() -> None:
    arm = wide_arm()
    limits = replace(arm.geometry, max_deg=(150.0, 50.0, 120.0, 180.0, 180.0), home_deg=(0.0,) * 5)
    narrow = Arm(limits, ARM.motors, ARM.frame)
    start = next(s for s in narrow.ik((330.0, 0.0, 200.0), 0.0, 0.0).solutions if s.branch is Branch.FRONT_UP)
    assert start.in_limits
    tracker = BranchTracker(narrow, start.q_deg, max_step_deg=3.0)
    statuses = []
    for x in np.arange(330.0, 120.0, -1.0):
        step = tracker.step((x, 0.0, 200.0), 0.0, 0.0)
        statuses.append(step.status)
        if step.status is TrackStatus.MUST_SWITCH:
            break
    assert statuses[-1] is TrackStatus.MUST_SWITCH
    assert step.alternative is not None and step.alternative.branch is not tracker.branch
    assert "does not reach" in step.reason
    tracker.switch_to(step.alternative)
    assert tracker.step((x, 0.0, 200.0), 0.0, 0.0).status is TrackStatus.FOLLOWED


def test_lost_carries_the_reason() -> None:
    start = ARM.ik((330.0, 0.0, 200.0), 0.0, 0.0).best
    assert start is not None
    tracker = BranchTracker(ARM, start.q_deg, max_step_deg=5.0)
    step = tracker.step((900.0, 0.0, 200.0), 0.0, 0.0)
    assert step.status is TrackStatus.LOST
    assert "beyond the stretched arm" in step.reason
    with pytest.raises(KinematicsError, match="above 0"):
        BranchTracker(ARM, start.q_deg, max_step_deg=0.0)

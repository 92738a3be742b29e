"""Ways of Cartesian jogs: straight where they can be, damped through singularities, inside every limit."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from rm501_host.config import Config, load_config
from rm501_host.config.schema import BoxSection
from rm501_host.errors import RefusedError
from rm501_host.kinematics import Arm
from rm501_host.machine.jog_path import LEAST_PROGRESS, MOST_DEVIATION_DEG, MOST_DEVIATION_MM, JogWalker
from rm501_host.machine.jog_plan import PlannedJog, heading_of, plan_cartesian_jog
from rm501_host.planner import Limits, Plan
from rm501_host.preflight.keep_out import KeepOut
from tests.support.virtual_machine import REPOSITORY

PLAIN = load_config(REPOSITORY / "configs" / "rm501.toml")
THESIS = load_config(REPOSITORY / "configs" / "thesis.toml")
TEACH_MM_S = 250.0
_STEP_S = 3e-3
AXIS_POSE = (0.0, 85.0, -30.0, 172.0, 0.0)
"""The tool leans back over the shoulder; x decreasing leads across the waist axis."""


def plan(
    config: Config, q_deg: object, frame: str, axis: str, speed: float, distance: float | None = None
) -> PlannedJog:
    arm = Arm.from_config(config)
    return plan_cartesian_jog(arm, config, np.array(q_deg, dtype=float), frame, axis, speed, distance, TEACH_MM_S)


def task_of(arm: Arm, q_deg: np.ndarray) -> np.ndarray:
    positions, _ = arm.fk_batch(q_deg)
    return np.column_stack((positions, q_deg[:, 1] + q_deg[:, 2] + q_deg[:, 3], q_deg[:, 4]))


def judge(config: Config, jog: PlannedJog, frame: str, axis: str, speed: float) -> None:
    """Every limit, the speed, steady progress, and no deviation outside the damped parts, from samples alone."""
    arm = Arm.from_config(config)
    whole = Plan(arm, config, jog.pieces)
    samples = whole.sample(_STEP_S)
    limits = Limits.from_config(config)
    ratios = whole.limits(samples)
    assert ratios.worst <= 1.0
    assert (samples.q_deg >= limits.min_deg - 1e-6).all() and (samples.q_deg <= limits.max_deg + 1e-6).all()
    # rest at both ends, positions and rates that belong together
    assert np.abs(samples.qd_deg_s[[0, -1]]).max() < 1e-6
    step_s = np.diff(samples.t_s)[:, None]
    chord = np.diff(samples.q_deg, axis=0) / step_s
    mean = 0.5 * (samples.qd_deg_s[1:] + samples.qd_deg_s[:-1])
    jumping = 0.5 * limits.joint_acceleration_deg_s2 * _STEP_S  # accelerations may jump between two samples
    assert (np.abs(chord - mean).max(axis=0) <= jumping + 1e-6).all()
    heading = heading_of(arm, samples.q_deg[0], frame, axis, np.sign(speed))
    task = task_of(arm, samples.q_deg)
    task[:, 4] -= heading.waist_share * samples.q_deg[:, 0]
    moved = task - task[0]
    tool_mm_s = np.linalg.norm(np.diff(task[:, :3], axis=0) / step_s, axis=1)
    assert tool_mm_s.max() <= (TEACH_MM_S if heading.is_turn else min(abs(speed), TEACH_MM_S)) * (1 + 1e-6)
    scale = np.array((1.0, 1.0, 1.0, 5.0, 5.0))
    unit = heading.direction * scale / np.linalg.norm(heading.direction * scale)
    along = (moved * scale) @ unit
    assert np.diff(along).min() > -1e-4, "the tool never goes back"
    off = moved * scale - along[:, None] * unit
    damped = samples.line == 1
    assert damped.any() == jog.path.is_damped
    first = int(np.argmax(damped)) if damped.any() else len(damped)
    assert np.linalg.norm(off[:first], axis=1).max(initial=0.0) < 1e-6, "straight before any damping"
    assert np.linalg.norm(off[:, :3], axis=1).max() <= MOST_DEVIATION_MM + 0.5
    assert np.abs(off[:, 3:] / 5.0).max() <= MOST_DEVIATION_DEG + 0.5
    if not jog.path.is_damped:
        assert jog.path.deviation_mm == 0.0


def random_pose(rng: np.random.Generator, config: Config) -> np.ndarray:
    limits = Limits.from_config(config)
    return rng.uniform(limits.min_deg + 0.5, limits.max_deg - 0.5)


@pytest.mark.parametrize("config", [PLAIN, THESIS], ids=["XYZAB", "XYZABC"])
def test_jogs_from_random_poses_keep_every_limit(config: Config) -> None:
    rng = np.random.default_rng(11)
    done = edges = 0
    while done < 25:
        q_deg = random_pose(rng, config)
        frame = str(rng.choice(["world", "tool"]))
        axis = str(rng.choice(list("xyzab"))) if frame == "world" else str(rng.choice(list("xyz")))
        speed = float(rng.choice([-1, 1]) * rng.uniform(5, 300))
        try:
            jog = plan(config, q_deg, frame, axis, speed)
        except RefusedError as error:
            assert "cannot" in str(error)
            continue
        assert jog.path.reason
        judge(config, jog, frame, axis, speed)
        done += 1
        edges += "leaves the reach" in jog.path.reason
    assert edges >= 3


def test_jogs_around_the_waist_axis_keep_every_limit() -> None:
    rng = np.random.default_rng(12)
    done = damped = 0
    while done < 15:
        q_deg = np.array(AXIS_POSE) + np.array([0.0, *rng.uniform(-8, 8, 3), rng.uniform(-90, 90)])
        q_deg[0] = rng.choice((-90.0, 0.0, 90.0)) + rng.uniform(-8, 8)
        q_deg = np.clip(q_deg, *(np.array(side) for side in Arm.from_config(PLAIN).limits_deg))
        axis, speed = str(rng.choice(list("xy"))), float(rng.choice([-1, 1]) * rng.uniform(10, 100))
        try:
            jog = plan(PLAIN, q_deg, "world", axis, speed)
        except RefusedError:
            continue
        judge(PLAIN, jog, "world", axis, speed)
        done += 1
        damped += jog.path.is_damped
    assert damped >= 6


@pytest.mark.parametrize("offset_mm", [(0.0, 0.0), (12.0, -7.0)])
def test_jogs_with_a_vertical_tool_keep_the_hands_direction_through_singularities(
    offset_mm: tuple[float, float],
) -> None:
    config = msgspec.structs.replace(THESIS, tool=msgspec.structs.replace(THESIS.tool, offset_mm=offset_mm))
    limits = Limits.from_config(config)
    rng = np.random.default_rng(13)
    done = damped = 0
    while done < 12:
        q_deg = random_pose(rng, config)
        if done % 2:  # over the shoulder, near the waist axis
            q_deg[:3] = rng.choice((-90.0, 0.0, 90.0)), rng.uniform(75, 100), rng.uniform(-60, -25)
        q_deg[3] = float(rng.choice([0.0, 180.0])) - q_deg[1] - q_deg[2]
        if not limits.min_deg[3] <= q_deg[3] <= limits.max_deg[3]:
            continue
        axis, speed = str(rng.choice(list("xyz"))), float(rng.choice([-1, 1]) * rng.uniform(10, 200))
        try:
            jog = plan(config, q_deg, "world", axis, speed)
        except RefusedError:
            continue
        judge(config, jog, "world", axis, speed)
        done += 1
        damped += jog.path.is_damped
    assert damped >= 3


@pytest.mark.parametrize("beside_mm", [0.0, 0.1, 0.5, 1.0])
def test_a_jog_beside_the_waist_axis_crosses_it_and_returns_to_its_line(beside_mm: float) -> None:
    arm = Arm.from_config(PLAIN)
    pose = arm.fk(AXIS_POSE)
    start = arm.ik((60.0, beside_mm, float(pose.xyz_mm[2])), pose.pitch_deg, 0.0, AXIS_POSE).best
    assert start is not None
    jog = plan(PLAIN, start.q_deg, "world", "x", -40.0)
    judge(PLAIN, jog, "world", "x", -40.0)
    end = Plan(arm, PLAIN, jog.pieces).sample().tcp_mm[-1]
    assert end[0] < -20.0, "beyond the axis"
    assert end[1:] == pytest.approx((beside_mm, pose.xyz_mm[2]), abs=1e-4), "on its line again"
    assert jog.path.deviation_mm <= 2.0 * beside_mm + 0.02
    assert "limit" in jog.path.reason


def test_a_jog_to_the_stretched_arm_ends_within_a_fraction_of_a_millimetre() -> None:
    arm = Arm.from_config(PLAIN)
    # straight out of the shoulder, and 70 mm above it
    level = arm.ik((430.0, 0.0, arm.geometry.d1_mm), 90.0, 0.0).best
    raised = arm.ik((430.0, 0.0, arm.geometry.d1_mm + 70.0), 90.0, 0.0).best
    assert level is not None and raised is not None
    jog = plan(PLAIN, level.q_deg, "world", "x", 30.0)
    judge(PLAIN, jog, "world", "x", 30.0)
    reach = arm.geometry.a2_mm + arm.geometry.a3_mm + arm.geometry.d5_mm
    end = Plan(arm, PLAIN, jog.pieces).sample().tcp_mm[-1]
    assert reach - 0.1 < end[0] <= reach
    assert not jog.path.is_damped and "leaves the reach" in jog.path.reason
    # aimed past the shoulder it stops on its line as well: it does not slide along the edge
    slanted = plan(PLAIN, raised.q_deg, "world", "x", 30.0)
    judge(PLAIN, slanted, "world", "x", 30.0)
    end = Plan(arm, PLAIN, slanted.pieces).sample().tcp_mm[-1]
    assert "leaves the reach" in slanted.path.reason and not slanted.path.is_damped
    d5_mm, edge_mm = arm.geometry.d5_mm, reach - arm.geometry.d5_mm
    assert end == pytest.approx((d5_mm + (edge_mm**2 - 70.0**2) ** 0.5, 0.0, arm.geometry.d1_mm + 70.0), abs=0.2)
    back = plan(PLAIN, Plan(arm, PLAIN, slanted.pieces).sample().q_deg[-1], "world", "x", -30.0, 50.0)
    assert not back.path.is_damped, "and comes back as it went"


def test_the_hand_keeps_its_direction_in_the_room_where_programs_give_one() -> None:
    arm = Arm.from_config(THESIS)
    start = arm.joints_from_program((210.0, 0.0, -150.0, 0.0, 0.0, 0.0)).best
    assert start is not None
    jog = plan(THESIS, start.q_deg, "world", "y", 60.0, 80.0)
    judge(THESIS, jog, "world", "y", 60.0)
    end = Plan(arm, THESIS, jog.pieces).sample().q_deg[-1]
    assert arm.program_from_joints(end) == pytest.approx((210.0, 80.0, -150.0, 0.0, 0.0, 0.0), abs=1e-6)
    # in XYZAB the roll is the arm's own: it stays
    plain = plan(PLAIN, start.q_deg, "world", "y", 60.0, 80.0)
    assert Plan(arm, PLAIN, plain.pieces).sample().q_deg[-1, 4] == pytest.approx(start.q_deg[4], abs=1e-9)


def test_turns_about_other_axes_than_the_arms_are_refused_with_the_angle() -> None:
    with pytest.raises(RefusedError, match=r"pitch axis .* 90.00 deg away"):
        plan(THESIS, (0.0, 60.0, -60.0, 60.0, 0.0), "world", "a", 10.0)
    with pytest.raises(RefusedError, match="no axis C"):
        plan(PLAIN, (0.0, 60.0, -60.0, 60.0, 0.0), "world", "c", 10.0)
    jog = plan(THESIS, (0.0, 60.0, -60.0, 60.0, 0.0), "world", "b", 10.0, 20.0)
    judge(THESIS, jog, "world", "b", 10.0)
    arm = Arm.from_config(THESIS)
    end = Plan(arm, THESIS, jog.pieces).sample().q_deg[-1]
    before, after = arm.program_from_joints((0.0, 60.0, -60.0, 60.0, 0.0)), arm.program_from_joints(end)
    assert np.subtract(after, before) == pytest.approx((0, 0, 0, 0, 20, 0), abs=1e-6)


def test_a_step_farther_than_the_way_is_refused_with_what_is_left() -> None:
    with pytest.raises(RefusedError, match=r"only 74\.\d+ mm are left that way .elbow is at its limit"):
        plan(PLAIN, (0.0, 60.0, -60.0, 60.0, 0.0), "world", "x", -40.0, 80.0)
    exact = plan(PLAIN, (0.0, 60.0, -60.0, 60.0, 0.0), "world", "x", -40.0, 70.0)
    assert exact.path.reach == pytest.approx(70.0, abs=1e-9)


def test_a_jog_ends_before_a_keep_out_zone_and_leads_out_of_one() -> None:
    box = BoxSection(name="vice", min_mm=(100.0, -100.0, 0.0), max_mm=(300.0, 100.0, 90.0))
    config = msgspec.structs.replace(PLAIN, keep_out=msgspec.structs.replace(PLAIN.keep_out, boxes=(box,)))
    arm = Arm.from_config(config)
    above = arm.ik((290.0, 0.0, 180.0), 0.0, 0.0).best
    assert above is not None
    jog = plan(config, above.q_deg, "world", "z", -30.0)
    assert "vice" in jog.path.reason
    samples = Plan(arm, config, jog.pieces).sample()
    assert KeepOut(config).first_entry(arm, samples.q_deg, -0.01) is None
    assert 90.0 <= samples.tcp_mm[-1, 2] < 90.1
    inside = arm.ik((290.0, 0.0, 80.0), 0.0, 0.0).best
    assert inside is not None and KeepOut(config).first_entry(arm, np.array([inside.q_deg]), 0.0) is not None
    assert plan(config, inside.q_deg, "world", "z", 30.0).path.reach > 50.0


def test_a_jog_under_limited_jerk_keeps_the_jerk() -> None:
    config = msgspec.structs.replace(PLAIN, planner=msgspec.structs.replace(PLAIN.planner, jerk_limited=True))
    for start, axis, speed in ((AXIS_POSE, "x", -40.0), ((0.0, 60.0, -60.0, 60.0, 0.0), "x", -40.0)):
        jog = plan(config, start, "world", axis, speed)
        judge(config, jog, "world", axis, speed)


def test_progress_is_never_less_than_promised() -> None:
    arm = Arm.from_config(PLAIN)
    walker = JogWalker(arm, KeepOut(PLAIN))
    heading = heading_of(arm, np.array(AXIS_POSE), "world", "x", -1.0)
    path = walker.walk(np.array(AXIS_POSE), heading, 1000.0)
    damped = [element for element in path.elements if element.source.line]
    commanded = sum(element.length for element in damped)
    straight = sum(element.length for element in path.elements if not element.source.line)
    assert damped and path.reach - straight >= LEAST_PROGRESS * commanded
    assert replace(heading, waist_share=0.0) is not heading

"""The program frame and its two coordinate systems, there and back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, Branch, IkStatus, KinematicsError, OrientationError, ShortfallKind
from tests.support.kinematics import CONFIGS, random_joints, with_section

THESIS_CONFIG = load_config(CONFIGS / "thesis.toml")
THESIS = Arm.from_config(THESIS_CONFIG)
PLAIN = Arm.from_config(load_config())
ODD_FRAME = with_section(THESIS_CONFIG, "frame", xyz_mm=(30.0, -40.0, 55.0), rpy_deg=(20.0, -35.0, 140.0))
ODD_TOOL = with_section(ODD_FRAME, "tool", length_mm=20.0, offset_mm=(5.0, 8.0), tilt_deg=(15.0, -30.0))
ARMS = {
    "thesis": THESIS,
    "odd frame": Arm.from_config(ODD_FRAME),
    "odd frame and tool": Arm.from_config(ODD_TOOL),
    "pitch and roll": Arm.from_config(with_section(ODD_FRAME, "machine", coordinates="XYZAB")),
}


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())
def test_joints_to_program_and_back(arm: Arm) -> None:
    for q in random_joints(arm, 400, seed=50, margin_deg=1.0):
        target = arm.program_from_joints(q)
        result = arm.joints_from_program(target, q)
        assert result.best is not None
        np.testing.assert_allclose(result.best.q_deg, q, atol=1e-6)
        np.testing.assert_allclose(arm.program_from_joints(result.best.q_deg), target, atol=1e-6)
        pose, wanted = arm.pose_from_program(target, q), arm.fk(q)
        np.testing.assert_allclose(pose.xyz_mm, wanted.xyz_mm, atol=1e-9)
        np.testing.assert_allclose(pose.rotation, wanted.rotation, atol=1e-8)
        assert pose.pitch_deg == pytest.approx(wanted.pitch_deg, abs=1e-7)
        assert pose.roll_deg == pytest.approx(wanted.roll_deg, abs=1e-7)


def test_every_solution_of_an_orientation_holds_it() -> None:
    """Also the one with the waist turned by half a turn, and an independent library agrees what ABC mean."""
    arm = ARMS["odd frame and tool"]
    counts = set()
    for q in random_joints(arm, 200, seed=51, margin_deg=1.0):
        target = arm.program_from_joints(q)
        frame = Rotation.from_euler("xyz", (20.0, -35.0, 140.0), degrees=True)
        wanted = (frame * Rotation.from_euler("xyz", target[3:], degrees=True)).as_matrix()
        np.testing.assert_allclose(arm.fk(q).rotation, wanted, atol=1e-12)
        solutions = arm.joints_from_program(target).solutions
        counts.add(len(solutions))
        for solution in solutions:
            pose = arm.fk(solution.q_deg)
            np.testing.assert_allclose(pose.rotation, wanted, atol=1e-8)
            np.testing.assert_allclose(pose.xyz_mm, arm.fk(q).xyz_mm, atol=1e-8)
    assert max(counts) == 4


@pytest.mark.parametrize("name", ["thesis", "odd frame", "odd frame and tool"])
def test_batch_is_scalar(name: str) -> None:
    arm = ARMS[name]
    q = random_joints(arm, 400, seed=52, margin_deg=1.0)
    targets = np.array([arm.program_from_joints(row) for row in q])
    answers = {branch: arm.joints_from_program_batch(targets, branch) for branch in Branch}
    for index, row in enumerate(q):
        solved, ok, residual = answers[arm.branch_of(row)]
        assert ok[index]
        assert residual[index] <= 1e-6
        np.testing.assert_allclose(solved[index], row, atol=1e-6)


def test_batch_along_a_path_does_not_jump_a_turn() -> None:
    """Roll over 180 deg: as separate poses it jumps to -180, as a path it goes on (and leaves the limits)."""
    waist = np.linspace(-20.0, 60.0, 81)
    joints = np.stack((waist, 0 * waist + 40, 0 * waist - 70, 0 * waist + 30, waist + 150), axis=1)
    targets = np.array([THESIS.program_from_joints(row) for row in joints])
    alone, ok_alone, _ = THESIS.joints_from_program_batch(targets, Branch.FRONT_UP)
    path, ok_path, _ = THESIS.joints_from_program_batch(targets, Branch.FRONT_UP, joints[0])
    assert ok_alone.all()
    assert np.abs(np.diff(alone[:, 4])).max() > 300.0
    np.testing.assert_allclose(path, joints, atol=1e-9)
    np.testing.assert_array_equal(ok_path, joints[:, 4] <= 180.0 + 1e-9)


def test_straight_down_keeps_the_hand_in_the_room() -> None:
    for waist in (-60.0, 0.0, 45.0, 100.0):
        for yaw in (-30.0, 0.0, 40.0):
            x, y = 250.0 * np.cos(np.radians(waist)), -250.0 * np.sin(np.radians(waist))
            result = THESIS.joints_from_program((x, y, -100.0, 0.0, 0.0, yaw))
            assert result.best is not None
            assert result.best.q_deg[0] == pytest.approx(waist)
            assert result.best.q_deg[4] == pytest.approx(waist + yaw)


@pytest.mark.parametrize("tilt_deg", [0.02, 1.0, 5.0, 30.0, 80.0])
def test_an_orientation_out_of_the_arms_plane_is_refused_with_its_residual(tilt_deg: float) -> None:
    """Leaning the tool sideways by an angle leaves exactly that angle, wherever the waist is."""
    for waist in (0.0, 35.0, -70.0):
        x, y = 250.0 * np.cos(np.radians(waist)), -250.0 * np.sin(np.radians(waist))
        lean = Rotation.from_rotvec(np.radians(tilt_deg) * np.array((x, y, 0.0)) / 250.0)
        a, b, c = lean.as_euler("xyz", degrees=True)
        target = (float(x), float(y), -100.0, float(a), float(b), float(c))
        with pytest.raises(OrientationError) as caught:
            THESIS.joints_from_program(target)
        assert caught.value.residual_deg == pytest.approx(_least_residual(target), rel=1e-6)
        assert caught.value.residual_deg == pytest.approx(tilt_deg, rel=1e-6)
        assert caught.value.tolerance_deg == 0.01
        assert f"{caught.value.residual_deg:.4g}" in str(caught.value)
        with pytest.raises(OrientationError):
            THESIS.pose_from_program(target)
        _, ok, residual = THESIS.joints_from_program_batch(np.array([target]))
        assert not ok[0]
        assert residual[0] == pytest.approx(tilt_deg, rel=1e-6)


def _least_residual(target: tuple[float, ...]) -> float:
    """Smallest angle over all pitches and rolls at that tip, by brute minimisation: the waist is given by the tip."""
    from scipy.optimize import minimize

    wanted = Rotation.from_euler("x", 180.0, degrees=True) * Rotation.from_euler("xyz", target[3:], degrees=True)
    waist = float(np.degrees(np.arctan2(-target[1], target[0])))

    def angle(x: np.ndarray) -> float:
        rotation = THESIS.fk((waist, 0.0, 0.0, x[0], x[1])).rotation
        return float(np.degrees((wanted.inv() * Rotation.from_matrix(rotation)).magnitude()))

    answers = [
        minimize(angle, (pitch, roll), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-10})
        for pitch in (-40.0, 0.0, 40.0)
        for roll in (waist - 20, waist, waist + 20)
    ]
    return float(min(answer.fun for answer in answers))


def test_a_small_residual_is_accepted_and_the_position_kept() -> None:
    loose = Arm.from_config(with_section(THESIS_CONFIG, "machine", orientation_tolerance_deg=2.0))
    target = (250.0, 0.0, -100.0, 1.0, 0.0, 0.0)
    with pytest.raises(OrientationError):
        THESIS.joints_from_program(target)
    result = loose.joints_from_program(target)
    assert result.best is not None
    pose = loose.fk(result.best.q_deg)
    np.testing.assert_allclose(pose.xyz_mm, (250.0, 0.0, 260.0), atol=1e-9)


def test_out_of_reach_and_out_of_limits_come_as_results_not_errors() -> None:
    far = THESIS.joints_from_program((600.0, 0.0, -100.0, 0.0, 0.0, 0.0))
    assert far.status is IkStatus.UNREACHABLE
    assert far.shortfalls[0].kind is ShortfallKind.TOO_FAR
    behind = THESIS.joints_from_program((-250.0, 0.0, -100.0, 0.0, 0.0, 0.0))
    assert behind.status is IkStatus.OUT_OF_LIMITS
    assert behind.best is None
    assert "waist" in behind.reason
    pose = THESIS.pose_from_program((600.0, 0.0, -100.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(pose.xyz_mm, (600.0, 0.0, 260.0))


def test_pitch_and_roll_are_literal_in_xyzab() -> None:
    arm = ARMS["pitch and roll"]
    pose = arm.fk((10.0, 50.0, -60.0, 40.0, 25.0))
    x, y, z = arm.frame.program_from_base(pose.xyz_mm)
    target = (float(x), float(y), float(z), 30.0, 25.0, 777.0)
    result = arm.joints_from_program(target)
    assert result.best is not None
    np.testing.assert_allclose(result.best.q_deg, (10.0, 50.0, -60.0, 40.0, 25.0), atol=1e-9)
    beyond = arm.joints_from_program((*target[:4], 190.0, 0.0))
    assert beyond.status is IkStatus.OUT_OF_LIMITS  # 190 is not -170
    assert "roll would be at 190" in beyond.reason


def test_the_tip_on_the_waist_axis_takes_the_waist_from_the_approach() -> None:
    arm = ARMS["odd frame"]
    radius = 220.0 * np.cos(np.radians(98.0)) + 150.0 * np.cos(np.radians(73.0))
    q4 = 180.0 - float(np.degrees(np.arcsin(-radius / 95.0))) - 73.0
    q = (25.0, 98.0, -25.0, q4, 30.0)
    target = arm.program_from_joints(q)
    result = arm.joints_from_program(target, (0.0, 90.0, -20.0, 90.0, 0.0))
    assert result.best is not None
    np.testing.assert_allclose(result.best.q_deg, q, atol=1e-5)
    assert result.status is IkStatus.SINGULAR


def test_bad_numbers_are_refused() -> None:
    with pytest.raises(KinematicsError, match="finite"):
        THESIS.pose_from_program((np.nan, 0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(KinematicsError, match=r"\(n, 6\)"):
        THESIS.joints_from_program_batch(np.zeros((3, 5)))


def test_tool_length_acts_along_the_tool() -> None:
    for arm in (PLAIN, Arm.from_config(with_section(load_config(), "tool", tilt_deg=(15.0, -30.0), length_mm=10.0))):
        longer = arm.with_tool(42.0, (3.0, -7.0))
        for q in random_joints(arm, 30, seed=53, margin_deg=0.0):
            before, after = arm.fk(q), longer.fk(q)
            np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-12)
            moved = before.rotation.T @ (after.xyz_mm - before.xyz_mm)
            np.testing.assert_allclose(moved, (3.0, -7.0, 42.0), atol=1e-9)
        again = longer.with_tool()
        assert again.geometry == arm.geometry
        assert longer.with_tool(5.0).geometry == arm.with_tool(5.0).geometry

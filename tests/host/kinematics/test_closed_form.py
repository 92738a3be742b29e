"""The closed form against itself, against DH products, and against configurations drawn at random."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, Branch, IkStatus
from tests.support.kinematics import CONFIGS, random_joints, with_section

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
TOOLS = {
    "no tool": ARM,
    "longer": ARM.with_tool(42.0),
    "offset": ARM.with_tool(30.0, (12.0, -25.0)),
    "tilted": Arm.from_config(
        with_section(CONFIG, "tool", length_mm=20.0, offset_mm=(5.0, 8.0), tilt_deg=(15.0, -30.0))
    ).with_tool(10.0, (3.0, 4.0)),
}


@pytest.fixture(params=TOOLS.values(), ids=TOOLS.keys())
def arm(request: pytest.FixtureRequest) -> Arm:
    tool: Arm = request.param
    return tool


def test_forward_is_the_product_of_dh_matrices(arm: Arm) -> None:
    q = random_joints(arm, 200, seed=1, margin_deg=0.0)
    positions, rotations = arm.fk_batch(q)
    for row, position, rotation in zip(q, positions, rotations, strict=True):
        tool = arm.frames(row)[-1]
        pose = arm.fk(row)
        np.testing.assert_allclose(tool[:3, 3], pose.xyz_mm, atol=1e-9)
        np.testing.assert_allclose(tool[:3, :3], pose.rotation, atol=1e-12)
        np.testing.assert_allclose(position, pose.xyz_mm, atol=1e-9)
        np.testing.assert_allclose(rotation, pose.rotation, atol=1e-12)


def test_inverse_returns_to_the_pose_on_every_branch(arm: Arm) -> None:
    q = random_joints(arm, 2000, seed=2, margin_deg=0.0)
    branches = set()
    for row in q:
        pose = arm.fk(row)
        result = arm.ik(pose.xyz_mm, pose.pitch_deg, pose.roll_deg, seed_deg=row)
        assert result.solutions
        for solution in result.solutions:
            back = arm.fk(solution.q_deg)
            assert np.abs(back.xyz_mm - pose.xyz_mm).max() <= 1e-9
            assert abs((back.pitch_deg - pose.pitch_deg + 180.0) % 360.0 - 180.0) <= 1e-9
            assert back.roll_deg == pose.roll_deg
            assert arm.branch_of(solution.q_deg) is solution.branch
            branches.add(solution.branch)
        assert result.best is not None
        assert np.abs(np.subtract(result.best.q_deg, row)).max() <= 1e-6
    assert branches == set(Branch)


def test_batch_is_scalar_on_every_branch(arm: Arm) -> None:
    q = random_joints(arm, 500, seed=3, margin_deg=-20.0)
    q[:, 4] = np.clip(q[:, 4], -180.0, 180.0)
    positions, _ = arm.fk_batch(q)
    pitch = q[:, 1:4].sum(axis=1)
    answers = {branch: arm.ik_batch(positions, pitch, q[:, 4], branch) for branch in Branch}
    compared = 0
    for index, row in enumerate(q):
        result = arm.ik(positions[index], pitch[index], row[4])
        for branch, (rows, ok) in answers.items():
            scalar = [solution for solution in result.solutions if solution.branch is branch]
            if not scalar:
                assert not ok[index]
                assert np.isnan(rows[index]).all()
                continue
            assert ok[index] == scalar[0].in_limits
            if scalar[0].in_limits:
                np.testing.assert_allclose(rows[index], scalar[0].q_deg, atol=1e-7)
                compared += 1
    assert compared > 100


def test_thesis_points_lie_inside_the_limits() -> None:
    arm = Arm.from_config(load_config(CONFIGS / "thesis.toml"))
    for x, y, z in ((210, 0, -150), (0, 210, -150), (0, 340, -30), (0, 340, 30), (290, 0, -30), (290, 0, 30)):
        target = (float(x), float(y), float(z), 0.0, 0.0, 0.0)
        result = arm.joints_from_program(target)
        assert result.status is IkStatus.OK
        assert result.best is not None
        pose = arm.pose_from_program(target)
        assert abs(pose.pitch_deg) < 1e-9
        assert pose.roll_deg == pytest.approx(pose.azimuth_deg, abs=1e-9)
        assert arm.program_from_joints(result.best.q_deg) == pytest.approx(target, abs=1e-9)

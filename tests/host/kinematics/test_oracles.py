"""The closed forms against independent methods: DH products, a numerical solver, and roboticstoolbox if installed."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, Branch
from tests.support.dh_oracle import dh_chain, dh_pose, geometric_jacobian
from tests.support.kinematics import random_joints

ARM = Arm.from_config(load_config())
LENGTHS = (230.0, 220.0, 150.0, 95.0)
COUNT = 100_000


@pytest.fixture(scope="module")
def rtb_robot() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rtb = pytest.importorskip("roboticstoolbox")
    d1, a2, a3, d5 = LENGTHS
    return rtb.DHRobot(
        [
            rtb.RevoluteDH(d=d1, alpha=np.pi / 2),
            rtb.RevoluteDH(a=a2),
            rtb.RevoluteDH(a=a3),
            rtb.RevoluteDH(alpha=np.pi / 2),
            rtb.RevoluteDH(d=d5),
        ]
    )


def test_forward_agrees_with_dh_products_on_1e5_configurations() -> None:
    q = random_joints(ARM, COUNT, seed=10, margin_deg=0.0)
    positions, rotations = ARM.fk_batch(q)
    wanted_positions, wanted_rotations = dh_pose(q, *LENGTHS)
    assert np.abs(positions - wanted_positions).max() <= 1e-9
    assert np.abs(rotations - wanted_rotations).max() <= 1e-12


def test_jacobian_agrees_with_its_definition() -> None:
    q = random_joints(ARM, 20_000, seed=11, margin_deg=0.0)
    wanted = geometric_jacobian(dh_chain(q, *LENGTHS))
    assert np.abs(ARM.jacobian_batch(q) - wanted).max() <= 1e-9
    assert np.abs(ARM.jacobian(q[7]) - wanted[7]).max() <= 1e-9


def test_batch_inverse_returns_to_the_pose_and_contains_the_joints_on_1e5_configurations() -> None:
    q = random_joints(ARM, COUNT, seed=12, margin_deg=0.0)
    positions, _ = dh_pose(q, *LENGTHS)
    pitch = q[:, 1:4].sum(axis=1)
    regular = (np.abs(np.sin(np.radians(q[:, 2]))) > 1e-3) & (np.hypot(positions[:, 0], positions[:, 1]) > 1.0)
    contained = np.zeros(COUNT, dtype=bool)
    for branch in Branch:
        solved, ok = ARM.ik_batch(positions, pitch, q[:, 4], branch)
        back, _ = dh_pose(solved[ok], *LENGTHS)
        assert np.abs(back - positions[ok]).max(initial=0.0) <= 1e-9
        turned = solved[ok, 1:4].sum(axis=1) - pitch[ok]
        assert np.abs((turned + 180.0) % 360.0 - 180.0).max(initial=0.0) <= 1e-9
        assert np.array_equal(solved[ok, 4], q[ok, 4])
        with np.errstate(invalid="ignore"):
            contained |= ok & (np.abs(solved - q).max(axis=1) <= 1e-7)
    assert regular.sum() > 0.98 * COUNT
    assert contained[regular].all()


def test_scalar_inverse_returns_to_the_pose_on_1e5_configurations() -> None:
    q = random_joints(ARM, COUNT, seed=13, margin_deg=0.0)
    positions, _ = dh_pose(q, *LENGTHS)
    pitch = q[:, 1:4].sum(axis=1)
    best, every, owner = [], [], []
    for index, (position, a, row) in enumerate(zip(positions.tolist(), pitch.tolist(), q.tolist(), strict=True)):
        result = ARM.ik(position, a, row[4], row)
        assert result.best is not None
        best.append(result.best.q_deg)
        every += [solution.q_deg for solution in result.solutions]
        owner += [index] * len(result.solutions)
    regular = np.abs(np.sin(np.radians(q[:, 2]))) > 1e-3
    assert np.abs(np.array(best) - q)[regular].max() <= 1e-7
    back, _ = dh_pose(np.array(every), *LENGTHS)
    assert np.abs(back - positions[owner]).max() <= 1e-9


def test_a_numerical_solver_finds_one_of_our_branches() -> None:
    """Least squares on the DH product, from far starts: wherever it converges, the closed form has that solution."""
    q = random_joints(ARM, 120, seed=14, margin_deg=5.0)
    rng = np.random.default_rng(15)
    found = 0
    for row in q:
        position = dh_pose(row, *LENGTHS)[0][0]
        pitch, roll = float(row[1:4].sum()), float(row[4])

        def residual(angles: Any, position: Any = position, pitch: float = pitch, roll: float = roll) -> Any:
            tip = dh_pose(angles, *LENGTHS)[0][0]
            return np.concatenate((tip - position, (angles[1:4].sum() - pitch, angles[4] - roll)))

        answer = least_squares(residual, row + rng.uniform(-60.0, 60.0, 5), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.abs(answer.fun).max() > 1e-9:
            continue  # it stuck in a local minimum
        found += 1
        solutions = ARM.ik(position, pitch, roll).solutions
        misses = [
            np.abs((np.subtract(solution.q_deg, answer.x) + 180.0) % 360.0 - 180.0).max() for solution in solutions
        ]
        assert min(misses) <= 1e-6
    assert found >= 100


def test_forward_and_jacobian_agree_with_roboticstoolbox(rtb_robot: Any) -> None:
    q = random_joints(ARM, 2_000, seed=16, margin_deg=0.0)
    positions, rotations = ARM.fk_batch(q)
    jacobians = ARM.jacobian_batch(q)
    for index, row in enumerate(np.radians(q)):
        matrix = rtb_robot.fkine(row).A
        assert np.abs(matrix[:3, 3] - positions[index]).max() <= 1e-9
        assert np.abs(matrix[:3, :3] - rotations[index]).max() <= 1e-12
        assert np.abs(rtb_robot.jacob0(row) - jacobians[index]).max() <= 1e-9


def test_inverse_contains_what_roboticstoolbox_finds(rtb_robot: Any) -> None:
    chain = rtb_robot.ets()
    checked = 0
    for row in random_joints(ARM, 200, seed=17, margin_deg=5.0):
        answer = chain.ikine_LM(rtb_robot.fkine(np.radians(row)).A, q0=np.radians(row + 5.0), tol=1e-16)
        if not answer.success:
            continue
        pose = ARM.fk(row)
        solutions = ARM.ik(pose.xyz_mm, pose.pitch_deg, pose.roll_deg).solutions
        found = np.degrees(answer.q)
        if abs((found[1:4].sum() - pose.pitch_deg + 180.0) % 360.0 - 180.0) > 1e-6:
            continue  # the other way to hold this orientation: waist + 180
        turned = [np.abs((np.subtract(s.q_deg, found) + 180.0) % 360.0 - 180.0).max() for s in solutions]
        assert min(turned) <= 1e-4
        checked += 1
    assert checked >= 100

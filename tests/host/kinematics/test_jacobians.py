"""Jacobians against differences of the forward kinematics, and what is derived from them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, KinematicsError
from rm501_host.kinematics.rates import task_rates_of_twist
from tests.support.kinematics import CONFIGS, random_joints, with_section

Array = npt.NDArray[np.float64]
CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
OFFSET = ARM.with_tool(30.0, (12.0, -25.0))
TILTED = Arm.from_config(with_section(CONFIG, "tool", length_mm=20.0, offset_mm=(5.0, 8.0), tilt_deg=(15.0, -30.0)))
THESIS = Arm.from_config(load_config(CONFIGS / "thesis.toml"))
ARMS = pytest.mark.parametrize("arm", [ARM, OFFSET, TILTED], ids=["plain", "offset", "tilted"])
STEP_RAD = 2e-4


def derivative(function: Callable[[Array], Array], q_deg: Array, direction_deg: Array) -> Array:
    """Central difference of fourth order of function(q + t direction) by t in rad."""
    h = np.degrees(STEP_RAD)
    value = [function(q_deg + factor * h * direction_deg) for factor in (-2.0, -1.0, 1.0, 2.0)]
    return (value[0] - 8 * value[1] + 8 * value[2] - value[3]) / (12 * STEP_RAD)


def angular_part(arm: Arm, q: Array, direction: Array) -> Array:
    """omega from R' R^T by differences."""
    rate = derivative(lambda p: arm.fk(p).rotation, q, direction) @ arm.fk(q).rotation.T
    return 0.5 * np.array((rate[2, 1] - rate[1, 2], rate[0, 2] - rate[2, 0], rate[1, 0] - rate[0, 1]))


@ARMS
def test_geometric_jacobian_is_the_derivative(arm: Arm) -> None:
    worst = 0.0
    for q in random_joints(arm, 300, seed=20, margin_deg=0.0):
        matrix = arm.jacobian(q)
        for joint, unit in enumerate(np.eye(5)):
            linear = derivative(lambda p: arm.fk(p).xyz_mm, q, unit)
            worst = max(worst, np.abs(matrix[:3, joint] - linear).max())
            worst = max(worst, np.abs(matrix[3:, joint] - angular_part(arm, q, unit)).max())
    assert worst <= 1e-6


@ARMS
def test_task_jacobian_and_its_closed_inverse(arm: Arm) -> None:
    q = random_joints(arm, 500, seed=21, margin_deg=2.0)
    rates = np.random.default_rng(22).uniform(-30.0, 30.0, q.shape)
    matrices = arm.task_jacobian_batch(q)
    np.testing.assert_allclose(matrices[3], arm.task_jacobian(q[3]), atol=1e-12)
    np.testing.assert_allclose(matrices[:, :3], arm.jacobian_batch(q)[:, :3], atol=1e-12)
    task = np.einsum("nij,nj->ni", matrices, np.radians(rates))
    task[:, 3:] = np.degrees(task[:, 3:])
    np.testing.assert_allclose(task[:, 3], rates[:, 1:4].sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(task[:, 4], rates[:, 4], atol=1e-9)
    np.testing.assert_allclose(arm.joint_rates_batch(q, task), rates, atol=1e-6)


@ARMS
def test_jacobian_rate_and_bias(arm: Arm) -> None:
    rng = np.random.default_rng(23)
    for q in random_joints(arm, 60, seed=24, margin_deg=0.0):
        rates = rng.uniform(-30.0, 30.0, 5)
        by_time = derivative(arm.jacobian, q, rates) * np.radians(1.0)
        rate = arm.jacobian_rate(q, rates)
        assert np.abs(rate - by_time).max() <= 1e-6
        bias = arm.task_bias_batch(q[None], rates[None])[0]
        np.testing.assert_allclose(bias[:3], rate[:3] @ np.radians(rates), atol=1e-8)
        assert not bias[3:].any()


def test_path_accelerations_follow_from_bias_and_inverse() -> None:
    """q'' along a straight line, from the closed forms and from differences of the inverse kinematics."""
    start, unit = np.array((320.0, -80.0, 180.0)), np.array((0.6, 0.8, 0.0))
    speed = 40.0
    times = np.array((-2.0, -1.0, 0.0, 1.0, 2.0)) * 1e-2
    q, ok = ARM.ik_batch(start + speed * times[:, None] * unit, 20.0, 10.0)
    assert ok.all()
    task = np.array((*speed * unit, 0.0, 0.0))[None]
    rates = ARM.joint_rates_batch(q[2:3], task)
    accelerations = ARM.joint_rates_batch(q[2:3], -ARM.task_bias_batch(q[2:3], rates))
    second = (-q[0] + 16 * q[1] - 30 * q[2] + 16 * q[3] - q[4]) / (12 * 1e-4)
    first = (q[0] - 8 * q[1] + 8 * q[3] - q[4]) / (12 * 1e-2)
    np.testing.assert_allclose(rates[0], first, atol=1e-6)
    np.testing.assert_allclose(accelerations[0], second, atol=1e-6)


@ARMS
@pytest.mark.parametrize("name", ["rpy", "zxz"])
def test_analytical_jacobian_is_the_derivative_of_the_angles(arm: Arm, name: str) -> None:
    from rm501_host.kinematics import rotations

    def angles(p: Array) -> Array:
        rotation = arm.fk(p).rotation
        return np.radians(rotations.rpy_from_matrix(rotation) if name == "rpy" else rotations.zxz_from_matrix(rotation))

    for q in random_joints(arm, 60, seed=25, margin_deg=3.0):
        matrix = arm.rpy_jacobian(q) if name == "rpy" else arm.zxz_jacobian(q)
        if np.abs(matrix[3:]).max() > 20.0:
            continue  # near gimbal lock the differences are worth nothing
        for joint, unit in enumerate(np.eye(5)):
            steps = [angles(q + factor * np.degrees(STEP_RAD) * unit) for factor in (-2.0, -1.0, 1.0, 2.0)]
            unwrapped = np.unwrap(np.array(steps), axis=0)
            slope = (unwrapped[0] - 8 * unwrapped[1] + 8 * unwrapped[2] - unwrapped[3]) / (12 * STEP_RAD)
            np.testing.assert_allclose(matrix[3:, joint], slope, atol=1e-6)


def test_analytical_jacobians_say_gimbal_lock() -> None:
    with pytest.raises(KinematicsError, match="gimbal lock"):
        ARM.zxz_jacobian((0.0, 45.0, -90.0, 45.0, 0.0))  # straight down: theta = 180
    with pytest.raises(KinematicsError, match="gimbal lock"):
        ARM.rpy_jacobian((0.0, 0.0, 0.0, 90.0, 0.0))  # tool level, r31 = s234 c5 = 1


@pytest.mark.parametrize("arm", [ARM, THESIS], ids=["XYZAB", "XYZABC"])
def test_program_jacobian_is_the_derivative_of_the_program_coordinates(arm: Arm) -> None:
    count = 6 if arm.frame.has_rpy else 5
    for q in random_joints(arm, 40, seed=26, margin_deg=3.0):
        matrix = arm.program_jacobian(q)
        assert matrix.shape == (count, 5)
        if np.abs(matrix[3:]).max() > 20.0:
            continue
        for joint, unit in enumerate(np.eye(5)):
            steps = np.array(
                [arm.program_from_joints(q + f * np.degrees(STEP_RAD) * unit) for f in (-2.0, -1.0, 1.0, 2.0)]
            )
            steps[:, 3:] = np.unwrap(np.radians(steps[:, 3:]), axis=0)
            slope = (steps[0] - 8 * steps[1] + 8 * steps[2] - steps[3]) / (12 * STEP_RAD)
            np.testing.assert_allclose(matrix[:, joint], slope[:count], atol=1e-6)


@ARMS
def test_pitch_and_roll_rates_come_out_of_a_twist(arm: Arm) -> None:
    rng = np.random.default_rng(27)
    for q in random_joints(arm, 50, seed=28, margin_deg=0.0):
        rates = rng.uniform(-40.0, 40.0, 5)
        omega = arm.jacobian(q)[3:] @ rates
        pitch, roll = task_rates_of_twist(q, rates[0], omega)
        assert pitch == pytest.approx(rates[1:4].sum(), abs=1e-9)
        assert roll == pytest.approx(rates[4], abs=1e-9)


def test_rates_of_a_singular_row_are_not_finite_and_the_others_are() -> None:
    q = np.array([(0.0, 30.0, -40.0, 50.0, 0.0), (0.0, 30.0, 0.0, 50.0, 0.0)])
    rates = ARM.joint_rates_batch(q, np.tile((10.0, 0.0, 5.0, 1.0, 0.0), (2, 1)))
    assert np.isfinite(rates[0]).all()
    assert not np.isfinite(rates[1]).all()
    with pytest.raises(KinematicsError, match="shape"):
        ARM.joint_rates_batch(q, np.zeros((3, 5)))

"""Joint and motor space: the differential wrist, steps, and the polytope."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, GeometryError, KinematicsError, MotorSpace
from tests.support.kinematics import random_joints, with_section

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)


def test_wrist_and_signs_as_in_the_machine_description() -> None:
    motors = ARM.motors.motor_deg_from_joints(np.array((1.0, 2.0, 3.0, 10.0, 4.0)))
    np.testing.assert_allclose(motors, (1.0, -2.0, -3.0, 4.0 - 10.0, 4.0 + 10.0))
    steps = ARM.motors_from_joints((1.0, 0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(steps, (40.0, 0.0, 0.0, 0.0, 0.0))
    pitch = ARM.motors_from_joints((0.0, 0.0, 0.0, 1.0, 0.0))
    np.testing.assert_allclose(pitch, (0.0, 0.0, 0.0, -26.66666, 26.66666))


@pytest.mark.parametrize("wrist", [((-1.0, 1.0), (1.0, 1.0)), ((0.5, 2.0), (-1.5, 0.25))])
def test_there_and_back_one_and_many(wrist: tuple[tuple[float, float], tuple[float, float]]) -> None:
    arm = Arm.from_config(with_section(CONFIG, "drive", wrist_matrix=wrist))
    q = random_joints(arm, 50, seed=70, margin_deg=0.0)
    steps = arm.motors_from_joints(q)
    assert steps.shape == (50, 5)
    np.testing.assert_allclose(arm.joints_from_motors(steps), q, atol=1e-10)
    np.testing.assert_allclose(arm.motors_from_joints(q[3]), steps[3])
    with pytest.raises(KinematicsError, match="shape"):
        arm.motors_from_joints(np.zeros((2, 6)))


def test_singular_wrist_is_refused_naming_the_key() -> None:
    with pytest.raises(GeometryError) as caught:
        MotorSpace.from_config(with_section(CONFIG, "drive", wrist_matrix=((1.0, 1.0), (1.0, 1.0))))
    assert caught.value.key == "drive.wrist_matrix"


def test_velocity_polytope_is_the_motors_and_the_joints() -> None:
    limits = ARM.motors.velocity_limits
    rng = np.random.default_rng(71)
    wrist_max = 1250.0 / 26.66666
    for rates in rng.uniform(-60.0, 60.0, (500, 5)):
        joints = max(abs(rates[0]) / 30, abs(rates[1]) / 30, abs(rates[2]) / 30, abs(rates[3]) / 45, abs(rates[4]) / 45)
        motors = max(
            *(abs(rates[i]) / 31.25 for i in range(3)),
            (abs(rates[3]) + abs(rates[4])) / wrist_max,  # whatever the signs: the larger of |a - b|, |a + b|
        )
        assert limits.ratio(rates) == pytest.approx(max(joints, motors))
    inside, outside = np.array((0, 0, 0, 23.0, 23.0)), np.array((0, 0, 0, 24.0, -24.0))
    assert limits.ratio(inside) < 1.0 < limits.ratio(outside)
    name, ratio = limits.worst(outside)
    assert name == "motor right_wrist"
    assert ratio == pytest.approx(48.0 / wrist_max)
    np.testing.assert_allclose(limits.ratio(np.stack((inside, outside))), [limits.ratio(inside), ratio])


def test_acceleration_limits_in_steps() -> None:
    np.testing.assert_allclose(
        ARM.motors.max_acceleration_steps_s2, (8000.0, 840.0, 840.0, 21 * 26.66666, 21 * 26.66666)
    )
    assert ARM.motors.acceleration_limits.worst(np.array((0, 0, 0, 15.0, 15.0)))[0] == "motor left_wrist"

"""Rotations against two independent libraries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from rm501_host.kinematics import KinematicsError, rotations
from rm501_host.kinematics import quaternions as quat

SAMPLES = Rotation.from_quat(np.random.default_rng(60).normal(size=(300, 4)))
ANGLES = st.floats(-360.0, 360.0)
UNIT = st.floats(-1.0, 1.0)


def test_rpy_and_zxz_against_scipy() -> None:
    for sample in SAMPLES:
        matrix = sample.as_matrix()
        rpy, zxz = rotations.rpy_from_matrix(matrix), rotations.zxz_from_matrix(matrix)
        np.testing.assert_allclose(rpy, sample.as_euler("xyz", degrees=True), atol=1e-9)
        np.testing.assert_allclose(zxz, sample.as_euler("ZXZ", degrees=True), atol=1e-9)
        np.testing.assert_allclose(rotations.matrix_from_rpy(rpy), matrix, atol=1e-12)
        np.testing.assert_allclose(rotations.matrix_from_zxz(zxz), matrix, atol=1e-12)


@given(ANGLES, st.sampled_from([-90.0, 90.0]), ANGLES)
def test_gimbal_lock_gives_back_the_same_rotation(roll: float, pitch: float, yaw: float) -> None:
    matrix = rotations.matrix_from_rpy((roll, pitch, yaw))
    again = rotations.rpy_from_matrix(matrix)
    assert again[2] == 0.0
    np.testing.assert_allclose(rotations.matrix_from_rpy(again), matrix, atol=1e-9)


@given(ANGLES, st.sampled_from([0.0, 180.0]), ANGLES)
def test_zxz_without_a_line_of_nodes(phi: float, theta: float, psi: float) -> None:
    matrix = rotations.matrix_from_zxz((phi, theta, psi))
    again = rotations.zxz_from_matrix(matrix)
    assert again[2] == 0.0
    np.testing.assert_allclose(rotations.matrix_from_zxz(again), matrix, atol=1e-9)


def test_quaternion_and_axis_angle_against_scipy() -> None:
    half_turns = Rotation.from_rotvec(np.pi * np.array([(1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (0.6, 0.8, 0)]))
    for sample in (*SAMPLES, *half_turns, Rotation.identity()):
        matrix = sample.as_matrix()
        quaternion = quat.quaternion_from_matrix(matrix)
        wanted = np.roll(sample.as_quat(), 1)  # scalar first
        assert abs(float(np.dot(quaternion, wanted))) == pytest.approx(1.0, abs=1e-12)
        assert quaternion[0] >= 0.0
        np.testing.assert_allclose(quat.matrix_from_quaternion(quaternion), matrix, atol=1e-12)
        axis, angle = quat.axis_angle_from_matrix(matrix)
        assert angle == pytest.approx(np.degrees(sample.magnitude()), abs=1e-9)
        np.testing.assert_allclose(quat.matrix_from_axis_angle(axis, angle), matrix, atol=1e-12)
        assert rotations.angle_between_deg(np.eye(3), matrix) == pytest.approx(angle, abs=1e-9)


def test_rotations_against_pytransform3d() -> None:
    other = pytest.importorskip("pytransform3d.rotations")
    for sample in SAMPLES[:50]:
        matrix = sample.as_matrix()
        mine = quat.quaternion_from_matrix(matrix)
        theirs = other.quaternion_from_matrix(matrix)
        assert abs(float(np.dot(mine, theirs))) == pytest.approx(1.0, abs=1e-12)
        axis, angle = quat.axis_angle_from_matrix(matrix)
        np.testing.assert_allclose(other.matrix_from_axis_angle((*axis, np.radians(angle))), matrix, atol=1e-12)


def test_small_angles_keep_their_digits() -> None:
    for angle in (1e-3, 1e-6, 1e-9):
        turn = quat.matrix_from_axis_angle((0.3, -0.5, 0.8), angle)
        assert rotations.angle_between_deg(np.eye(3), turn) == pytest.approx(angle, rel=1e-6)
        rows = np.stack((turn, np.eye(3)))
        both = rotations.angles_between_deg(np.stack((np.eye(3), np.eye(3))), rows)
        np.testing.assert_allclose(both, (angle, 0.0), rtol=1e-6, atol=1e-15)


def test_interpolation_against_slerp() -> None:
    fractions = np.linspace(0.0, 1.0, 11)
    for start, end in zip(SAMPLES[:60], SAMPLES[60:120], strict=True):
        mine = quat.interpolate_rotation(start.as_matrix(), end.as_matrix(), fractions)
        theirs = Slerp([0.0, 1.0], Rotation.concatenate([start, end]))(fractions).as_matrix()
        np.testing.assert_allclose(mine, theirs, atol=1e-9)
    near = quat.matrix_from_axis_angle((0, 0, 1), 1e-5)
    mine = quat.interpolate_rotation(np.eye(3), near, np.array([0.5]))[0]
    np.testing.assert_allclose(mine, quat.matrix_from_axis_angle((0, 0, 1), 0.5e-5), atol=1e-15)


@given(ANGLES, ANGLES, ANGLES)
def test_batch_is_scalar(roll: float, pitch: float, yaw: float) -> None:
    rows = rotations.matrices_from_rpy(np.array([(roll, pitch, yaw), (0.0, 0.0, 0.0)]))
    np.testing.assert_allclose(rows[0], rotations.matrix_from_rpy((roll, pitch, yaw)), atol=1e-15)
    np.testing.assert_allclose(rows[1], np.eye(3))


@given(ANGLES, ANGLES, ANGLES, UNIT, UNIT, UNIT)
def test_angle_rates_give_the_angular_velocity(a: float, b: float, c: float, da: float, db: float, dc: float) -> None:
    """omega = E rates, against R' R^T by differences, for both sets of angles."""
    for to_matrix, to_angular in (
        (rotations.matrix_from_rpy, rotations.angular_from_rpy_rates),
        (rotations.matrix_from_zxz, rotations.angular_from_zxz_rates),
    ):
        h = 1e-5
        step = np.degrees(h) * np.array((da, db, dc))
        angles = np.array((a, b, c))
        rate = (to_matrix(angles + step) - to_matrix(angles - step)) / (2 * h) @ to_matrix(angles).T
        omega = np.array((rate[2, 1], rate[0, 2], rate[1, 0]))
        np.testing.assert_allclose(to_angular(angles) @ (da, db, dc), omega, atol=1e-8)


def test_what_is_no_rotation_is_refused() -> None:
    with pytest.raises(KinematicsError, match="length above 0"):
        quat.matrix_from_quaternion((0.0, 0.0, 0.0, 0.0))
    with pytest.raises(KinematicsError, match="axis"):
        quat.matrix_from_axis_angle((0.0, 0.0, 0.0), 10.0)

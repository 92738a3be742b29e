"""One test per row of docs/errata.md: the corrected form holds, the printed one does not."""

from __future__ import annotations

import re
from math import atan2, cos, degrees, hypot, pi, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import linprog

from rm501_host.config import load_config
from rm501_host.gcode import interpret, resolve
from rm501_host.kinematics import Arm, Branch, IkStatus, minors, rotations
from rm501_host.kinematics.singularities import task_determinant
from rm501_host.kinematics.velocity_inverse import damped_rates
from rm501_host.moves import Dwell, PathModeChange
from rm501_protocol.board_config import INPUT_LINES, OUTPUT_LINES, BoardConfig, InputId, Motor, SlotSource
from tests.support.kinematics import CONFIGS, random_joints

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
THESIS = Arm.from_config(load_config(CONFIGS / "thesis.toml"))
D1, A2, A3, D5 = 230.0, 220.0, 150.0, 95.0
SAMPLES = random_joints(ARM, 200, seed=100, margin_deg=2.0)
DOCUMENT = Path(__file__).parents[3] / "docs" / "errata.md"
RNG = np.random.default_rng(101)


class Sines:
    """cos and sin of q1, q2, q2 + q3, q2 + q3 + q4."""

    def __init__(self, q_deg: np.ndarray) -> None:
        q1, q2, q3, q4, _ = np.radians(q_deg)
        self.c1, self.s1 = float(np.cos(q1)), float(np.sin(q1))
        self.c2, self.s2 = float(np.cos(q2)), float(np.sin(q2))
        self.c23, self.s23 = float(np.cos(q2 + q3)), float(np.sin(q2 + q3))
        self.c234, self.s234 = float(np.cos(q2 + q3 + q4)), float(np.sin(q2 + q3 + q4))


def test_every_row_of_the_document_has_its_test() -> None:
    rows = re.findall(r"^\| (E\d\d) \|", DOCUMENT.read_text("utf-8"), flags=re.MULTILINE)
    tests = [name for name in globals() if re.match(r"test_e\d\d_", name)]
    assert rows == [f"E{number:02d}" for number in range(1, len(rows) + 1)]
    assert sorted(rows) == sorted(name[5:8].upper() for name in tests)


def test_e01_turn_about_z() -> None:
    turn = rotations.matrix_from_rpy((0.0, 0.0, 30.0))
    homogeneous = np.eye(4)
    homogeneous[:3, :3] = turn
    np.testing.assert_allclose(homogeneous[2:, 2:], np.eye(2), atol=1e-15)
    printed = homogeneous.copy()
    printed[2:, 2:] = 0.0
    assert abs(np.linalg.det(homogeneous) - 1.0) < 1e-12
    assert abs(np.linalg.det(printed)) < 1e-12  # no rigid motion


def test_e02_links_without_twist() -> None:
    chain = ARM.frames(SAMPLES[0])
    for link in (2, 5):
        step = np.linalg.inv(chain[link - 1]) @ chain[link]
        assert abs(step[2, 1]) < 1e-12
        printed = step.copy()
        printed[2, 1] = 1.0
        assert np.abs(printed[:3, :3].T @ printed[:3, :3] - np.eye(3)).max() > 0.5


def test_e03_roll_from_a_matrix() -> None:
    rotation = rotations.matrix_from_rpy((25.0, 40.0, -70.0))
    assert rotations.rpy_from_matrix(rotation) == pytest.approx((25.0, 40.0, -70.0))
    assert degrees(atan2(rotation[1, 2], rotation[2, 2])) != pytest.approx(25.0, abs=1.0)


def planar(q_deg: np.ndarray) -> tuple[float, float, float, float]:
    """dx, dz, s3, c3 of the wrist centre in the arm's plane."""
    t = Sines(q_deg)
    q3 = radians(float(q_deg[2]))
    return A2 * t.c2 + A3 * t.c23, A2 * t.s2 + A3 * t.s23, sin(q3), cos(q3)


def test_e04_shoulder_angle() -> None:
    wrong = 0
    for q in SAMPLES:
        dx, dz, s3, c3 = planar(q)
        assert degrees(atan2(dz, dx) - atan2(A3 * s3, A2 + A3 * c3)) == pytest.approx(q[1], abs=1e-9)
        wrong += abs(degrees(atan2(dz, dx) - atan2(A3 * s3, A2 + A3 * s3)) - q[1]) > 1.0
    assert wrong > 150


def test_e05_wrist_radius_at_any_waist() -> None:
    for waist in (-90.0, 90.0, 33.0):
        q = np.array((waist, 40.0, -60.0, 60.0, 0.0))
        x, y, _ = ARM.fk(q).xyz_mm
        t = Sines(q)
        dx, _, _, _ = planar(q)
        assert x * t.c1 + y * t.s1 - D5 * t.s234 == pytest.approx(dx, abs=1e-9)
        result = ARM.ik((x, y, ARM.fk(q).xyz_mm[2]), 40.0, 0.0, q)
        assert result.best is not None
        np.testing.assert_allclose(result.best.q_deg, q, atol=1e-9)
    off_axis = x + 1e-9  # px / c1 multiplies the rounding of px without bound as c1 goes to 0
    assert abs(off_axis / cos(radians(90.0 - 1e-9)) - x / cos(radians(90.0 - 1e-9))) > 10.0


def test_e06_transcendental_pair() -> None:
    for q in SAMPLES:
        dx, dz, s3, c3 = planar(q)
        a, b, theta = A2 + A3 * c3, A3 * s3, radians(float(q[1]))
        assert a * cos(theta) - b * sin(theta) == pytest.approx(dx, abs=1e-9)
        assert a * sin(theta) + b * cos(theta) == pytest.approx(dz, abs=1e-9)
    printed = [abs(a_sin(q) - planar(q)[0]) for q in SAMPLES]
    assert max(printed) > 100.0


def a_sin(q_deg: np.ndarray) -> float:
    """The printed first equation's left-hand side, a sin - b cos, said to be dx."""
    _, _, s3, c3 = planar(q_deg)
    theta = radians(float(q_deg[1]))
    return (A2 + A3 * c3) * sin(theta) - A3 * s3 * cos(theta)


def test_e07_jacobian_row_1_column_2() -> None:
    for q in SAMPLES[:50]:
        t = Sines(q)
        assert ARM.jacobian(q)[0, 1] == pytest.approx(-t.c1 * (A3 * t.s23 + A2 * t.s2 - D5 * t.c234), abs=1e-9)
    printed = -t.c1 * (A3 * t.s23 + A2 * t.s2 * D5 * t.c234)
    assert abs(ARM.jacobian(q)[0, 1] - printed) > 1.0


def test_e08_jacobian_row_2_and_last_row() -> None:
    for q in SAMPLES[:50]:
        t = Sines(q)
        matrix = ARM.jacobian(q)
        assert matrix[1, 2] == pytest.approx(-t.s1 * (A3 * t.s23 - D5 * t.c234), abs=1e-9)
        np.testing.assert_allclose(matrix[5], (1.0, 0.0, 0.0, 0.0, -t.c234), atol=1e-12)
    assert abs(matrix[1, 2] + t.s1 * A3 * (A3 * t.s23 - D5 * t.c234)) > 1.0


def test_e09_rates_of_roll_pitch_yaw() -> None:
    angles, rates, h = np.array((20.0, -35.0, 50.0)), np.array((0.3, -0.5, 0.8)), 1e-6
    before = rotations.matrix_from_rpy(angles - np.degrees(h * rates))
    after = rotations.matrix_from_rpy(angles + np.degrees(h * rates))
    spin = (after - before) / (2 * h) @ rotations.matrix_from_rpy(angles).T
    omega = np.array((spin[2, 1], spin[0, 2], spin[1, 0]))
    np.testing.assert_allclose(rotations.angular_from_rpy_rates(angles) @ rates, omega, atol=1e-8)
    phi, theta = np.radians(angles[0]), np.radians(angles[1])
    printed = np.array(
        (
            (1.0, 0.0, np.sin(theta)),
            (0.0, np.cos(phi), -np.cos(theta) * np.sin(phi)),
            (0.0, np.sin(phi), np.cos(theta) * np.sin(phi)),
        )
    )
    assert np.abs(printed @ rates - omega).max() > 0.1


def test_e10_damped_least_squares() -> None:
    matrix, wish, factor = ARM.jacobian(SAMPLES[0]) / 100.0, RNG.normal(size=6), 0.3
    answer = damped_rates(matrix, wish, factor)
    cost = np.linalg.norm(matrix @ answer - wish) ** 2 + factor**2 * np.linalg.norm(answer) ** 2
    for _ in range(50):
        other = answer + RNG.normal(size=5) * 0.01
        assert np.linalg.norm(matrix @ other - wish) ** 2 + factor**2 * np.linalg.norm(other) ** 2 > cost
    np.testing.assert_allclose(
        matrix.T @ np.linalg.solve(matrix @ matrix.T + factor**2 * np.eye(6), wish), answer, atol=1e-9
    )
    with pytest.raises(ValueError, match="broadcast"):
        matrix.T + factor**2 * np.eye(6)  # the printed J^T + l^2 I adds a 5x6 to a 6x6 matrix


def test_e11_damped_singular_values() -> None:
    matrix, wish, factor = ARM.jacobian(SAMPLES[1]) / 100.0, RNG.normal(size=6), 0.3
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    wanted = damped_rates(matrix, wish, factor)
    np.testing.assert_allclose(vt.T @ (s / (s**2 + factor**2) * (u.T @ wish)), wanted, atol=1e-9)
    assert np.abs(vt.T @ (s / (s + factor**2) * (u.T @ wish)) - wanted).max() > 1e-2


def test_e12_manipulability_and_condition() -> None:
    for q in SAMPLES[:50]:
        t = Sines(q)
        matrix = ARM.jacobian(q)
        r = A2 * t.c2 + A3 * t.c23 + D5 * t.s234
        closed = A2 * A3 * abs(sin(radians(q[2]))) * hypot(r, t.s234)
        assert ARM.manipulability(q) == pytest.approx(closed)
        assert ARM.manipulability(q) == pytest.approx(sqrt(np.linalg.det(matrix.T @ matrix)), rel=1e-6)
        weighted = np.diag((1 / A2, 1 / A2, 1 / A2, 1, 1, 1)) @ matrix
        assert ARM.ellipsoid(q).condition == pytest.approx(np.linalg.cond(weighted))
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.det(matrix.T)  # not square


def test_e13_shoulder_singularity() -> None:
    q23 = degrees(np.arccos(-A2 * cos(radians(100.0)) / A3))
    q = np.array((0.0, 100.0, q23 - 100.0, 180.0 - q23, 0.0))  # tool straight up: q234 = 180
    c4 = cos(radians(q[3]))
    assert np.linalg.matrix_rank(ARM.jacobian(q), tol=1e-6) == 4
    assert np.abs(minors.minors(ARM.geometry, q)).max() < 1e-6
    assert abs(A2 * cos(radians(100.0)) + A3 * c4) > 50.0  # the printed condition does not hold here


def test_e14_waist_axis_is_singular_for_the_task() -> None:
    lean = -(A2 * cos(radians(98.0)) + A3 * cos(radians(73.0))) / D5
    q = np.array((10.0, 98.0, -25.0, 180.0 - degrees(np.arcsin(lean)) - 73.0, 0.0))
    assert abs(lean) > 0.1
    assert np.linalg.matrix_rank(ARM.jacobian(q), tol=1e-6) == 5
    assert abs(np.linalg.det(ARM.task_jacobian(q))) < 1e-6
    for sample in SAMPLES[:20]:
        t = Sines(sample)
        wanted = A2 * A3 * sin(radians(sample[2])) * (A2 * t.c2 + A3 * t.c23 + D5 * t.s234)
        assert abs(task_determinant(ARM.geometry, sample)) == pytest.approx(abs(wanted))
        assert abs(np.linalg.det(ARM.task_jacobian(sample))) == pytest.approx(abs(wanted))


def test_e15_pitch_from_the_rotation() -> None:
    wrong = 0
    for q in SAMPLES:
        rotation = ARM.fk(q).rotation
        t = Sines(q)
        across = t.c1 * rotation[0, 2] + t.s1 * rotation[1, 2]
        pitch = float(q[1:4].sum())
        assert abs((degrees(atan2(across, -rotation[2, 2])) - pitch + 180.0) % 360.0 - 180.0) < 1e-9
        wrong += abs((degrees(atan2(-rotation[2, 2], across)) - pitch + 180.0) % 360.0 - 180.0) > 1.0
    assert wrong > 190


def test_e16_the_inverse_is_complete() -> None:
    for q in SAMPLES:
        pose = ARM.fk(q)
        result = ARM.ik(pose.xyz_mm, pose.pitch_deg, pose.roll_deg, q)
        assert result.best is not None
        np.testing.assert_allclose(result.best.q_deg, q, atol=1e-6)


def test_e17_branch_flags() -> None:
    seen = set()
    for q in SAMPLES:
        pose = ARM.fk(q)
        solutions = ARM.ik(pose.xyz_mm, pose.pitch_deg, pose.roll_deg).solutions
        branches = [solution.branch for solution in solutions]
        assert len(branches) == len(set(branches))  # one solution a branch: the wrist has one way
        for solution in solutions:
            assert ARM.branch_of(solution.q_deg) is solution.branch
            assert (sin(radians(solution.q_deg[2])) <= 0.0) == solution.branch.is_elbow_up
        seen |= set(branches)
    assert seen == set(Branch)


def test_e18_blend_time() -> None:
    q0, qf, tf, a = 10.0, 70.0, 5.0, 20.0
    blend = tf / 2 - 0.5 * sqrt((tf**2 * a - 4 * (qf - q0)) / a)
    printed = tf / 2 - sqrt((tf**2 * a - 4 * (qf - q0)) / (2 * a))

    def travelled(t: float) -> float:
        return a * t * t + a * t * (tf - 2 * t)  # two parabolas and the line between them

    assert travelled(blend) == pytest.approx(qf - q0)
    assert abs(travelled(printed) - (qf - q0)) > 1.0


def test_e19_parabolic_blend() -> None:
    start, along, next_, v1, v2, dt = np.array((1.0, 2.0)), np.array((1.0, 0.0)), np.array((0.6, 0.8)), 10.0, 6.0, 0.4
    times = np.linspace(0.0, dt, 4001)
    velocity = (1 - times / dt)[:, None] * v1 * along + (times / dt)[:, None] * v2 * next_
    end = start + trapezoid(velocity, times, axis=0)
    np.testing.assert_allclose(start + dt / 2 * (v1 * along + v2 * next_), end, atol=1e-9)
    assert np.abs(start + dt / 2 * v1 * along + v2 * next_ - end).max() > 1.0


def curve(s: np.ndarray | float) -> np.ndarray:
    return np.array((np.sin(2.0 * s), s * s - 0.5 * s, 0.7 * np.cos(s) - s))


def slopes(s: float) -> tuple[np.ndarray, np.ndarray]:
    first = np.array((2 * np.cos(2 * s), 2 * s - 0.5, -0.7 * np.sin(s) - 1.0))
    return first, np.array((-4 * np.sin(2 * s), 2.0, -0.7 * np.cos(s)))


def test_e20_path_acceleration() -> None:
    s, rate, push, h = 0.9, 1.3, -0.4, 1e-4

    def at(t: float) -> np.ndarray:
        return curve(s + rate * t + 0.5 * push * t * t)

    first, second = slopes(s)
    by_time = (at(h) - 2 * at(0.0) + at(-h)) / h**2
    np.testing.assert_allclose(first * push + second * rate**2, by_time, atol=1e-6)
    assert np.abs(first * rate - by_time).max() > 1.0
    most = np.array((9.0, 7.0, 5.0))
    closed = np.min(most / np.abs(first) - second * rate**2 / first)
    above = np.concatenate((most - second * rate**2, most + second * rate**2))
    best = linprog([-1.0], A_ub=np.concatenate((first, -first))[:, None], b_ub=above, bounds=[(None, None)])
    assert closed == pytest.approx(best.x[0])


def test_e21_path_velocity() -> None:
    first, second = slopes(0.9)
    most_rate, most = np.array((3.0, 2.0, 4.0)), np.array((9.0, 7.0, 5.0))
    bound = np.min(most_rate / np.abs(first))
    assert np.max(np.abs(first * bound) / most_rate) == pytest.approx(1.0)

    def gap(rate: float) -> float:
        """Room between the highest lower and the lowest upper bound of s''."""
        middle = -second * rate**2 / first
        half = most / np.abs(first)
        return float(np.min(middle + half) - np.max(middle - half))

    meeting = min(
        sqrt((most[i] / abs(first[i]) + most[j] / abs(first[j])) / abs(second[i] / first[i] - second[j] / first[j]))
        for i in range(3)
        for j in range(i)
    )
    assert gap(meeting * 0.999) > 0.0 > gap(meeting * 1.001)


def test_e22_backward_pass() -> None:
    end, a, length = 12.0, 20.0, 9.0
    start = sqrt(end**2 + 2 * a * length)
    time = (start - end) / a
    assert (start + end) / 2 * time == pytest.approx(length)
    printed = sqrt(end + 2 * a * length)
    assert abs((printed + end) / 2 * (printed - end) / a - length) > 1.0


def cubic(q0: float, v0: float, qf: float, vf: float, t0: float, tf: float) -> np.ndarray:
    rows = [(1, t0, t0**2, t0**3), (0, 1, 2 * t0, 3 * t0**2), (1, tf, tf**2, tf**3), (0, 1, 2 * tf, 3 * tf**2)]
    return np.linalg.solve(np.array(rows, dtype=float), (q0, v0, qf, vf))


def test_e23_cubic_coefficient() -> None:
    q0, v0, qf, vf, duration = 5.0, 3.0, 40.0, -7.0, 2.5
    coefficients = cubic(q0, v0, qf, vf, 0.0, duration)
    corrected = (2 * q0 - 2 * qf + v0 * duration + vf * duration) / duration**3
    assert coefficients[3] == pytest.approx(corrected)
    assert abs((2 * q0 - 2 * qf + 2 * v0 * duration) / duration**3 - coefficients[3]) > 0.1


def test_e24_cubic_matrix() -> None:
    q0, v0, qf, vf, t0, tf = 5.0, 3.0, 40.0, -7.0, 1.0, 3.5
    a = np.polynomial.Polynomial(cubic(q0, v0, qf, vf, t0, tf))
    slope = a.deriv()
    assert (a(t0), slope(t0), a(tf), slope(tf)) == pytest.approx((q0, v0, qf, vf))


def test_e25_home_offsets() -> None:
    """Table 5, in the .ini's signs: homing labels the switch's place with HOME_OFFSET."""
    first = np.array((-150.0, -100.0, 90.0, 0.0, -67.0))
    measured = np.array((-149.9, -97.65, 89.6, 0.26, -67.37))
    deviation = measured - first
    np.testing.assert_allclose(deviation, (0.1, 2.35, -0.4, 0.26, -0.37), atol=1e-9)

    def true_minus_shown(offset: np.ndarray) -> np.ndarray:
        switch = measured  # where the switches are, as the camera saw them with the first offsets in use
        return switch - offset

    np.testing.assert_allclose(true_minus_shown(first + deviation), 0.0, atol=1e-9)
    np.testing.assert_allclose(true_minus_shown(first - deviation), 2 * deviation, atol=1e-9)  # twice as wrong
    printed = np.array((-150.1, -102.35, 90.4, -0.26, -66.63))
    np.testing.assert_allclose(first - deviation, printed, atol=1e-9)
    in_dh = printed * (1.0, -1.0, -1.0, -1.0, 1.0)
    np.testing.assert_allclose([joint.home.switch_deg for joint in CONFIG.joints.ordered], in_dh)


def test_e26_signs_of_joints_2_to_4() -> None:
    printed = {"shoulder": (-100.0, 30.0), "elbow": (0.0, 90.0), "pitch": (-180.0, 0.0)}
    for name, (low, high) in printed.items():
        joint = getattr(CONFIG.joints, name)
        assert joint.min_deg == pytest.approx(-high, abs=0.02)
        assert joint.max_deg == pytest.approx(-low, abs=0.02)
    home = ARM.fk((0.0, 100.0, -90.0, 0.0, 0.0))
    assert home.xyz_mm[2] > 300.0 and home.xyz_mm[0] > 0.0  # raised, the tool in front
    unflipped = ARM.fk((0.0, -100.0, 90.0, 0.0, 0.0))
    assert unflipped.xyz_mm[2] < 0.0  # the printed signs read as DH angles: under the table


def test_e27_wrist_speed() -> None:
    motor = CONFIG.motors.right_wrist
    fastest = motor.max_rate_steps_s / motor.steps_per_deg
    assert fastest == pytest.approx(46.875, abs=1e-3)
    limits = ARM.motors.velocity_limits
    assert limits.ratio(np.array((0.0, 0.0, 0.0, 92.0, 0.0))) > 1.9
    assert CONFIG.joints.pitch.max_velocity_deg_s < fastest


def test_e28_cartesian_limits_are_their_own() -> None:
    names = CONFIG.planner.__struct_fields__
    assert {"tcp_max_speed_mm_s", "tcp_max_acceleration_mm_s2"} <= set(names)
    assert CONFIG.planner.tcp_max_speed_mm_s != CONFIG.joints.waist.max_velocity_deg_s


def test_e29_slot_2_carries_the_hands_direction() -> None:
    slots = BoardConfig().slots.slots
    assert slots[2].step_1 == SlotSource.HAND_DIR
    entries = [entry for entry in CONFIG.board.table if entry >> 1 & 3 == 2]
    assert len(entries) == 2
    assert all(entry >> 5 & 1 for entry in entries)  # under the hand-direction select


def test_e30_crossed_pins_are_configuration() -> None:
    pins = {line.name: (line.port, line.pin) for line in OUTPUT_LINES}
    inputs = {line.name: (line.port, line.pin) for line in INPUT_LINES}
    assert (pins["RIGHT_WRIST_SELECT"], pins["LEFT_WRIST_SELECT"]) == ((1, 5), (1, 6))
    assert (inputs["SWITCH_ROLL"], inputs["SWITCH_PITCH"]) == ((1, 12), (1, 13))
    assert CONFIG.board.wiring.swap_wrist_selects is False
    assert CONFIG.board.wiring.swap_wrist_switches is False


def test_e31_second_port_and_board_732() -> None:
    inputs = {line.name: line for line in INPUT_LINES}
    assert inputs["OVERFLOW_732"].port == inputs["SWITCH_SHOULDER"].port == inputs["SWITCH_PITCH"].port == 1
    assert "OVERFLOW_732" in InputId.__members__ and "OVERFLOW_724" in InputId.__members__
    motors = inputs["OVERFLOW_732"].motors
    assert motors == 1 << Motor.SHOULDER | 1 << Motor.RIGHT_WRIST | 1 << Motor.LEFT_WRIST


def test_e32_dwell_and_tolerance() -> None:
    moves = list(resolve(interpret("G21 G90 G94\nG64 P0.5\nG4 P1.5\nM2\n")))
    parts = [getattr(move, "move", move) for move in moves]
    dwells = [move.seconds for move in parts if isinstance(move, Dwell)]
    tolerances = [move.tolerance_mm for move in parts if isinstance(move, PathModeChange)]
    assert dwells == [1.5]
    assert tolerances[-1] == 0.5


PROGRAM = ((210, 0, -150), (0, 210, -150), (0, 340, -30), (0, 340, 30), (290, 0, -30), (290, 0, 30))


def test_e33_z_points_down() -> None:
    corner = np.degrees(np.linspace(0.0, pi / 2, 50))
    arc = [(210 * cos(radians(a)), 210 * sin(radians(a)), -150.0) for a in corner]
    lines = [np.linspace(PROGRAM[i], PROGRAM[i + 1], 50) for i in (1, 2, 4)]
    for x, y, z in np.concatenate((arc, *lines)).tolist():
        assert THESIS.joints_from_program((x, y, z, 0.0, 0.0, 0.0)).status is IkStatus.OK
    # what the program calls up, at -150, is above what it calls down, at 30
    up, down = (THESIS.frame.base_from_program(np.array((210.0, 0.0, z)))[2] for z in (-150.0, 30.0))
    assert up - down == 180.0

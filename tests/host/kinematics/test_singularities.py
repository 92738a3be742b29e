"""Singularities: the closed formulas against determinants, and the inverse kinematics all around each of them."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, IkResult, IkStatus, KinematicsError, ShortfallKind, SingularityKind
from rm501_host.kinematics.minors import minors, singular_vector
from rm501_host.kinematics.singularities import distances, task_determinant
from tests.support.kinematics import random_joints

ARM = Arm.from_config(load_config())
OFFSET = ARM.with_tool(30.0, (12.0, -25.0))
ARMS = pytest.mark.parametrize("arm", [ARM, OFFSET], ids=["plain", "offset"])
ELBOW = (10.0, 40.0, 0.0, 50.0, 20.0)
# a2 c2 + a3 c23 = 0 with the tool straight up: q2 = 100, c23 = -a2 c2 / a3
_Q23 = float(np.degrees(np.arccos(-220.0 * np.cos(np.radians(100.0)) / 150.0)))
SHOULDER = (10.0, 100.0, _Q23 - 100.0, 180.0 - _Q23, 20.0)
DOUBLE = (10.0, 90.0, 0.0, 90.0, 20.0)
# r = 0 with the tool neither up nor down
_S234 = -(220.0 * np.cos(np.radians(98.0)) + 150.0 * np.cos(np.radians(73.0))) / 95.0
WAIST_AXIS = (10.0, 98.0, -25.0, 180.0 - float(np.degrees(np.arcsin(_S234))) - 73.0, 20.0)


@ARMS
def test_minors_manipulability_and_task_determinant(arm: Arm) -> None:
    for q in random_joints(arm, 300, seed=30, margin_deg=0.0):
        matrix = arm.jacobian(q)
        wanted = np.array([np.linalg.det(np.delete(matrix, row, axis=0)) for row in range(6)])
        np.testing.assert_allclose(minors(arm.geometry, q), wanted, atol=1e-3)  # of up to 1e7 mm^3
        for length_mm in (1.0, 220.0):
            weighted = matrix.copy()
            weighted[:3] /= length_mm
            gram = np.sqrt(np.linalg.det(weighted.T @ weighted))
            assert arm.manipulability(q, length_mm) == pytest.approx(gram, rel=1e-6)
        assert np.linalg.norm(singular_vector(arm.geometry, q)) == pytest.approx(arm.manipulability(q), rel=1e-9)
        assert np.abs(matrix.T @ singular_vector(arm.geometry, q)).max() <= 1e-6 * arm.manipulability(q)
        wanted_task = np.linalg.det(arm.task_jacobian(q))
        assert task_determinant(arm.geometry, q) == pytest.approx(wanted_task, rel=1e-9, abs=1e-6)


def test_minors_and_singular_vector_by_computer_algebra() -> None:
    """From the DH table to the formulas of `minors`, with nothing in between but SymPy."""
    q1, q2, q3, q4, q5, d1, a2, a3, tx, ty, tz = sympy.symbols("q1 q2 q3 q4 q5 d1 a2 a3 tx ty tz", real=True)
    q23, q234 = q2 + q3, q2 + q3 + q4
    quarter = sympy.pi / 2
    links = [(q1, d1, 0, quarter), (q2, 0, a2, 0), (q3, 0, a3, 0), (q4, 0, 0, quarter), (q5, 0, 0, 0)]
    frame = sympy.eye(4)
    axes, origins = [], []
    for theta, d, a, alpha in links:
        axes.append(frame[:3, 2])
        origins.append(frame[:3, 3])
        c, s, ca, sa = sympy.cos(theta), sympy.sin(theta), sympy.cos(alpha), sympy.sin(alpha)
        frame = frame * sympy.Matrix(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    tip = frame[:3, :3] * sympy.Matrix([tx, ty, tz]) + frame[:3, 3]
    jacobian = sympy.Matrix.hstack(
        *[sympy.Matrix.vstack(z.cross(tip - o), z) for z, o in zip(axes, origins, strict=True)]
    )
    linear = tip.jacobian([q1, q2, q3, q4, q5])
    k = a2 * a3 * sympy.sin(q3)
    g = tx * sympy.cos(q5) - ty * sympy.sin(q5)
    r0 = a2 * sympy.cos(q2) + a3 * sympy.cos(q23) + tz * sympy.sin(q234)
    c1, s1, c234, s234 = sympy.cos(q1), sympy.sin(q1), sympy.cos(q234), sympy.sin(q234)
    across = c234 * r0 - g * s234**2
    formulas = [k * s1 * s234, k * c1 * s234, 0, -k * c1 * across, k * s1 * across, -k * s234 * (r0 + g * c234)]
    # Identities of trigonometric polynomials: judged in exact fractions at random rational points of the circle.
    rng = np.random.default_rng(31)
    for _ in range(4):
        values = _rational_values(rng, (q1, q2, q3, q4, q5), (d1, a2, a3, tx, ty, tz))
        exact = _with_circle_points(jacobian, (q1, q2, q3, q4, q5), values)
        assert exact[:3, :] == _with_circle_points(linear, (q1, q2, q3, q4, q5), values)
        wanted = [_with_circle_points(sympy.Matrix([f]), (q1, q2, q3, q4, q5), values)[0] for f in formulas]
        signed = sympy.zeros(6, 1)
        for row in range(6):
            square = exact.copy()
            square.row_del(row)
            assert square.det() == wanted[row]
            signed[row] = (-1) ** row * wanted[row]
        assert exact.T * signed == sympy.zeros(5, 1)


def _rational_values(
    rng: np.random.Generator, angles: tuple[sympy.Symbol, ...], lengths: tuple[sympy.Symbol, ...]
) -> dict[sympy.Symbol, sympy.Rational]:
    """Tangents of the half angles, and lengths, as small fractions."""
    return {symbol: sympy.Rational(int(rng.integers(-9, 10)), int(rng.integers(1, 8))) for symbol in angles + lengths}


def _with_circle_points(
    matrix: sympy.Matrix, angles: tuple[sympy.Symbol, ...], values: dict[sympy.Symbol, sympy.Rational]
) -> sympy.Matrix:
    """The matrix with sin and cos of each angle replaced by 2t/(1+t^2), (1-t^2)/(1+t^2): exact fractions."""
    expanded = matrix.applyfunc(sympy.expand_trig)
    pairs: dict[sympy.Expr, sympy.Rational] = {}
    for angle in angles:
        t = values[angle]
        pairs[sympy.sin(angle)] = 2 * t / (1 + t * t)
        pairs[sympy.cos(angle)] = (1 - t * t) / (1 + t * t)
    lengths = {symbol: value for symbol, value in values.items() if symbol not in angles}
    return expanded.subs(pairs).subs(lengths)


@pytest.mark.parametrize(
    ("q", "kinds", "rank", "task_rank"),
    [
        (ELBOW, {SingularityKind.ELBOW}, 4, 4),
        (SHOULDER, {SingularityKind.SHOULDER, SingularityKind.WAIST_AXIS}, 4, 4),
        (WAIST_AXIS, {SingularityKind.WAIST_AXIS}, 5, 4),
        (
            DOUBLE,
            {
                SingularityKind.ELBOW,
                SingularityKind.SHOULDER,
                SingularityKind.WAIST_AXIS,
                SingularityKind.DOUBLE,
            },
            3,
            3,
        ),
        ((10.0, 40.0, -60.0, 50.0, 20.0), set(), 5, 5),
    ],
    ids=["elbow", "shoulder", "waist axis", "double", "regular"],
)
def test_kinds_and_ranks(q: tuple[float, ...], kinds: set[SingularityKind], rank: int, task_rank: int) -> None:
    low, high = ARM.limits_deg
    assert (low <= q).all() and (q <= high).all()
    found = {singularity.kind for singularity in ARM.singularities(q, margin=1e-9)}
    assert found == kinds
    ellipsoid = ARM.ellipsoid(q)
    assert ellipsoid.rank == rank
    assert np.isinf(ellipsoid.condition) == (rank < 5)
    assert np.linalg.matrix_rank(ARM.task_jacobian(q), tol=1e-7) == task_rank
    assert (ARM.manipulability(q) < 1e-6) == (rank < 5)


def test_distances_grow_as_the_arm_moves_away() -> None:
    for delta_deg in (1e-6, 1e-3, 1.0):
        elbow = distances(ARM.geometry, (0.0, 40.0, -delta_deg, 50.0, 0.0))[0]
        assert elbow.distance == pytest.approx(delta_deg, rel=1e-6)
        assert elbow.unit == "deg"
    folded = distances(ARM.geometry, (0.0, 40.0, 179.0, 50.0, 0.0))[0]
    assert folded.distance == pytest.approx(1.0)
    with pytest.raises(KinematicsError, match="margin"):
        ARM.singularities(ELBOW, margin=-1.0)
    with pytest.raises(KinematicsError, match="above 0 mm"):
        ARM.manipulability(ELBOW, length_mm=0.0)


def test_ellipsoid_axes_are_what_unit_joint_rates_do() -> None:
    q = (10.0, 40.0, -60.0, 50.0, 20.0)
    ellipsoid = ARM.ellipsoid(q, length_mm=100.0)
    matrix = ARM.jacobian(q)
    matrix[:3] /= 100.0
    np.testing.assert_allclose(matrix @ ellipsoid.joint_axes, ellipsoid.axes * ellipsoid.radii, atol=1e-9)
    assert ellipsoid.condition == pytest.approx(np.linalg.cond(matrix))
    assert np.prod(ellipsoid.radii) == pytest.approx(ARM.manipulability(q, 100.0))


def check_answer(arm: Arm, xyz: np.ndarray, pitch: float, roll: float, result: IkResult) -> None:
    """Judge an answer from outside: every number in it recomputed."""
    geometry = arm.geometry
    tx, ty, tz = geometry.tcp_mm
    a, b = np.radians(pitch), np.radians(roll)
    g, v = tx * np.cos(b) - ty * np.sin(b), -(tx * np.sin(b) + ty * np.cos(b))
    square = xyz[0] ** 2 + xyz[1] ** 2 - v * v
    radius = np.sqrt(max(square, 0.0))
    height = xyz[2] - geometry.d1_mm - g * np.sin(a) + tz * np.cos(a)
    reaches = [np.hypot(sign * radius - g * np.cos(a) - tz * np.sin(a), height) for sign in (1, -1)]
    outer, inner = geometry.a2_mm + geometry.a3_mm, abs(geometry.a2_mm - geometry.a3_mm)
    for solution in result.solutions:
        assert np.isfinite(solution.q_deg).all()
        pose = arm.fk(solution.q_deg)
        assert np.abs(pose.xyz_mm - xyz).max() <= 2e-9
        assert abs((pose.pitch_deg - pitch + 180.0) % 360.0 - 180.0) <= 1e-9
        low, high = arm.limits_deg
        q = np.array(solution.q_deg)
        assert solution.in_limits == bool((q >= low - 1e-9).all() and (q <= high + 1e-9).all())
    kinds = {shortfall.kind for shortfall in result.shortfalls}
    if result.status is IkStatus.UNREACHABLE:
        assert not result.solutions and result.best is None
        excess = [max(reach - outer, inner - reach) for reach in reaches]
        if square < 0 and kinds == {ShortfallKind.INSIDE_OFFSET}:
            assert result.shortfalls[0].amount == pytest.approx(abs(v) - np.hypot(xyz[0], xyz[1]), abs=1e-9)
        else:
            assert kinds <= {ShortfallKind.TOO_FAR, ShortfallKind.TOO_NEAR}
            assert min(excess) > 0
            assert result.shortfalls[0].amount == pytest.approx(min(excess), abs=1e-9)
        assert result.reason
        return
    assert result.solutions
    assert any(inner - 2e-9 <= reach <= outer + 2e-9 for reach in reaches)
    if result.status is IkStatus.OUT_OF_LIMITS:
        assert result.best is None and not any(solution.in_limits for solution in result.solutions)
        assert kinds == {ShortfallKind.JOINT_LIMIT}
        return
    assert result.best is not None and result.best.in_limits
    singular = set()
    if radius < 1e-6:
        singular.add(ShortfallKind.WAIST_UNDETERMINED)
    if abs(np.sin(np.radians(result.best.q_deg[2]))) < 1e-6:
        singular.add(ShortfallKind.ELBOW_STRAIGHT)
    assert kinds == singular
    assert result.status is (IkStatus.SINGULAR if singular else IkStatus.OK)
    assert bool(result.reason) == bool(singular)


@pytest.mark.parametrize("name", ["elbow", "shoulder", "waist axis", "double"])
def test_ten_thousand_poses_around_each_singularity(name: str) -> None:
    """Each 1e-6 to 1 (deg, mm) away, in and out of reach: no NaN, no exception, the right reason and amount."""
    centre = {"elbow": ELBOW, "shoulder": SHOULDER, "waist axis": WAIST_AXIS, "double": DOUBLE}[name]
    rng = np.random.default_rng(32)
    pose = ARM.fk(centre)
    seen = set()
    for _ in range(10_000):
        size = 10.0 ** rng.uniform(-6.0, 0.0)
        direction = rng.normal(size=5)
        direction *= size / np.linalg.norm(direction)
        if name == "elbow":  # also where the elbow is straight elsewhere
            low, high = ARM.limits_deg
            q = rng.uniform(low + 1.0, high - 1.0)
            q[2] = 0.0
            pose = ARM.fk(q)
        target = pose.xyz_mm + direction[:3]
        pitch = pose.pitch_deg + direction[3] * rng.integers(0, 2)
        roll = float(np.clip(pose.roll_deg + direction[4], -180.0, 180.0))
        result = ARM.ik(target, pitch, roll, centre)
        check_answer(ARM, target, pitch, roll, result)
        seen.add(result.status)
    assert IkStatus.OK in seen
    if name in ("elbow", "double"):
        assert IkStatus.UNREACHABLE in seen


@pytest.mark.parametrize("q", [ELBOW, SHOULDER, WAIST_AXIS, DOUBLE], ids=["elbow", "shoulder", "waist axis", "double"])
def test_exactly_at_each_singularity(q: tuple[float, ...]) -> None:
    pose = ARM.fk(q)
    result = ARM.ik(pose.xyz_mm, pose.pitch_deg, pose.roll_deg, q)
    check_answer(ARM, pose.xyz_mm, pose.pitch_deg, pose.roll_deg, result)
    assert result.best is not None
    # q3 of a stretched arm is known to the root of the rounding only; the tip is exact
    assert np.abs(np.subtract(result.best.q_deg, q)).max() <= 1e-4


def test_the_waist_stays_where_the_seed_has_it_on_the_axis() -> None:
    pose = ARM.fk(WAIST_AXIS)
    on_axis = (0.0, 0.0, float(pose.xyz_mm[2]))
    for waist in (-120.0, 0.0, 77.0):
        result = ARM.ik(on_axis, pose.pitch_deg, 0.0, (waist, *WAIST_AXIS[1:]))
        assert result.status is IkStatus.SINGULAR
        assert result.best is not None
        assert result.best.q_deg[0] == waist
        assert "waist" in result.reason and f"{waist:.4f}" in result.reason
    assert ARM.ik(on_axis, pose.pitch_deg, 0.0).best.q_deg[0] == ARM.home_deg[0]  # type: ignore[union-attr]


def test_the_batch_takes_the_waist_that_is_given_on_the_axis() -> None:
    pose = ARM.fk(WAIST_AXIS)
    on_axis = np.tile((0.0, 0.0, float(pose.xyz_mm[2])), (3, 1))
    waists = np.array((-120.0, 0.0, 77.0))
    q, ok = ARM.ik_batch(on_axis, pose.pitch_deg, 0.0, waist_deg=waists)
    assert ok.all()
    np.testing.assert_array_equal(q[:, 0], waists)
    np.testing.assert_allclose(ARM.fk_batch(q)[0], on_axis, atol=1e-9)
    assert (ARM.ik_batch(on_axis, pose.pitch_deg, 0.0, waist_deg=33.0)[0][:, 0] == 33.0).all()


def test_offset_tool_has_a_hole_around_the_waist_axis() -> None:
    result = OFFSET.ik((1.0, 2.0, 600.0), 150.0, 0.0)
    assert result.status is IkStatus.UNREACHABLE
    assert result.shortfalls[0].kind is ShortfallKind.INSIDE_OFFSET
    assert result.shortfalls[0].amount == pytest.approx(25.0 - np.sqrt(5.0))
    check_answer(OFFSET, np.array((1.0, 2.0, 600.0)), 150.0, 0.0, result)


def test_equal_links_that_fold_onto_the_shoulder_keep_its_angle() -> None:
    from dataclasses import replace

    from rm501_host.kinematics.inverse import InverseSolver

    geometry = replace(ARM.geometry, a3_mm=220.0, max_deg=(150.0, 100.0, 180.0, 180.0, 180.0))
    geometry = replace(geometry, min_deg=(-150.0, -30.0, -180.0, -180.0, -180.0))
    result = InverseSolver(geometry).solve(95.0, 0.0, 230.0, 90.0, 0.0, (0.0, 33.0, -180.0, 0.0, 0.0))
    assert result.status is IkStatus.SINGULAR
    assert {shortfall.kind for shortfall in result.shortfalls} == {
        ShortfallKind.SHOULDER_UNDETERMINED,
        ShortfallKind.ELBOW_STRAIGHT,
    }
    assert result.best is not None
    assert result.best.q_deg[1] == 33.0


def test_random_targets_are_judged_right() -> None:
    rng = np.random.default_rng(33)
    seen = set()
    for arm in (ARM, OFFSET):
        for _ in range(3_000):
            target = rng.uniform((-500.0, -500.0, -250.0), (500.0, 500.0, 750.0))
            pitch, roll = float(rng.uniform(-180.0, 280.0)), float(rng.uniform(-190.0, 190.0))
            result = arm.ik(target, pitch, roll)
            check_answer(arm, target, pitch, roll, result)
            seen.add(result.status)
    assert seen == {IkStatus.OK, IkStatus.OUT_OF_LIMITS, IkStatus.UNREACHABLE}

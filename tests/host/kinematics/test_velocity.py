"""Inverse velocity: each method against what defines it, and the tool driven through every singularity."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.kinematics import PASSAGES, PassageCase, passage
from rm501_host.config import load_config
from rm501_host.kinematics import (
    Arm,
    Damping,
    DampingLaw,
    KinematicsError,
    VelocityController,
    Weights,
    default_damping,
)
from rm501_host.kinematics.velocity_control import METHODS, default_weights, solve_iteratively
from rm501_host.kinematics.velocity_inverse import (
    damped_rates,
    filtered_rates,
    pseudo_inverse_rates,
    selective_rates,
    transpose_rates,
    weighted_manipulability,
)
from tests.support.kinematics import random_joints

ARM = Arm.from_config(load_config())
RNG = np.random.default_rng(40)
MATRICES = [RNG.normal(size=shape) for shape in ((5, 5), (6, 5)) for _ in range(20)]


@pytest.mark.parametrize("a", MATRICES)
def test_methods_against_their_definitions(a: np.ndarray) -> None:
    b = RNG.normal(size=len(a))
    identity = np.eye(5)
    np.testing.assert_allclose(pseudo_inverse_rates(a, b), np.linalg.pinv(a) @ b, atol=1e-9)
    for factor in (1e-3, 0.1, 2.0):
        normal = np.linalg.solve(a.T @ a + factor**2 * identity, a.T @ b)
        other = a.T @ np.linalg.solve(a @ a.T + factor**2 * np.eye(len(a)), b)
        np.testing.assert_allclose(damped_rates(a, b, factor), normal, atol=1e-7)
        np.testing.assert_allclose(normal, other, atol=1e-7)  # both forms of the errata are one
    np.testing.assert_allclose(damped_rates(a, b, 0.0), np.linalg.pinv(a) @ b, atol=1e-9)
    smallest = np.linalg.svd(a, compute_uv=False)[-1]
    np.testing.assert_allclose(filtered_rates(a, b, 0.3, 0.5 * smallest), np.linalg.pinv(a) @ b, atol=1e-9)
    step = transpose_rates(a, b)
    for factor in (0.9, 1.1):  # its length is the best along its direction
        assert np.linalg.norm(b - a @ step) < np.linalg.norm(b - factor * (a @ step))


def test_damping_bounds_the_rates_where_the_pseudo_inverse_explodes() -> None:
    u, _ = np.linalg.qr(RNG.normal(size=(5, 5)))
    v, _ = np.linalg.qr(RNG.normal(size=(5, 5)))
    b = u[:, 4]
    for smallest in (1e-3, 1e-6, 1e-9, 0.0):
        a = u @ np.diag((1.0, 1.0, 1.0, 1.0, smallest)) @ v.T
        assert np.linalg.norm(damped_rates(a, b, 0.05)) <= 1 / (2 * 0.05) + 1e-9  # max of s/(s^2 + l^2)
        assert np.linalg.norm(filtered_rates(a, b, 0.05, 0.1)) <= 1 / (2 * 0.05) * 1.2
        assert np.abs(selective_rates(a, b, 0.5)).max() <= 0.5 + 1e-12
        if smallest >= 1e-9:
            assert np.linalg.norm(pseudo_inverse_rates(a, b)) > 0.5 / smallest
        else:
            assert np.linalg.norm(pseudo_inverse_rates(a, b)) < 1e-9  # a direction of 0 is left out
    assert not transpose_rates(np.zeros((5, 5)), b).any()


def test_selective_damping_leaves_easy_directions_alone() -> None:
    a = np.diag((1.0, 1.0, 1.0, 1.0, 1e-6))
    easy, hard = np.array((0.1, 0.0, 0.0, 0.0, 0.0)), np.array((0.0, 0.0, 0.0, 0.0, 0.1))
    np.testing.assert_allclose(selective_rates(a, easy, 1.0), easy)
    np.testing.assert_allclose(selective_rates(a, easy + hard, 1.0)[0], 0.1)
    assert 0.0 < selective_rates(a, hard, 1.0)[4] <= 1.0


def test_damping_laws() -> None:
    law = Damping(DampingLaw.MANIPULABILITY, largest=0.2, threshold=4.0)
    assert law.factor(4.0) == law.factor(9.0) == 0.0
    assert law.factor(0.0) == 0.2
    assert law.factor(1.0) == pytest.approx(0.2 * 0.75)
    change = Damping(DampingLaw.RATE_OF_CHANGE, largest=0.2, threshold=0.9)
    assert change.factor(1.0) == 0.2  # nothing is known yet: the safe side
    assert change.factor(0.95, before=1.0) == change.factor(2.0, before=1.0) == 0.0
    assert change.factor(0.75, before=1.0) == pytest.approx(0.1)
    assert Damping(DampingLaw.CONSTANT, 0.3).factor(1e9) == 0.3
    with pytest.raises(KinematicsError, match="above 0"):
        Damping(DampingLaw.CONSTANT, 0.0)
    with pytest.raises(KinematicsError, match="weights"):
        Weights(np.array((1.0, 0.0)), np.ones(5))


def test_weights_say_what_counts() -> None:
    """A row that counts a thousand times is met, at the cost of the others; a dear joint moves less."""
    a = ARM.task_jacobian((0.0, 40.0, -60.0, 60.0, 0.0))
    b = np.array((20.0, 5.0, -10.0, 0.2, 0.1))
    strong = Weights(np.array((1.0, 1e3, 1.0, 1.0, 1.0)), np.ones(5))
    even = Weights(np.ones(5), np.ones(5))
    misses = []
    for weights in (even, strong):
        weighted = weights.apply(a, b)
        misses.append(abs((a @ weights.rates(damped_rates(*weighted, 500.0)) - b)[1]))
    assert misses[1] < 0.01 * misses[0]
    dear = Weights(np.ones(5), np.array((1.0, 1e3, 1.0, 1.0, 1.0)))
    moved = [abs(w.rates(damped_rates(*w.apply(a, b), 100.0))[1]) for w in (even, dear)]
    assert moved[1] < 0.1 * moved[0]


@pytest.mark.parametrize("name", sorted(METHODS))
def test_every_method_solves_inverse_kinematics_by_iteration(name: str) -> None:
    """Independent of the closed form: wherever the iteration arrives, the closed form has that solution."""
    rng = np.random.default_rng(41)
    arrived = 0
    for q in random_joints(ARM, 12, seed=42, margin_deg=15.0):
        pose = ARM.fk(q)
        slow = name in ("transpose", "damped", "filtered", "selective")
        result = solve_iteratively(
            ARM.geometry,
            pose.xyz_mm,
            pose.pitch_deg,
            pose.roll_deg,
            q + rng.uniform(-8.0, 8.0, 5),
            METHODS[name],
            max_steps=4000 if slow else 50,
            tolerance_mm=1e-6,
        )
        if result.position_error_mm > 1e-6:
            continue
        arrived += 1
        solutions = ARM.ik(pose.xyz_mm, pose.pitch_deg, pose.roll_deg).solutions
        assert min(np.abs(np.subtract(s.q_deg, result.q_deg)).max() for s in solutions) <= 1e-4
    assert arrived >= 10


@pytest.mark.parametrize("case", PASSAGES, ids=[case.name for case in PASSAGES])
def test_the_tool_passes_every_singularity_inside_all_limits(case: PassageCase) -> None:
    run = passage(ARM, case, default_damping())
    assert run is not None
    assert np.isfinite(run.q_deg).all()
    assert float(np.max(ARM.motors.velocity_limits.ratio(run.rates_deg_s))) <= 1.0 + 1e-12
    low, high = ARM.limits_deg
    assert (run.q_deg >= low - 1e-9).all() and (run.q_deg <= high + 1e-9).all()
    assert run.error_mm[-1] <= 0.1
    measures = [
        min(s.measure for s in ARM.singularities(q, margin=10.0)) for q in run.q_deg[:: max(1, len(run.q_deg) // 400)]
    ]
    assert min(measures) < 0.02  # it was there
    inside = ARM.ik(run.wanted_mm[-1], case.start[3], case.start[4], run.q_deg[-1])
    assert inside.best is not None  # and it came out


def test_without_damping_the_tool_is_stuck_or_beside_its_way() -> None:
    """The reason for damping: the same passages by pseudo-inverse."""
    by_name = {case.name: case for case in PASSAGES}
    assert passage(ARM, by_name["double, out of reach and back"], None, max_s=4.0) is None  # 1.9 s when damped
    missed = passage(ARM, by_name["waist axis, 1 mm beside it"], None)
    assert missed is not None and missed.error_mm[-1] > 1.0  # the waist ran into its limit


def test_the_controller_keeps_rates_limits_and_ranges_for_any_wish() -> None:
    controller = VelocityController(ARM.geometry, ARM.motors.velocity_limits, default_damping())
    rng = np.random.default_rng(43)
    low, high = ARM.limits_deg
    for q in random_joints(ARM, 500, seed=44, margin_deg=0.0):
        step = controller.step(q, rng.normal(size=5) * 10.0 ** rng.uniform(0.0, 4.0), period_s=0.05)
        assert ARM.motors.velocity_limits.ratio(step.rates_deg_s) <= 1.0 + 1e-12
        after = q + step.rates_deg_s * 0.05
        assert (after >= low - 1e-9).all() and (after <= high + 1e-9).all()
        assert 0.0 < step.scale <= 1.0
    with pytest.raises(KinematicsError, match="finite"):
        controller.step(q, np.array((np.nan, 0.0, 0.0, 0.0, 0.0)), 0.01)
    with pytest.raises(KinematicsError, match="period"):
        controller.step(q, np.zeros(5), 0.0)


def test_slow_wishes_far_from_singularities_are_met_exactly() -> None:
    controller = VelocityController(ARM.geometry, ARM.motors.velocity_limits, default_damping())
    q = (0.0, 40.0, -60.0, 60.0, 0.0)
    wish = np.array((5.0, 3.0, -2.0, 1.0, -1.0))
    step = controller.step(q, wish, 0.001)
    assert step.damping == 0.0 and step.scale == 1.0
    assert np.abs(step.error).max() <= 1e-9
    a, _ = default_weights(ARM.geometry).apply(ARM.task_jacobian(q), wish)
    assert weighted_manipulability(a) == pytest.approx(abs(np.linalg.det(a)))

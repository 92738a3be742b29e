"""What others rely on: names, docstrings, examples, light imports, refusals with key and line."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import inspect
import pkgutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rm501_host.kinematics as kinematics
from rm501_host.config import ConfigError, load_config
from rm501_host.kinematics import Arm, ArmGeometry, Branch, GeometryError, IkStatus, KinematicsError, MotorSpace
from rm501_host.kinematics.inverse import InverseSolver
from tests.support.kinematics import CONFIGS, with_section

MODULES = [f"rm501_host.kinematics.{info.name}" for info in pkgutil.iter_modules(kinematics.__path__)]
CONFIG = load_config()
ARM = Arm.from_config(CONFIG)


def test_public_names_are_pinned() -> None:
    assert kinematics.__all__ == sorted(kinematics.__all__)
    public = {
        name for name, value in vars(kinematics).items() if not name.startswith("_") and not inspect.ismodule(value)
    }
    assert public == set(kinematics.__all__)
    for name in ("Arm", "Pose", "IkResult", "Branch", "OrientationError", "VelocityController"):
        assert name in kinematics.__all__


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(name: str) -> None:
    module = importlib.import_module(name)
    """`arm` is the default arm, `np` numpy."""
    result = doctest.testmod(module, extraglobs={"arm": ARM, "np": np})
    assert result.failed == 0


def test_examples_in_the_documentation_run() -> None:
    result = doctest.testfile(str(CONFIGS.parent / "docs" / "kinematics.md"), module_relative=False)
    assert result.attempted >= 7
    assert result.failed == 0


def test_figures_of_the_documentation_are_drawn_by_code(tmp_path: Path) -> None:
    script = CONFIGS.parent / "docs" / "figures" / "kinematics.py"
    spec = importlib.util.spec_from_file_location("kinematics_figures", script)
    assert spec is not None and spec.loader is not None
    figures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(figures)
    text = (CONFIGS.parent / "docs" / "kinematics.md").read_text("utf-8")
    for name in ("frames", "branches", "singularities"):
        getattr(figures, f"draw_{name}")(ARM, tmp_path / f"kinematics_{name}.png")
        assert (tmp_path / f"kinematics_{name}.png").stat().st_size > 10_000
        assert f"figures/kinematics_{name}.png" in text


def test_some_examples_exist() -> None:
    finder = doctest.DocTestFinder()
    total = sum(len(test.examples) for name in MODULES for test in finder.find(importlib.import_module(name)))
    assert total >= 20


@pytest.mark.parametrize("name", MODULES)
def test_public_functions_say_shapes_or_units(name: str) -> None:
    """Every public function with arithmetic has a docstring that names a unit, a shape or a type of angle."""
    module = importlib.import_module(name)
    words = (
        "mm",
        "deg",
        "rad",
        "(n,",
        "(5",
        "(3",
        "(6",
        "(m",
        "shape",
        "unit",
        "steps",
        "URDF",
        "branch",
        "matplotlib",
    )
    functions = [
        value
        for key, value in vars(module).items()
        if inspect.isfunction(value) and value.__module__ == name and not key.startswith("_")
    ]
    for kind in (value for value in vars(module).values() if inspect.isclass(value) and value.__module__ == name):
        functions += [f for key, f in vars(kind).items() if inspect.isfunction(f) and not key.startswith("_")]
    for function in functions:
        text = inspect.getdoc(function)
        assert text, f"{name}.{function.__qualname__} has no docstring"
        if len(inspect.signature(function).parameters) > 1:
            assert any(word in text for word in words), f"{name}.{function.__qualname__}: {text}"


def test_import_is_light() -> None:
    code = (
        "import sys, rm501_host.kinematics; "
        "print([m for m in ('scipy', 'sympy', 'matplotlib', 'roboticstoolbox', 'click') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "[]"


@pytest.mark.parametrize(
    ("key", "line", "said"),
    [
        ("geometry.a2_mm", "a2_mm = -220.0", "a2_mm"),
        ("geometry.d1_mm", "d1_mm = nan", "a number to work with"),
        ("joints.elbow.min_deg", "min_deg = 20.0", "is not below"),
        ("drive.wrist_matrix", "wrist_matrix = [[1.0, 1.0], [1.0, 1.0]]", "singular"),
    ],
)
def test_bad_configurations_are_refused_with_key_and_line(tmp_path: Path, key: str, line: str, said: str) -> None:
    table, name = key.rsplit(".", 1)
    lines = (CONFIGS / "rm501.toml").read_text("utf-8").splitlines()
    start = (
        lines.index(f"[{table}]")
        if f"[{table}]" in lines
        else next(index for index, text in enumerate(lines) if text.startswith(f"[{table}]"))
    )
    number = next(index for index in range(start, len(lines)) if lines[index].startswith(f"{name} "))
    lines[number] = line
    path = tmp_path / "bad.toml"
    path.write_text("\n".join(lines), "utf-8")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    problem = caught.value.problems[0]
    assert problem.key == key
    assert problem.line == number + 1
    assert said in str(problem)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"a2_mm": 0.0}, "geometry.a2_mm"),
        ({"a3_mm": -1.0}, "geometry.a3_mm"),
        ({"d5_mm": float("nan")}, "geometry.d5_mm"),
        ({"tool_mm": (0.0, float("inf"), 0.0)}, "tool"),
        ({"min_deg": (150.0, -30.0, -90.0, 0.0, -180.0)}, "joints.waist.min_deg"),
        ({"home_deg": (0.0, 100.0, -90.0, 0.0, 181.0)}, "joints.roll.home.home_deg"),
        ({"weights": (0.0, 1.0, 1.0, 1.0, 1.0)}, "joints.waist.max_velocity_deg_s"),
    ],
)
def test_geometry_checks_itself(changes: dict[str, object], key: str) -> None:
    """Also where it does not come from a file: the second line of defence names the same keys."""
    with pytest.raises(GeometryError) as caught:
        replace(ARM.geometry, **changes)  # type: ignore[arg-type]
    assert caught.value.key == key
    assert key in str(caught.value)


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(KinematicsError, match="finite"):
        ARM.ik((float("nan"), 0.0, 0.0), 0.0, 0.0)
    with pytest.raises(KinematicsError, match="five numbers"):
        ARM.fk((1.0, 2.0))
    with pytest.raises(KinematicsError, match="finite"):
        ARM.fk((1.0, 2.0, float("inf"), 0.0, 0.0))
    with pytest.raises(KinematicsError, match=r"\(n, 5\)"):
        ARM.fk_batch(np.zeros((5,)))
    with pytest.raises(KinematicsError, match=r"\(n, 3\)"):
        ARM.ik_batch(np.zeros((4, 2)), 0.0, 0.0)
    with pytest.raises(KinematicsError, match=r"\(4,\)"):
        ARM.ik_batch(np.zeros((4, 3)), np.zeros(3), 0.0)


def test_a_row_that_is_no_number_is_not_ok_and_spoils_no_other() -> None:
    xyz = np.array([(300.0, 0.0, 200.0), (np.nan, 0.0, 200.0), (300.0, 0.0, 200.0)])
    q, ok = ARM.ik_batch(xyz, 0.0, 0.0)
    assert ok.tolist() == [True, False, True]
    assert np.isnan(q[1]).all()
    np.testing.assert_array_equal(q[0], q[2])
    q, ok = ARM.ik_batch(np.empty((0, 3)), 0.0, 0.0)
    assert q.shape == (0, 5) and ok.shape == (0,)


def test_answers_do_not_depend_on_what_was_asked_before() -> None:
    first = ARM.ik((300.0, 50.0, 200.0), 10.0, 20.0)
    ARM.ik((0.0, 0.0, 700.0), 180.0, 0.0, (50.0, 0.0, 0.0, 0.0, 0.0))
    ARM.with_tool(30.0).ik((300.0, 50.0, 200.0), 10.0, 20.0)
    assert ARM.ik((300.0, 50.0, 200.0), 10.0, 20.0) == first
    pose = ARM.fk((0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="read-only"):
        pose.xyz_mm[0] = 1.0


def test_seed_chooses_among_branches_inside_the_limits() -> None:
    geometry = replace(ARM.geometry, min_deg=(-180.0,) * 5, max_deg=(180.0,) * 5)
    arm = Arm(geometry, ARM.motors, ARM.frame)
    solutions = arm.ik((300.0, 50.0, 200.0), 10.0, 20.0).solutions
    assert {solution.branch for solution in solutions} == set(Branch)
    for wanted in solutions:
        seed = np.add(wanted.q_deg, (1.0, -2.0, 1.5, 0.5, 3.0))
        result = arm.ik((300.0, 50.0, 200.0), 10.0, 20.0, seed)
        assert result.best is not None
        assert result.best.branch is wanted.branch
        far = [arm.joint_distance(solution.q_deg, seed) for solution in result.solutions]
        assert far == sorted(far)


def test_joints_with_more_than_a_turn_take_the_turn_nearest_to_the_seed() -> None:
    geometry = replace(
        ARM.geometry, min_deg=(-400.0, -30.0, -90.0, -400.0, -180.0), max_deg=(400.0, 100.0, 0.0, 700.0, 180.0)
    )
    solver = InverseSolver(geometry)
    result = solver.solve(300.0, 0.0, 200.0, 0.0, 0.0, None)
    assert result.best is not None
    assert abs(result.best.q_deg[0]) < 1e-9
    high = replace(
        geometry,
        min_deg=(170.0, -30.0, -90.0, 0.0, -180.0),
        max_deg=(900.0, 100.0, 0.0, 180.0, 180.0),
        home_deg=(360.0, 100.0, -90.0, 0.0, 0.0),
    )
    for near in (360.0, 720.0):
        result = InverseSolver(high).solve(300.0, 10.0, 200.0, 0.0, 0.0, (near, 50.0, -50.0, 0.0, 0.0))
        assert result.best is not None
        assert result.best.q_deg[0] == pytest.approx(near + np.degrees(np.arctan2(10.0, 300.0)))


def test_the_roll_is_literal_and_the_reason_says_by_how_much() -> None:
    result = ARM.ik((300.0, 0.0, 200.0), 0.0, 190.0)
    assert result.status is IkStatus.OUT_OF_LIMITS
    assert result.shortfalls[0].joint == 4
    assert result.shortfalls[0].amount == pytest.approx(10.0)
    assert result.shortfalls[0].unit == "deg"


def test_the_configured_arm_is_what_the_file_says() -> None:
    geometry = ArmGeometry.from_config(with_section(CONFIG, "geometry", d1_mm=250.0, a3_mm=160.0, d5_mm=65.0))
    arm = Arm(geometry, MotorSpace.from_config(CONFIG), ARM.frame)
    assert arm.geometry.reach_mm == 445.0  # the manual's reach: 220 + 160 + 65
    np.testing.assert_allclose(arm.fk((0.0, 0.0, 0.0, 90.0, 0.0)).xyz_mm, (445.0, 0.0, 250.0), atol=1e-9)

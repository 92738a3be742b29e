"""The tick path is written as firmware: what C on a small chip could not do, or not in time, does not occur in it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rm501_firmware_model

PACKAGE = Path(rm501_firmware_model.__file__).parent
LAYERS = ("core_state", "queue_end", "transitions", "holding", "core")
TICK_PATH = ("stepgen", "motion", "segment_queue", "limits", "hand", "inputs", *LAYERS)
MAIN_LOOP = ("board", "commands", "layout", "states", "pins", "memory")
ALL = tuple(sorted(path.stem for path in PACKAGE.glob("*.py")))

CONTAINERS = (
    ast.Dict | ast.Set | ast.List | ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp | ast.JoinedStr
)
FUNCTIONS_ALLOWED = {"range", "abs", "len", "rule"}
METHODS_FORBIDDEN = {"append", "extend", "insert", "pop_front", "add", "update", "copy", "setdefault", "sort"}
OUTSIDE_ALLOWED = {"__future__", "enum", "rm501_protocol"}


def trees(names: tuple[str, ...]) -> list[tuple[str, ast.Module]]:
    return [(name, ast.parse((PACKAGE / f"{name}.py").read_text(encoding="utf-8"))) for name in names]


def offences(name: str, tree: ast.Module) -> list[str]:
    """What a module of the tick path does that it may not."""
    found = []
    classes = {node.name for _, other in trees(TICK_PATH) for node in other.body if isinstance(node, ast.ClassDef)}
    functions = {node.name for _, other in trees(TICK_PATH) for node in other.body if isinstance(node, ast.FunctionDef)}
    for function in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]:
        constructing = function.name == "__init__"
        for node in ast.walk(function):
            line = f"{name}.py:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Constant) and isinstance(node.value, float | complex | bytes):
                found.append(f"{line} constant {node.value!r}")
            if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(
                node.op, ast.Div | ast.FloorDiv | ast.Mod | ast.Pow | ast.MatMult
            ):
                found.append(f"{line} division, remainder or power")
            if isinstance(node, ast.Try | ast.Raise | ast.With | ast.Yield | ast.Await | ast.Lambda | ast.Global):
                found.append(f"{line} {type(node).__name__}")
            if constructing:
                continue
            if isinstance(node, CONTAINERS):
                found.append(f"{line} makes a {type(node).__name__}")
            if isinstance(node, ast.Slice):
                found.append(f"{line} slice")
            if isinstance(node, ast.Call):
                if isinstance(node.func, ast.Name) and node.func.id not in FUNCTIONS_ALLOWED | functions:
                    found.append(f"{line} calls {node.func.id}")
                if isinstance(node.func, ast.Name) and node.func.id in classes:
                    found.append(f"{line} allocates a {node.func.id}")
                if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS_FORBIDDEN:
                    found.append(f"{line} calls {node.func.attr}")
    return found


def imported(tree: ast.Module) -> set[str]:
    """Top-level names of what a module imports from outside the package."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add((node.module or "").split(".")[0])
    return names


@pytest.mark.parametrize("name", TICK_PATH)
def test_the_tick_path_is_firmware(name: str) -> None:
    (_, tree), *_ = trees((name,))
    assert offences(name, tree) == []
    assert imported(tree) <= OUTSIDE_ALLOWED


@pytest.mark.parametrize("name", TICK_PATH)
def test_every_class_of_the_tick_path_has_fixed_fields(name: str) -> None:
    (_, tree), *_ = trees((name,))
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not any(ast.unparse(base) == "IntFlag" for base in node.bases):
            assigned = [item for item in node.body if isinstance(item, ast.Assign)]
            assert any(ast.unparse(item.targets[0]) == "__slots__" for item in assigned), node.name


@pytest.mark.parametrize("name", MAIN_LOOP)
def test_the_main_loop_has_no_floats_and_no_foreign_imports(name: str) -> None:
    (_, tree), *_ = trees((name,))
    for node in ast.walk(tree):
        assert not (isinstance(node, ast.Constant) and isinstance(node.value, float)), node.lineno
        assert not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div)), node.lineno
    foreign = imported(tree) - OUTSIDE_ALLOWED - {"dataclasses", "collections", "typing", "sys"}
    assert foreign <= ({"numpy"} if name == "pins" else set())


def test_numpy_is_in_the_fast_path_alone_and_every_module_is_sorted_here() -> None:
    assert set(ALL) == {*TICK_PATH, *MAIN_LOOP, "fast", "fast_motors", "__init__"}
    for name, tree in trees(ALL):
        if "numpy" in imported(tree):
            # pins.py needs it for an annotation only
            assert name in ("fast", "fast_motors", "pins")


@pytest.mark.parametrize(
    "line",
    [
        "x = self.a / 2",
        "x = self.a // 2",
        "x = 0.5",
        "x = [1, 2]",
        "x = {}",
        "self.a.append(1)",
        "x = sorted(self.a)",
        "x = Motion(1, 2, 3)",
        "raise ValueError",
        "x = self.a[1:]",
    ],
)
def test_the_rules_find_what_they_forbid(line: str) -> None:
    assert offences("stepgen", ast.parse(f"def f(self):\n    {line}\n"))

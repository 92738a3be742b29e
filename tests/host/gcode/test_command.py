"""`rm501-host interpret`: the listing, JSON, and the options."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from rm501_host.gcode import CODES, GcodeError, Support
from rm501_host.gcode.command import interpret_command
from rm501_host.gcode.registry import markdown_table

from .listings import run_text

DOCS = Path(__file__).resolve().parents[3] / "docs" / "gcode.md"


def _run(*arguments: str, as_json: bool = False) -> tuple[int, str, str, BaseException | None]:
    result = CliRunner().invoke(interpret_command, list(arguments), obj=SimpleNamespace(json_output=as_json))
    return result.exit_code, result.stdout, result.stderr, result.exception


def test_the_listing(tmp_path: Path) -> None:
    path = tmp_path / "p.ngc"
    text = "G21 F100\nN7 G1 X1\n(PRINT,two #1)\nM2\n"
    path.write_text(text)
    code, out, err, _ = _run(str(path))
    assert (code, err) == (0, "")
    assert out.splitlines() == run_text(text).lines
    assert "    9 N7     STRAIGHT_FEED(1.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)" in out
    assert "two 0.000000" in out.splitlines()


def test_a_variable_file_that_cannot_be_written_is_told_before_anything_is_read(tmp_path: Path) -> None:
    path = tmp_path / "p.ngc"
    path.write_text("G21 F100\nG1 X1\nM2\n")
    (tmp_path / "file").write_text("")
    code, out, _, problem = _run(str(path), "--vars", str(tmp_path / "file" / "x.var"))
    assert (code, out) == (1, "")
    assert "--vars" in str(problem) and "cannot be written" in str(problem)


def test_an_unknown_function_is_answered_by_those_there_are(tmp_path: Path) -> None:
    path = tmp_path / "p.ngc"
    path.write_text("G0 X[foo[2]]\nM2\n")
    problem = _run(str(path))[3]
    assert "ATAN" in str(problem) and "docs/gcode.md" in str(problem)
    known = str(problem).split("Functions are ")[1].split(" (")[0].split(", ")
    assert all(f"{name} " in DOCS.read_text() or f"{name}[" in DOCS.read_text() for name in known)


def test_json(tmp_path: Path) -> None:
    path = tmp_path / "p.ngc"
    path.write_text("N7 G0 X1\nG0\nM2\n")
    code, out, err, _ = _run(str(path), as_json=True)
    assert code == 0
    calls = [json.loads(line) for line in out.splitlines()]
    traverse = next(call for call in calls if call["op"] == "StraightTraverse")
    assert traverse == {
        "op": "StraightTraverse", "file": str(path), "line": 1, "n": 7, "target": [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    }  # fmt: skip
    assert "warning" in err


def test_options(tmp_path: Path) -> None:
    program, tools, variables = tmp_path / "p.ngc", tmp_path / "t.tbl", tmp_path / "v.var"
    program.write_text("/G0 X9\nT4 M6 G43\n#500=5\nG10 L2 P1 X1\no<s> call\nM2\n")
    (tmp_path / "s.ngc").write_text("o<s> sub\nG0 Y3\no<s> endsub\n")
    tools.write_text("T4 P4 Z2\n")
    code, out, _, problem = _run(str(program), "--tools", str(tools), "--vars", str(variables), "--block-delete")
    assert code == 0, problem
    assert "USE_TOOL_LENGTH_OFFSET(0.0000 0.0000 50.8000" in out
    assert "9.0000" not in out
    assert "3.0000" in out
    assert "5221\t0.039370" in variables.read_text()
    _, out, _, _ = _run(str(program), "--tools", str(tools), "--machine-units", "mm")
    assert "USE_TOOL_LENGTH_OFFSET(0.0000 0.0000 2.0000" in out


def test_what_was_listed_before_an_error_stays(tmp_path: Path) -> None:
    path = tmp_path / "p.ngc"
    path.write_text("G0 X1\nG77\nM2\n")
    code, out, _, problem = _run(str(path))
    assert code == 1
    assert isinstance(problem, GcodeError)
    assert problem.line == 2
    assert "STRAIGHT_TRAVERSE" in out


def test_a_missing_file_is_a_usage_error(tmp_path: Path) -> None:
    assert _run(str(tmp_path / "none.ngc"))[0] == 2


def test_the_documented_table_is_the_registry() -> None:
    assert markdown_table() in DOCS.read_text(encoding="utf-8")


@pytest.mark.parametrize("code", [code for code in CODES if code.support is Support.REFUSED], ids=lambda c: c.name)
def test_refused_codes_are_refused_by_name(code: object) -> None:
    name = code.name  # type: ignore[attr-defined]  # a Code
    error = run_text(f"G0 X1\n{name}\nM2").error
    assert error is not None
    assert error.line == 2
    assert name in error.message

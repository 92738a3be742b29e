"""Every error names file, line, column, block, call stack and remedy, and has the right class."""

from __future__ import annotations

import pytest

from rm501_host.errors import Rm501Error
from rm501_host.gcode import (
    GcodeAbortError,
    GcodeError,
    GcodeFlowError,
    GcodeGeometryError,
    GcodeLimitError,
    GcodeMathError,
    GcodeModalError,
    GcodeParameterError,
    GcodeSyntaxError,
    GcodeUnsupportedError,
    Settings,
)

from .listings import run_text

CASES: list[tuple[str, type[GcodeError], int, int | None, str]] = [
    ("G0 X1\nG0 X[1+2\nM2", GcodeSyntaxError, 2, 5, "unclosed expression"),
    ("G0 X1 ( a ) Y..5\nM2", GcodeSyntaxError, 1, 14, "bad number format"),
    ("G0 X1 Y2 X3\nM2", GcodeSyntaxError, 1, 10, "multiple X words"),
    ("G0 X1 K3\nM2", GcodeModalError, 1, 7, "K word"),
    ("G0 X1\n  G77\nM2", GcodeModalError, 2, 3, "unknown G code"),
    ("G0 X[1 / 0]\nM2", GcodeMathError, 1, 4, "divide by zero"),
    ("G0 X1 Y[2 + SQRT[-4]]\nM2", GcodeMathError, 1, 7, "sqrt"),
    ("#1=1\nG0 X#<nix>\nM2", GcodeParameterError, 2, 6, "#<nix>"),
    ("#<abcd>=1\nG0 X#<abce>\nM2", GcodeParameterError, 2, 6, "not defined"),
    ("G2 X10 R1 F5\nM2", GcodeGeometryError, 1, None, "too small"),
    ("G0 X1\no5 endwhile\nM2", GcodeFlowError, 2, None, "endwhile"),
    ("G0 X1\nG0 \udc89Y2\nM2", GcodeSyntaxError, 2, None, "p.ngc:2:4: byte 0x89 is not text"),
    ("G41 D1\nM2", GcodeUnsupportedError, 1, 1, "Cutter compensation"),
    ("G0 U4\nM2", GcodeUnsupportedError, 1, 4, "no U axis"),
    ("M150\nM2", GcodeUnsupportedError, 1, None, "M150"),
    ("(ABORT, no part at #1)\nM2", GcodeAbortError, 1, None, "no part at 0.000000"),
    ("G0 X1\n" + "(" + "x" * 300 + ")\nM2", GcodeLimitError, 2, None, "too long"),
    ("M110 P7 Q1\nM2", GcodeModalError, 1, None, "joint 1 to 5"),
    ("M101 (PY, import os)\nM2", GcodeUnsupportedError, 1, None, "Python"),
]


@pytest.mark.parametrize(("text", "kind", "line", "column", "words"), CASES, ids=[c[0][:20] for c in CASES])
def test_error_has_class_place_and_remedy(
    text: str, kind: type[GcodeError], line: int, column: int | None, words: str
) -> None:
    error = run_text(text).error
    assert type(error) is kind
    assert isinstance(error, Rm501Error)
    assert (error.file, error.line) == ("p.ngc", line)
    assert words in str(error)
    assert error.block == text.split("\n")[line - 1]
    assert error.remedy or kind is GcodeAbortError
    if column is not None:
        assert error.column == column
        shown, caret = str(error).splitlines()[1:3]
        assert caret.index("^") == shown.index(error.block) + column - 1


def test_call_stack_names_every_call() -> None:
    outer = "o<outer> sub\n  o<inner> call [0]\no<outer> endsub\n"
    text = outer + "o<inner> sub\nG0 X[1/#1]\no<inner> endsub\no<outer> call\nM2"
    error = run_text(text).error
    assert error is not None
    assert [(frame.label, frame.called_from.line) for frame in error.call_stack] == [("o<outer>", 7), ("o<inner>", 2)]
    assert "in o<inner>, called from p.ngc:2" in str(error)


def test_suggestion_for_a_misspelt_name() -> None:
    error = run_text("#<height>=3\nG0 Z#<heigth>\nM2").error
    assert error is not None
    assert "#<height>" in error.remedy


def test_control_characters_do_not_reach_the_terminal() -> None:
    error = run_text("G0 X1 \x1b[31m\nM2").error
    assert error is not None
    assert "\x1b" not in str(error).splitlines()[1]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("G0\nM2", 1, "without axis words"),
        ("G1 ^45 F10\nM2", 1, "radius"),
        ("#1=0\no1 while [#1 LT 3]\n#1=[#1+1]\nM2", 2, "missing endwhile"),
        ("o1 repeat [2]\nG0 X1\nM2", 1, "missing endrepeat"),
        ("G0 X1\0Y2\nM2", 1, "NUL"),
        ("G0 X1\nM99", 2, "M99"),
        ("o1 if [1] (MSG, x)\no1 endif\nM2", 1, "beside an O-word"),
        ("F1 G5 P1 Q1 X5 Y5\nM2", 1, "without I and J"),
    ],
)
def test_warnings_for_what_is_accepted_but_probably_wrong(text: str, line: int, words: str) -> None:
    outcome = run_text(text)
    assert outcome.error is None
    assert [w.location.line for w in outcome.warnings if words in w.message] == [line]


def test_a_complete_loop_gives_no_warning() -> None:
    text = "#1=0\no1 while [#1 LT 3]\n#1=[#1+1]\no2 if [#1 EQ 2]\nM2\no2 endif\no1 endwhile\nM2"
    outcome = run_text(text)
    assert outcome.error is None
    assert outcome.warnings == []


def test_the_first_move_after_a_tool_length_should_name_x_y_z() -> None:
    """On an arm the tool length acts along the tool, so what X Y Z are after it only the kinematics knows."""
    arm = Settings()
    assert run_text("G43.1 Z50\nG0 X1 Y2 Z3\nG0 X2\nM2", arm).warnings == []
    assert run_text("G49\nG0 X1\nM2", arm).warnings == []
    warned = run_text("G43.1 Z50\nG0 X1\nG0 X2\nM2", arm).warnings
    assert [w.location.line for w in warned] == [2]
    assert "tool length" in warned[0].message
    assert run_text("G43.1 Z50\nG0 X1\nM2").warnings == []

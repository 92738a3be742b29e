"""No limit dodged: recursion, endless loops, huge numbers and deep expressions end in clear errors."""

from __future__ import annotations

import itertools

import pytest

from rm501_host.gcode import (
    GcodeBudgetError,
    GcodeError,
    GcodeLimitError,
    GcodeMathError,
    GcodeStoppedError,
    Interpreter,
    ResolveOptions,
    Settings,
    TextLines,
    resolve,
)
from rm501_host.gcode.canon import Heartbeat

from .listings import run_text


def _error(text: str, settings: Settings | None = None) -> GcodeError:
    error = run_text(text, settings).error
    assert error is not None
    return error


def test_nine_calls_inside_one_another_and_not_ten() -> None:
    text = "o1 sub\no2 if [#1 GT 1]\no1 call [#1-1]\no2 endif\no1 endsub\no1 call [{}]\nM2"
    assert run_text(text.format(9)).error is None
    error = _error(text.format(10))
    assert isinstance(error, GcodeLimitError)
    assert len(error.call_stack) == 9


def test_a_loop_without_motion_yields_heartbeats_and_can_be_stopped() -> None:
    interpreter = Interpreter(TextLines("o1 while [1]\no1 endwhile\nM2"))
    calls = interpreter.calls()
    assert any(isinstance(call, Heartbeat) for call in itertools.islice(calls, 10))
    interpreter.stop()
    with pytest.raises(GcodeStoppedError):
        for _ in calls:
            pass


def test_a_loop_with_motion_can_be_left_at_any_time() -> None:
    interpreter = Interpreter(TextLines("o1 repeat [1000000000]\nG0 X1\no1 endrepeat\nM2"))
    calls = interpreter.calls()
    assert len(list(itertools.islice(calls, 1000))) == 1000
    calls.close()


def test_block_budget() -> None:
    error = _error("o1 repeat [1000000000]\n#1=[#1+1]\no1 endrepeat\nM2", Settings(max_blocks=5000))
    assert isinstance(error, GcodeBudgetError)
    assert "5000" in str(error)


def test_resolving_an_endless_silent_loop_ends() -> None:
    with pytest.raises(GcodeLimitError, match="loop for ever"):
        list(
            resolve(
                Interpreter(TextLines("o1 while [1]\no1 endwhile\nM2")).calls(), ResolveOptions(max_silent_heartbeats=3)
            )
        )


@pytest.mark.parametrize("depth", [10, 60, 118, 121, 125])
def test_deep_expressions(depth: int) -> None:
    text = f"#1={'[' * depth}1{']' * depth}\nM2"
    error = run_text(text).error
    if depth < 120:
        assert error is None
    else:
        assert isinstance(error, GcodeLimitError)


def test_signs_and_functions_count_as_depth() -> None:
    assert isinstance(_error(f"#1={'-' * 200}1\nM2"), GcodeLimitError)
    assert isinstance(_error(f"#1={'#' * 200}1\nM2"), GcodeLimitError)


@pytest.mark.parametrize(
    "text",
    ["#1=[10**400]", "#1=[EXP[1000]]", "#1=[-1*10**200*10**200]", "o[10**300] if [1]\no1 endif", "#[10**300]=1"],
)
def test_numbers_out_of_range(text: str) -> None:
    assert isinstance(_error(f"{text}\nM2"), GcodeMathError | GcodeError)


def test_huge_but_finite_numbers_are_numbers() -> None:
    assert run_text("G0 X[10**300] Y99999999999999999999999\nM2").error is None


def test_pecks_and_control_points_are_bounded() -> None:
    assert "pecks" in str(_error("F1 G83 Z-1000000 R0 Q0.0001\nM2"))


def test_names_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rm501_host.gcode.parameters.MAX_NAMED", 3)
    assert isinstance(_error("#<a>=1\n#<b>=1\n#<c>=1\n#<d>=1\nM2"), GcodeLimitError)


def test_many_m_words() -> None:
    assert isinstance(_error("M3 M7 M48 M62 M0 P1\nM2"), GcodeError)

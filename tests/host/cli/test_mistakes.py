"""Mistakes that people make in programs and files: what `check` and `plan` answer, and with which exit code."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.main import run_command_line
from tests.support.virtual_machine import REPOSITORY

GOOD = (REPOSITORY / "examples" / "01_first_moves.ngc").read_text()


def answer(command: str, program: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[ExitCode, str]:
    code = run_command_line([*options, command, str(program)])
    out, err = capsys.readouterr()
    return code, out + err


@pytest.mark.parametrize(
    ("before", "after", "place", "words"),
    [
        ("G1 Y60", "G1 Y6O", "7:", "is it a zero"),
        ("G1 Y60", "G1 Y60 Y70", "7:", "multiple Y words"),
        ("G1 Y60", "G77 Y60", "7:", "docs/gcode.md"),
        ("G1 Y60", "G2 Y60", "7:", "Give a radius R, or the centre with I J K"),
        ("X310", "X310 mm", "6:", "A word is a letter and a number"),
        ("X310", "X310,5", "6:", "bad character ','"),
        (" F1500", "", "6:", "Give an F word"),
        ("X310", "X910", "6:", "bring the point nearer"),
        ("G21", "G20", "5:", "bring the point nearer"),
        ("M2", "", "", "End the program with M2"),
        ("G1 Y60", "G1 Y60 (" + 300 * "-" + ")", "7", "Split the block"),
    ],
)
def test_a_mistake_is_refused_with_line_and_remedy(
    before: str, after: str, place: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "mistake.ngc"
    program.write_text(GOOD.replace(before, after, 1))
    code, said = answer("check", program, capsys)
    assert code is ExitCode.REFUSED
    assert f"mistake.ngc:{place}" in said
    assert words in said


@pytest.mark.parametrize(
    "data",
    [
        GOOD.encode(),
        GOOD.lower().encode(),
        GOOD.replace("\n", "\r\n").encode(),
        GOOD.replace(" ", "\t").encode(),
        GOOD.encode("utf-8-sig"),
    ],
    ids=["as it is", "lower case", "CRLF", "tabs", "byte order mark"],
)
def test_what_editors_do_to_a_good_program_does_no_harm(
    data: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "mein ordner ü" / "teil ä.ngc"
    program.parent.mkdir()
    program.write_bytes(data)
    code, said = answer("check", program, capsys)
    assert code is ExitCode.OK
    assert "checked to its end, 11 moves: nothing forbids the start" in said


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "End the program with M2"),
        (GOOD.encode("utf-16"), "Save it as UTF-8"),
        (b"\x7fELF\x02\x01\x01\x00\x00\n", "bad character"),
        (bytes(range(128, 256)), "is not text"),
    ],
    ids=["empty", "UTF-16", "binary", "noise"],
)
def test_what_is_no_program_is_refused_in_words(
    data: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "thing.ngc"
    program.write_bytes(data)
    code, said = answer("check", program, capsys)
    assert code is ExitCode.REFUSED
    assert words in said


def test_a_word_without_effect_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "turn.ngc"
    program.write_text(GOOD.replace("Y60", "Y60 C20").replace("Y-60", "Y-60 C30"))
    code, said = answer("check", program, capsys)
    assert code is ExitCode.OK
    assert said.count("C has no effect") == 1
    assert "turn.ngc:7: warning: C has no effect" in said
    thesis = str(REPOSITORY / "configs" / "thesis.toml")
    assert "C has no effect" not in answer("check", REPOSITORY / "examples" / "pick_and_place.ngc", capsys)[1]
    assert "C has no effect" not in answer("check", program, capsys, "--config", thesis)[1]


def test_plan_reads_a_program_as_check_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "arm.toml"
    text = (REPOSITORY / "configs" / "rm501.toml").read_text()
    text = text.replace("digital_outputs = []", 'digital_outputs = ["0.1"]')
    config.write_text(text.replace("[gcode.outputs]", "[gcode.outputs]\nM3 = [0, true]"))
    program = tmp_path / "lamp.ngc"
    program.write_text(GOOD.replace("G1 Y60", "M3", 1))
    for command in ("check", "plan"):
        code, said = answer(command, program, capsys, "--config", str(config))
        assert code is ExitCode.OK, said

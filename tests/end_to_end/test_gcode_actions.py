"""What programs do beside moving: M codes of a folder, outputs, tool length, logs, pauses."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.gcode.errors import GcodeError
from rm501_protocol.board_config import output_bit
from tests.support.cell import run_in_cell

ROOT = Path(__file__).parents[2]
RM501 = ROOT / "configs" / "rm501.toml"
HEAD = "G21 G90 G94\nG0 X280 Y0 Z200 A0 B0\n"


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_an_m_code_of_a_folder_runs_at_rest_with_its_words_and_its_failure_stops_the_run(tmp_path: Path) -> None:
    folder = tmp_path / "m-codes"
    folder.mkdir()
    out = tmp_path / "called"
    for number, body in ((105, f'echo "$1 $2" >> {out}'), (106, "echo no glue >&2; exit 3")):
        script = write(folder / f"M{number}", f"#!/bin/sh\n{body}\n")
        script.chmod(0o755)
    config = load_config(write(tmp_path / "c.toml", f'extends = "{RM501}"\n[gcode]\nm_codes_folder = "{folder}"\n'))
    good = run_in_cell(write(tmp_path / "good.ngc", HEAD + "M105 P2 Q2.5\nG1 Z190 F2000\nM105\nM2\n"), config)
    assert good.result.report.result == "ok"
    assert out.read_text().split() == ["2.000000", "2.500000", "-1.000000", "-1.000000"]
    bad = run_in_cell(write(tmp_path / "bad.ngc", HEAD + "G1 Z190 F2000\nM106\nG1 Z180\nM2\n"), config)
    assert bad.result.report.result == "stopped"
    assert "bad.ngc:4" in str(bad.result.error)
    assert "no glue" in str(bad.result.error)
    assert bad.last_truth.tcp_mm[2] == pytest.approx(190.0, abs=0.3)


def test_an_m_code_without_an_executable_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GcodeError, match=r"x\.ngc:3"):
        run_in_cell(write(tmp_path / "x.ngc", HEAD + "M150\nM2\n"), load_config(RM501))


def test_spindle_and_coolant_words_switch_the_outputs_that_are_configured(tmp_path: Path) -> None:
    text = f'extends = "{RM501}"\n[board]\ndigital_outputs = ["0.1", "1.2", "1.7"]\n'
    text += "[gcode.outputs]\nM3 = [0, true]\nM5 = [0, false]\nM8 = [2, true]\n"
    config = load_config(write(tmp_path / "c.toml", text))
    run = run_in_cell(write(tmp_path / "x.ngc", HEAD + "M3 S100\nG1 Z190 F2000\nM5 M8\nM2\n"), config)
    assert run.result.report.result == "ok"
    events = [
        (event.mask, event.levels)
        for piece in run.result.plan.pieces
        for event in piece.events
        if piece.kind.value == "output"
    ]
    pins = run.words[-1]
    assert not pins & 1 << output_bit(1, 7), "output 2 stays on, active low"
    assert events[:3] == [(1, 1), (1, 0), (4, 4)]


def test_an_output_that_is_not_fitted_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(GcodeError, match=r"x\.ngc:3.*\n.*no digital output 5|x\.ngc:3.*no digital output 5"):
        run_in_cell(write(tmp_path / "x.ngc", HEAD + "M64 P5\nM2\n"), load_config(RM501))


def test_words_left_out_after_a_tool_length_keep_the_tip_where_it_is(tmp_path: Path) -> None:
    program = write(tmp_path / "x.ngc", HEAD + "G43.1 Z20\nG1 X285 F2000\nM2\n")
    run = run_in_cell(program, load_config(RM501))
    # the tip of the longer tool was at Z 180 and stays there: the wrist does not move up or down
    assert run.last_truth.tcp_mm == pytest.approx((285.0, 0.0, 200.0), abs=0.3)


def test_messages_and_pauses_are_told(tmp_path: Path) -> None:
    program = write(tmp_path / "x.ngc", HEAD + "(MSG,hello)\n(PRINT,Z is #5422)\nM1\nM2\n")
    run = run_in_cell(program, load_config(RM501))
    assert any("hello" in message for message in run.watched.messages)
    assert any("M1" in message for message in run.watched.messages)

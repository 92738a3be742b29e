"""A program that goes wrong beyond what was checked before the start: the arm ends at rest before that place."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest

from rm501_host.cli.main import exit_code_of
from rm501_host.config import load_config
from rm501_host.errors import ProgramRefusedError
from tests.support.cell import run_in_cell

CONFIG = load_config()
SHORT = msgspec.structs.replace(CONFIG, preflight=msgspec.structs.replace(CONFIG.preflight, max_blocks=100))
GOOD = 600
HEAD = ["G21 G90 G94 G64 P0.1 Q0", "G0 X280 Y0 Z200 A0 B0", "F6000", "(LOGOPEN, out.txt)"]
LINES = [f"G1 X{280 + 5 * math.sin(0.02 * i):.4f} Y{0.15 * i:.3f}" for i in range(1, GOOD + 1)]
LAST_MM = (280 + 5 * math.sin(0.02 * GOOD), 0.15 * GOOD, 200.0)
BAD_LINE = len(HEAD) + GOOD + 2


@pytest.mark.parametrize(("bad", "said"), [("G1 X900", "cannot be reached"), ("G1 Xoops", "unknown")])
def test_it_ends_at_rest_at_the_end_of_the_last_good_move(tmp_path: Path, bad: str, said: str) -> None:
    program = tmp_path / "long.ngc"
    program.write_text("\n".join([*HEAD, *LINES, "(LOG, nearly)", bad, "G1 X300", "(LOG, over)", "M2", ""]))
    run = run_in_cell(program, SHORT)
    error = run.result.error
    assert isinstance(error, ProgramRefusedError)
    assert exit_code_of(error) == 5
    assert f"long.ngc:{BAD_LINE}:" in str(error)
    assert "was running" in str(error)
    assert said in str(error).lower()
    assert run.result.report.result == "refused"
    assert run.last_truth.tcp_mm == pytest.approx(LAST_MM, abs=0.4)
    assert run.result.report.limits.joint_acceleration_ratio <= 1.0 + 1e-6
    moved = [piece for piece in run.result.plan.pieces if piece.motion_s]
    assert moved[-1].ends_at_rest and len(moved) > 1
    assert (tmp_path / "out.txt").read_text() == "nearly\n"


def test_the_same_program_is_refused_before_the_start_where_the_check_reaches(tmp_path: Path) -> None:
    program = tmp_path / "long.ngc"
    program.write_text("\n".join([*HEAD, *LINES, "(LOG, nearly)", "G1 X900", "M2", ""]))
    with pytest.raises(Exception, match=rf"long\.ngc:{BAD_LINE}: error: .*cannot be reached") as refused:
        run_in_cell(program, CONFIG)
    assert not isinstance(refused.value, ProgramRefusedError)
    assert not (tmp_path / "out.txt").exists()

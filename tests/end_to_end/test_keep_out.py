"""Keep-out zones and long programs: checked before the start, planned as the arm moves."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.errors import RefusedError
from tests.support.cell import run_in_cell

ROOT = Path(__file__).parents[2]
RM501 = ROOT / "configs" / "rm501.toml"
DOWN_AND_UP = "G21 G90 G94\nG0 X280 Y0 Z200 A0 B0\nG1 Z100 F2000\nG1 Z200\nM2\n"


def test_a_path_below_the_table_is_refused_naming_the_line(tmp_path: Path) -> None:
    config = tmp_path / "table.toml"
    config.write_text(f'extends = "{RM501}"\n[keep_out]\ntable_z_mm = 120.0\n')
    program = tmp_path / "down.ngc"
    program.write_text(DOWN_AND_UP)
    with pytest.raises(RefusedError, match=r"down\.ngc:3: error: .*table"):
        run_in_cell(program, load_config(config))
    assert run_in_cell(program, load_config(RM501)).result.error is None


def test_a_program_too_long_to_plan_ahead_runs_to_its_exact_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rm501_host.program_plan.EAGER_MOVES", 100)
    program = tmp_path / "long.ngc"
    lines = ["G21 G90 G94 G61", "G0 X280 Y0 Z200 A0 B0", "F6000"]
    lines += [f"G1 Z{200 - 0.02 * (index % 2):.2f}" for index in range(100)]
    lines += ["G64 P0.1"] + [f"G1 Y{0.01 * index:.3f}" for index in range(500)] + ["M2"]
    program.write_text("\n".join(lines) + "\n")
    run = run_in_cell(program, load_config(RM501))
    assert run.result.report.result == "ok"
    assert run.last_truth.tcp_mm == pytest.approx((280.0, 4.99, 200.0), abs=0.4)

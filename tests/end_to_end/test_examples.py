"""Every shipped example runs on the emulated arm, on the configuration that its first line names."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.config import Config, load_config
from tests.support.cell import run_in_cell

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.ngc"))


def configuration_for(program: Path) -> Config:
    name = "thesis.toml" if "thesis.toml" in program.read_text().splitlines()[0] else "rm501.toml"
    return load_config(ROOT / "configs" / name)


@pytest.mark.parametrize("program", EXAMPLES, ids=lambda path: path.name)
def test_an_example_runs_to_its_end(program: Path) -> None:
    run = run_in_cell(program, configuration_for(program))
    assert run.result.error is None
    assert run.result.report.result == "ok"
    assert run.result.report.tracking.max_step_error <= 0.1
    planned = run.result.plan.sample(1e-3).q_deg[-1]
    assert run.last_truth.joint_deg == pytest.approx(tuple(planned), abs=0.04)

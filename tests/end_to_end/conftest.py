"""One run of the thesis's program, shared by the tests that look at it from different sides."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.config import Config, load_config
from tests.support.cell import CellRun, run_in_cell
from tests.support.pin_decoder import DecodedRun, decode

ROOT = Path(__file__).parents[2]
PROGRAM = ROOT / "examples" / "pick_and_place.ngc"


@pytest.fixture(scope="session")
def thesis() -> Config:
    return load_config(ROOT / "configs" / "thesis.toml")


@pytest.fixture(scope="session")
def thesis_run(thesis: Config) -> CellRun:
    return run_in_cell(PROGRAM, thesis)


@pytest.fixture(scope="session")
def thesis_pins(thesis_run: CellRun) -> DecodedRun:
    return decode(thesis_run.words.tolist())

"""Draws `sim-board-swapped-select.svg` from the VCD of the worked example in `docs/sim-board.md`.

python docs/figures/sim_board.py [folder]

The example is run first, from its command line; it has to end as the page says.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from vcdvcd import VCDVCD

REPOSITORY = Path(__file__).resolve().parents[2]
FAULT = "swap:line=elbow_select,with=waist_select"
TOLD = "homing waist: stopped: the board stopped the arm: the up/down counter of a driver board overflowed"
ROWS = (
    "pins.STROBE",
    "pins.STEP_1",
    "pins.ELBOW_SELECT",
    "pins.WAIST_SELECT",
    "lines.ELBOW_SELECT",
    "lines.WAIST_SELECT",
    "lines.STROBE_724",
    "lines.STEP_1",
)


def record(vcd: Path) -> None:
    """Run the worked example, which records its pins."""
    command = [sys.executable, "-m", "rm501_host", "--config", "configs/thesis.toml"]
    command += ["--port", f"emu://?fault={FAULT}&vcd={vcd}"]
    command += ["run", "examples/pick_and_place.ngc", "--speed", "max"]
    result = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    if TOLD not in result.stderr:
        sys.exit(f"the worked example ended otherwise than docs/sim-board.md says: {result.stderr}")


def draw(vcd: Path, picture: Path) -> None:
    """The frame in which the elbow counts its first step, at the pins and at the terminals."""
    dump = VCDVCD(str(vcd))
    step_us = dump["motors.elbow_steps"].tv[1][0]
    start_us = step_us // 320 * 320
    times_us = list(range(start_us - 40, start_us + 361, 4))
    figure, axes = plt.subplots(figsize=(9, 4.2))
    for row, name in enumerate(reversed(ROWS)):
        levels = [1.5 * row + int(dump[name][t]) for t in times_us]
        swapped = name.startswith("lines.") and "SELECT" in name
        axes.step(times_us, levels, where="post", color="#b03030" if swapped else "#203a60", lw=1.5)
        axes.text(start_us - 46, 1.5 * row + 0.3, name, ha="right", fontsize=8, family="monospace")
    axes.axvline(step_us, color="#999999", ls="--", lw=1)
    axes.text(step_us + 2, 1.5 * len(ROWS) - 0.4, "the elbow counts a step", fontsize=8)
    axes.set_yticks([])
    axes.set_xlabel("us since power-up")
    axes.set_xlim(start_us - 44, start_us + 364)
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    figure.tight_layout()
    figure.savefig(picture, metadata={"Date": None})


def main() -> None:
    """Run the example, draw its picture into the folder of the command line, or beside this file."""
    plt.rcParams["svg.hashsalt"] = "rm501"
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    with tempfile.TemporaryDirectory() as scratch:
        vcd = Path(scratch) / "swap.vcd"
        record(vcd)
        draw(vcd, folder / "sim-board-swapped-select.svg")


if __name__ == "__main__":
    main()

"""The figure of overshoot in docs/planning.md: python docs/figures/overshoot.py [folder].

It draws docs/figures/overshoot.json, which `python -m benchmarks.overshoot --jerk 2 1 0.5 --save ...` writes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

HERE = Path(__file__).parent


def main() -> None:
    """The tool's way along the direction of arrival around the worst stop of each law."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    saved = json.loads((HERE / "overshoot.json").read_text())
    figure, axes = plt.subplots(figsize=(9, 4))
    for label, beyond in saved["beyond_um"].items():
        times_ms = saved["first_ms"] + saved["step_ms"] * np.arange(len(beyond))
        axes.plot(times_ms, 1e-3 * np.array(beyond), lw=1.2, label=label)
    axes.axhline(0.0, color="k", lw=0.5)
    axes.set(xlim=(saved["first_ms"], 400), ylim=(-2.0, 1.2), xlabel="ms after the end of the commanded motion")
    axes.set(ylabel="mm beyond the rest", title="Pick and place F6000, the stop with the largest overshoot")
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(folder / "planning_overshoot.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()

"""The live path: override changes, holds and running back at random instants of a program, on virtual time.

    python -m benchmarks.live_path [--n RUNS] [--seed N]

Every run must end on the very steps of the undisturbed one, stay on its path at the pins (within the resolution of
both) and keep every limit in the segments that were played, cuts of the queue included. Half of the runs are
jerk-limited.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import sys
import tempfile
from pathlib import Path

import msgspec

from rm501_host.config import load_config
from rm501_host.virtual_time import run_virtual
from tests.support.live_cell import Trial, live_cell, trial, undisturbed


async def trials(runs: int, seed: int, *, backs: bool, jerk_limited: bool = False) -> tuple[float, list[Trial]]:
    """Duration of the undisturbed run in s, and the disturbed ones."""
    rng = random.Random(seed)
    config = load_config()
    if jerk_limited:
        planner = msgspec.structs.replace(config.planner, jerk_limited=True)
        config = msgspec.structs.replace(config, planner=planner)
    with tempfile.TemporaryDirectory() as folder:
        async with live_cell(Path(folder), config=config) as cell:
            reference = await undisturbed(cell)
            found = []
            for _ in range(runs):
                found.append(await trial(cell, reference, rng, backs=backs))
                await asyncio.sleep(0)
            return reference.duration_s, found


def main() -> int:
    """Run and print; 1 when a run is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=float, default=40, help="runs")
    parser.add_argument("--seed", type=int, default=501)
    arguments = parser.parse_args()
    wrong = 0
    print(
        "what                   runs  instants  cuts  mm off  steps off  velocity  acceleration  jump, steps/s  wrong"
    )
    for name, backs, jerk_limited in (
        ("override, hold", False, False),
        ("running back", True, False),
        ("override, hold; jerk", False, True),
        ("running back; jerk", True, True),
    ):
        runs = max(1, int(arguments.n) // 4)
        _, found = run_virtual(trials(runs, arguments.seed, backs=backs, jerk_limited=jerk_limited))
        bad = [item for item in found if item.wrong]
        wrong += len(bad)
        print(
            f"{name:22s} {len(found):4d} {sum(len(item.acts) for item in found):9d} "
            f"{sum(item.cuts for item in found):5d} {max(item.deviation_mm for item in found):7.3f} "
            f"{max(item.steps_off for item in found):10d} {max(item.ratios.velocity for item in found):9.4f} "
            f"{max(item.ratios.acceleration for item in found):13.4f} "
            f"{max(item.ratios.jump_steps_s for item in found):14.5f} {len(bad):6d}"
        )
        for item in bad:
            print(f"  {item.wrong}: {'; '.join(item.acts)}")
    print(f"live path: {wrong} runs wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

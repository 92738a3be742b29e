"""Cartesian jogs from random poses: every limit, the tool's speed, and how far damping takes the tool off its line; how
long jogs and other motions take to begin.

    python -m benchmarks.jogs --n 200

Half of the poses are anywhere inside the joint ranges, half near the waist axis. Ratios are of the ideal law, sampled
every 2 ms; the deviation outside damped parts is measured before the first of them, from the forward kinematics alone.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.starts import print_starts
from rm501_host.config import load_config
from rm501_host.errors import RefusedError
from rm501_host.kinematics import Arm
from rm501_host.machine.jog_path import MOST_DEVIATION_MM
from rm501_host.machine.jog_plan import heading_of, plan_cartesian_jog
from rm501_host.planner import Plan

REPOSITORY = Path(__file__).resolve().parents[1]
TEACH_MM_S = 250.0
AXIS_POSE = np.array((0.0, 85.0, -30.0, 172.0, 0.0))
Array = NDArray[np.float64]


def main() -> int:
    """Run as many jogs as asked for; 1 when a target was missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=lambda text: int(float(text)), default=200, help="jogs")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    config = load_config(REPOSITORY / "configs" / "rm501.toml")
    arm = Arm.from_config(config)
    low, high = arm.limits_deg
    rng = np.random.default_rng(options.seed)
    done = damped = refused = 0
    worst = speed = straight_mm = off_mm = back_mm = 0.0
    ends: Counter[str] = Counter()
    while done < options.n:
        near_axis = done % 2 == 1
        if near_axis:
            spread = np.array((100.0, 8.0, 8.0, 8.0, 90.0))
            q_deg = np.clip(AXIS_POSE + spread * rng.uniform(-1.0, 1.0, 5), low, high)
        else:
            q_deg = rng.uniform(low, high)
        frame = str(rng.choice(["world", "tool"]))
        axis = str(rng.choice(list("xyz")))
        wanted = float(rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 300.0))
        try:
            jog = plan_cartesian_jog(arm, config, q_deg, frame, axis, wanted, None, TEACH_MM_S)
        except RefusedError:
            refused += 1
            continue
        done += 1
        plan = Plan(arm, config, jog.pieces)
        samples = plan.sample(2e-3)
        worst = max(worst, plan.limits(samples).worst)
        direction = heading_of(arm, q_deg, frame, axis, float(np.sign(wanted))).direction[:3]
        moved = samples.tcp_mm - samples.tcp_mm[0]
        along = moved @ direction
        off = np.linalg.norm(moved - along[:, None] * direction, axis=1)
        step_s = np.diff(samples.t_s)
        rates = np.linalg.norm(np.diff(samples.tcp_mm, axis=0), axis=1) / step_s
        speed = max(speed, float(rates.max()) / min(abs(wanted), TEACH_MM_S))
        back_mm = max(back_mm, float(-np.diff(along).min()))
        in_zone = samples.line == 1
        first = int(np.argmax(in_zone)) if in_zone.any() else len(in_zone)
        straight_mm = max(straight_mm, float(off[:first].max(initial=0.0)))
        off_mm = max(off_mm, float(off.max()))
        damped += bool(in_zone.any())
        ends[_kind(jog.path.reason)] += 1
    print(f"{done} jogs ({refused} more could not start that way), {damped} of them through a damped part")
    print(f"  largest ratio to a joint's or a motor's limit   {worst:.6f}")
    print(f"  largest tool speed over what was asked          {speed:.6f}")
    print(f"  off the line before any damping                 {straight_mm:.2e} mm")
    print(f"  off the line anywhere                           {off_mm:.2f} mm")
    print(f"  largest step back along the line                {max(back_mm, 0.0):.2e} mm")
    print("  ended by: " + ", ".join(f"{what} {count}" for what, count in ends.most_common()))
    good = (
        worst <= 1.0
        and speed <= 1.0 + 1e-6
        and straight_mm < 1e-6
        and off_mm < MOST_DEVIATION_MM + 0.1
        and back_mm < 1e-4
    )
    good = print_starts() and good
    print(f"jogs: {'all targets met' if good else 'a target was MISSED'}")
    return 0 if good else 1


def _kind(reason: str) -> str:
    for word in ("limit", "leaves the reach", "sideways", "off the line", "no way on"):
        if word in reason:
            return word
    return reason or "nothing"


if __name__ == "__main__":
    sys.exit(main())

"""Kinematics: throughput beside roboticstoolbox (when installed), agreement, and passages through singularities.

    python -m benchmarks.kinematics [--n 1e5] [--no-passages]

Prints a table and one closing line; exits 1 when a target is missed. Rates are per second of this process's own CPU
time, the best of many short rounds, so that a busy machine spoils them less; compare the ratios of one run.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, Branch, Damping, DampingLaw, VelocityController, default_damping
from rm501_host.kinematics.passages import NotArrivedError, Passage, run_passage
from rm501_host.kinematics.results import FloatArray

SCALAR_IK_TARGET_S = 60e3
BATCH_IK_TARGET_S = 2.5e6
FK_TARGET_MM = 1e-9
BATCH_ROWS = 10_000
ROUNDS = 30


@dataclass(frozen=True, slots=True)
class PassageCase:
    """A start (x, y, z in mm, pitch, roll in deg) and legs (mm) that meet a singularity."""

    name: str
    start: tuple[float, float, float, float, float]
    legs_mm: tuple[tuple[float, float, float], ...]
    speed_mm_s: float = 20.0


PASSAGES = (
    PassageCase("elbow, out of reach and back", (430.0, 0.0, 330.0, 90.0, 0.0), ((30.0, 0.0, 0.0), (-30.0, 0.0, 0.0))),
    PassageCase(
        "elbow, out of reach and aside", (430.0, 0.0, 330.0, 90.0, 0.0), ((30.0, 0.0, 0.0), (-20.0, 60.0, 0.0))
    ),
    PassageCase("waist axis, through it", (40.0, 0.0, 650.0, 225.0, 0.0), ((-80.0, 0.0, 0.0),)),
    PassageCase("waist axis, 1 mm beside it", (40.0, 1.0, 650.0, 225.0, 0.0), ((-80.0, 0.0, 0.0),)),
    PassageCase("shoulder, through it", (25.0, 0.0, 692.0, 180.0, 0.0), ((-40.0, 0.0, 0.0),)),
    PassageCase("double, out of reach and back", (1.0, 0.0, 689.0, 180.0, 0.0), ((0.0, 0.0, 8.0), (0.0, 0.0, -8.0))),
)
"""Every kind of singularity; the first two and the last leave the workspace on purpose and come back."""

METHODS: tuple[tuple[str, Damping | None], ...] = (
    ("pseudo-inverse", None),
    ("constant", Damping(DampingLaw.CONSTANT, 0.05)),
    ("manipulability", default_damping()),
    ("rate of change", Damping(DampingLaw.RATE_OF_CHANGE, 0.1)),
)


def passage(arm: Arm, case: PassageCase, damping: Damping | None, max_s: float = 30.0) -> Passage | None:
    """Drive one case with one damping; None when it never arrives."""
    result = arm.ik(case.start[:3], case.start[3], case.start[4])
    assert result.best is not None, f"{case.name}: {result.reason}"
    limits = arm.motors.velocity_limits
    controller = VelocityController(arm.geometry, limits, damping)
    try:
        return run_passage(
            arm.geometry,
            controller,
            result.best.q_deg,
            np.array(case.legs_mm),
            case.speed_mm_s,
            settle_s=1.0,
            max_s=max_s,
        )
    except NotArrivedError:
        return None


def best_rate(run: Callable[[], None], count: int) -> float:
    """Calls per second of CPU time: the best of several rounds."""
    best = float("inf")
    for _ in range(ROUNDS):
        begin = time.process_time()
        run()
        best = min(best, time.process_time() - begin)
    return count / best


def toolbox_robot(arm: Arm) -> Any:
    """The same arm in roboticstoolbox, or None where it is not installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import roboticstoolbox as rtb
        except ImportError:
            return None
        geometry = arm.geometry
        return rtb.DHRobot(
            [
                rtb.RevoluteDH(d=geometry.d1_mm, alpha=np.pi / 2),
                rtb.RevoluteDH(a=geometry.a2_mm),
                rtb.RevoluteDH(a=geometry.a3_mm),
                rtb.RevoluteDH(alpha=np.pi / 2),
                rtb.RevoluteDH(d=geometry.d5_mm),
            ]
        )


def throughput(arm: Arm, robot: Any, q: FloatArray) -> list[tuple[str, float, float | None]]:
    """(name, ours per s, roboticstoolbox per s or None)."""
    rows = q[:BATCH_ROWS]
    positions, _ = arm.fk_batch(rows)
    pitch, roll = rows[:, 1:4].sum(axis=1), np.ascontiguousarray(rows[:, 4])
    some = rows[:500].tolist()
    poses = list(zip(positions[:500].tolist(), pitch[:500].tolist(), roll[:500].tolist(), strict=True))
    few = np.radians(rows[:50])

    def each(function: Callable[[Any], object], values: Any) -> Callable[[], None]:
        def run() -> None:
            for value in values:
                function(value)

        return run

    theirs: dict[str, float] = {}
    if robot is not None:
        chain = robot.ets()
        matrices = [robot.fkine(row).A for row in few]
        theirs["fk"] = best_rate(each(robot.fkine, few), len(few))
        theirs["jacobian"] = best_rate(each(robot.jacob0, few), len(few))
        theirs["ik"] = best_rate(each(lambda m: chain.ik_LM(m, q0=few[0]), matrices), len(few))
    count = len(rows)
    return [
        ("fk", best_rate(each(arm.fk, some), len(some)), theirs.get("fk")),
        ("fk_batch", best_rate(lambda: _drop(arm.fk_batch(rows)), count), theirs.get("fk")),
        ("ik", best_rate(each(lambda p: arm.ik(*p), poses), len(poses)), theirs.get("ik")),
        ("ik_batch", best_rate(lambda: _drop(arm.ik_batch(positions, pitch, roll)), count), theirs.get("ik")),
        ("jacobian", best_rate(each(arm.jacobian, some), len(some)), theirs.get("jacobian")),
        ("jacobian_batch", best_rate(lambda: _drop(arm.jacobian_batch(rows)), count), theirs.get("jacobian")),
        ("task_jacobian_batch", best_rate(lambda: _drop(arm.task_jacobian_batch(rows)), count), None),
        ("joint_rates_batch", best_rate(lambda: _drop(arm.joint_rates_batch(rows, rows)), count), None),
    ]


def _drop(_: object) -> None:
    return None


def agreement(arm: Arm, robot: Any, q: FloatArray) -> list[tuple[str, float, str]]:
    """(what, largest difference, unit) over the configurations."""
    positions, rotations = arm.fk_batch(q)
    pitch = q[:, 1:4].sum(axis=1)
    found = []
    worst_mm = worst_deg = 0.0
    contained = np.zeros(len(q), dtype=bool)
    inside = np.zeros(len(q), dtype=int)
    for branch in Branch:
        solved, ok = arm.ik_batch(positions, pitch, q[:, 4], branch)
        inside += ok
        if not ok.any():
            continue
        back, _ = arm.fk_batch(solved[ok])
        worst_mm = max(worst_mm, float(np.abs(back - positions[ok]).max()))
        turn = solved[ok, 1:4].sum(axis=1) - pitch[ok]
        worst_deg = max(worst_deg, float(np.abs((turn + 180.0) % 360.0 - 180.0).max()))
        with np.errstate(invalid="ignore"):
            contained |= ok & (np.abs(solved - q).max(axis=1) <= 1e-6)
    regular = (np.abs(np.sin(np.radians(q[:, 2]))) > 1e-3) & (np.hypot(*positions[:, :2].T) > 1.0)
    found.append(("FK(IK(x)), position", worst_mm, "mm"))
    found.append(("FK(IK(x)), pitch", worst_deg, "deg"))
    found.append(("IK(FK(q)) without q, regular", float((regular & ~contained).sum()), "of n"))
    print(f"exactly one branch inside the limits: {(inside == 1).mean():.1%} of these poses")
    if robot is not None:
        far_mm = far_rotation = far_jacobian = 0.0
        jacobians = arm.jacobian_batch(q)
        for row, position, rotation, jacobian in zip(np.radians(q), positions, rotations, jacobians, strict=True):
            matrix = robot.fkine(row).A
            far_mm = max(far_mm, float(np.abs(matrix[:3, 3] - position).max()))
            far_rotation = max(far_rotation, float(np.abs(matrix[:3, :3] - rotation).max()))
            far_jacobian = max(far_jacobian, float(np.abs(robot.jacob0(row) - jacobian).max()))
        found.append(("FK - roboticstoolbox", far_mm, "mm"))
        found.append(("rotation - roboticstoolbox", far_rotation, ""))
        found.append(("J - roboticstoolbox", far_jacobian, "mm/rad"))
    return found


def show_passages(arm: Arm) -> bool:
    """Print every case with every damping; True when the default stays inside the limits and arrives."""
    good = True
    limits = arm.motors.velocity_limits
    print(f"\n{'passage at 20 mm/s':32} {'damping':16} {'time s':>7} {'error mm':>9} {'end mm':>8} {'rate/max':>9}")
    for case in PASSAGES:
        for name, damping in METHODS:
            run = passage(arm, case, damping)
            if run is None:
                print(f"{case.name:32} {name:16} does not arrive within 30 s")
                continue
            ratio = float(np.max(limits.ratio(run.rates_deg_s)))
            end = float(run.error_mm[-1])
            print(f"{case.name:32} {name:16} {run.t_s[-1]:7.2f} {run.largest_error_mm:9.3f} {end:8.4f} {ratio:9.4f}")
            if name == "manipulability":
                good &= ratio <= 1.0 + 1e-12 and end <= 0.1
    return good


def main() -> int:
    """Run everything; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=lambda text: int(float(text)), default=20_000, help="configurations (1e5)")
    parser.add_argument("--no-passages", action="store_true", help="leave out the passages through singularities")
    arguments = parser.parse_args()
    arm = Arm.from_config(load_config())
    robot = toolbox_robot(arm)
    low, high = arm.limits_deg
    q = np.random.default_rng(1).uniform(low, high, (max(arguments.n, BATCH_ROWS), 5))
    rates = throughput(arm, robot, q)
    print(f"{'operation':22} {'per CPU s':>14} {'roboticstoolbox':>16} {'ratio':>9}")
    for name, ours, theirs in rates:
        other = f"{theirs:16,.0f} {ours / theirs:9,.0f}" if theirs else f"{'-':>16} {'-':>9}"
        print(f"{name:22} {ours:14,.0f} {other}")
    print(f"\n{'agreement over ' + str(len(q)) + ' configurations':42} {'largest':>10}")
    agreed = True
    for what, largest, unit in agreement(arm, robot, q):
        print(f"{what:42} {largest:10.2e} {unit}")
        agreed &= largest <= FK_TARGET_MM if unit != "of n" else largest == 0
    passed = True if arguments.no_passages else show_passages(arm)
    by_name = {name: ours for name, ours, _ in rates}
    scalar, many = by_name["ik"], by_name["ik_batch"]
    good = agreed and passed and scalar >= SCALAR_IK_TARGET_S and many >= BATCH_IK_TARGET_S
    verdict = "PASS" if good else "FAIL"
    print(
        f"\nkinematics: {verdict}: ik {scalar / 1e3:.0f} k/s (target 60), ik_batch {many / 1e6:.1f} M/s (target 2.5), "
        f"agreement {'ok' if agreed else 'MISSED'}, passages {'ok' if passed else 'MISSED'}"
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

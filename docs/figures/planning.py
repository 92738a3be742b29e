"""The figures of docs/planning.md: python docs/figures/planning.py [folder]."""

from __future__ import annotations

import sys
from math import sqrt
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import msgspec
import numpy as np

from rm501_host.config import JOINT_NAMES, load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, LinearMove, Move, PathMode, PathModeChange, Source
from rm501_host.planner import Plan, Planner
from rm501_host.planner.elements import ElementTable
from rm501_host.planner.grid import GridBuilder
from rm501_host.planner.law import PathLaw
from rm501_host.planner.limits import Limits
from rm501_host.planner.timelaw import backward_pass

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
LIMITS = Limits.from_config(CONFIG)
CORNERS = ((280, -100), (340, -100), (340, -30), (310, -30), (310, 30), (340, 30), (340, 100), (280, 100))


def source(line: int) -> Source:
    """A place in the example."""
    return Source("figure.ngc", line)


def polyline(blend_mm: float | None) -> list[Move]:
    """Polyline A, stopping (None) or blended."""
    mode = PathMode.EXACT_STOP if blend_mm is None else PathMode.BLEND
    moves: list[Move] = [PathModeChange(mode, blend_mm, None, source(1))]
    for line, (x, y) in enumerate(CORNERS[1:], 2):
        moves.append(LinearMove((x, y, 100.0, 0.0, 0.0, 0.0), Feed(30000.0), source(line)))
    return moves


def start_of(x: float, y: float, z: float, pitch: float = 0.0) -> tuple[float, ...]:
    """Joints at a point."""
    best = ARM.ik((x, y, z), pitch, 0.0).best
    assert best is not None
    return best.q_deg


def planned(moves: list[Move], start: tuple[float, ...]) -> Plan:
    """A plan under the default configuration."""
    return Plan(ARM, CONFIG, Planner(ARM, CONFIG, start).plan(moves))


def phase_plane(folder: Path) -> None:
    """s against ds/dt: rate limits, what can still stop, the law."""
    plan = planned(polyline(2.0711), start_of(280, -100, 100))
    law = plan.pieces[0].law
    assert isinstance(law, PathLaw)
    grid = GridBuilder(ARM, LIMITS).build(ElementTable(law.table.elements))
    offsets = np.concatenate((np.zeros(1), np.cumsum(law.table.length)))
    way = np.append(offsets[grid.element] + grid.start, offsets[-1])
    figure, axes = plt.subplots(figsize=(9, 4))
    axes.plot(
        way[1:], np.sqrt(np.minimum(grid.lines.y_cap, 500.0**2)), color="0.6", lw=1, label="joint and motor rates"
    )
    axes.plot(way[:-1], np.sqrt(grid.lines.peak_x), color="tab:orange", lw=1, label="accelerations (maximum velocity)")
    axes.plot(
        way, np.sqrt(backward_pass(grid.lines, 0.0)), color="tab:green", lw=1, ls="--", label="can still reach the end"
    )
    mine = np.append(offsets[law.element] + law.start, offsets[law.element[-1]] + law.stop[-1])
    axes.plot(mine, law.speed, color="tab:blue", lw=2, label="the law")
    axes.set(xlabel="s along the path, mm", ylabel="ds/dt, mm/s", ylim=(0, 260), title="Polyline A with 5 mm blends")
    axes.legend(loc="upper right", fontsize=8)
    save(figure, folder, "planning_phase_plane.png")


def joint_curves(folder: Path) -> None:
    """Rates and accelerations of the joints against their limits."""
    samples = planned(polyline(2.0711), start_of(280, -100, 100)).sample()
    figure, (rates, accelerations) = plt.subplots(2, 1, figsize=(9, 6), sharex=True)
    for joint in range(4):
        name = JOINT_NAMES[joint]
        rates.plot(samples.t_s, samples.qd_deg_s[:, joint] / LIMITS.joint_velocity_deg_s[joint], label=name, lw=1)
        accelerations.plot(
            samples.t_s, samples.qdd_deg_s2[:, joint] / LIMITS.joint_acceleration_deg_s2[joint], label=name, lw=1
        )
    for axes, what in ((rates, "rate"), (accelerations, "acceleration")):
        axes.axhline(1, color="k", lw=0.5)
        axes.axhline(-1, color="k", lw=0.5)
        axes.set_ylabel(f"joint {what} / limit")
        axes.legend(loc="upper right", fontsize=8, ncol=4)
    accelerations.set_xlabel("t, s")
    save(figure, folder, "planning_joints.png")


def blends(folder: Path) -> None:
    """The path from above, stopping and blended."""
    figure, axes = plt.subplots(figsize=(5, 6))
    start = start_of(280, -100, 100)
    for label, blend, colour in (
        ("G61.1", None, "0.6"),
        ("G64 P0.5", 0.5, "tab:green"),
        ("G64 P2.07", 2.0711, "tab:blue"),
    ):
        plan = planned(polyline(blend), start)
        samples = plan.sample()
        axes.plot(
            samples.tcp_mm[:, 0], samples.tcp_mm[:, 1], color=colour, lw=1.3, label=f"{label}: {plan.motion_s:.2f} s"
        )
    axes.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title="Polyline A from above")
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.02, 0.5))
    save(figure, folder, "planning_blends.png")


def stretch(folder: Path) -> None:
    """Tool speed along chords whose ends come near to full stretch."""
    figure, axes = plt.subplots(figsize=(9, 4))
    for gap in (5.0, 1.0, 0.1, 0.001):
        x = sqrt((465.0 - gap) ** 2 - 60.0**2)
        move = LinearMove((x, 60.0, 230.0, 90.0, 0.0, 0.0), Feed(6000.0), source(1))
        plan = planned([move], start_of(x, -60, 230, 90))
        samples = plan.sample()
        speed = np.linalg.norm(np.diff(samples.tcp_mm, axis=0), axis=1) / np.diff(samples.t_s)
        axes.plot(samples.tcp_mm[1:, 1], speed, lw=1.2, label=f"{gap:g} mm: {plan.motion_s:.2f} s")
    axes.set(xlabel="y, mm", ylabel="tool speed, mm/s", title="A chord whose ends are this far from full stretch")
    axes.legend(fontsize=8)
    save(figure, folder, "planning_stretch.png")


def jerk(folder: Path) -> None:
    """Accelerations with and without the jerk limit."""
    soft = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
    figure, axes = plt.subplots(figsize=(9, 4))
    start = start_of(280, -100, 100)
    for config, label in ((CONFIG, "time-optimal"), (soft, "jerk-limited")):
        plan = Plan(ARM, config, Planner(ARM, config, start).plan(polyline(2.0711)[:4]))
        samples = plan.sample()
        axes.plot(samples.t_s, samples.qdd_deg_s2[:, 1], lw=1, label=f"{label}: {plan.motion_s:.2f} s")
    axes.set(xlabel="t, s", ylabel="shoulder acceleration, deg/s²", title="First three lines of polyline A")
    axes.legend(fontsize=8)
    save(figure, folder, "planning_jerk.png")


def save(figure: plt.Figure, folder: Path, name: str) -> None:
    """Write a figure without a date in it, so that it changes only when its content does."""
    figure.tight_layout()
    figure.savefig(folder / name, dpi=110, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    """Write every figure."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    for draw in (phase_plane, joint_curves, blends, stretch, jerk):
        draw(folder)


if __name__ == "__main__":
    main()

"""A picture of a planned program: the tool's path in space and the joints over time."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rm501_host.config.schema import JOINT_NAMES
from rm501_host.errors import RefusedError

if TYPE_CHECKING:
    from numpy.typing import NDArray

SUFFIXES = (".png", ".svg")


def require_matplotlib() -> None:
    """Raise RefusedError when pictures cannot be drawn here."""
    if importlib.util.find_spec("matplotlib") is None:
        raise RefusedError("pictures need matplotlib: pip install 'rm501[plot]'")


def draw_program(
    path: Path,
    title: str,
    time_s: NDArray[np.float64],
    joints_deg: NDArray[np.float64],
    tcp_mm: NDArray[np.float64],
) -> None:
    """Write PNG or SVG (by the suffix) to `path`: `time_s` (n), `joints_deg` (n, 5), `tcp_mm` (n, 3) in the base
    frame.

    Raises RefusedError when matplotlib is not installed, ValueError for a suffix outside SUFFIXES, OSError when the
    file cannot be written.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path}: a picture is PNG or SVG")
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.1, 1.3))
    space = figure.add_subplot(grid[:, 0], projection="3d")
    space.plot(tcp_mm[:, 0], tcp_mm[:, 1], tcp_mm[:, 2], linewidth=1.5)
    space.scatter(*tcp_mm[0], marker="o", label="start")
    space.scatter(*tcp_mm[-1], marker="s", label="end")
    space.set(xlabel="X mm", ylabel="Y mm", zlabel="Z mm", title="tool centre point, base frame")
    for axis in (space.xaxis, space.yaxis):
        axis.labelpad = 12  # clear of the ticks' numbers
    space.set_aspect("equal")
    space.legend(loc="upper left")
    angles = figure.add_subplot(grid[0, 1])
    for joint, name in enumerate(JOINT_NAMES):
        # joints often run in step (the roll with the waist): a dashed line shows the one below
        angles.plot(time_s, joints_deg[:, joint], label=name, linestyle="-" if joint < len(JOINT_NAMES) - 1 else "--")
    angles.set(ylabel="joint angle, deg")
    angles.legend(loc="upper right", ncols=5, fontsize="small")
    rates = figure.add_subplot(grid[1, 1], sharex=angles)
    velocities_deg_s = np.diff(joints_deg, axis=0) / np.diff(time_s)[:, None]
    for joint in range(len(JOINT_NAMES)):
        rates.plot(time_s[1:], velocities_deg_s[:, joint], linestyle="-" if joint < len(JOINT_NAMES) - 1 else "--")
    rates.set(xlabel="time, s", ylabel="joint velocity, deg/s")
    for axes in (angles, rates):
        axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)

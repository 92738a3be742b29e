"""Pictures of workspace and manipulability; matplotlib is imported only when one is drawn (extra `plot`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import FloatArray
from rm501_host.kinematics.workspace import WorkspaceMap, workspace_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PITCH_STEP_DEG = 5.0
_DOWN_DEG, _LEVEL_DEG = 0.0, 90.0


def section_map(arm: Arm, step_mm: float) -> WorkspaceMap:
    """The map over the whole reach of the arm: radius, height on a grid of `step_mm`, pitch every 5 deg."""
    geometry = arm.geometry
    count = int(np.ceil(geometry.reach_mm / step_mm))
    radii: FloatArray = np.arange(-count, count + 1, dtype=np.float64) * step_mm
    heights: FloatArray = geometry.d1_mm + np.arange(-count, count + 1, dtype=np.float64) * step_mm
    return workspace_map(arm, radii, heights, np.arange(-120.0, 285.0, _PITCH_STEP_DEG))


def draw_workspace(arm: Arm, section: WorkspaceMap, path: Path) -> None:
    """Write three panels: span of pitch and manipulability over the section, and the plan view, tool down.

    Raises KinematicsError when matplotlib is missing or does not know the file's ending.
    """
    figure = new_figure((15.0, 5.2))
    left, middle, right = figure.subplots(1, 3)
    extent = (section.r_mm[0], section.r_mm[-1], section.z_mm[0], section.z_mm[-1])
    span = np.where(section.pitch_span_deg > 0, section.pitch_span_deg, np.nan)
    for axes, values, title in (
        (left, span, "reachable pitch, deg"),
        (middle, section.manipulability, f"best manipulability, 1 rad = {section.length_mm:g} mm"),
    ):
        picture = axes.imshow(values.T, origin="lower", extent=extent, cmap="viridis", interpolation="nearest")
        figure.colorbar(picture, ax=axes, shrink=0.8)
        for pitch, colour, name in ((_DOWN_DEG, "tab:red", "straight down"), (_LEVEL_DEG, "tab:orange", "level")):
            layer = section.reachable[:, :, int(np.abs(section.pitch_deg - pitch).argmin())].T.astype(float)
            if layer.any() and not layer.all():
                axes.contour(section.r_mm, section.z_mm, layer, levels=[0.5], colors=[colour], linewidths=1.2)
                axes.plot([], [], color=colour, label=f"tool {name}")
        draw_arm(axes, arm, arm.home_deg)
        axes.set(title=title, xlabel="radius r, mm", ylabel="height z, mm")
        axes.legend(loc="lower left", fontsize=8)
    _plan_view(arm, section, right)
    save(figure, path)


def _plan_view(arm: Arm, section: WorkspaceMap, axes: Axes) -> None:
    down = section.reachable[:, :, int(np.abs(section.pitch_deg - _DOWN_DEG).argmin())]
    angles = np.radians(np.linspace(arm.geometry.min_deg[0], arm.geometry.max_deg[0], 361))
    radii = section.r_mm[down.any(axis=1)]
    if len(radii):
        for radius, style in ((radii.min(), "--"), (radii.max(), "-")):
            axes.plot(radius * np.cos(angles), radius * np.sin(angles), style, color="tab:red")
    any_pitch = section.r_mm[section.reachable.any(axis=(1, 2))]
    axes.plot(any_pitch.max() * np.cos(angles), any_pitch.max() * np.sin(angles), color="tab:blue")
    axes.set(title="plan: reach (blue), tool down (red)", xlabel="x, mm", ylabel="y, mm")
    axes.set_aspect("equal")


def draw_arm(axes: Axes, arm: Arm, q_deg: tuple[float, ...]) -> None:
    """The links at joints (5,) deg as lines in the arm's own plane (r, z), waist at 0."""
    chain = arm.frames((0.0, *q_deg[1:]))
    points: FloatArray = chain[:, :3, 3]
    order = [0, 1, 2, 3, 6]
    axes.plot(points[order, 0], points[order, 2], "o-", color="black", linewidth=1.5, markersize=3)


def new_figure(size_inches: tuple[float, float]) -> Figure:
    """A figure without a window; raises KinematicsError when matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise KinematicsError("pictures need matplotlib; install rm501[plot]") from error
    return Figure(figsize=size_inches, layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write a figure; raises KinematicsError for an ending that matplotlib does not know."""
    try:
        figure.savefig(path, dpi=110)
    except ValueError as error:
        raise KinematicsError(f"cannot draw {path}: {error}; use .png, .svg or .pdf") from error

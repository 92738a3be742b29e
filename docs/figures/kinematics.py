"""Draws the figures of docs/kinematics.md into this folder: python docs/figures/kinematics.py [FOLDER].

Everything is computed by the package; nothing is drawn by hand but the labels.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, Damping, DampingLaw, VelocityController, default_damping
from rm501_host.kinematics.passages import NotArrivedError, run_passage
from rm501_host.kinematics.pictures import draw_arm, draw_workspace, new_figure, save, section_map
from rm501_host.kinematics.singularities import distances

ROOT = Path(__file__).resolve().parents[2]
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red")
ELBOW = (0.0, 40.0, 0.0, 50.0, 0.0)


def plane_points(arm: Arm, q_deg: tuple[float, ...]) -> np.ndarray:
    """Base, shoulder, elbow, wrist and tip in the arm's plane, (5, 2) mm."""
    chain = arm.frames((0.0, *q_deg[1:]))
    return chain[[0, 1, 2, 3, 6]][:, [0, 2], 3]


def draw_frames(arm: Arm, path: Path) -> None:
    """The arm in its own plane, with lengths, angles and frames."""
    q = (0.0, 60.0, -75.0, 60.0, 0.0)
    figure = new_figure((7.0, 6.0))
    axes = figure.subplots()
    draw_arm(axes, arm, q)
    points = plane_points(arm, q)
    names = ("d1", "a2", "a3", "d5 + tool")
    for name, start, end in zip(names, points, points[1:], strict=False):
        middle = (start + end) / 2
        axes.annotate(name, middle, textcoords="offset points", xytext=(8, 4), color="tab:blue")
    chain = arm.frames(q)
    for index in (0, 1, 2, 3, 4, 6):
        origin = chain[index][[0, 2], 3]
        for column, colour in ((0, "tab:red"), (1, "tab:green"), (2, "tab:blue")):
            direction = chain[index][[0, 2], column]
            if np.linalg.norm(direction) > 0.1:
                axes.annotate("", origin + 40 * direction, origin, arrowprops={"arrowstyle": "->", "color": colour})
    for angle, at, label in ((q[1], points[1], "q2"), (q[2], points[2], "q3"), (q[3], points[3], "q4")):
        axes.annotate(f"{label} = {angle:g}°", at, textcoords="offset points", xytext=(-62, -4))
    pitch = sum(q[1:4])
    axes.annotate(f"pitch = q234 = {pitch:g}°", points[4], textcoords="offset points", xytext=(10, -10))
    axes.plot([points[4][0]] * 2, [points[4][1], 0], ":", color="grey")
    axes.annotate("", (points[4][0], 10), (0, 10), arrowprops={"arrowstyle": "<->", "color": "grey"})
    axes.annotate("r", (points[4][0] / 2, 16), color="grey")
    axes.set(xlabel="radius, mm", ylabel="height z, mm", title="The arm's plane; x red, y green, z blue")
    axes.set(xlim=(-90.0, 480.0), ylim=(-20.0, 480.0))
    axes.set_aspect("equal")
    save(figure, path)


def draw_branches(arm: Arm, path: Path) -> None:
    """All four ways to one pose, limits left aside."""
    figure = new_figure((7.0, 5.0))
    axes = figure.subplots()
    result = arm.ik((180.0, 0.0, 400.0), 40.0, 0.0)
    for solution, colour in zip(sorted(result.solutions, key=lambda s: s.branch), COLOURS, strict=False):
        chain = arm.frames(solution.q_deg)
        points = chain[[0, 1, 2, 3, 6]][:, [0, 2], 3]
        inside = "inside the limits" if solution.in_limits else "outside"
        name = solution.branch.name.lower().replace("_", ", ")
        axes.plot(points[:, 0], points[:, 1], "o-", color=colour, label=f"{name}: {inside}", alpha=0.8)
    axes.legend(fontsize=8)
    axes.set(xlabel="x, mm", ylabel="z, mm", title="One tip, pitch 40° in the arm's own plane: four branches")
    axes.set_aspect("equal")
    save(figure, path)


def draw_singularities(arm: Arm, path: Path) -> None:
    """One arm for each singularity, and the manipulability around it."""
    q23 = float(np.degrees(np.arccos(-220.0 * np.cos(np.radians(100.0)) / 150.0)))
    s234 = -(220.0 * np.cos(np.radians(98.0)) + 150.0 * np.cos(np.radians(73.0))) / 95.0
    cases = {
        "elbow": ELBOW,
        "shoulder": (0.0, 100.0, q23 - 100.0, 180.0 - q23, 0.0),
        "waist axis": (0.0, 98.0, -25.0, 180.0 - float(np.degrees(np.arcsin(s234))) - 73.0, 0.0),
        "double": (0.0, 90.0, 0.0, 90.0, 0.0),
    }
    figure = new_figure((13.0, 4.4))
    for axes, (name, q) in zip(figure.subplots(1, 4), cases.items(), strict=True):
        draw_arm(axes, arm, q)
        axes.axvline(0.0, linestyle=":", color="grey")
        far = [f"{s.kind.value.replace('_', ' ')} {abs(round(s.measure, 3)):g}" for s in distances(arm.geometry, q)]
        rank = arm.ellipsoid(q).rank
        axes.set(
            title=f"{name}: rank {rank}\n{', '.join(far[:2])}\n{', '.join(far[2:])}", xlim=(-150, 480), ylim=(0, 720)
        )
        axes.title.set_fontsize(8)
        axes.set_aspect("equal")
        _ellipse(axes, arm, q)
    save(figure, path)


def _ellipse(axes: Axes, arm: Arm, q_deg: tuple[float, ...]) -> None:
    """What the tip can do in the plane with unit rates of shoulder, elbow and pitch: mm/rad, a quarter of the size."""
    matrix = arm.jacobian(q_deg)[[0, 2], 1:4]
    turns = np.linspace(0.0, 2 * np.pi, 100)
    u, s, _ = np.linalg.svd(matrix)
    outline = u @ (s[:, None] * np.stack((np.cos(turns), np.sin(turns)))) * 0.25
    tip = plane_points(arm, q_deg)[-1]
    axes.plot(tip[0] + outline[0], tip[1] + outline[1], color="tab:purple", linewidth=1.0)


def draw_passages(arm: Arm, path: Path) -> None:
    """Three ways through singularities by velocity control, with and without damping."""
    cases = (
        ("elbow: out of reach and back", (430.0, 0.0, 330.0, 90.0, 0.0), ((30.0, 0.0, 0.0), (-30.0, 0.0, 0.0))),
        ("1 mm beside the waist axis", (40.0, 1.0, 650.0, 225.0, 0.0), ((-80.0, 0.0, 0.0),)),
        ("double: out of reach and back", (1.0, 0.0, 689.0, 180.0, 0.0), ((0.0, 0.0, 8.0), (0.0, 0.0, -8.0))),
    )
    methods = (
        ("pseudo-inverse", None),
        ("damped, constant", Damping(DampingLaw.CONSTANT, 0.05)),
        ("damped by manipulability", default_damping()),
    )
    limits = arm.motors.velocity_limits
    figure = new_figure((13.0, 6.5))
    panels = figure.subplots(2, 3, sharex="col")
    for column, (title, start, legs) in enumerate(cases):
        top, bottom = panels[0][column], panels[1][column]
        solution = arm.ik(start[:3], start[3], start[4]).best
        assert solution is not None
        for (name, damping), colour in zip(methods, COLOURS, strict=False):
            controller = VelocityController(arm.geometry, limits, damping)
            try:
                run = run_passage(
                    arm.geometry, controller, solution.q_deg, np.array(legs), 20.0, settle_s=0.5, max_s=30.0
                )
            except NotArrivedError:
                top.plot([], [], color=colour, label=f"{name}: does not arrive")
                continue
            top.plot(run.t_s, run.error_mm, color=colour, label=name)
            bottom.plot(run.t_s, limits.ratio(run.rates_deg_s), color=colour)
        top.set(title=title, ylabel="distance from the line's point, mm")
        top.legend(fontsize=7)
        top.set_xlim(0.0, 7.0)
        bottom.axhline(1.0, linestyle=":", color="grey")
        bottom.set(xlabel="time, s", ylabel="largest rate / limit")
    save(figure, path)


def main(folder: Path) -> None:
    """Draw all figures."""
    arm = Arm.from_config(load_config(ROOT / "configs" / "rm501.toml"))
    draw_frames(arm, folder / "kinematics_frames.png")
    draw_branches(arm, folder / "kinematics_branches.png")
    draw_singularities(arm, folder / "kinematics_singularities.png")
    draw_passages(arm, folder / "kinematics_passages.png")
    draw_workspace(arm, section_map(arm, 5.0), folder / "kinematics_workspace.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)

"""Commands of the command line that show and export the geometry; the program around them provides `ctx.obj`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Protocol

import click
import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import BoolArray
from rm501_host.kinematics.workspace import WorkspaceMap


class _Options(Protocol):
    """What these commands need of the global options."""

    @property
    def config(self) -> Config: ...

    @property
    def json_output(self) -> bool: ...


@click.command("workspace")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Write a picture (png, svg or pdf).")
@click.option("--step", "step_mm", type=click.FloatRange(1.0, 100.0), default=10.0, show_default=True, help="Grid, mm.")
@click.option("--tool-length", "tool_length_mm", type=float, default=0.0, show_default=True, help="Tool length, mm.")
@click.pass_obj
def workspace_command(options: _Options, out: Path | None, step_mm: float, tool_length_mm: float) -> None:
    """Show where the arm can work, inside its joint limits."""
    from rm501_host.kinematics import pictures

    arm = Arm.from_config(options.config).with_tool(tool_length_mm)
    section = pictures.section_map(arm, step_mm)
    anyhow = _extent(section, np.asarray(section.reachable.any(axis=2)))
    if anyhow is None:
        raise KinematicsError("nothing is reachable; look at the joint limits and the link lengths")
    down = _extent(section, section.reachable[:, :, int(np.abs(section.pitch_deg).argmin())])
    if out is not None:
        pictures.draw_workspace(arm, section, out)
    if options.json_output:
        report = {
            "grid_mm": step_mm,
            "section_mm2": section.area_mm2,
            "any_pitch": anyhow,
            "tool_down": down,
            "picture": None if out is None else str(out),
        }
        click.echo(json.dumps(report))
        return
    low, high = anyhow["radius_mm"]
    click.echo(f"radius  {low:8.1f} .. {high:8.1f} mm from the waist axis (negative: behind it)")
    low, high = anyhow["height_mm"]
    click.echo(f"height  {low:8.1f} .. {high:8.1f} mm above the base plane")
    click.echo(f"section {section.area_mm2 / 100:8.1f} cm2, grid {step_mm:g} mm, any pitch")
    if down is not None:
        (near, far), (low, high) = down["radius_mm"], down["height_mm"]
        click.echo(f"tool straight down: radius {near:.1f} .. {far:.1f} mm, height {low:.1f} .. {high:.1f} mm")
    if out is not None:
        click.echo(f"wrote {out}")


def _extent(section: WorkspaceMap, reachable: BoolArray) -> dict[str, tuple[float, float]] | None:
    """Smallest and largest radius and height of the cells (n_r, n_z) that are reachable, None when none is."""
    rows, columns = np.nonzero(reachable)
    if not len(rows):
        return None
    r, z = section.r_mm[rows], section.z_mm[columns]
    return {"radius_mm": (float(r.min()), float(r.max())), "height_mm": (float(z.min()), float(z.max()))}


@click.command("export-urdf")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="File to write; without it, stdout.")
@click.option("--name", default="rm501", show_default=True, help="Name of the robot.")
@click.option("--tool-length", "tool_length_mm", type=float, default=0.0, show_default=True, help="Tool length, mm.")
@click.pass_obj
def export_urdf_command(options: _Options, out: Path | None, name: str, tool_length_mm: float) -> None:
    """Write the arm as URDF (m and rad, DH joint angles)."""
    from rm501_host.kinematics.urdf import urdf_text

    text = urdf_text(Arm.from_config(options.config).with_tool(tool_length_mm), name)
    if out is not None:
        try:
            out.write_text(text, encoding="utf-8")
        except OSError as error:
            raise KinematicsError(f"{out} cannot be written: {error.strerror}; give another --out") from error
    if options.json_output:
        click.echo(json.dumps({"out": str(out)} if out is not None else {"urdf": text}))
    elif out is None:
        click.echo(text, nl=False)
    else:
        click.echo(f"wrote {out}")

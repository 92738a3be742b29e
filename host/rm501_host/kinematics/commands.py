"""Commands of the command line that show and export the geometry; the program around them provides `ctx.obj.config`."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from rm501_host.kinematics.arm import Arm


@click.command("workspace")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Write a picture (png, svg or pdf).")
@click.option("--step", "step_mm", type=click.FloatRange(1.0, 100.0), default=10.0, show_default=True, help="Grid, mm.")
@click.option("--tool-length", "tool_length_mm", type=float, default=0.0, show_default=True, help="Tool length, mm.")
@click.pass_context
def workspace_command(ctx: click.Context, out: Path | None, step_mm: float, tool_length_mm: float) -> None:
    """Show where the arm can work, inside its joint limits."""
    from rm501_host.kinematics import pictures

    arm = Arm.from_config(ctx.obj.config).with_tool(tool_length_mm)
    section = pictures.section_map(arm, step_mm)
    rows, columns = np.nonzero(section.reachable.any(axis=2))
    if not len(rows):
        raise click.ClickException("nothing is reachable: look at the joint limits and link lengths")
    r, z = section.r_mm[rows], section.z_mm[columns]
    click.echo(f"radius  {r.min():8.1f} .. {r.max():8.1f} mm from the waist axis (negative: behind it)")
    click.echo(f"height  {z.min():8.1f} .. {z.max():8.1f} mm above the base plane")
    click.echo(f"section {section.area_mm2 / 100:8.1f} cm2, grid {step_mm:g} mm, any pitch")
    rows, columns = np.nonzero(section.reachable[:, :, int(np.abs(section.pitch_deg).argmin())])
    if len(rows):
        r, z = section.r_mm[rows], section.z_mm[columns]
        click.echo(f"down    radius {r.min():.1f} .. {r.max():.1f}, height {z.min():.1f} .. {z.max():.1f} mm, pitch 0")
    if out is not None:
        pictures.draw_workspace(arm, section, out)
        click.echo(f"wrote {out}")


@click.command("export-urdf")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="File to write; without it, stdout.")
@click.option("--name", default="rm501", show_default=True, help="Name of the robot.")
@click.option("--tool-length", "tool_length_mm", type=float, default=0.0, show_default=True, help="Tool length, mm.")
@click.pass_context
def export_urdf_command(ctx: click.Context, out: Path | None, name: str, tool_length_mm: float) -> None:
    """Write the arm as URDF (m and rad, DH joint angles)."""
    from rm501_host.kinematics.urdf import urdf_text

    text = urdf_text(Arm.from_config(ctx.obj.config).with_tool(tool_length_mm), name)
    if out is None:
        click.echo(text, nl=False)
    else:
        out.write_text(text, encoding="utf-8")
        click.echo(f"wrote {out}", err=True)

"""`rm501-host limits`: what limits hold for the next motion; lower them, or go back to the file's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from rm501_host.cli.context import CommandContext
from rm501_host.client.client import DaemonClient
from rm501_host.client.session import daemon_option, talk
from rm501_host.config.schema import JOINT_NAMES


def _per_joint(context: click.Context, option: click.Parameter, values: tuple[str, ...]) -> dict[str, float]:
    found = {}
    for text in values:
        name, separator, number = text.partition("=")
        try:
            if not separator or name not in JOINT_NAMES:
                raise ValueError
            found[name] = float(number)
        except ValueError as error:
            raise click.BadParameter(f"give JOINT=NUMBER, the joints are {', '.join(JOINT_NAMES)}") from error
    return found


@click.command("limits")
@click.option("--velocity", multiple=True, metavar="JOINT=DEG_S", callback=_per_joint, help="May be repeated.")
@click.option("--acceleration", multiple=True, metavar="JOINT=DEG_S2", callback=_per_joint, help="May be repeated.")
@click.option("--tool", "tool_mm_s", type=click.FloatRange(0, min_open=True), help="The tool's speed, mm/s.")
@click.option("--reset", is_flag=True, help="Back to those of the configuration file.")
@daemon_option
@click.pass_obj
def limits_command(
    context: CommandContext,
    velocity: dict[str, float],
    acceleration: dict[str, float],
    tool_mm_s: float | None,
    reset: bool,
    daemon: str | None,
    token_file: Path | None,
) -> None:
    """Show the limits in force, or lower them from the next motion on; a restart forgets it."""

    async def work(client: DaemonClient) -> Any:
        if reset:
            await client.call("limits.reset")
        if velocity or acceleration or tool_mm_s is not None:
            await client.call(
                "limits.set", velocity_deg_s=velocity, acceleration_deg_s2=acceleration, tcp_speed_mm_s=tool_mm_s
            )
        return await client.call("limits.get")

    limits = talk(daemon, token_file, work)
    if context.json_output:
        click.echo(json.dumps(limits))
        return
    now, hard = limits["in_force"], limits["hard"]
    click.echo("joint        deg/s  of most     deg/s2  of most")
    for i, name in enumerate(JOINT_NAMES):
        click.echo(
            f"{name:9} {now['velocity_deg_s'][i]:8g} {hard['velocity_deg_s'][i]:8g} "
            f"{now['acceleration_deg_s2'][i]:10g} {hard['acceleration_deg_s2'][i]:8g}"
        )
    tool = "not limited" if now["tcp_speed_mm_s"] is None else f"{now['tcp_speed_mm_s']:g} mm/s"
    click.echo(f"tool      {tool}")

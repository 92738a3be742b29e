"""`rm501-host follow`: a timed joint trajectory from a file, through the daemon."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import click

from rm501_host.cli.context import CommandContext
from rm501_host.client.client import DaemonClient
from rm501_host.client.session import daemon_option, talk
from rm501_host.client.trajectory_file import read_trajectory


@click.command("follow")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--stretch", is_flag=True, help="Slow it down where it is too fast, by the least that makes it legal.")
@click.option("--detach", is_flag=True, help="Return once it runs.")
@daemon_option
@click.pass_obj
def follow_command(
    context: CommandContext, file: Path, stretch: bool, detach: bool, daemon: str | None, token_file: Path | None
) -> None:
    """Follow the timed joint trajectory in FILE; all of it is checked before anything moves.

    \b
    CSV   t_s,waist,shoulder,elbow,pitch,roll[,waist_vel,...,roll_vel] and a row a point (s, deg, deg/s)
    JSON  {"times_s": [..], "points_deg": [[5]..], "velocities_deg_s": [[5]..]}
    JSON  a ROS JointTrajectory: {"joint_names": [..], "points": [{"positions", "velocities", "time_from_start"}]}, rad
    """
    trajectory = read_trajectory(file)

    async def work(client: DaemonClient) -> Any:
        started = await client.follow(
            trajectory.points_deg, trajectory.times_s, trajectory.velocities_deg_s, stretch=stretch
        )
        if detach:
            return started
        try:
            return await client.wait(started)
        except asyncio.CancelledError:
            await client.call("hold")
            raise

    result = talk(daemon, token_file, work)
    if context.json_output:
        click.echo(json.dumps(result))
    elif detach:
        click.echo(f"{file.name}: runs")
    else:
        slower = f", slowed by {result['slowed_by']:.4f}" if result["slowed_by"] > 1.001 else ""
        click.echo(f"{file.name}: done in {result['duration_s']:.2f} s{slower}")

"""`rm501-host check-config`: is this configuration usable, and what follows from it."""

from __future__ import annotations

import json

import click

from rm501_host.cli.context import CommandContext
from rm501_host.config import MOTOR_NAMES
from rm501_host.config.board import board_config_from
from rm501_host.errors import RefusedError


@click.command("check-config")
@click.pass_obj
def check_config_command(context: CommandContext) -> None:
    """Check the configuration of --config and print what follows from it."""
    config = context.config
    board = board_config_from(config)
    problems = board.problems()
    if problems:
        raise RefusedError("the board's configuration contradicts itself: " + "; ".join(problems))
    motors = {
        name: {
            "max_rate_deg_s": motor.max_rate_steps_s / motor.steps_per_deg,
            "max_acceleration_deg_s2": motor.max_acceleration_deg_s2,
        }
        for name, motor in zip(MOTOR_NAMES, config.motors.ordered, strict=True)
    }
    derived = {
        "machine": config.machine.name,
        "coordinates": config.machine.coordinates,
        "frame_us": board.frame_us,
        "max_step_rate_steps_s": board.max_step_rate,
        "config_hash": f"{board.hash:08x}",
        "motors": motors,
    }
    if context.json_output:
        click.echo(json.dumps(derived))
        return
    click.echo(f"{config.machine.name}: the configuration is usable")
    click.echo(f"  programs       {config.machine.coordinates}")
    click.echo(f"  frame          {board.frame_us} us, at most {board.max_step_rate} steps/s")
    for name, motor in motors.items():
        click.echo(f"  {name:14} {motor['max_rate_deg_s']:.2f} deg/s, {motor['max_acceleration_deg_s2']:.1f} deg/s2")
    click.echo(f"  board hash     {board.hash:08x}")

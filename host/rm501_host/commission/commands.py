"""`commission`, `verify`, `doctor`: all through the running daemon, so that nothing else moves the arm meanwhile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import msgspec

from rm501_host.cli.context import CommandContext
from rm501_host.cli.outputs import require_writable
from rm501_host.client.client import DaemonClient
from rm501_host.client.session import daemon_option, talk
from rm501_host.commission.diagnosis import diagnose, judge
from rm501_host.commission.lead import STEP_DEG, lead
from rm501_host.commission.terminal import Console
from rm501_host.config.loader import load_config
from rm501_host.errors import RefusedError, StoppedError
from rm501_host.ini_import.toml_text import toml_text
from rm501_host.storage.atomic import write_atomic


@click.command("verify")
@click.argument("joints", nargs=-1)
@daemon_option
@click.pass_obj
def verify_command(
    context: CommandContext, joints: tuple[str, ...], daemon: str | None, token_file: Path | None
) -> None:
    """Touch the switches again and report lost steps."""
    result = talk(daemon, token_file, lambda client: client.motion("verify", joints=list(joints)))
    if context.json_output:
        click.echo(json.dumps(result))
    else:
        for joint in result["joints"]:
            verdict = "LOST STEPS" if joint["suspicious"] else "ok"
            click.echo(
                f"{joint['joint']:9} {joint['lost_steps']:+8.1f} steps  {joint['lost_deg']:+8.4f} deg  {verdict}"
            )
    lost = [joint["joint"] for joint in result["joints"] if joint["suspicious"]]
    if lost:
        raise StoppedError(
            f"steps were lost: {', '.join(lost)}; home these joints and look for load, collision or speed"
        )


@click.command("doctor")
@click.option("--seconds", type=click.FloatRange(1, 600), default=10.0, show_default=True)
@daemon_option
@click.pass_obj
def doctor_command(context: CommandContext, seconds: float, daemon: str | None, token_file: Path | None) -> None:
    """Measure stalls of this computer, round trips and queue lead; say whether they suffice."""
    measured = talk(daemon, token_file, lambda client: diagnose(client, seconds))
    findings = judge(measured, stall_budget_s=context.config.planner.stall_budget_s)
    if context.json_output:
        click.echo(json.dumps({**measured, "findings": [list(finding) for finding in findings]}))
    else:
        for name, value in measured.items():
            click.echo(f"{name:22} {'-' if value is None else f'{value:.3f}':>10}")
        for good, text in findings:
            click.echo(f"{'ok      ' if good else 'NOT FIT '} {text}")
    if not all(good for good, _ in findings):
        raise RefusedError("this computer, as loaded now, is not fit for the arm: see the lines above")


@click.command("commission")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="Write the configuration.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@daemon_option
@click.pass_obj
def commission_command(
    context: CommandContext, out: Path, force: bool, daemon: str | None, token_file: Path | None
) -> None:
    """Set up a real arm, step by step: switches, directions, wrist, configuration."""
    if out.exists() and not force:
        raise click.BadParameter(f"{out} exists; give --force to replace it", param_hint="--out")
    require_writable("--out", out)
    config = context.config

    async def work(client: DaemonClient) -> dict[str, Any]:
        click.echo(
            "The emergency stop within reach, nobody in the arm's way. "
            f"Every step moves one joint, slowly, by {STEP_DEG:.0f} deg and back."
        )
        return await lead(client, config, Console())

    changes = talk(daemon, token_file, work)
    base = without_none(msgspec.to_builtins(config))
    data = laid_over(base, changes)
    text = toml_text(data, {}, f"Commissioned for {config.machine.name}.")
    trial = out.with_name(f".{out.name}.trial.toml")
    try:
        write_atomic(trial, text.encode())
        load_config(trial)
    finally:
        trial.unlink(missing_ok=True)
    write_atomic(out, text.encode())
    click.echo(
        f"{out}: written and checked. The board changes its configuration with the motors off only: support the arm, "
        f"rm501-host stop, end the daemon, serve with --config {out}, then reset and home"
    )


def without_none(table: dict[str, Any]) -> dict[str, Any]:
    """Nested tables without the keys that have no value: TOML has no null."""
    return {
        key: without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }


def laid_over(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Nested tables with those of `changes` in place of their own values; neither is altered."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = laid_over(old, value) if isinstance(value, dict) and isinstance(old, dict) else value
    return merged

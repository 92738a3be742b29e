"""The commands that act on the path of a program under way: override, back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from rm501_host.cli.context import CommandContext
from rm501_host.client.session import daemon_option, talk


@click.command("override")
@click.argument("percent", type=click.FloatRange(0, 200))
@daemon_option
@click.pass_obj
def override_command(context: CommandContext, percent: float, daemon: str | None, token_file: Path | None) -> None:
    """Set the feed override to PERCENT of the programmed feeds, 0 to 200; 0 holds."""
    ratio = percent / 100.0
    talk(daemon, token_file, lambda client: client.call("override", ratio=ratio))
    _print(context, {"override": ratio}, f"override {percent:g} %")


@click.command("back")
@click.argument("seconds", type=click.FloatRange(0, 30, min_open=True))
@daemon_option
@click.pass_obj
def back_command(context: CommandContext, seconds: float, daemon: str | None, token_file: Path | None) -> None:
    """Run a held program back along its path, as far as it came in SECONDS at 100 %; `resume` then goes forward."""
    result = talk(daemon, token_file, lambda client: client.call("program.back", seconds=seconds))
    again = f"; that repeats: {', '.join(result['repeats'])}" if result["repeats"] else ""
    _print(context, result, f"going back by {result['seconds']:.2f} s; resume goes forward from there{again}")


def _print(context: CommandContext, result: Any, text: str) -> None:
    click.echo(json.dumps(result) if context.json_output else text)

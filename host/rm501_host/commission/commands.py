"""`commission`, `verify`, `doctor`: all through the running daemon, so that nothing else moves the arm meanwhile."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import click
import msgspec

from rm501_host.cli.context import CommandContext
from rm501_host.client.client import DaemonClient
from rm501_host.client.session import daemon_option, talk
from rm501_host.commission.derive import Seen, drive_signs, switches_swapped, wrist_matrix
from rm501_host.commission.diagnosis import diagnose, judge
from rm501_host.config import JOINT_NAMES
from rm501_host.config.loader import load_config
from rm501_host.errors import RefusedError, StoppedError
from rm501_host.ini_import.toml_text import toml_text
from rm501_host.storage.atomic import write_atomic

_STEP_DEG = 5.0
_POSITIVE = {
    "waist": "counter-clockwise, seen from above",
    "shoulder": "up",
    "elbow": "up (the forearm toward straight)",
}
_WATCH_S = 60.0


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
            click.echo(f"{name:22} {value:10.3f}")
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
    click.echo(
        "The emergency stop within reach, nobody in the arm's way. Every step moves one joint, slowly, by 5 deg."
    )
    config = context.config
    changes = talk(daemon, token_file, lambda client: _lead(client, context))
    base = _without_none(msgspec.to_builtins(config))
    data = _laid_over(base, changes)
    text = toml_text(data, {}, f"Commissioned for {config.machine.name}.")
    trial = out.with_name(f".{out.name}.trial.toml")
    try:
        write_atomic(trial, text.encode())
        load_config(trial)
    finally:
        trial.unlink(missing_ok=True)
    write_atomic(out, text.encode())
    click.echo(f"{out}: written and checked; serve with --config {out}, then home")


async def _lead(client: DaemonClient, context: CommandContext) -> dict[str, Any]:
    config = context.config
    await client.subscribe(20)
    inputs = [joint.home.input for joint in config.joints.ordered]
    seen = {}
    for name, switch in zip(JOINT_NAMES, inputs, strict=True):
        seen[switch] = await _watch(client, name, switch, inputs)
    swap = switches_swapped(seen, config.board.wiring.swap_wrist_switches)
    if (await client.call("status"))["task_state"] != "ON":
        await client.call("reset")
    right = []
    for name in JOINT_NAMES[:3]:
        await _step(client, name)
        right.append(await _ask(f"The {name} was commanded {_POSITIVE[name]}. Did it turn that way?"))
    wrist = [await _saw(client, name) for name in JOINT_NAMES[3:]]
    matrix = wrist_matrix(config.drive.wrist_matrix, wrist[0], wrist[1])
    return {
        "drive": {"signs": list(drive_signs(config.drive.signs, right)), "wrist_matrix": [list(row) for row in matrix]},
        "board": {"wiring": {"swap_wrist_switches": swap}},
    }


async def _watch(client: DaemonClient, name: str, switch: str, inputs: list[str]) -> str:
    """Wait until a person has pressed a joint's switch; the input that became active."""
    click.echo(f"Press the switch of the {name} by hand and hold it ...")
    before = set(client.status["inputs"])
    try:
        await client.status_where(lambda now: bool((set(now["inputs"]) - before) & set(inputs)), _WATCH_S)
    except TimeoutError:
        raise StoppedError(f"no switch closed within {_WATCH_S:.0f} s; look at {switch} and its wiring") from None
    found: str = sorted((set(client.status["inputs"]) - before) & set(inputs))[0]
    click.echo(f"  {found}. Let go.")
    await client.status_where(lambda now: found not in now["inputs"], _WATCH_S)
    return found


async def _step(client: DaemonClient, joint: str) -> None:
    click.pause(f"Press a key: the {joint} turns by {_STEP_DEG:.0f} deg and back ...")
    await client.motion("jog.start", frame="joint", axis=joint, speed=3.0, distance=_STEP_DEG)
    await asyncio.sleep(0.5)
    await client.motion("jog.start", frame="joint", axis=joint, speed=-3.0, distance=_STEP_DEG)


async def _ask(question: str) -> bool:
    return click.confirm(question)


async def _saw(client: DaemonClient, joint: str) -> Seen:
    await _step(client, joint)
    words = {
        "hand-up": Seen.PITCH_PLUS, "hand-down": Seen.PITCH_MINUS,
        "turned-right": Seen.ROLL_PLUS, "turned-left": Seen.ROLL_MINUS,
    }  # fmt: skip
    answer = click.prompt(
        f"What did the hand do first on {joint}+ (turns are seen along the hand, from the arm)?",
        type=click.Choice(list(words)),
    )
    return words[answer]


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }


def _laid_over(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        merged[key] = _laid_over(old, value) if isinstance(value, dict) and isinstance(old, dict) else value
    return merged

"""The command line's side of the daemon: status, home, jog, mdi, send, hold, resume, stop, reset, gripper, teach,
monitor.

Each command is one conversation over the daemon's socket. Interrupting a command that waits for a motion (Ctrl-C) asks
the daemon to hold; the arm stands on its path then, `resume` goes on and `abort` ends the motion.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from rm501_host.cli.context import CommandContext
from rm501_host.client.client import DaemonClient, RemoteRefusedError
from rm501_host.client.session import daemon_option, talk
from rm501_host.client.show import status_lines
from rm501_host.config.schema import JOINT_NAMES
from rm501_host.error_groups import told_by
from rm501_host.errors import RefusedError, Rm501Error

_PIECE = 16_000
"""Characters of a program sent at once: 64 KiB hold them however they are encoded."""
_KEEP_S = 0.06
"""Three renewals within the lease of 200 ms."""


def _print(context: CommandContext, result: Any, text: str) -> None:
    click.echo(json.dumps(result) if context.json_output else text)


async def _moved(
    client: DaemonClient, method: str, on_status: Callable[[dict[str, Any]], None] | None = None, **params: Any
) -> Any:
    """Call a method that moves and wait; holds the arm when interrupted."""
    started = await client.call(method, **params)
    if on_status is not None:
        client.on_status = on_status
        await client.subscribe(200, ("line", "progress", "time_left_s", "run_state", "waiting", "messages", "cause"))
    try:
        return await client.wait(started)
    except asyncio.CancelledError:
        try:
            is_held = (await client.call("hold"))["held"]
        except Rm501Error as error:
            click.echo(f"the arm could not be held: {error}", err=True)
        else:
            held = "held on the path: resume goes on, abort ends the motion"
            click.echo(held if is_held else "nothing moves any more", err=True)
        raise


@click.command("status")
@daemon_option
@click.pass_obj
def status_command(context: CommandContext, daemon: str | None, token_file: Path | None) -> None:
    """Show the arm's state."""
    status = talk(daemon, token_file, lambda client: client.call("status"))
    _print(context, status, "\n".join(status_lines(status)))


@click.command("monitor")
@click.option("--period", "period_ms", type=click.IntRange(20, 60_000), default=200, show_default=True, help="ms")
@click.option("--count", type=click.IntRange(1), help="End after so many lines, the first status included.")
@daemon_option
@click.pass_obj
def monitor_command(
    context: CommandContext, period_ms: int, count: int | None, daemon: str | None, token_file: Path | None
) -> None:
    """Follow the arm's state: a line for each change (with --json: the changed fields)."""

    async def follow(client: DaemonClient) -> None:
        left = [None if count is None else count - 1]
        done = asyncio.Event()

        def show(changed: dict[str, Any]) -> None:
            if context.json_output:
                click.echo(json.dumps(changed))
            else:
                fields = "  ".join(f"{key}={value}" for key, value in changed.items() if key != "time_s")
                click.echo(f"{changed['time_s']:12.3f}  {fields}")
            if left[0] is not None:
                left[0] -= 1
                if left[0] == 0:
                    done.set()

        client.on_status = show
        status = await client.subscribe(period_ms)
        if context.json_output:
            click.echo(json.dumps(status))
        else:
            click.echo("\n".join(status_lines(status)))
        if left[0] == 0:
            return
        async with asyncio.TaskGroup() as tasks:
            ended = tasks.create_task(client.closed())
            await done.wait()
            ended.cancel()

    try:
        talk(daemon, token_file, follow)
    except BaseExceptionGroup as group:
        raise told_by(group) from None


@click.command("home")
@click.argument("joints", nargs=-1)
@daemon_option
@click.pass_obj
def home_command(context: CommandContext, joints: tuple[str, ...], daemon: str | None, token_file: Path | None) -> None:
    """Home all joints, or those named, on their switches."""
    result = talk(daemon, token_file, lambda client: _moved(client, "home", joints=list(joints)))
    lines = [
        f"{joint['joint']:9} homed, latches agree within {joint['spread_deg']:.4f} deg" for joint in result["joints"]
    ]
    _print(context, result, "\n".join(lines))


@click.command("jog", context_settings={"ignore_unknown_options": True})
@click.argument("axis")
@click.argument("speed", type=float)
@click.option(
    "--frame", type=click.Choice(["joint", "world", "tool"]), help="Default: joint for a joint's name, else world."
)
@click.option("--distance", type=click.FloatRange(0, 1000, min_open=True), help="Just so far: deg or mm.")
@click.option("--seconds", type=click.FloatRange(0, 600, min_open=True), help="As if a key were held for so long.")
@daemon_option
@click.pass_obj
def jog_command(
    context: CommandContext,
    axis: str,
    speed: float,
    frame: str | None,
    distance: float | None,
    seconds: float | None,
    daemon: str | None,
    token_file: Path | None,
) -> None:
    """Move AXIS by hand at SPEED (deg/s or mm/s; the sign is the direction).

    Without --distance and --seconds until Ctrl-C. AXIS: a joint's name, or x y z a b c.
    """
    frame = frame or ("world" if len(axis) == 1 else "joint")

    async def work(client: DaemonClient) -> Any:
        started = await client.call("jog.start", frame=frame, axis=axis, speed=speed, distance=distance)
        if distance is None:
            await _keep_jogging(client, started["motion"], seconds)
        return await client.wait(started)

    result = talk(daemon, token_file, work)
    joints = "  ".join(f"{angle:.3f}" for angle in result["joints_deg"])
    why = f", and no farther: {result['ended']}" if result.get("ended") else ""
    _print(context, result, f"at {joints} deg{why}")


async def _keep_jogging(client: DaemonClient, motion: int, seconds: float | None) -> None:
    try:
        async with asyncio.timeout(seconds):
            while (await client.call("jog.keep", motion=motion))["moving"]:  # noqa: ASYNC110  # renewing is the point
                await asyncio.sleep(_KEEP_S)
            return
    except TimeoutError:
        pass
    except asyncio.CancelledError:
        await client.call("jog.end")
        raise
    await client.call("jog.end")


@click.command("mdi")
@click.argument("block")
@daemon_option
@click.pass_obj
def mdi_command(context: CommandContext, block: str, daemon: str | None, token_file: Path | None) -> None:
    """Run one BLOCK of G-code."""
    result = talk(daemon, token_file, lambda client: _moved(client, "mdi", block=block))
    _print(context, result, "done")


@click.command("send")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--line", type=click.IntRange(1), default=1, help="Begin at this line.")
@click.option("--speed", type=click.FloatRange(0, 2, min_open=True), default=1.0, help="Factor of the feeds.")
@click.option("--detach", is_flag=True, help="Return once it runs.")
@daemon_option
@click.pass_obj
def send_command(
    context: CommandContext,
    file: Path,
    line: int,
    speed: float,
    detach: bool,
    daemon: str | None,
    token_file: Path | None,
) -> None:
    """Give program FILE to the daemon, have it checked, and run it."""
    text = _program_text(file)

    async def work(client: DaemonClient) -> Any:
        await upload(client, file.name, text)
        if detach:
            return await client.call("program.run", name=file.name, line=line, speed=speed)
        show = None if context.json_output else show_progress()
        if not context.json_output:
            client.on_alive = lambda status: click.echo(f"checking line {status['checked_to_line']} ...", err=True)
        return await _moved(client, "program.run", show, name=file.name, line=line, speed=speed)

    result = talk(daemon, token_file, work)
    _print(context, result, f"{file.name}: {'runs' if detach else 'done'}")


def _program_text(file: Path) -> str:
    """The text of a program; one that is not UTF-8 is taken as Latin-1, as many an old comment is written."""
    data = file.read_bytes()
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


async def upload(client: DaemonClient, name: str, text: str) -> None:
    """Store a program in the daemon's folder, piece by piece."""
    offset = 0
    for start in range(0, max(1, len(text)), _PIECE):
        piece = text[start : start + _PIECE]
        last = start + _PIECE >= len(text)
        answer = await client.call("program.upload", name=name, text=piece, offset=offset, last=last)
        offset = answer["bytes"]


def show_progress() -> Callable[[dict[str, Any]], None]:
    """What `send` does with each change of the status: messages, pauses, every tenth of the program."""
    seen: dict[str, Any] = {}

    def show(changed: dict[str, Any]) -> None:
        for message in [text for text in changed.get("messages", []) if text not in seen.get("messages", [])]:
            click.echo(message)
        for key in ("waiting", "cause", "run_state"):
            if changed.get(key):
                click.echo(f"{key.replace('_', ' ')}: {changed[key]}", err=True)
        before = int(10 * seen.get("progress", 0))
        seen.update(changed)
        if int(10 * seen.get("progress", 0)) != before:
            click.echo(f"{seen['progress']:4.0%}  {seen.get('time_left_s', 0):.0f} s left", err=True)

    return show


def _simple(name: str, method: str, done: str, help_text: str) -> click.Command:
    @click.command(name, help=help_text)
    @daemon_option
    @click.pass_obj
    def command(context: CommandContext, daemon: str | None, token_file: Path | None) -> None:
        result = talk(daemon, token_file, lambda client: client.call(method))
        _print(context, result, done)

    return command


def _of_a_motion(name: str, key: str, done: str, help_text: str) -> click.Command:
    """A command that is refused, exit code 5, where nothing moves: the result's `key` says whether something did."""

    @click.command(name, help=help_text)
    @daemon_option
    @click.pass_obj
    def command(context: CommandContext, daemon: str | None, token_file: Path | None) -> None:
        async def work(client: DaemonClient) -> Any:
            result = await client.call(name)
            if not result[key]:
                raise RefusedError(nothing_to(name, await _status_if_allowed(client)))
            return result

        _print(context, talk(daemon, token_file, work), done)

    return command


async def _status_if_allowed(client: DaemonClient) -> dict[str, Any] | None:
    """The status; None for a client without the token, who may stop and hold and see nothing."""
    try:
        status: dict[str, Any] = await client.call("status")
    except RemoteRefusedError:
        return None
    return status


def nothing_to(name: str, status: dict[str, Any] | None) -> str:
    """What to say when there is no motion to hold or abort."""
    if status is None:
        return f"nothing moves, so there is nothing to {name}"
    state = status["run_state"] if status["task_state"] == "ON" else status["task_state"]
    cause = f" ({status['cause']})" if status["cause"] else ""
    return f"nothing moves, so there is nothing to {name}; the machine is {state}{cause}"


hold_command = _of_a_motion("hold", "held", "holding", "Hold on the path, motors on; resume goes on.")
resume_command = _simple("resume", "resume", "goes on", "Go on after a hold, M0, M1 or a single block.")
abort_command = _of_a_motion("abort", "ended", "ended, motors on", "End the motion on its path, motors on.")


@click.command("stop")
@click.option("--kill", is_flag=True, help="Not even a ramp: the position is lost.")
@daemon_option
@click.pass_obj
def stop_command(context: CommandContext, kill: bool, daemon: str | None, token_file: Path | None) -> None:
    """Stop on the path, motors off. No substitute for the emergency stop that is wired."""
    result = talk(daemon, token_file, lambda client: client.call("kill" if kill else "stop"))
    _print(context, result, "killed: home every joint" if kill else "stopped")


@click.command("reset")
@click.option("--fault", help="Name of the latched fault, as status shows it.")
@click.option("--off", is_flag=True, help="Leave the motors off.")
@daemon_option
@click.pass_obj
def reset_command(
    context: CommandContext, fault: str | None, off: bool, daemon: str | None, token_file: Path | None
) -> None:
    """Clear a stop or the fault that is named, switch the motors on. Nothing moves."""

    async def work(client: DaemonClient) -> Any:
        await client.call("reset", fault=fault, power=not off)
        return await client.call("status")

    status = talk(daemon, token_file, work)
    _print(context, status, "\n".join(status_lines(status)[:3]))


@click.command("gripper")
@click.argument("action", type=click.Choice(["open", "close"]))
@daemon_option
@click.pass_obj
def gripper_command(context: CommandContext, action: str, daemon: str | None, token_file: Path | None) -> None:
    """Open or close the hand."""
    result = talk(daemon, token_file, lambda client: _moved(client, "hand", action=action))
    _print(context, result, "opened (commanded)" if action == "open" else "closed (commanded)")


@click.group("teach")
def teach_command() -> None:
    """Record, list, edit and go to points."""


@teach_command.command("list")
@daemon_option
@click.pass_obj
def _teach_list(context: CommandContext, daemon: str | None, token_file: Path | None) -> None:
    """All points by number."""
    points = talk(daemon, token_file, lambda client: client.call("teach.list"))
    _print(context, points, "\n".join(map(_point_line, points)) or "no points yet")


@teach_command.command("record")
@click.argument("name")
@click.option("--note", default="")
@click.option("--replace", is_flag=True, help="Also when there is a point of that name: it is recorded anew.")
@daemon_option
@click.pass_obj
def _teach_record(
    context: CommandContext, name: str, note: str, replace: bool, daemon: str | None, token_file: Path | None
) -> None:
    """Record where the arm stands as NAME."""
    point = talk(daemon, token_file, lambda client: client.call("teach.record", name=name, note=note, replace=replace))
    _print(context, point, _point_line(point))


@teach_command.command("go")
@click.argument("name")
@click.option("--linear", is_flag=True, help="Straight in space instead of in joint space.")
@click.option("--speed", type=click.FloatRange(0, 1, min_open=True), default=0.5, show_default=True)
@daemon_option
@click.pass_obj
def _teach_go(
    context: CommandContext, name: str, linear: bool, speed: float, daemon: str | None, token_file: Path | None
) -> None:
    """Go to point NAME."""
    how = "linear" if linear else "joint"
    result = talk(daemon, token_file, lambda client: _moved(client, "teach.go", name=name, how=how, speed=speed))
    _print(context, result, f"at {name}")


@teach_command.command("edit")
@click.argument("name")
@click.option("--rename", "new_name")
@click.option("--note")
@click.option("--joints", help="Five angles in deg, with commas.")
@daemon_option
@click.pass_obj
def _teach_edit(
    context: CommandContext,
    name: str,
    new_name: str | None,
    note: str | None,
    joints: str | None,
    daemon: str | None,
    token_file: Path | None,
) -> None:
    """Change point NAME."""
    try:
        q_deg = None if joints is None else [float(part) for part in joints.split(",")]
    except ValueError as error:
        raise click.BadParameter("give five numbers with commas", param_hint="--joints") from error
    if q_deg is not None and len(q_deg) != len(JOINT_NAMES):
        raise click.BadParameter("give five numbers with commas", param_hint="--joints")
    point = talk(
        daemon,
        token_file,
        lambda client: client.call("teach.edit", name=name, new_name=new_name, note=note, q_deg=q_deg),
    )
    _print(context, point, _point_line(point))


@teach_command.command("delete")
@click.argument("name")
@daemon_option
@click.pass_obj
def _teach_delete(context: CommandContext, name: str, daemon: str | None, token_file: Path | None) -> None:
    """Forget point NAME."""
    talk(daemon, token_file, lambda client: client.call("teach.delete", name=name))
    _print(context, None, f"{name} forgotten")


def _point_line(point: dict[str, Any]) -> str:
    angles = " ".join(f"{angle:9.3f}" for angle in point["q_deg"])
    return f"{point['number']:3}  {point['name']:16} {angles}  {point['note']}".rstrip()


__all__ = [
    "abort_command",
    "gripper_command",
    "hold_command",
    "home_command",
    "jog_command",
    "mdi_command",
    "monitor_command",
    "reset_command",
    "resume_command",
    "send_command",
    "status_command",
    "stop_command",
    "teach_command",
    "upload",
]

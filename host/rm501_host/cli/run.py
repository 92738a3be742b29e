"""`rm501-host run`: home the arm, run a program to its end, report."""

from __future__ import annotations

import asyncio
import random
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from rm501_host.cli.context import CommandContext
from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.outputs import require_suffix, require_writable
from rm501_host.cli.progress import watcher_for
from rm501_host.errors import RefusedError, Rm501Error
from rm501_host.picture import SUFFIXES, draw_program, require_matplotlib
from rm501_host.program_run import RunOptions, RunResult, run_program
from rm501_host.report import RunReport
from rm501_host.storage import StorageError, write_atomic
from rm501_host.virtual_time import ScaledLoop, VirtualLoop

_VIRTUAL_SEED = 501


class _Speed(click.ParamType[float | None]):
    """`max`, or a factor of real time."""

    name = "max|FACTOR"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        if value is None or value == "max":
            return None
        try:
            factor = float(value)
        except (TypeError, ValueError):
            self.fail(f"{value!r} is neither 'max' nor a number", param, ctx)
        if not 0 < factor < float("inf"):
            self.fail(f"{value} must be above 0", param, ctx)
        return factor


@click.command("run")
@click.argument("program", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--speed", type=_Speed(), default="1", help="Time of an emulated board: max, or times real time.")
@click.option("--report", "report_path", type=click.Path(path_type=Path), help="Write the report as JSON.")
@click.option("--picture", type=click.Path(path_type=Path), help="Draw the tool's path and the joints: PNG or SVG.")
@click.option("--wire-log", type=click.Path(path_type=Path), help="Write every packet: time in us, direction, hex.")
@click.option("--no-home", is_flag=True, help="Start where the arm stands; refused unless it is homed.")
@click.pass_obj
def run_command(
    context: CommandContext,
    program: Path,
    speed: float | None,
    report_path: Path | None,
    picture: Path | None,
    wire_log: Path | None,
    no_home: bool,
) -> ExitCode:
    """Check PROGRAM, home the arm, run it to its end, and report."""
    config = context.config
    in_process = context.port_url.startswith("emu:")
    if speed != 1.0 and not in_process:
        raise RefusedError(f"--speed changes time, {context.port_url} has its own; leave it out, or use emu://")
    _require_outputs(report_path, picture, wire_log)
    virtual = speed is None
    wire_lines: list[str] = []
    options = RunOptions(
        port_url=context.port_url,
        home=not no_home,
        nonce=_nonce_source(virtual),
        wire_tap=None
        if wire_log is None
        else lambda now_us, direction, data: wire_lines.append(f"{now_us} {direction} {data.hex()}\n"),
        keep_pieces=picture is not None,
        wall_clock_s=time.perf_counter,  # noqa: TID251  # speed_ratio compares with the wall, nothing else does
    )
    unwritten: list[Rm501Error] = []
    try:
        with watcher_for(context) as watcher, _runner(speed) as runner:
            result = runner.run(run_program(program, config, options, watcher))
    finally:  # a run that was refused or interrupted is the one whose wire is looked at
        unwritten += _write_wire_log(wire_log, wire_lines)
    report, failed = _write_report(result, program, report_path, picture)
    unwritten += failed
    click.echo(report.as_json() if context.json_output else report.as_text())
    if result.error is not None:
        for problem in unwritten:
            click.echo(f"rm501-host: {problem}", err=True)
        raise result.error
    if unwritten:
        raise RefusedError("\n".join(map(str, unwritten)))
    return ExitCode.OK


def _require_outputs(report: Path | None, picture: Path | None, wire_log: Path | None) -> None:
    """Refuse what could not be written, or drawn, before anything moves."""
    require_suffix("--picture", picture, SUFFIXES)
    if picture is not None:
        require_matplotlib()
    for option, path in (("--report", report), ("--picture", picture), ("--wire-log", wire_log)):
        require_writable(option, path)


def _write_wire_log(path: Path | None, lines: list[str]) -> list[Rm501Error]:
    try:
        if path is not None:
            write_atomic(path, "".join(lines).encode())
    except StorageError as error:
        return [error]
    return []


def _write_report(
    result: RunResult, program: Path, report_path: Path | None, picture: Path | None
) -> tuple[RunReport, list[Rm501Error]]:
    """Write what was asked for; the arm has moved, so a full disk must not cost the report on the terminal."""
    report, unwritten = result.report, list[Rm501Error]()
    if picture is not None and result.plan.pieces:
        samples = result.plan.sample(0.01)
        try:
            draw_program(picture, program.name, samples.t_s, samples.q_deg, samples.tcp_mm)
            report = replace(report, picture=str(picture))
        except OSError as error:
            unwritten.append(RefusedError(f"--picture {picture}: cannot be written: {error.strerror or error}"))
    try:
        if report_path is not None:
            report.write(report_path)
    except StorageError as error:
        unwritten.append(error)
    return report, unwritten


def _runner(speed: float | None) -> asyncio.Runner:
    if speed is None:
        return asyncio.Runner(loop_factory=VirtualLoop)
    if speed == 1.0:
        return asyncio.Runner()
    return asyncio.Runner(loop_factory=lambda: ScaledLoop(speed))


def _nonce_source(virtual: bool) -> Any:
    source = random.Random(_VIRTUAL_SEED) if virtual else random.SystemRandom()
    return lambda: source.getrandbits(32)

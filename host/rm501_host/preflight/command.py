"""`rm501-host check`: the preflight of a program, without a board."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from .findings import Finding, PreflightReport


@click.command("check")
@click.argument("program", type=click.Path(exists=True, dir_okay=False, readable=True, path_type=Path))
@click.option("--start", help="Joints at the start, q1,q2,q3,q4,q5 in deg; default: the home position.")
@click.option("--max-blocks", type=click.IntRange(min=1), help="Check at most so many; default from [preflight].")
@click.pass_context
def check_command(ctx: click.Context, program: Path, start: str | None, max_blocks: int | None) -> None:
    """Check PROGRAM from its start to its end, or to the first point that depends on the outside world."""
    from rm501_host.cli.progress import words_of_progress
    from rm501_host.errors import RefusedError
    from rm501_host.gcode.errors import GcodeBudgetError
    from rm501_host.kinematics import Arm
    from rm501_host.planner.programs import start_joints
    from rm501_host.program import program_settings, read_moves

    from .check import ProgramCheck

    config = ctx.obj.config
    arm = Arm.from_config(config)
    start_deg = start_joints(start, arm)
    most = max_blocks or config.preflight.max_blocks
    settings = replace(program_settings(config, program), max_blocks=10 * most)
    check = ProgramCheck(arm, config, start_deg)
    moves = read_moves(
        program, arm, lambda: check.q_deg.tolist(), lambda text: click.echo(text, err=True), settings, config=config
    )
    moves = words_of_progress(ctx.obj, "checking", moves)
    report = check.run(moves, max_moves=most, limit_error=GcodeBudgetError)
    if ctx.obj.json_output:
        click.echo(json.dumps(_as_json(report)))
    else:
        _print(program, report)
    if not report.ok:
        raise RefusedError(f"{program}: {_count(report)}, the program would not run")


def _count(report: PreflightReport) -> str:
    errors = len(report.errors)
    return f"{errors} error{'' if errors == 1 else 's'}"


def _as_json(report: PreflightReport) -> dict[str, object]:
    return {
        "ok": report.ok,
        "complete": report.complete,
        "checked_to_line": report.checked_to_line,
        "stopped_by": report.stopped_by,
        "moves": report.moves,
        "cycle_s": report.cycle_s,
        "motion_s": report.motion_s,
        "estimated_s": report.estimated_s,
        "stop_horizon_s": report.stop_horizon_s,
        "needed_lead_s": report.needed_lead_s,
        "needed_lead_segments": report.needed_lead_segments,
        "findings": [_finding(finding) for finding in report.findings],
    }


def _finding(finding: Finding) -> dict[str, object]:
    data = asdict(finding)
    data["severity"], data["kind"] = finding.severity.value, finding.kind.value
    data["file"], data["line"] = finding.source.file, finding.source.line
    del data["source"]
    return data


def _print(program: Path, report: PreflightReport) -> None:
    for finding in report.findings:
        click.echo(str(finding))
    ending = "to its end" if report.complete else f"to line {report.checked_to_line} ({report.stopped_by})"
    verdict = "nothing forbids the start" if report.ok else _count(report)
    click.echo(f"{program}: checked {ending}, {report.moves} moves: {verdict}")
    if report.estimated_s is not None:
        click.echo(f"  time           about {report.estimated_s:.0f} s, estimated from planned stretches")
    if report.cycle_s is not None:
        click.echo(f"  time           {report.cycle_s:.2f} s, of which {report.motion_s:.2f} s motion")
        click.echo(f"  stop horizon   {report.stop_horizon_s:.3f} s")
        click.echo(f"  needed lead    {report.needed_lead_s:.3f} s, {report.needed_lead_segments} segments")

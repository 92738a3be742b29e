"""`rm501-host plan`: the time law of a program, without a board."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command("plan")
@click.argument("program", type=click.Path(exists=True, dir_okay=False, readable=True, path_type=Path))
@click.option("--out", type=click.Path(dir_okay=False, writable=True, path_type=Path), help="Write samples (.npz).")
@click.option("--start", help="Joints at the start, q1,q2,q3,q4,q5 in deg; default: the home position.")
@click.option("--max-moves", type=click.IntRange(min=1), default=20_000, show_default=True, help="Refuse longer ones.")
@click.pass_context
def plan_command(ctx: click.Context, program: Path, out: Path | None, start: str | None, max_moves: int) -> None:
    """Plan PROGRAM and print its times and the limits it reaches; with --json as JSON on stdout.

    The samples are 1 ms apart but for the last: t_s (n), q_deg (n,5), tcp_mm (n,3) in the base frame, motor_steps
    (n,6), line (n). All of the plan is kept in memory, so a program of too many moves, or without an end, is refused.
    """
    import numpy as np

    from rm501_host.cli.progress import words_of_progress
    from rm501_host.kinematics import Arm
    from rm501_host.planner.plan import Plan
    from rm501_host.planner.planner import Planner
    from rm501_host.planner.programs import start_joints
    from rm501_host.program import read_moves
    from rm501_host.reading import at_most
    from rm501_host.segmenter import Segmenter, stop_horizon
    from rm501_host.segmenter.fit import to_q48

    config = ctx.obj.config
    arm = Arm.from_config(config)
    start_deg = start_joints(start, arm)
    planner = Planner(arm, config, start_deg)
    moves = read_moves(
        program, arm, lambda: planner.q_deg.tolist(), lambda text: click.echo(text, err=True), config=config
    )
    remedy = "the whole plan is kept in memory: correct its loop, or plan more of it with --max-moves"
    bounded = at_most(moves, max_moves, remedy)
    plan = Plan(arm, config, planner.plan(words_of_progress(ctx.obj, "planning", bounded)))
    positions = [*map(to_q48, arm.motors_from_joints(start_deg).tolist()), 0]
    segments = list(Segmenter(config, positions, 0).segments(plan.pieces))
    horizon = stop_horizon(config, segments)
    cycle_s = plan.duration_s + horizon.tail_s
    summary: dict[str, object] = {
        "program": str(program),
        "cycle_s": cycle_s,
        "motion_s": plan.motion_s,
        "pieces": len(plan.pieces),
        "segments": len(segments),
        "max_step_error": max((item.max_error_steps for item in segments), default=0.0),
        "stop_horizon_s": horizon.stop_s,
        "hold_horizon_s": horizon.hold_s,
        "needed_lead_s": horizon.lead_s,
        "needed_lead_segments": horizon.lead_segments,
    }
    if plan.duration_s > 0.0:
        samples = plan.sample()
        ratios = plan.limits(samples)
        summary["limits"] = {
            "joint_velocity_ratio": ratios.joint_velocity_ratio,
            "joint_acceleration_ratio": ratios.joint_acceleration_ratio,
            "motor_rate_ratio": ratios.motor_rate_ratio,
            "motor_acceleration_ratio": ratios.motor_acceleration_ratio,
        }
        if out is not None:
            np.savez(
                out,
                t_s=samples.t_s,
                q_deg=samples.q_deg,
                tcp_mm=samples.tcp_mm,
                motor_steps=samples.motor_steps,
                line=samples.line,
            )
    elif out is not None:
        raise click.UsageError("the program does not move: there is nothing to write")
    if ctx.obj.json_output:
        click.echo(json.dumps(summary))
        return
    click.echo(f"{program}: {cycle_s:.3f} s, of which {plan.motion_s:.3f} s motion")
    click.echo(f"  segments       {len(segments)}, at most {summary['max_step_error']:.3f} step from the law")
    click.echo(f"  stop horizon   {horizon.stop_s:.3f} s (hold {horizon.hold_s:.3f} s)")
    click.echo(f"  needed lead    {horizon.lead_s:.3f} s, {horizon.lead_segments} segments")
    for name, ratio in summary.get("limits", {}).items():  # type: ignore[attr-defined]  # a dict when present
        click.echo(f"  {name:26} {ratio:.6f}")

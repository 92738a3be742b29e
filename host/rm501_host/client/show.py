"""The status as lines for people."""

from __future__ import annotations

from typing import Any

from rm501_host.config.schema import JOINT_NAMES


def status_lines(status: dict[str, Any]) -> list[str]:
    """A few lines that say what matters first."""
    run = f" {status['run_state']}" if status["task_state"] == "ON" else ""
    what = f", {status['activity']}" if status["activity"] else ""
    owner = f" (owner {status['owner']})" if status["owner"] else ""
    lines = [f"{status['task_state']}{run}, {status['mode']}{what}{owner}"]
    if status["cause"]:
        lines.append(f"  why      {status['cause']}")
    if status["remedy"]:
        lines.append(f"  remedy   {status['remedy']}")
    for name, angle, homed in zip(JOINT_NAMES, status["joints_deg"], status["homed"], strict=True):
        lines.append(f"  {name:8} {angle:9.3f} deg{'' if homed else '   not homed'}")
    if status["position"] is not None:
        axes = "  ".join(f"{axis}{value:.2f}" for axis, value in zip("XYZABC", status["position"], strict=True))
        lines.append(f"  tool     {axes}")
    lines.append(f"  hand     {status['hand']} (commanded)")
    lines.append(
        f"  board    {status['board_state'] or 'not connected'}, rate {status['rate']:.2f}, override "
        f"{status['override']:.2f}, queue {status['queue_lead_s']:.2f} s"
    )
    if status["jog_damped"]:
        lines.append("  jog      damped: near a singularity, slower and perhaps off its line")
    if status["limits_reduced"]:
        velocities = " ".join(f"{value:g}" for value in status["velocity_limits_deg_s"])
        accelerations = " ".join(f"{value:g}" for value in status["acceleration_limits_deg_s2"])
        tool = "" if status["tcp_limit_mm_s"] is None else f", tool {status['tcp_limit_mm_s']:g} mm/s"
        lines.append(f"  limits   lowered: {velocities} deg/s, {accelerations} deg/s2{tool}")
    if status["program"]:
        lines.append(
            f"  program  {status['program']} line {status['line']}: {status['block'].strip()}  "
            f"{status['progress']:.0%}, {status['time_left_s']:.0f} s left"
        )
        end = "to its end" if status["check_complete"] else f"to line {status['checked_to_line']}"
        lines.append(f"           checked {end}")
    if status["waiting"]:
        lines.append(f"  waits    {status['waiting']}: resume goes on")
    lines += [f"  message  {text}" for text in status["messages"]]
    lines += [f"  warning  {text}" for text in status["warnings"]]
    return lines

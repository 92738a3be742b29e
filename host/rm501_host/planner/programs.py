"""Options that the commands `plan` and `check` share."""

from __future__ import annotations

import click

from rm501_host.kinematics import Arm


def start_joints(text: str | None, arm: Arm) -> tuple[float, ...]:
    """`--start q1,q2,q3,q4,q5`, or the home position; raises click.BadParameter."""
    if text is None:
        return arm.home_deg
    try:
        joints = tuple(float(word) for word in text.split(","))
    except ValueError:
        joints = ()
    if len(joints) != 5 or not all(abs(joint) < 1e6 for joint in joints):
        raise click.BadParameter("five joint angles in deg, such as 0,80,-80,10,0", param_hint="--start")
    return joints

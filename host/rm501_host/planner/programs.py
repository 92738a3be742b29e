"""Options that the commands `plan` and `check` share."""

from __future__ import annotations

import click

from rm501_host.config import JOINT_NAMES
from rm501_host.kinematics import Arm
from rm501_host.kinematics.geometry import LIMIT_TOLERANCE_DEG


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
    low, high = arm.limits_deg
    for name, angle, least, most in zip(JOINT_NAMES, joints, low.tolist(), high.tolist(), strict=True):
        if not least - LIMIT_TOLERANCE_DEG <= angle <= most + LIMIT_TOLERANCE_DEG:
            raise click.BadParameter(
                f"the {name} cannot start at {angle:g} deg: its range is {least:g} to {most:g} deg",
                param_hint="--start",
            )
    return joints

"""Reading a program file into moves, for the commands `plan` and `check`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from rm501_host.gcode import Interpreter, ResolvedMove, Settings, resolve
from rm501_host.gcode.source import FileLines
from rm501_host.kinematics import Arm


@contextmanager
def program_moves(path: Path, arm: Arm, start_deg: Sequence[float]) -> Iterator[Iterator[ResolvedMove]]:
    """The moves of a program file, lazily, read from where the arm stands."""
    source = FileLines.open(path)
    try:
        settings = Settings(subroutine_path=(path.resolve().parent,))
        interpreter = Interpreter(source, settings)
        interpreter.set_position(arm.program_from_joints(start_deg))
        yield resolve(interpreter.calls())
    finally:
        source.close()


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

"""From a program file to moves, knowing where the arm stands: what `run`, `plan` and `check` read programs with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rm501_host.gcode.errors import GcodeFlowError, Location
from rm501_host.gcode.interpreter import Interpreter, Settings
from rm501_host.gcode.resolve import ExternalAction, ResolveOptions, resolve
from rm501_host.gcode.source import FileLines
from rm501_host.kinematics import Arm
from rm501_host.moves import JointMove, Move, ToolChange

JointPosition = Callable[[], Sequence[float]]
"""Gives the joints (5,) in deg at the end of the moves taken so far."""


def read_moves(
    program: Path,
    arm: Arm,
    joints_deg: JointPosition,
    on_warning: Callable[[str], None] | None = None,
    settings: Settings | None = None,
) -> Iterator[Move]:
    """The moves of a program, read as they are taken.

    `joints_deg` is asked before the first line and after every joint move, so that words that a block leaves out have
    their true values. Raises GcodeError naming file and line; GcodeFileError when the file cannot be read as text.
    """
    source = FileLines.open(program)

    def warn(text: object) -> None:
        if on_warning is not None:
            on_warning(str(text))

    try:
        settings = settings or Settings(subroutine_path=(program.resolve().parent,))
        interpreter = Interpreter(source, settings, on_warning=warn)
        interpreter.set_position(arm.program_from_joints(tuple(joints_deg())))
        options = ResolveOptions(on_warning=lambda text, at: warn(f"{at}: {text}"))
        for move in resolve(interpreter.calls(), options):
            if isinstance(move, ExternalAction):
                error = GcodeFlowError(f"M{move.number} has no action", "Remove it, or run the program in the daemon.")
                error.location = Location(move.source.file, move.source.line, move.source.block)
                raise error
            if isinstance(move, ToolChange):
                arm = arm.with_tool(move.length_mm, move.offset_mm)
            yield move
            if isinstance(move, JointMove):
                interpreter.set_position(arm.program_from_joints(tuple(joints_deg())))
    finally:
        source.close()

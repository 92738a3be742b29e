"""From a program file to moves, knowing where the arm stands: what `run`, `plan` and `check` read programs with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rm501_host.config import Config
from rm501_host.gcode.canon import CanonCall, Signal
from rm501_host.gcode.errors import GcodeError, GcodeUnsupportedError, Location
from rm501_host.gcode.interpreter import Interpreter
from rm501_host.gcode.program_log import LogNote, require_log_name
from rm501_host.gcode.resolve import ExternalAction, ResolveOptions, Resolver, resolve, source_of
from rm501_host.gcode.settings import Settings
from rm501_host.gcode.source import FileLines
from rm501_host.gcode.user_m import find_user_m, run_user_m
from rm501_host.kinematics import Arm
from rm501_host.moves import ArcMove, JointMove, LinearMove, Move, OutputChange, RapidMove, ToolChange
from rm501_host.planner.pieces import Action

JointPosition = Callable[[], Sequence[float]]
"""Gives the joints (5,) in deg at the end of the moves taken so far."""

_SIGNALS = {
    "M3": (Signal.START_SPINDLE_CLOCKWISE,),
    "M4": (Signal.START_SPINDLE_COUNTERCLOCKWISE,),
    "M5": (Signal.STOP_SPINDLE_TURNING,),
    "M7": (Signal.MIST_ON,),
    "M8": (Signal.FLOOD_ON,),
    "M9": (Signal.MIST_OFF, Signal.FLOOD_OFF),
}


def program_settings(config: Config, program: Path, *, start_line: int = 1) -> Settings:
    """How `config` wants programs read: subroutines beside the program, its M codes."""
    return Settings(
        subroutine_path=(program.resolve().parent,),
        user_m=find_user_m(m_codes_folder(config)),
        start_line=start_line,
    )


def output_map(config: Config) -> dict[Signal, tuple[int, bool]]:
    """What M3 to M9 switch, from `[gcode.outputs]`."""
    return {signal: target for code, target in config.gcode.outputs.items() for signal in _SIGNALS[code]}


def m_codes_folder(config: Config) -> Path | None:
    """Where the executables of M codes are, None where there are none."""
    folder = config.gcode.m_codes_folder
    return None if folder is None else Path(folder)


def run_external(config: Config, action: ExternalAction) -> None:
    """Run the executable of an M code and wait for it (blocking); raises UserMCodeError."""
    folder = m_codes_folder(config)
    assert folder is not None, "an M code without a folder is refused when the program is read"
    run_user_m(folder, action.number, action.p, action.q, timeout_s=config.gcode.m_codes_timeout_s)


def read_moves(
    program: Path,
    arm: Arm,
    joints_deg: JointPosition,
    on_warning: Callable[[str], None] | None = None,
    settings: Settings | None = None,
    *,
    config: Config | None = None,
    with_notes: bool = False,
) -> Iterator[Move | Action]:
    """The moves of a program, read as they are taken.

    `joints_deg` is asked before the first line, after every joint move and every change of the tool, so that words
    that a block leaves out have their true values. `config` gives the settings (unless `settings` are given) and the
    outputs; `with_notes`: log comments come as `LogNote` between the moves, long silence as `StillReading`. Raises
    GcodeError naming file and line; GcodeFileError when the file cannot be read as text.
    """
    source = FileLines.open(program)

    def warn(text: object) -> None:
        if on_warning is not None:
            on_warning(str(text))

    try:
        if settings is None:
            folder = program.resolve().parent
            settings = Settings(subroutine_path=(folder,)) if config is None else program_settings(config, program)
        interpreter = Interpreter(source, settings, on_warning=warn)
        options = ResolveOptions(
            outputs={} if config is None else output_map(config),
            on_warning=lambda text, at: warn(f"{at}: {text}"),
            on_log=require_log_name,
        )
        notes: list[LogNote] = []
        if with_notes:
            options = noting(options, notes)
        resolver = Resolver(options)

        def stand() -> None:
            position = arm.program_from_joints(tuple(joints_deg()))
            interpreter.set_position(position)
            resolver.set_position(position)

        stand()
        is_c_unheard = config is not None and config.machine.coordinates == "XYZAB"
        for move in with_notes_between(resolve(interpreter.calls(), options, resolver=resolver), notes):
            if isinstance(move, OutputChange) and config is not None:
                _check_output(move, len(config.board.digital_outputs))
            if is_c_unheard and isinstance(move, RapidMove | LinearMove | ArcMove) and move.target[5] != 0.0:
                is_c_unheard = False  # told once
                warn(
                    f"{move.source}: warning: C has no effect, [machine] coordinates is XYZAB (A pitch, B roll); "
                    "leave C out, or use XYZABC"
                )
            yield move
            if isinstance(move, ToolChange):
                arm = arm.with_tool(move.length_mm, move.offset_mm)
            if isinstance(move, JointMove | ToolChange):
                stand()
    finally:
        source.close()


def noting(options: ResolveOptions, notes: list[LogNote]) -> ResolveOptions:
    """`options` that put log comments into `notes` and tell of long silence; for `with_notes_between`."""

    def note(call: CanonCall) -> None:
        require_log_name(call)
        notes.append(LogNote(call, source_of(call.at)))

    return replace(options, on_log=note, tells_silence=True)


def with_notes_between(moves: Iterable[Move | Action], notes: list[LogNote]) -> Iterator[Move | Action]:
    """The moves with the notes that reading them made, at their places."""
    try:
        for move in moves:
            if notes:
                yield from notes
                notes.clear()
            yield move
    except GcodeError:
        yield from notes
        raise
    yield from notes


def _check_output(move: OutputChange, fitted: int) -> None:
    if move.output < fitted:
        return
    error = GcodeUnsupportedError(
        f"there is no digital output {move.output}: {fitted} are fitted", "List its pin in [board] digital_outputs."
    )
    error.location = Location(move.source.file, move.source.line, move.source.block)
    raise error

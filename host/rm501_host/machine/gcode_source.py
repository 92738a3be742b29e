"""Programs and single blocks as moves, in the machine's own surroundings.

The interpreter sees the variable file (work offsets, persistent parameters), the tool table, and the teach points: as
named parameters `#<_point_NAME_q1>` to `q5`, and as the subroutine `O<goto> CALL [number]`, a rapid to the recorded
position in machine coordinates, whatever units and offsets are active.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rm501_host.config import Config
from rm501_host.errors import RefusedError
from rm501_host.gcode.canon import Axes, CanonCall, OperatorMessage, Units
from rm501_host.gcode.context import ProbeResult
from rm501_host.gcode.interpreter import Interpreter, Settings
from rm501_host.gcode.program_log import LogNote
from rm501_host.gcode.resolve import ResolveOptions, Resolver, StillReading, resolve
from rm501_host.gcode.source import FileLines
from rm501_host.gcode.tools import ToolTable, load_tool_table
from rm501_host.gcode.user_m import find_user_m
from rm501_host.kinematics import Arm
from rm501_host.moves import JointMove, Message, Move, Pause, ProgramEnd, Source, ToolChange
from rm501_host.planner.pieces import Action
from rm501_host.program import m_codes_folder, noting, output_map, with_notes_between
from rm501_host.storage import write_atomic
from rm501_host.teach import TeachFile

STEP_MARK = "\0step"
"""Text of the message that stands between two blocks in single block mode: a place at rest."""
MAX_MDI_HISTORY = 500
_END_OF_BLOCK = "-- end of block --"
Joints = Callable[[], Sequence[float]]


@dataclass
class InputAnswer:
    """What M66 is answered with: the consumer waits for the input, the interpreter then takes the value."""

    value: float = 0.0

    def input_value(self, index: int, analog: bool, mode: int, timeout_s: float) -> float:
        """The value that was waited for."""
        del index, analog, mode, timeout_s
        return self.value

    def probe_result(self, start: Axes, target: Axes, units: Units) -> ProbeResult:
        """There is no probe."""
        del start, target, units
        raise RefusedError("there is no probe input on this machine; remove G38 from the program")


@dataclass
class Surroundings:
    """What programs find around them; `folder` holds the daemon's own files."""

    folder: Path
    programs: Path
    teach: TeachFile
    answer: InputAnswer = field(default_factory=InputAnswer)
    config: Config | None = None
    """Gives the M codes of a folder and the outputs of M3 to M9; without it there are none."""

    @property
    def variables(self) -> Path:
        """The variable file."""
        return self.folder / "rm501.var"

    @property
    def logs(self) -> Path:
        """Where log comments of programs may write."""
        return self.folder / "logs"

    @property
    def tool_file(self) -> Path:
        """The tool table."""
        return self.folder / "tool.tbl"

    def tools(self) -> ToolTable:
        """The tool table as it is on disk; empty without a file."""
        return load_tool_table(self.tool_file) if self.tool_file.is_file() else ToolTable()

    def interpreter(self, lines: object, arm: Arm, settings: Settings) -> Interpreter:
        """An interpreter with everything around it."""
        self._write_goto(arm)
        variables = self.variables if self.variables.is_file() else None
        interpreter = Interpreter(
            lines,  # type: ignore[arg-type]  # any ProgramLines
            settings,
            tools=self.tools(),
            variables=variables,
            feedback=self.answer,
        )
        for point in self.teach.points:
            for index, angle in enumerate(point.q_deg, start=1):
                interpreter.parameters.globals[f"_point_{point.name}_q{index}"] = angle
        return interpreter

    def settings(self, **changes: object) -> Settings:
        """Settings with the subroutine folders and the M codes."""
        handlers = find_user_m(None if self.config is None else m_codes_folder(self.config))
        return Settings(subroutine_path=(self.programs, self.folder), user_m=handlers, **changes)  # type: ignore[arg-type]

    def resolve_options(self) -> ResolveOptions:
        """What M3 to M9 switch."""
        return ResolveOptions(outputs={} if self.config is None else output_map(self.config))

    def save_variables(self, interpreter: Interpreter) -> None:
        """Keep the persistent parameters; raises GcodeFileError."""
        self.folder.mkdir(parents=True, exist_ok=True)
        interpreter.parameters.save(self.variables)

    def _write_goto(self, arm: Arm) -> None:
        """The subroutine `goto`, made from the teach points."""
        lines = ["; made from the teach points, do not edit", "o<goto> sub", "M73 G21 G90"]
        keyword = "if"
        for point in self.teach.points:
            x, y, z, a, b, c = arm.program_from_joints(np.array(point.q_deg))
            lines.append(f"o1 {keyword} [#1 EQ {point.number}]")
            lines.append(f"  G53 G0 X{x:.6f} Y{y:.6f} Z{z:.6f} A{a:.6f} B{b:.6f} C{c:.6f}")
            keyword = "elseif"
        if keyword == "elseif":
            lines += ["o1 else", "  (abort,there is no teach point #1)", "o1 endif"]
        else:
            lines.append("(abort,there are no teach points)")
        lines.append("o<goto> endsub")
        text = "\n".join(lines) + "\n"
        path = self.folder / "goto.ngc"
        if not path.is_file() or path.read_text("utf-8") != text:
            write_atomic(path, text.encode())


class ProgramReader:
    """Reads a program file once, from `start_line`; `step`: with a STEP_MARK message after every block that moves."""

    def __init__(
        self, path: Path, arm: Arm, joints_deg: Joints, around: Surroundings, *, start_line: int, step: bool
    ) -> None:
        self._path = path
        self._arm = arm
        self._joints_deg = joints_deg
        self._around = around
        self._start_line = start_line
        self._step = step
        self._interpreter: Interpreter | None = None

    def moves(self) -> Iterator[Move | Action]:
        """The moves, read as they are taken, with log comments as `LogNote`; raises GcodeError and its kin naming
        file and line.
        """
        source = FileLines.open(self._path, self._path.name)
        around, arm = self._around, self._arm
        try:
            interpreter = around.interpreter(source, arm, around.settings(start_line=self._start_line))
            self._interpreter = interpreter
            notes: list[LogNote] = []
            options = noting(around.resolve_options(), notes)
            resolver = Resolver(options)
            _stand(interpreter, resolver, arm, self._joints_deg)
            last: Source | None = None
            tool = arm
            for move in with_notes_between(resolve(interpreter.calls(), options, resolver=resolver), notes):
                if isinstance(move, ToolChange):
                    tool = arm.with_tool(move.length_mm, move.offset_mm)
                ends_block = last is not None and move.source.line != last.line
                if self._step and last is not None and ends_block and not isinstance(move, ProgramEnd):
                    yield Message(STEP_MARK, last)
                    last = None
                yield move
                if not isinstance(move, Message | Pause | ProgramEnd | ToolChange | LogNote | StillReading):
                    last = move.source
                if isinstance(move, JointMove | ToolChange):
                    _stand(interpreter, resolver, tool, self._joints_deg)
        finally:
            source.close()

    def save_variables(self) -> None:
        """Keep the persistent parameters as the program has left them, once it has been played to its end."""
        if self._interpreter is not None:
            self._around.save_variables(self._interpreter)


def _stand(interpreter: Interpreter, resolver: Resolver, arm: Arm, joints_deg: Joints) -> None:
    """Both readers of a program learn where the tool is: words left out, and where arcs begin."""
    position = arm.program_from_joints(np.array(joints_deg()))
    interpreter.set_position(position)
    resolver.set_position(position)


class MdiSession:
    """Single blocks, one after another, with the modes and parameters that earlier ones left behind.

    After an error the modes are the defaults again; offsets and persistent parameters stay, they are in the variable
    file.
    """

    def __init__(self, around: Surroundings) -> None:
        self._around = around
        self._lines = _BlockByBlock()
        self._interpreter: Interpreter | None = None
        self._tool: ToolChange | None = None
        self._calls: Iterator[CanonCall] = iter(())
        self._resolver = Resolver(around.resolve_options())
        self.history: deque[str] = deque(maxlen=MAX_MDI_HISTORY)

    def moves(self, block: str, arm: Arm, joints_deg: Joints) -> Generator[Move | Action, None, None]:
        """The moves of one block; raises GcodeError, RefusedError."""
        if "\n" in block or "\r" in block:
            raise RefusedError("MDI takes one block; put several into a program")
        self.history.append(block)
        bare = arm
        try:
            interpreter = self._live(arm)
            self._lines.put(block)
            if self._tool is not None:
                # every block is planned by itself, from an arm without a tool
                arm = arm.with_tool(self._tool.length_mm, self._tool.offset_mm)
                yield self._tool
            _stand(interpreter, self._resolver, arm, joints_deg)
            for call in self._calls:
                if isinstance(call, OperatorMessage) and call.text.strip() == _END_OF_BLOCK:
                    break
                for move in self._resolver.feed(call):
                    if isinstance(move, ToolChange):
                        self._tool = move
                        arm = bare.with_tool(move.length_mm, move.offset_mm)
                    yield move
                    if isinstance(move, JointMove | ToolChange):
                        _stand(interpreter, self._resolver, arm, joints_deg)
                    if isinstance(move, ProgramEnd):
                        self._interpreter = None
            self._around.save_variables(interpreter)
        except BaseException:
            self._interpreter = None
            raise

    def forget(self) -> None:
        """The tables or a program have changed what the interpreter knew: begin anew with the next block."""
        self._interpreter = None

    def _live(self, arm: Arm) -> Interpreter:
        """The interpreter that the last block left behind, or a new one."""
        if self._interpreter is None:
            self._tool = None
            self._lines = _BlockByBlock()
            self._interpreter = self._around.interpreter(self._lines, arm, self._around.settings())
            self._calls = self._interpreter.calls()
            self._resolver = Resolver(self._around.resolve_options())
        return self._interpreter


class _BlockByBlock:
    """A program that grows: every block is followed by a message that says it is over."""

    def __init__(self) -> None:
        self.name = "(mdi)"
        self._first = 0
        self._pair: list[str] = []

    def put(self, block: str) -> None:
        """The next block."""
        self._first += len(self._pair)
        self._pair = [block, f"(MSG,{_END_OF_BLOCK})"]

    def block(self, index: int) -> tuple[int, list[str]]:
        """The newest block and its message; nothing else is there any more."""
        return (self._first, self._pair) if 0 <= index - self._first < len(self._pair) else (index, [])

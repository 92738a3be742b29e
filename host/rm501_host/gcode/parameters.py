"""Parameters: numbered, named, computed; and the variable file that keeps some of them.

Numbered parameters 5161 to 5390 hold machine units, as their file does; #5420 to #5428 and `#<_x>` show the position
in program units.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from rm501_host.gcode.canon import Plane, Units
from rm501_host.gcode.errors import GcodeFileError, GcodeLimitError, GcodeParameterError, GcodeSyntaxError, Location
from rm501_host.gcode.expressions import MAX_PARAMETER
from rm501_host.gcode.state import SavedModes, State
from rm501_host.gcode.tools import ToolTable

G28, G30, G92, G5X = 5161, 5181, 5211, 5221
"""First parameters (X) of the stored positions and offsets; work system n starts at G5X + 20 (n - 1)."""
G92_ACTIVE, G5X_INDEX = 5210, 5220
PROBE, PROBE_OK, INPUT_RESULT = 5061, 5070, 5399
DEBUG_SWITCH = 5599
MAX_NAMED = 10_000
"""Named parameters in one scope: a program that makes more is broken, and memory is bounded."""

_PLANES = {Plane.XY: 170.0, Plane.XZ: 180.0, Plane.YZ: 190.0}
_AXES = "xyzabcuvw"


def required_parameters() -> tuple[int, ...]:
    """Parameters that a variable file always holds (RS274/NGC, section 3.2.1)."""
    out = [*range(G28, G28 + 9), *range(G30, G30 + 9), *range(G92_ACTIVE, G92_ACTIVE + 10), G5X_INDEX]
    for system in range(9):
        out += range(G5X + 20 * system, G5X + 20 * system + 10)
    return tuple(out)


class Parameters:
    """The parameters an interpreter works with; `state` and `tools` supply the computed ones."""

    def __init__(self, state: State, tools: ToolTable) -> None:
        self.numbered = [0.0] * (MAX_PARAMETER + 1)
        self.numbered[G5X_INDEX] = 1.0
        self.numbered[DEBUG_SWITCH] = 1.0
        self.globals: dict[str, float] = {}
        self.locals: dict[str, float] = {}
        self.state = state
        self.tools = tools
        self.call_level = 0
        self.line = 0
        self.return_value = 0.0
        self.value_returned = False
        self.saved: SavedModes | None = None
        """M70, M73 of the call level in force."""
        self._system = _system_parameters(self)

    # -- reading

    def read_numbered(self, index: int) -> float:
        """Value of #index."""
        if 5420 <= index <= 5428:
            axis = index - 5420
            if axis < 2 and self.state.rotation is not None:
                return self.state.rotation.back(self.state.position[0], self.state.position[1])[axis]
            return self.state.position[axis] if axis < 6 else 0.0
        if 5400 <= index <= 5413:
            return self._tool_parameter(index)
        if index >= 5600:
            return 0.0
        return self.numbered[index]

    def _tool_parameter(self, index: int) -> float:
        number = self.state.tool_in_spindle
        if index == 5400:
            return float(number)
        tool = self.tools.get(number)
        if tool is None:
            return 0.0
        axis = index - 5401
        if axis < 6:
            return tool.offset[axis]
        return tool.diameter if index == 5410 else 0.0

    def read_named(self, name: str) -> float:
        """Value of #<name>. Raises GcodeParameterError when it was never set."""
        if name.startswith("_"):
            value = self.globals.get(name)
            if value is not None:
                return value
            system = self._system.get(name)
            if system is not None:
                return system()
            known = self.globals
        else:
            value = self.locals.get(name)
            if value is not None:
                return value
            known = self.locals
        raise GcodeParameterError(f"named parameter #<{name}> not defined", _suggestion(name, known))

    def has_named(self, name: str) -> bool:
        """EXISTS[#<name>]."""
        if name.startswith("_"):
            return name in self.globals or name in self._system
        return name in self.locals

    # -- writing

    def write_numbered(self, index: int, value: float) -> None:
        """Set #index. Raises GcodeParameterError for the read-only ones."""
        if 5400 <= index <= 5413 or 5420 <= index <= 5428:
            raise GcodeParameterError(
                f"parameter #{index} is readonly", "It shows the tool or the position; use another number."
            )
        if index < 5600:
            self.numbered[index] = value

    def write_named(self, name: str, value: float) -> None:
        """Set #<name>, global with a leading underscore. Raises GcodeParameterError, GcodeLimitError."""
        if name in self._system:
            raise GcodeParameterError(
                f"cannot assign to read-only parameter #<{name}>",
                "It shows the state of the machine; use another name.",
            )
        scope = self.globals if name.startswith("_") else self.locals
        if len(scope) >= MAX_NAMED and name not in scope:
            raise GcodeLimitError(f"more than {MAX_NAMED} named parameters", "Use numbered parameters in loops.")
        scope[name] = value

    # -- groups of six

    def axes(self, first: int) -> list[float]:
        """Six machine-unit values from #first on, converted to program units."""
        factor = self.state.to_program
        values = self.numbered[first : first + 6]
        return [values[i] * factor if i < 3 else values[i] for i in range(6)]

    def store_axes(self, first: int, values: list[float]) -> None:
        """Store six program-unit values in machine units."""
        factor = self.state.to_program
        for i in range(6):
            self.numbered[first + i] = values[i] / factor if i < 3 else values[i]

    # -- the variable file

    def load(self, path: Path) -> None:
        """Read a variable file: `number value` a line. Raises GcodeFileError, GcodeSyntaxError."""
        try:
            text = path.read_text(encoding="ascii", errors="replace")
        except OSError as error:
            reason = error.strerror or str(error)
            raise GcodeFileError(f"cannot read {path}: {reason}", "Check the name and the permissions.") from error
        last = 0
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip():
                continue
            where = Location(str(path), number, line)
            try:
                key, value = line.split()
                index, parsed = int(key), float(value)
            except ValueError:
                raise _located(GcodeSyntaxError("a line holds a number and a value", "As: 5221 10.5"), where) from None
            if not 1 <= index <= MAX_PARAMETER or parsed != parsed or abs(parsed) == float("inf"):
                raise _located(GcodeSyntaxError(f"parameter {index} = {value} out of range", "Correct it."), where)
            if index <= last:
                raise _located(GcodeSyntaxError(f"parameter {index} out of order", "Sort the file."), where)
            last = index
            self.numbered[index] = parsed

    def save(self, path: Path) -> None:
        """Write the file atomically: the required parameters and every one the old file had. Raises GcodeFileError."""
        kept = set(required_parameters())
        with contextlib.suppress(OSError, ValueError):
            kept |= {int(line.split()[0]) for line in path.read_text(encoding="ascii").splitlines() if line.strip()}
        text = "".join(f"{i}\t{self.numbered[i]!r}\n" for i in sorted(kept) if 1 <= i <= MAX_PARAMETER)
        try:
            handle, temporary = tempfile.mkstemp(prefix=path.name, dir=path.parent)
            try:
                with os.fdopen(handle, "w", encoding="ascii") as file:
                    file.write(text)
                    file.flush()
                    os.fsync(file.fileno())
                Path(temporary).replace(path)
            except BaseException:
                Path(temporary).unlink(missing_ok=True)
                raise
        except OSError as error:
            reason = error.strerror or str(error)
            raise GcodeFileError(f"cannot write {path}: {reason}", "The old file is untouched.") from error


def _located(error: GcodeSyntaxError, where: Location) -> GcodeSyntaxError:
    error.location = where
    return error


def _suggestion(name: str, known: dict[str, float]) -> str:
    import difflib

    near = difflib.get_close_matches(name, list(known)[:500], n=1)
    hint = f" Did you mean #<{near[0]}>?" if near else ""
    return f"Set it before it is used, or ask with EXISTS.{hint}"


def _flag(value: bool) -> float:
    return 1.0 if value else 0.0


def _system_parameters(p: Parameters) -> dict[str, Callable[[], float]]:
    """The read-only named parameters (LinuxCNC 2.9)."""
    s = p.state
    table: dict[str, Callable[[], float]] = {
        "_vmajor": lambda: 2.9,
        "_vminor": lambda: 0.0,
        "_line": lambda: float(p.line),
        "_motion_mode": lambda: float(max(-1, s.motion)),
        "_plane": lambda: _PLANES[s.plane],
        "_ccomp": lambda: 400.0,
        "_metric": lambda: _flag(s.units is Units.MM),
        "_imperial": lambda: _flag(s.units is Units.INCH),
        "_absolute": lambda: _flag(s.absolute),
        "_incremental": lambda: _flag(not s.absolute),
        "_inverse_time": lambda: _flag(s.inverse_time),
        "_units_per_minute": lambda: _flag(not s.inverse_time),
        "_units_per_rev": lambda: 0.0,
        "_coord_system": lambda: 540.0 + (10.0 * (s.g5x_index - 1) if s.g5x_index <= 6 else 50.0 + s.g5x_index - 6),
        "_tool_offset": lambda: _flag(s.tool_offset_active),
        "_retract_r_plane": lambda: _flag(s.retract_r),
        "_retract_old_z": lambda: _flag(not s.retract_r),
        "_spindle_rpm_mode": lambda: 1.0,
        "_spindle_css_mode": lambda: 0.0,
        "_ijk_absolute_mode": lambda: _flag(s.arc_absolute),
        "_lathe_diameter_mode": lambda: 0.0,
        "_lathe_radius_mode": lambda: 1.0,
        "_spindle_on": lambda: _flag(s.spindle != 0),
        "_spindle_cw": lambda: _flag(s.spindle > 0),
        "_mist": lambda: _flag(s.mist),
        "_flood": lambda: _flag(s.flood),
        "_speed_override": lambda: _flag(s.speed_override),
        "_feed_override": lambda: _flag(s.feed_override),
        "_adaptive_feed": lambda: _flag(s.adaptive_feed),
        "_feed_hold": lambda: _flag(s.feed_hold),
        "_feed": lambda: s.feed,
        "_rpm": lambda: s.speed,
        "_current_tool": lambda: float(s.tool_in_spindle),
        "_current_pocket": lambda: 1.0,
        "_selected_tool": lambda: float(s.selected_tool),
        "_selected_pocket": lambda: -1.0,
        "_value": lambda: p.return_value,
        "_value_returned": lambda: _flag(p.value_returned),
        "_call_level": lambda: float(p.call_level),
        "_remap_level": lambda: 0.0,
        "_task": lambda: 0.0,
    }
    for i, axis in enumerate(_AXES):
        table[f"_{axis}"] = _reader(p, 5420 + i)
        if i < 6:
            table[f"_abs_{axis}"] = _machine_reader(s, i)
    return table


def _reader(p: Parameters, index: int) -> Callable[[], float]:
    return lambda: p.read_numbered(index)


def _machine_reader(s: State, axis: int) -> Callable[[], float]:
    return lambda: s.machine_position(s.position)[axis]

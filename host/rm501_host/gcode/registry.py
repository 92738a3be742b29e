"""Every code of the dialect: modal group, support, and what differs from LinuxCNC 2.9.

The parser takes the modal groups from here, the executor refuses from here, and `docs/gcode.md` is generated from
here, so none of them can disagree.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Support(Enum):
    """How far a code is supported."""

    FULL = "yes"
    DIFFERS = "yes, differs"
    OWN = "own addition"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Code:
    """One code. `key` is ten times its number (G59.3 is 593); `group` its modal group."""

    letter: str
    key: int
    group: int
    title: str
    support: Support = Support.FULL
    note: str = ""

    @property
    def name(self) -> str:
        """The code as it is written: G59.3."""
        whole, tenth = divmod(self.key, 10)
        return f"{self.letter}{whole}" + (f".{tenth}" if tenth else "")


MOTION, ONE_SHOT, PLANE, DISTANCE, ARC_DISTANCE, FEED_MODE, UNITS = 1, 0, 2, 3, 4, 5, 6
CUTTER, TOOL_LENGTH, RETRACT, WORK_OFFSET, PATH_CONTROL, SPINDLE_MODE, LATHE = 7, 8, 10, 12, 13, 14, 15
ROTATION = 16
M_STOP, M_IO, M_TOOL, M_SPINDLE, M_COOLANT, M_OVERRIDE, M_USER = 4, 5, 6, 7, 8, 9, 10

_R = Support.REFUSED
_MILL = "Cutter compensation needs a cutter; this is an arm."
_LATHE = "A lathe code."
_SPINDLE = "Needs a spindle synchronised with the feed."


def _g(number: float, group: int, title: str, support: Support = Support.FULL, note: str = "") -> Code:
    return Code("G", round(number * 10), group, title, support, note)


def _m(number: int, group: int, title: str, support: Support = Support.FULL, note: str = "") -> Code:
    return Code("M", number * 10, group, title, support, note)


_OUT = "The call is issued; on the arm it drives the output configured for it, or is refused."

CODES: tuple[Code, ...] = (
    _g(0, MOTION, "Rapid move", Support.DIFFERS, "On the arm a line in joint space by default."),
    _g(1, MOTION, "Straight feed"),
    _g(2, MOTION, "Arc or helix, clockwise"),
    _g(3, MOTION, "Arc or helix, counter-clockwise"),
    _g(4, ONE_SHOT, "Dwell P seconds"),
    _g(5, MOTION, "Cubic spline", Support.DIFFERS, "Kept as a curve with its control points; never flattened here."),
    _g(5.1, MOTION, "Quadratic spline", Support.DIFFERS, "As G5."),
    _g(5.2, MOTION, "NURBS, begin", Support.DIFFERS, "As G5."),
    _g(5.3, MOTION, "NURBS, end"),
    _g(7, LATHE, "Diameter mode", _R, _LATHE),
    _g(8, LATHE, "Radius mode"),
    _g(
        10, ONE_SHOT, "Set tool table (L1), work offset (L2, L20)", note="L10 and L11 are refused: they need a fixture."
    ),
    _g(17, PLANE, "XY plane"),
    _g(17.1, PLANE, "UV plane", _R, "The arm has no U V W."),
    _g(18, PLANE, "XZ plane"),
    _g(18.1, PLANE, "UW plane", _R, "The arm has no U V W."),
    _g(19, PLANE, "YZ plane"),
    _g(19.1, PLANE, "VW plane", _R, "The arm has no U V W."),
    _g(20, UNITS, "Inches"),
    _g(21, UNITS, "Millimetres"),
    _g(28, ONE_SHOT, "Go to the stored position 1"),
    _g(28.1, ONE_SHOT, "Store position 1"),
    _g(30, ONE_SHOT, "Go to the stored position 2"),
    _g(30.1, ONE_SHOT, "Store position 2"),
    _g(33, MOTION, "Spindle-synchronised motion", _R, _SPINDLE),
    _g(33.1, MOTION, "Rigid tapping", _R, _SPINDLE),
    _g(38.2, MOTION, "Probe towards contact, error when missed"),
    _g(38.3, MOTION, "Probe towards contact"),
    _g(38.4, MOTION, "Probe away from contact, error when missed"),
    _g(38.5, MOTION, "Probe away from contact"),
    _g(40, CUTTER, "Cutter compensation off"),
    _g(41, CUTTER, "Cutter compensation left", _R, _MILL),
    _g(41.1, CUTTER, "Cutter compensation left, dynamic", _R, _MILL),
    _g(42, CUTTER, "Cutter compensation right", _R, _MILL),
    _g(42.1, CUTTER, "Cutter compensation right, dynamic", _R, _MILL),
    _g(43, TOOL_LENGTH, "Tool length from the table", Support.DIFFERS, "On the arm it acts along the tool."),
    _g(43.1, TOOL_LENGTH, "Tool length from the words", Support.DIFFERS, "As G43."),
    _g(43.2, TOOL_LENGTH, "Further tool length", Support.DIFFERS, "As G43."),
    _g(49, TOOL_LENGTH, "Tool length off"),
    _g(52, ONE_SHOT, "Local offset"),
    _g(53, ONE_SHOT, "Move in machine coordinates"),
    _g(54, WORK_OFFSET, "Work coordinates 1"),
    _g(55, WORK_OFFSET, "Work coordinates 2"),
    _g(56, WORK_OFFSET, "Work coordinates 3"),
    _g(57, WORK_OFFSET, "Work coordinates 4"),
    _g(58, WORK_OFFSET, "Work coordinates 5"),
    _g(59, WORK_OFFSET, "Work coordinates 6"),
    _g(59.1, WORK_OFFSET, "Work coordinates 7"),
    _g(59.2, WORK_OFFSET, "Work coordinates 8"),
    _g(59.3, WORK_OFFSET, "Work coordinates 9"),
    _g(61, PATH_CONTROL, "Exact path"),
    _g(61.1, PATH_CONTROL, "Exact stop"),
    _g(64, PATH_CONTROL, "Blend within P", Support.DIFFERS, "The path never leaves P; the peer exceeds it."),
    _g(68, ROTATION, "Rotate about X Y by R degrees", Support.OWN, "Targets are listed already rotated."),
    _g(69, ROTATION, "Rotation off", Support.OWN),
    _g(70, MOTION, "Finishing cycle", _R, _LATHE),
    _g(71, MOTION, "Roughing cycle", _R, _LATHE),
    _g(71.1, MOTION, "Roughing cycle", _R, _LATHE),
    _g(71.2, MOTION, "Roughing cycle", _R, _LATHE),
    _g(72, MOTION, "Roughing cycle", _R, _LATHE),
    _g(72.1, MOTION, "Roughing cycle", _R, _LATHE),
    _g(72.2, MOTION, "Roughing cycle", _R, _LATHE),
    _g(73, MOTION, "Drilling with chip breaking"),
    _g(74, MOTION, "Left-hand tapping", _R, _SPINDLE),
    _g(76, MOTION, "Threading", _R, _LATHE),
    _g(80, MOTION, "Motion mode off"),
    _g(81, MOTION, "Drilling"),
    _g(82, MOTION, "Drilling with dwell"),
    _g(83, MOTION, "Peck drilling"),
    _g(84, MOTION, "Tapping", _R, _SPINDLE),
    _g(85, MOTION, "Boring, feed out"),
    _g(86, MOTION, "Boring, spindle stop", _R, _SPINDLE),
    _g(87, MOTION, "Back boring", _R, _SPINDLE),
    _g(88, MOTION, "Boring, manual out", _R, _SPINDLE),
    _g(89, MOTION, "Boring with dwell, feed out"),
    _g(90, DISTANCE, "Absolute distances"),
    _g(90.1, ARC_DISTANCE, "Absolute arc centres"),
    _g(91, DISTANCE, "Incremental distances"),
    _g(91.1, ARC_DISTANCE, "Incremental arc centres"),
    _g(92, ONE_SHOT, "Set the G92 offset"),
    _g(92.1, ONE_SHOT, "G92 offset off, forgotten"),
    _g(92.2, ONE_SHOT, "G92 offset off, remembered"),
    _g(92.3, ONE_SHOT, "G92 offset back"),
    _g(93, FEED_MODE, "Inverse time feed"),
    _g(94, FEED_MODE, "Feed in units per minute"),
    _g(95, FEED_MODE, "Feed per revolution", _R, _SPINDLE),
    _g(96, SPINDLE_MODE, "Constant surface speed", _R, _LATHE),
    _g(97, SPINDLE_MODE, "Spindle speed in turns per minute"),
    _g(98, RETRACT, "Cycles retract to the old position"),
    _g(99, RETRACT, "Cycles retract to R"),
    _m(0, M_STOP, "Pause"),
    _m(1, M_STOP, "Optional pause"),
    _m(2, M_STOP, "Program end"),
    _m(30, M_STOP, "Program end, exchange"),
    _m(60, M_STOP, "Exchange and pause"),
    _m(3, M_SPINDLE, "Spindle clockwise", Support.DIFFERS, _OUT),
    _m(4, M_SPINDLE, "Spindle counter-clockwise", Support.DIFFERS, _OUT),
    _m(5, M_SPINDLE, "Spindle off", Support.DIFFERS, _OUT),
    _m(6, M_TOOL, "Tool change", note="Changes the tool data; on the arm a pause for the operator."),
    _m(7, M_COOLANT, "Mist on", Support.DIFFERS, _OUT),
    _m(8, M_COOLANT, "Flood on", Support.DIFFERS, _OUT),
    _m(9, M_COOLANT, "Mist and flood off", Support.DIFFERS, _OUT),
    _m(19, M_SPINDLE, "Orient spindle", _R, _SPINDLE),
    _m(48, M_OVERRIDE, "Overrides on"),
    _m(49, M_OVERRIDE, "Overrides off"),
    _m(50, M_OVERRIDE, "Feed override P"),
    _m(51, M_OVERRIDE, "Speed override P"),
    _m(52, M_OVERRIDE, "Adaptive feed P"),
    _m(53, M_OVERRIDE, "Feed hold P"),
    _m(61, M_TOOL, "Set the tool number Q"),
    _m(62, M_IO, "Output P on with the next motion"),
    _m(63, M_IO, "Output P off with the next motion"),
    _m(64, M_IO, "Output P on now"),
    _m(65, M_IO, "Output P off now"),
    _m(66, M_IO, "Wait for input P or E"),
    _m(67, M_IO, "Analog output E to Q with the next motion"),
    _m(68, M_IO, "Analog output E to Q now"),
    _m(70, M_SPINDLE, "Save the modal state"),
    _m(71, M_SPINDLE, "Forget the saved modal state"),
    _m(72, M_SPINDLE, "Restore the modal state"),
    _m(73, M_SPINDLE, "Save the modal state, restore at the end of the subroutine"),
    _m(98, M_IO, "Call subroutine P, L times"),
    _m(99, M_IO, "Return", note="In the main program: its end, as the peer's stand-alone interpreter has it."),
    _m(101, M_USER, "Open the hand", Support.OWN),
    _m(102, M_USER, "Close the hand", Support.OWN),
    _m(110, M_USER, "Move joint P (1 to 5) to Q degrees", Support.OWN),
    _m(111, M_USER, "Move joint P (1 to 5) by Q degrees", Support.OWN),
)

G_CODES: dict[int, Code] = {code.key: code for code in CODES if code.letter == "G"}
M_CODES: dict[int, Code] = {code.key // 10: code for code in CODES if code.letter == "M"}
USER_M = range(100, 200)


def g_group(key: int) -> int | None:
    """Modal group of a G code by ten times its number, None for an unknown code."""
    code = G_CODES.get(key)
    return None if code is None else code.group


def m_group(number: int) -> int | None:
    """Modal group of an M code, None for an unknown one; M100 to M199 are user codes."""
    if number in USER_M:
        return M_USER
    code = M_CODES.get(number)
    return None if code is None else code.group


def markdown_table() -> str:
    """The table of `docs/gcode.md`."""
    rows = ["| code | meaning | supported | note |", "|---|---|---|---|"]
    rows += [f"| {c.name} | {c.title} | {c.support.value} | {c.note} |" for c in CODES]
    rows.append("| M100..M199 | others: an executable of the configured folder | yes | P and Q are its arguments |")
    return "\n".join(rows)

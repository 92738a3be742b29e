"""Canonical calls: what a program asks of the machine, in program units and program coordinates.

The set and its meaning are the canonical machining functions of RS274/NGC as LinuxCNC 2.9 uses them: targets do not
contain work offsets, rotation or tool length (those are calls of their own), lengths are in the unit last selected by
UseLengthUnits (mm at the start), angles in deg, feed in units/min. Every call ends with `at`, the block it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from rm501_host.gcode.errors import Location

Axes = tuple[float, float, float, float, float, float]
"""X Y Z in program units, A B C in deg."""


class Units(Enum):
    """Unit of length of a program (G20, G21)."""

    INCH = "INCHES"
    MM = "MM"

    @property
    def mm(self) -> float:
        """Millimetres in one unit."""
        return 25.4 if self is Units.INCH else 1.0


class Plane(Enum):
    """Plane of arcs and cycles (G17, G18, G19)."""

    XY = "XY"
    XZ = "XZ"
    YZ = "YZ"


class MotionMode(Enum):
    """How corners are passed (G61, G61.1, G64)."""

    EXACT_PATH = "EXACT_PATH"
    EXACT_STOP = "EXACT_STOP"
    CONTINUOUS = "CONTINUOUS"


class CanonFeedMode(IntEnum):
    """SET_FEED_MODE: G94 (and G93, whose rate is converted), G95."""

    UNITS_PER_MINUTE = 0
    UNITS_PER_REVOLUTION = 1


class Signal(Enum):
    """Calls without arguments, by the name they are listed under."""

    ON_RESET = "ON_RESET()"
    SET_FEED_REFERENCE_XYZ = "SET_FEED_REFERENCE(CANON_XYZ)"
    TURN_PROBE_ON = "TURN_PROBE_ON()"
    TURN_PROBE_OFF = "TURN_PROBE_OFF()"
    START_CHANGE = "START_CHANGE()"
    START_SPINDLE_CLOCKWISE = "START_SPINDLE_CLOCKWISE(0)"
    START_SPINDLE_COUNTERCLOCKWISE = "START_SPINDLE_COUNTERCLOCKWISE(0)"
    STOP_SPINDLE_TURNING = "STOP_SPINDLE_TURNING(0)"
    MIST_ON = "MIST_ON()"
    MIST_OFF = "MIST_OFF()"
    FLOOD_ON = "FLOOD_ON()"
    FLOOD_OFF = "FLOOD_OFF()"
    ENABLE_FEED_OVERRIDE = "ENABLE_FEED_OVERRIDE()"
    DISABLE_FEED_OVERRIDE = "DISABLE_FEED_OVERRIDE()"
    ENABLE_SPEED_OVERRIDE = "ENABLE_SPEED_OVERRIDE(0)"
    DISABLE_SPEED_OVERRIDE = "DISABLE_SPEED_OVERRIDE(0)"
    ENABLE_ADAPTIVE_FEED = "ENABLE_ADAPTIVE_FEED()"
    DISABLE_ADAPTIVE_FEED = "DISABLE_ADAPTIVE_FEED()"
    ENABLE_FEED_HOLD = "ENABLE_FEED_HOLD()"
    DISABLE_FEED_HOLD = "DISABLE_FEED_HOLD()"
    PALLET_SHUTTLE = "PALLET_SHUTTLE()"
    PROGRAM_STOP = "PROGRAM_STOP()"
    OPTIONAL_PROGRAM_STOP = "OPTIONAL_PROGRAM_STOP()"
    PROGRAM_END = "PROGRAM_END()"
    FINISH = "FINISH()"
    LOG_CLOSE = "LOGCLOSE()"


@dataclass(frozen=True, slots=True)
class SignalCall:
    """A call without arguments."""

    signal: Signal
    at: Location


@dataclass(frozen=True, slots=True)
class UseLengthUnits:
    """G20, G21: lengths of the calls that follow."""

    units: Units
    at: Location


@dataclass(frozen=True, slots=True)
class SetG5xOffset:
    """Origin of work coordinate system `index` (1 to 9), now in force."""

    index: int
    offset: Axes
    at: Location


@dataclass(frozen=True, slots=True)
class SetG92Offset:
    """G92, G52: the offset on top of the work coordinate system."""

    offset: Axes
    at: Location


@dataclass(frozen=True, slots=True)
class SetXyRotation:
    """Rotation of the work coordinate system about its Z axis."""

    angle_deg: float
    at: Location


@dataclass(frozen=True, slots=True)
class SetFeedRate:
    """Feed in units/min; in inverse-time mode already multiplied by the length of the move that follows, and
    `inverse_time` is the F word itself (moves per minute).
    """

    rate: float
    at: Location
    inverse_time: float | None = None


@dataclass(frozen=True, slots=True)
class SetFeedMode:
    """G94, G95."""

    mode: CanonFeedMode
    at: Location


@dataclass(frozen=True, slots=True)
class SelectPlane:
    """G17, G18, G19."""

    plane: Plane
    at: Location


@dataclass(frozen=True, slots=True)
class StraightTraverse:
    """G0."""

    target: Axes
    at: Location


@dataclass(frozen=True, slots=True)
class StraightFeed:
    """G1."""

    target: Axes
    at: Location


@dataclass(frozen=True, slots=True)
class ArcFeed:
    """G2, G3: `end` and `centre` are the two coordinates of the plane (XY: X Y; XZ: Z X; YZ: Y Z), `turns` counts
    begun turns, negative clockwise; `axis_end` is the third coordinate at the end.
    """

    end: tuple[float, float]
    centre: tuple[float, float]
    turns: int
    axis_end: float
    abc: tuple[float, float, float]
    at: Location


@dataclass(frozen=True, slots=True)
class NurbsFeed:
    """G5, G5.1, G5.2: a spline in the XY plane from the current point: all control points, weights, knots, degree."""

    control_points: tuple[tuple[float, float], ...]
    weights: tuple[float, ...]
    knots: tuple[float, ...]
    degree: int
    at: Location


@dataclass(frozen=True, slots=True)
class StraightProbe:
    """G38.2 to G38.5. `towards`: contact is looked for, else its loss; `must_succeed`: an error when it is missed."""

    target: Axes
    towards: bool
    must_succeed: bool
    at: Location


@dataclass(frozen=True, slots=True)
class CanonDwell:
    """G4, and dwells of cycles."""

    seconds: float
    at: Location


@dataclass(frozen=True, slots=True)
class SetMotionControlMode:
    """G61, G61.1, G64; `tolerance` in program units, 0 where G64 gave none."""

    mode: MotionMode
    tolerance: float
    at: Location


@dataclass(frozen=True, slots=True)
class SetNaivecamTolerance:
    """G64 Q: how far nearly straight runs of short lines may be simplified, program units."""

    tolerance: float
    at: Location


@dataclass(frozen=True, slots=True)
class SelectTool:
    """T."""

    tool: int
    at: Location


@dataclass(frozen=True, slots=True)
class ChangeTool:
    """M6; `index` is the tool's place in the table, from 1 (0 without a tool)."""

    tool: int
    index: int
    at: Location


@dataclass(frozen=True, slots=True)
class ChangeToolNumber:
    """M61; `index` is the tool's place in the table, from 1 (0 without a tool)."""

    tool: int
    index: int
    at: Location


@dataclass(frozen=True, slots=True)
class UseToolLengthOffset:
    """G43, G43.1, G43.2, G49: X Y Z in program units, A B C in deg."""

    offset: Axes
    at: Location


@dataclass(frozen=True, slots=True)
class SetToolTableEntry:
    """G10 L1: `offset` in machine units; `index` is the tool's place in the table, from 1, or 0 for the spindle."""

    index: int
    tool: int
    offset: Axes
    diameter: float
    front_angle_deg: float
    back_angle_deg: float
    orientation: int
    at: Location


@dataclass(frozen=True, slots=True)
class SetSpindleSpeed:
    """S."""

    speed: float
    at: Location


@dataclass(frozen=True, slots=True)
class SetSpindleMode:
    """G97 (0), G96 (the limit)."""

    limit: float
    at: Location


@dataclass(frozen=True, slots=True)
class SetOutputBit:
    """M62 to M65: `synchronised` with the start of the next motion, else at once."""

    output: int
    on: bool
    synchronised: bool
    at: Location


@dataclass(frozen=True, slots=True)
class SetOutputValue:
    """M67, M68: an analog output."""

    output: int
    value: float
    synchronised: bool
    at: Location


@dataclass(frozen=True, slots=True)
class WaitInput:
    """M66: the interpreter reads on only after the answer is known (not listed by the peer). `mode` is its L: 0 at
    once, 1 a rise, 2 a fall, 3 high, 4 low.
    """

    input: int
    analog: bool
    mode: int
    timeout_s: float
    at: Location


class UserMKind(Enum):
    """Who acts on M100 to M199."""

    HAND = "hand"
    JOINT = "joint"
    EXTERNAL = "external"


@dataclass(frozen=True, slots=True)
class UserMCode:
    """M100 to M199 with its P and Q words (None where missing)."""

    number: int
    kind: UserMKind
    p: float | None
    q: float | None
    at: Location


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment, or the interpreter's own remark about a change of mode."""

    text: str
    at: Location


@dataclass(frozen=True, slots=True)
class OperatorMessage:
    """(MSG, ...) and (DEBUG, ...)."""

    text: str
    at: Location


@dataclass(frozen=True, slots=True)
class PrintText:
    """(PRINT, ...): to the standard output of the program."""

    text: str
    at: Location


class LogAction(Enum):
    """(LOGOPEN, ...), (LOGAPPEND, ...), (LOG, ...)."""

    OPEN = "LOGOPEN"
    APPEND = "LOGAPPEND"
    TEXT = "LOG"


@dataclass(frozen=True, slots=True)
class LogCall:
    """A log file is opened, appended to, or written."""

    action: LogAction
    text: str
    at: Location


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Nothing happened for `blocks` blocks: gives a consumer the chance to stop a program that loops for ever."""

    blocks: int
    at: Location


CanonCall = (
    StraightFeed
    | StraightTraverse
    | ArcFeed
    | NurbsFeed
    | StraightProbe
    | CanonDwell
    | SetFeedRate
    | SetFeedMode
    | SelectPlane
    | UseLengthUnits
    | SetG5xOffset
    | SetG92Offset
    | SetXyRotation
    | SetMotionControlMode
    | SetNaivecamTolerance
    | SelectTool
    | ChangeTool
    | ChangeToolNumber
    | UseToolLengthOffset
    | SetToolTableEntry
    | SetSpindleSpeed
    | SetSpindleMode
    | SetOutputBit
    | SetOutputValue
    | WaitInput
    | UserMCode
    | Comment
    | OperatorMessage
    | PrintText
    | LogCall
    | SignalCall
    | Heartbeat
)

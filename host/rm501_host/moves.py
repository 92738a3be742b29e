"""Moves: what a program asks for once units, offsets and rotation are resolved.

The interpreter speaks in canonical calls, the planner in moves; this module is all that they share. Every
coordinate is in the program frame (the configured rigid transform of the base frame, design: `[frame]`), lengths in
mm, angles in deg, with work offsets, G92 and rotation already applied. A target is always complete: six numbers X Y
Z A B C, where the meaning of A B C follows from `machine.coordinates` (XYZAB: pitch, roll, unused; XYZABC: roll,
pitch, yaw of the tool frame).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

Target = tuple[float, float, float, float, float, float]
"""X, Y, Z in mm and A, B, C in deg, program frame."""

Vector = tuple[float, float, float]
"""Three components in the program frame (mm, or a unit vector where named so)."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where a move comes from: file name, line (from 1) and the text of that block."""

    file: str
    line: int
    block: str = ""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


class FeedMode(Enum):
    """How a feed number is read (RS274 G93, G94)."""

    UNITS_PER_MINUTE = "units_per_minute"
    """mm/min along XYZ; deg/min along ABC where XYZ do not move (RS274/NGC 2.1.2.5)."""
    INVERSE_TIME = "inverse_time"
    """1/min: the move takes 1/F minutes."""


@dataclass(frozen=True, slots=True)
class Feed:
    """A feed number and its meaning; `value` is in mm/min (deg/min) or 1/min."""

    value: float
    mode: FeedMode = FeedMode.UNITS_PER_MINUTE


@dataclass(frozen=True, slots=True)
class RapidMove:
    """G0: to `target`, by default as a line in joint space, as fast as every limit allows."""

    target: Target
    source: Source


@dataclass(frozen=True, slots=True)
class LinearMove:
    """G1: a straight line of the tool centre point to `target`, A B C along with it."""

    target: Target
    feed: Feed
    source: Source


@dataclass(frozen=True, slots=True)
class ArcMove:
    """G2, G3: a circular or helical arc to `target`.

    `centre_mm` lies in the plane of the start point; `axis` is the unit normal about which the tool turns
    counter-clockwise (right-hand rule) when `angle_deg` > 0, clockwise when < 0. `angle_deg` is the whole angle
    swept, full turns included. The rise along the axis and A B C are linear in the angle; a radius that differs
    between start and end within the interpreter's tolerance is blended linearly in the angle.
    """

    target: Target
    centre_mm: Vector
    axis: Vector
    angle_deg: float
    feed: Feed
    source: Source


@dataclass(frozen=True, slots=True)
class SplineMove:
    """G5, G5.1, G5.2/G5.3: a NURBS curve in the program frame that starts at the current point.

    `control_points_mm` (n points), `weights` (n), `knots` (n + degree + 1, non-decreasing); Bezier curves are NURBS
    with unit weights and clamped knots. A B C keep their values.
    """

    target: Target
    control_points_mm: tuple[Vector, ...]
    weights: tuple[float, ...]
    knots: tuple[float, ...]
    degree: int
    feed: Feed
    source: Source


@dataclass(frozen=True, slots=True)
class JointMove:
    """M110, M111: one joint (index 0..4) to an angle, or by an angle when `relative`; the others stand still."""

    joint: int
    angle_deg: float
    relative: bool
    source: Source


@dataclass(frozen=True, slots=True)
class ToolChange:
    """G43, G49 (and tool numbers): the tool length that holds from here on.

    `length_mm` lengthens the last link along the tool, `offset_mm` shifts the tool centre point across it (tool
    frame X, Y).
    """

    length_mm: float
    offset_mm: tuple[float, float]
    source: Source


@dataclass(frozen=True, slots=True)
class Dwell:
    """G4: stand still for `seconds`."""

    seconds: float
    source: Source


@dataclass(frozen=True, slots=True)
class HandMove:
    """M101 (open), M102 (close): at the exact end of the motion before it; the stroke is waited for."""

    open: bool
    source: Source


@dataclass(frozen=True, slots=True)
class OutputChange:
    """M62 to M65: a digital output. `synchronised`: with the start of the next motion; else at once, at rest."""

    output: int
    on: bool
    synchronised: bool
    source: Source


class PathMode(Enum):
    """How corners are passed (RS274 G61, G61.1, G64)."""

    EXACT_PATH = "exact_path"
    EXACT_STOP = "exact_stop"
    BLEND = "blend"


@dataclass(frozen=True, slots=True)
class PathModeChange:
    """G61, G61.1, G64 P Q: `tolerance_mm` and `naive_cam_tolerance_mm` are None where the program gave none."""

    mode: PathMode
    tolerance_mm: float | None
    naive_cam_tolerance_mm: float | None
    source: Source


class PauseKind(Enum):
    """Why a program waits for the operator."""

    PROGRAM = "M0"
    OPTIONAL = "M1"
    EXCHANGE = "M60"


@dataclass(frozen=True, slots=True)
class Pause:
    """M0, M1, M60."""

    kind: PauseKind
    source: Source


@dataclass(frozen=True, slots=True)
class InputWait:
    """M66: wait for an input; the program cannot be read on before its answer is known."""

    input: int
    mode: int
    timeout_s: float
    analog: bool
    source: Source


@dataclass(frozen=True, slots=True)
class ProbeMove:
    """G38.2 to G38.5: a straight line that ends at the probe's contact (or its loss)."""

    target: Target
    feed: Feed
    towards: bool
    error_if_missed: bool
    source: Source


@dataclass(frozen=True, slots=True)
class Message:
    """(MSG,...), (PRINT,...), (DEBUG,...): a text for the operator."""

    text: str
    source: Source


@dataclass(frozen=True, slots=True)
class ProgramEnd:
    """M2, M30."""

    source: Source


Move = (
    RapidMove
    | LinearMove
    | ArcMove
    | SplineMove
    | JointMove
    | ToolChange
    | Dwell
    | HandMove
    | OutputChange
    | PathModeChange
    | Pause
    | InputWait
    | ProbeMove
    | Message
    | ProgramEnd
)

"""The modal state of an interpreter, and how positions are converted.

All lengths are in program units and are converted when G20 or G21 changes the unit; parameters, the tool table and the
variable file are in machine units. A point of the program becomes a point of the machine by

    machine_xy = Rot(rotation) * (program_xy + g92_xy) + g5x_xy + tool_xy,      other axes: p + g92 + g5x + tool

(LinuxCNC 2.9: the rotation turns the G92 offset with the work coordinate system, not the tool's).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from rm501_host.gcode.canon import MotionMode, Plane, Units

AXES = "xyzabc"
LINEAR_AXES = 3

NO_MOTION = 800
"""Motion mode key of G80."""
NO_MOTION_AFTER_NURBS = -10
"""The same after G5.3; the peer shows it as -1 in #<_motion_mode>."""


@dataclass(frozen=True, slots=True)
class SavedModes:
    """What M70 and M73 save; `at_return` marks M73."""

    units: Units
    plane: Plane
    absolute: bool
    arc_absolute: bool
    inverse_time: bool
    feed: float
    speed: float
    g5x_index: int
    g92_active: bool
    tool_offset: tuple[float, ...]
    control_mode: MotionMode
    control_tolerance: float
    naivecam_tolerance: float
    retract_r: bool
    spindle: int
    mist: bool
    flood: bool
    overrides: tuple[bool, bool, bool, bool]
    at_return: bool


@dataclass(slots=True)
class State:
    """Everything that one block hands on to the next."""

    machine_units: Units = Units.MM
    units: Units = Units.MM
    position: list[float] = field(default_factory=lambda: [0.0] * 6)
    g5x_index: int = 1
    g5x: list[float] = field(default_factory=lambda: [0.0] * 6)
    g92: list[float] = field(default_factory=lambda: [0.0] * 6)
    tool_offset: list[float] = field(default_factory=lambda: [0.0] * 6)
    rotation_deg: float = 0.0
    motion: int = NO_MOTION
    plane: Plane = Plane.XY
    absolute: bool = True
    arc_absolute: bool = False
    inverse_time: bool = False
    retract_r: bool = True
    feed: float = 0.0
    speed: float = 0.0
    spindle: int = 0
    """0 off, 1 clockwise, -1 counter-clockwise."""
    mist: bool = False
    flood: bool = False
    feed_override: bool = True
    speed_override: bool = True
    adaptive_feed: bool = False
    feed_hold: bool = True
    control_mode: MotionMode = MotionMode.CONTINUOUS
    control_tolerance: float = 0.0
    naivecam_tolerance: float = 0.0
    selected_tool: int = 0
    current_tool: int = 0
    tool_in_spindle: int = 0
    """The tool whose data the parameters #5400 show."""
    tool_offset_active: bool = False
    tool_unplaced: bool = False
    """A tool length has changed and no move has named X, Y and Z since (see docs/gcode.md, After G43 on an arm)."""
    cycle: CycleWords | None = None
    spline_tangent: tuple[float, float] | None = None
    nurbs: NurbsInProgress | None = None
    rotation: ProgramRotation | None = None

    @property
    def to_program(self) -> float:
        """Program units in one machine unit."""
        return self.machine_units.mm / self.units.mm

    def set_units(self, units: Units) -> None:
        """Convert every stored length."""
        if units is self.units:
            return
        factor = self.units.mm / units.mm
        for axes in (self.position, self.g5x, self.g92, self.tool_offset):
            for i in range(LINEAR_AXES):
                axes[i] *= factor
        self.units = units
        if self.rotation is not None:
            centre = self.rotation.centre
            self.rotation = ProgramRotation((centre[0] * factor, centre[1] * factor), self.rotation.angle_deg)

    def machine_position(self, program: list[float]) -> list[float]:
        """Machine coordinates (program units) of a program point."""
        x, y = rotate(program[0] + self.g92[0], program[1] + self.g92[1], self.rotation_deg)
        out = [x + self.g5x[0] + self.tool_offset[0], y + self.g5x[1] + self.tool_offset[1]]
        out += [program[i] + self.g92[i] + self.g5x[i] + self.tool_offset[i] for i in range(2, 6)]
        return out

    def program_position(self, machine: list[float]) -> list[float]:
        """Program coordinates of a machine point (program units)."""
        x, y = rotate(
            machine[0] - self.g5x[0] - self.tool_offset[0],
            machine[1] - self.g5x[1] - self.tool_offset[1],
            -self.rotation_deg,
        )
        out = [x - self.g92[0], y - self.g92[1]]
        out += [machine[i] - self.g92[i] - self.g5x[i] - self.tool_offset[i] for i in range(2, 6)]
        return out


@dataclass(frozen=True, slots=True)
class ProgramRotation:
    """G68: a rotation of the program's XY coordinates about a centre (program units)."""

    centre: tuple[float, float]
    angle_deg: float

    def forward(self, x: float, y: float) -> tuple[float, float]:
        """From the program's numbers to the coordinates of the canonical calls."""
        dx, dy = rotate(x - self.centre[0], y - self.centre[1], self.angle_deg)
        return self.centre[0] + dx, self.centre[1] + dy

    def back(self, x: float, y: float) -> tuple[float, float]:
        """The other way."""
        dx, dy = rotate(x - self.centre[0], y - self.centre[1], -self.angle_deg)
        return self.centre[0] + dx, self.centre[1] + dy


@dataclass(frozen=True, slots=True)
class CycleWords:
    """What sticks from one canned cycle to the next: R plane and depth as absolute program coordinates, dwell P, peck
    Q, and where the tool stood along the depth axis when the series of cycles began (G98 goes back there).
    """

    r: float
    depth: float
    p: float | None
    q: float | None
    series_start: float


@dataclass(slots=True)
class NurbsInProgress:
    """Control points gathered between G5.2 and G5.3."""

    order: int
    points: list[tuple[float, float]]
    weights: list[float]


def rotate(x: float, y: float, angle_deg: float) -> tuple[float, float]:
    """Turn a point counter-clockwise about the origin."""
    if angle_deg == 0.0:
        return x, y
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return x * c - y * s, x * s + y * c

"""The arm as numbers: DH lengths, tool centre point, joint ranges; built from the configuration and checked.

Standard (distal) Denavit-Hartenberg parameters, angles in deg, joints 1..5:

    link         d    a    alpha  theta
    1 waist      d1   0    +90    q1
    2 shoulder   0    a2     0    q2
    3 elbow      0    a3     0    q3
    4 pitch      0    0    +90    q4
    5 roll       d5   0      0    q5

The tool centre point lies at (tool X, tool Y, tool length) from the end of link 5, in the axes of frame 5; the tool
frame is tilted there about its X, then its Y axis. A tool length of the program (G43) acts along the tilted tool.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rm501_host.config import JOINT_NAMES, Config
from rm501_host.kinematics.errors import GeometryError

LIMIT_TOLERANCE_DEG = 1e-9
"""Rounding of the closed form at a joint limit; a motor step is 0.025 deg."""

Rotation9 = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class ArmGeometry:
    """Lengths in mm, angles in deg; `tool_mm` and `tool_tilt_deg` are relative to the end of link 5.

    Raises GeometryError naming the configuration key when a number describes no arm.
    """

    d1_mm: float
    a2_mm: float
    a3_mm: float
    d5_mm: float
    tool_mm: tuple[float, float, float]
    tool_tilt_deg: tuple[float, float]
    min_deg: tuple[float, float, float, float, float]
    max_deg: tuple[float, float, float, float, float]
    home_deg: tuple[float, float, float, float, float]
    weights: tuple[float, float, float, float, float]
    """Weight of each joint in the distance between two configurations, 1/(deg/s)."""

    def __post_init__(self) -> None:
        lengths = (
            ("geometry.d1_mm", self.d1_mm),
            ("geometry.a2_mm", self.a2_mm),
            ("geometry.a3_mm", self.a3_mm),
            ("geometry.d5_mm", self.d5_mm),
        )
        for key, length_mm in lengths:
            if not math.isfinite(length_mm) or length_mm < 0:
                raise GeometryError(key, f"{length_mm} is no length", "give a length in mm, 0 or more")
        for key, length_mm in lengths[1:3]:
            if length_mm == 0:
                raise GeometryError(key, "a link of length 0 leaves no elbow", "give a length in mm above 0")
        if not all(map(math.isfinite, (*self.tool_mm, *self.tool_tilt_deg))):
            raise GeometryError("tool", f"{self.tool_mm}, {self.tool_tilt_deg} is no tool", "give finite numbers")
        for name, low, high, home, weight in zip(
            JOINT_NAMES, self.min_deg, self.max_deg, self.home_deg, self.weights, strict=True
        ):
            if not low < high or not math.isfinite(high - low):
                raise GeometryError(f"joints.{name}.min_deg", f"{low} is not below max_deg {high}", "swap the limits")
            if not low <= home <= high:
                raise GeometryError(f"joints.{name}.home.home_deg", f"{home} is out of range", "put it inside")
            if not (math.isfinite(weight) and weight > 0):
                raise GeometryError(f"joints.{name}.max_velocity_deg_s", "is no speed", "give a number above 0")

    @classmethod
    def from_config(cls, config: Config) -> ArmGeometry:
        """The geometry of `[geometry]`, `[tool]` and `[joints]`."""
        joints = config.joints.ordered
        waist, shoulder, elbow, pitch, roll = joints
        return cls(
            d1_mm=config.geometry.d1_mm,
            a2_mm=config.geometry.a2_mm,
            a3_mm=config.geometry.a3_mm,
            d5_mm=config.geometry.d5_mm,
            tool_mm=(config.tool.offset_mm[0], config.tool.offset_mm[1], config.tool.length_mm),
            tool_tilt_deg=config.tool.tilt_deg,
            min_deg=(waist.min_deg, shoulder.min_deg, elbow.min_deg, pitch.min_deg, roll.min_deg),
            max_deg=(waist.max_deg, shoulder.max_deg, elbow.max_deg, pitch.max_deg, roll.max_deg),
            home_deg=(
                waist.home.home_deg,
                shoulder.home.home_deg,
                elbow.home.home_deg,
                pitch.home.home_deg,
                roll.home.home_deg,
            ),
            weights=(
                1.0 / waist.max_velocity_deg_s,
                1.0 / shoulder.max_velocity_deg_s,
                1.0 / elbow.max_velocity_deg_s,
                1.0 / pitch.max_velocity_deg_s,
                1.0 / roll.max_velocity_deg_s,
            ),
        )

    def with_tool(self, length_mm: float, offset_mm: tuple[float, float]) -> ArmGeometry:
        """This arm with a further tool of that length along and offset across the (tilted) tool, mm."""
        r = self.tilt
        x, y = offset_mm
        z = length_mm
        tx, ty, tz = self.tool_mm
        return replace(
            self,
            tool_mm=(
                tx + r[0] * x + r[1] * y + r[2] * z,
                ty + r[3] * x + r[4] * y + r[5] * z,
                tz + r[6] * x + r[7] * y + r[8] * z,
            ),
        )

    @property
    def tcp_mm(self) -> tuple[float, float, float]:
        """The tool centre point seen from the wrist centre, axes of frame 5."""
        return (self.tool_mm[0], self.tool_mm[1], self.d5_mm + self.tool_mm[2])

    @property
    def tilt(self) -> Rotation9:
        """Rotation of the tool frame in frame 5, row by row: Rx(tilt x) Ry(tilt y)."""
        ax, ay = (math.radians(angle) for angle in self.tool_tilt_deg)
        cx, sx, cy, sy = math.cos(ax), math.sin(ax), math.cos(ay), math.sin(ay)
        return (cy, 0.0, sy, sx * sy, cx, -sx * cy, -cx * sy, sx, cx * cy)

    @property
    def reach_mm(self) -> float:
        """Farthest distance of the tool centre point from the shoulder axis' centre."""
        return self.a2_mm + self.a3_mm + math.dist(self.tcp_mm, (0.0, 0.0, 0.0))

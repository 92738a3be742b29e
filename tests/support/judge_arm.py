"""The judge's own arm: forward and inverse kinematics from the DH table, nothing of `rm501_host.kinematics`.

With R' = Rz(-q1) R5, q23 = q2 + q3, q234 = q23 + q4 and the tool (tx, ty, tz) in frame 5 (tz with d5):

    r = a2 c2 + a3 c23 + c234 (c5 tx - s5 ty) + s234 tz         v = -(s5 tx + c5 ty)
    z = d1 + a2 s2 + a3 s23 + s234 (c5 tx - s5 ty) - c234 tz    x + i y = exp(i q1) (r + i v)

Angles in deg, lengths in mm. `dh_oracle` multiplies the matrices one by one; a test holds the two together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from math import atan2, degrees, hypot, pi, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JudgeArm:
    """Lengths, joint ranges, and the program frame (`frame` (3, 3), `origin` (3,)); `has_rpy`: XYZABC."""

    d1: float
    a2: float
    a3: float
    tool: tuple[float, float, float]
    low: Array
    high: Array
    frame: Array
    origin: Array
    has_rpy: bool

    @classmethod
    def of(cls, config: Config) -> JudgeArm:
        assert config.tool.tilt_deg == (0.0, 0.0), "the judge knows no tilted tools"
        g = config.geometry
        joints = config.joints.ordered
        return cls(
            g.d1_mm,
            g.a2_mm,
            g.a3_mm,
            (config.tool.offset_mm[0], config.tool.offset_mm[1], g.d5_mm + config.tool.length_mm),
            np.array([j.min_deg for j in joints]),
            np.array([j.max_deg for j in joints]),
            rotation_of_rpy(*config.frame.rpy_deg),
            np.array(config.frame.xyz_mm),
            config.machine.coordinates == "XYZABC",
        )

    def with_tool(self, length_mm: float, offset_mm: tuple[float, float]) -> JudgeArm:
        """This arm with a tool beyond its own."""
        x, y, z = self.tool
        return replace(self, tool=(x + offset_mm[0], y + offset_mm[1], z + length_mm))

    def places(self, q_deg: Array) -> Array:
        """Tool centre points (n, 3), base frame."""
        q = np.radians(q_deg)
        tx, ty, tz = self.tool
        q23 = q[:, 1] + q[:, 2]
        q234 = q23 + q[:, 3]
        along = np.cos(q[:, 4]) * tx - np.sin(q[:, 4]) * ty
        r = self.a2 * np.cos(q[:, 1]) + self.a3 * np.cos(q23) + np.cos(q234) * along + np.sin(q234) * tz
        v = -(np.sin(q[:, 4]) * tx + np.cos(q[:, 4]) * ty)
        z = self.d1 + self.a2 * np.sin(q[:, 1]) + self.a3 * np.sin(q23) + np.sin(q234) * along - np.cos(q234) * tz
        c, s = np.cos(q[:, 0]), np.sin(q[:, 0])
        return np.stack((c * r - s * v, s * r + c * v, z), axis=1)

    def task(self, q_deg: Array) -> Array:
        """x, y, z, pitch, roll (n, 5), base frame."""
        return np.concatenate((self.places(q_deg), q_deg[:, 1:4].sum(axis=1, keepdims=True), q_deg[:, 4:5]), axis=1)

    def rotation(self, q_deg: Array) -> Array:
        """Rotation (3, 3) of the tool in the base frame at one place (5,)."""
        c1, s1 = np.cos(radians(q_deg[0])), np.sin(radians(q_deg[0]))
        tilt = radians(q_deg[1] + q_deg[2] + q_deg[3])
        c, s = np.cos(tilt), np.sin(tilt)
        c5, s5 = np.cos(radians(q_deg[4])), np.sin(radians(q_deg[4]))
        plane = np.array([[c * c5, -c * s5, s], [-s5, -c5, 0.0], [s * c5, -s * s5, -c]])
        turn = np.array([[c1, -s1, 0.0], [s1, c1, 0.0], [0.0, 0.0, 1.0]])
        # written for x forward: the DH chain's second axis points to -y of the plane
        return np.asarray(turn @ plane)

    def program_position(self, q_deg: Array) -> tuple[float, float, float, float, float, float]:
        """X Y Z A B C of the program frame at joints (5,)."""
        x, y, z = (self.places(q_deg[None])[0] - self.origin) @ self.frame
        if not self.has_rpy:
            return (float(x), float(y), float(z), float(q_deg[1:4].sum()), float(q_deg[4]), 0.0)
        a, b, c = rpy_of_rotation(self.frame.T @ self.rotation(q_deg))
        return (float(x), float(y), float(z), a, b, c)

    def base_point(self, xyz: Array) -> Array:
        """Points (3,) or (n, 3) of the program frame in the base frame."""
        return np.asarray(xyz @ self.frame.T + self.origin)

    def goals(self, target: tuple[float, ...]) -> list[Array]:
        """Every way (5,) within the joint ranges to X Y Z A B C of the program frame, turns by 360 deg included."""
        xyz = self.base_point(np.array(target[:3]))
        if not self.has_rpy:
            ways = self.solve(xyz, target[3], target[4])
        else:
            wanted = self.frame @ rotation_of_rpy(*target[3:6])
            ways = []
            for pitch, roll in self._readings(xyz, wanted):
                ways += [q for q in self.solve(xyz, pitch, roll) if angle_between(self.rotation(q), wanted) < 0.02]
        return [q for q in ways if (q >= self.low - 1e-6).all() and (q <= self.high + 1e-6).all()]

    def _readings(self, xyz: Array, wanted: Array) -> list[tuple[float, float]]:
        wrist = xyz - wanted @ np.array(self.tool)
        waist = atan2(wrist[1], wrist[0]) if hypot(*wrist[:2]) > 1e-3 else atan2(wanted[1, 2], wanted[0, 2])
        found = []
        for turn in (waist, waist + pi):
            c, s = np.cos(turn), np.sin(turn)
            pitch = atan2(c * wanted[0, 2] + s * wanted[1, 2], -wanted[2, 2])
            roll = atan2(s * wanted[0, 0] - c * wanted[1, 0], s * wanted[0, 1] - c * wanted[1, 1])
            found += [(degrees(pitch), degrees(roll) + 360.0 * k) for k in (-1, 0, 1)]
        return found

    def solve(self, xyz: Array, pitch_deg: float, roll_deg: float) -> list[Array]:
        """All joint angles (5,) for a place in the base frame, limits aside; waist and wrist as multiples of 360."""
        tx, ty, tz = self.tool
        s5, c5 = np.sin(radians(roll_deg)), np.cos(radians(roll_deg))
        s, c = np.sin(radians(pitch_deg)), np.cos(radians(pitch_deg))
        v = -(s5 * tx + c5 * ty)
        square = float(xyz[0] ** 2 + xyz[1] ** 2 - v * v)
        if square < -1e-9:
            return []
        found = []
        for side, bend in product((1.0, -1.0), (-1.0, 1.0)):
            r = side * sqrt(max(square, 0.0))
            q1 = atan2(xyz[1], xyz[0]) - atan2(v, r)
            wr = r - (c * (c5 * tx - s5 * ty) + s * tz)
            wz = float(xyz[2]) - self.d1 - (s * (c5 * tx - s5 * ty) - c * tz)
            cosine = (wr * wr + wz * wz - self.a2**2 - self.a3**2) / (2.0 * self.a2 * self.a3)
            if abs(cosine) > 1.0 + 1e-12:
                continue
            q3 = bend * np.arccos(np.clip(cosine, -1.0, 1.0))
            q2 = atan2(wz, wr) - atan2(self.a3 * np.sin(q3), self.a2 + self.a3 * np.cos(q3))
            q = np.degrees((q1, q2, q3, 0.0, 0.0))
            q[:2] = (q[:2] + 180.0) % 360.0 - 180.0
            q[3] = pitch_deg - q[1] - q[2]
            q[4] = roll_deg
            for turns in product((-360.0, 0.0, 360.0), repeat=3):
                found.append(q + np.array([turns[0], turns[1], 0.0, turns[2] - turns[1], 0.0]))
        return found


def rotation_of_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), angles in deg."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(np.radians((roll, pitch, yaw))), np.sin(np.radians((roll, pitch, yaw)))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    about_y = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    about_x = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)


def rpy_of_rotation(rotation: Array) -> tuple[float, float, float]:
    """The inverse of `rotation_of_rpy`, deg."""
    return (
        degrees(atan2(rotation[2, 1], rotation[2, 2])),
        degrees(atan2(-rotation[2, 0], hypot(rotation[0, 0], rotation[1, 0]))),
        degrees(atan2(rotation[1, 0], rotation[0, 0])),
    )


def angle_between(one: Array, other: Array) -> float:
    """Angle in deg that turns one rotation into the other."""
    between = one.T @ other
    skew = np.array((between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]))
    return degrees(atan2(0.5 * float(np.linalg.norm(skew)), 0.5 * (float(np.trace(between)) - 1.0)))

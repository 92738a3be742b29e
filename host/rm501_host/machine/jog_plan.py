"""Cartesian jogs: what an axis means from where the arm stands, and the plan of the whole way under every limit.

World: X Y Z of the program frame, and A B C as programs turn the tool. Tool: X Y Z along the tool's own axes. The arm
turns its hand about two axes only, across its plane (pitch) and along the tool (roll); a turn about any other is
refused with the angle that is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.errors import RefusedError
from rm501_host.kinematics import Arm
from rm501_host.kinematics.rotations import matrix_from_rpy
from rm501_host.machine.jog_elements import JOG_SOURCE, Heading, with_speed
from rm501_host.machine.jog_path import JogPath, JogWalker
from rm501_host.planner import Limits, Piece, PieceKind, PlanError
from rm501_host.planner.grid import GridBuilder
from rm501_host.planner.jerk import JerkLaw
from rm501_host.planner.window import Window
from rm501_host.preflight.keep_out import KeepOut

Array = NDArray[np.float64]

WORLD_AXES = ("x", "y", "z", "a", "b", "c")
TOOL_AXES = ("x", "y", "z")
_LINEAR_REACH_MM = 1000.0
"""The workspace's diameter is below this."""
_ANGULAR_REACH_DEG = 360.0
_VERTICAL_SINE = 1e-3
"""A tool within 0.06 deg of vertical keeps its direction in the room where programs give one."""
_LEAST_TOLERANCE_DEG = 0.01
_SHORTEST = 0.05
"""A way shorter than this, mm or deg, is none: two steps of a motor."""


@dataclass(frozen=True, slots=True)
class PlannedJog:
    """The pieces of a jog and what its path says."""

    pieces: tuple[Piece, ...]
    path: JogPath


def plan_cartesian_jog(
    arm: Arm,
    config: Config,
    start_deg: Array,
    frame: str,
    axis: str,
    speed: float,
    distance: float | None,
    tool_mm_s: float,
) -> PlannedJog:
    """The jog from joints (5,) along an axis at |speed| (mm/s, deg/s), the tool at most at `tool_mm_s`.

    As far as it goes without `distance` (mm, deg), exactly so far with it. Raises RefusedError with the reason when it
    does not go that way, or not so far.
    """
    heading = heading_of(arm, start_deg, frame, axis, 1.0 if speed > 0 else -1.0)
    farthest = (_ANGULAR_REACH_DEG if heading.is_turn else _LINEAR_REACH_MM) if distance is None else distance
    path = JogWalker(arm, KeepOut(config)).walk(start_deg, heading, farthest)
    unit = "deg" if heading.is_turn else "mm"
    if path.reach < _SHORTEST and (distance is None or path.reach < distance):
        raise RefusedError(f"cannot jog {frame} {axis} that way from here: {path.reason}")
    if distance is not None and path.reach < distance - 1e-5:
        raise RefusedError(
            f"cannot jog {frame} {axis} by {distance:g} {unit}, only {path.reach:.3f} {unit} are left that way "
            f"({path.reason}); choose a shorter step"
        )
    elements = with_speed(path.elements, heading, abs(speed), tool_mm_s)
    limits = Limits.from_config(config)
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    window = Window(arm, GridBuilder(arm, limits, check_limits=False), frame_s)
    try:
        window.extend(elements)
        stretch = window.finish()
    except PlanError as error:
        raise RefusedError(f"cannot jog {frame} {axis} that way from here: {error}") from error
    assert stretch is not None
    law = JerkLaw.over(stretch.law, stretch.lines, limits, frame_s) if config.planner.jerk_limited else stretch.law
    rest = tuple(law.q_deg(np.array([law.duration_s]))[0].tolist())
    piece = Piece(PieceKind.MOTION, JOG_SOURCE, 0.0, law.duration_s, rest, law=law, motion_s=law.duration_s, arm=arm)
    return PlannedJog((piece,), path)


def heading_of(arm: Arm, start_deg: Array, frame: str, axis: str, sign: float) -> Heading:
    """Where an axis leads from joints (5,); raises RefusedError for a turn that the arm cannot make."""
    direction = np.zeros(5)
    index = WORLD_AXES.index(axis)
    if frame == "world" and index >= 3:
        direction[3:] = sign * _turn(arm, start_deg, axis)
        return Heading(direction)
    if frame == "tool":
        direction[:3] = sign * arm.fk(start_deg).rotation[:, index]
    else:
        direction[:3] = sign * arm.frame.rotation[:, index]
    return Heading(direction, _waist_share(arm, start_deg))


def _waist_share(arm: Arm, start_deg: Array) -> float:
    """How the roll follows the waist: with orientations in the room and a vertical tool only."""
    pitch_rad = np.radians(arm.fk(start_deg).pitch_deg)
    if not arm.frame.has_rpy or abs(np.sin(pitch_rad)) > _VERTICAL_SINE:
        return 0.0
    return 1.0 if np.cos(pitch_rad) > 0 else -1.0


def _turn(arm: Arm, start_deg: Array, axis: str) -> Array:
    """Pitch and roll (2,), deg per deg of a turn about A, B or C."""
    if not arm.frame.has_rpy:
        if axis == "c":
            raise RefusedError("there is no axis C in XYZAB: A is the pitch, B the roll; use joint waist")
        return np.array((1.0, 0.0) if axis == "a" else (0.0, 1.0))
    pitch, yaw = arm.program_from_joints(start_deg)[4:]
    before = {"a": matrix_from_rpy((0.0, pitch, yaw)), "b": matrix_from_rpy((0.0, 0.0, yaw)), "c": np.eye(3)}[axis]
    wanted = arm.frame.rotation @ before[:, "abc".index(axis)]
    turning: np.ndarray[Any, np.dtype[np.float64]] = arm.jacobian(start_deg)[3:, 3:]
    shares = turning.T @ wanted
    best = int(np.argmax(np.abs(shares)))
    missing_deg = float(np.degrees(np.arccos(min(1.0, abs(float(shares[best]))))))
    if missing_deg > max(arm.frame.tolerance_deg, _LEAST_TOLERANCE_DEG):
        raise RefusedError(
            f"cannot turn about {axis.upper()} from here: the arm turns its hand about its pitch axis and the tool's "
            f"own axis, the nearer of them is {missing_deg:.2f} deg away; jog joint pitch or roll"
        )
    result = np.zeros(2)
    result[best] = np.sign(shares[best])
    return result

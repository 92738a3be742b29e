"""Orientations given as roll, pitch, yaw along a path (XYZABC): pitch and roll of the arm that follow from them.

The tool turns from its orientation at the start to that at the end about one fixed axis, by an angle proportional to
the way (angle-axis, thesis 4.2). At each place the arm's plane is given by the waist, so the arm's pitch and roll are
functions of place and orientation; what the arm cannot take is refused with the residual angle. Their derivatives
come from five-point central differences: the functions are smooth on a scale of the arm's reach, and at a step of
0.1 mm truncation and rounding both stay below 1e-9 of their values. A spline has nothing beyond its ends: there the
same five points lie inside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm, Branch
from rm501_host.kinematics.program_frame import read_wrist_rows
from rm501_host.kinematics.rotations import matrix_from_rpy
from rm501_host.moves import Source

from .elements import Array, Element, ElementTable, Indices
from .errors import OrientationError
from .splines import SplineCurve

STEP = 0.1
"""Of the central differences, in mm."""
_OFFSETS = (-2.0, -1.0, 0.0, 1.0, 2.0)
FEWEST_KNOTS, MOST_KNOTS = 5, 129
KNOT_SPACING_MM = 0.25
KNOT_SPACING_RAD = 0.025
WELL_WITHIN = 0.5
"""Residuals above this share of the tolerance are looked at in as many places as there are."""


class OrientedCurve:
    """A path of the tool centre point with a tool orientation that turns about one axis.

    `places`: gives x, y, z; `first_rpy_deg`, `last_rpy_deg`: program frame; `start_task` (5,): where it starts.
    """

    def __init__(
        self,
        arm: Arm,
        branch: Branch,
        places: Element,
        first_rpy_deg: tuple[float, float, float],
        last_rpy_deg: tuple[float, float, float],
        start_task: Array,
        waist_deg: float,
    ) -> None:
        self._arm = arm
        self._branch = branch
        self._places = places
        # a spline ends where it ends; lines and arcs go on beyond
        self._ends_count = isinstance(places.curve, SplineCurve)
        self._waist_deg = waist_deg
        self._places_alone = ElementTable([places])
        first = arm.frame.rotation @ matrix_from_rpy(first_rpy_deg)
        last = arm.frame.rotation @ matrix_from_rpy(last_rpy_deg)
        vector = rotation_vector(first.T @ last)
        self._angle_rad = float(np.linalg.norm(vector))
        # frame 5 turns as R5 = still + sin(angle) sine + (1 - cos(angle)) cosine (Rodrigues)
        cross = _cross(vector / self._angle_rad) if self._angle_rad else np.zeros((3, 3))
        self._tilt = np.array(arm.geometry.tilt).reshape(3, 3)
        still, sine, cosine = (first @ part @ self._tilt.T for part in (np.eye(3), cross, cross @ cross))
        self._still, self._sine, self._cosine = still[:, :, None], sine[:, :, None], cosine[:, :, None]
        count = int(knot_counts(np.array(places.length), np.array(self._angle_rad)))
        self._look(count, start_task)
        if self.residual_deg > WELL_WITHIN * arm.frame.tolerance_deg and count < MOST_KNOTS:
            self._look(MOST_KNOTS, start_task)

    def _look(self, count: int, start_task: Array) -> None:
        self._knots = np.linspace(0.0, self._places.length, count)
        pitch, roll, residual = self._angles(self._knots)
        self.residual_deg = float(np.nanmax(residual)) if len(residual) else 0.0
        self.residual_place = float(self._knots[int(np.nanargmax(residual))])
        self._pitch_knots = start_task[3] + _unwrapped(pitch, float(start_task[3]))
        self._roll_knots = start_task[4] + _unwrapped(roll, float(start_task[4]))

    @property
    def end_angles_deg(self) -> tuple[float, float]:
        """Pitch and roll at the end, without jumps from the start."""
        return float(self._pitch_knots[-1]), float(self._roll_knots[-1])

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives, each (n, 5)."""
        values, slopes, bends = self._places.evaluate(s)
        stencil = Stencil.around(s, np.array(self._places.length), np.array(self._ends_count, dtype=np.bool_))
        angles = np.array([np.stack(self._continuous(at), axis=1) for at in stencil.places])
        values[:, 3:], slopes[:, 3:], bends[:, 3:] = stencil.derivatives(angles)
        return values, slopes, bends

    def _continuous(self, s: Array) -> tuple[Array, Array]:
        _, _, pitch, roll = self._read(s)
        near_pitch = np.interp(s, self._knots, self._pitch_knots)
        near_roll = np.interp(s, self._knots, self._roll_knots)
        return (
            pitch - 360.0 * np.rint((pitch - near_pitch) / 360.0),
            roll - 360.0 * np.rint((roll - near_roll) / 360.0),
        )

    def _evaluate_places(self, s: Array) -> tuple[Array, Array, Array]:
        return self._places_alone.evaluate(np.zeros(len(s), dtype=np.intp), s)

    def _read(self, s: Array) -> tuple[Array, Array, Array, Array]:
        """The orientation wanted, of frame 5, and the waist, pitch and roll that come nearest to it."""
        xyz = self._evaluate_places(s)[0][:, :3]
        turned = s / self._places.length * self._angle_rad
        r5 = (self._still + np.sin(turned) * self._sine + (1.0 - np.cos(turned)) * self._cosine).transpose(2, 0, 1)
        waist, pitch, roll = read_wrist_rows(self._arm.geometry, xyz, r5, self._branch.is_front, self._waist_deg)
        return r5, waist, pitch, roll

    def _angles(self, s: Array) -> tuple[Array, Array, Array]:
        r5, waist, pitch, roll = self._read(s)
        got = self._arm.fk_batch(np.stack((waist, np.zeros_like(waist), np.zeros_like(waist), pitch, roll), axis=1))[1]
        cosine = 0.5 * (np.einsum("nij,nij->n", r5 @ self._tilt, got) - 1.0)
        return pitch, roll, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Stencil:
    """Five places a step apart around each s (n,): `places` (5, n); s lies `offset` (n,) steps of `step` (n,) from the
    middle one.
    """

    places: Array
    step: Array
    offset: Array

    @classmethod
    def around(cls, s: Array, length: Array, ends_count: NDArray[np.bool_]) -> Stencil:
        """Around s (n,) on paths of `length` mm; where `ends_count`, within the path."""
        if not ends_count.any():
            step, offset = np.full(len(s), STEP), np.zeros(len(s))
            return cls(np.array([s + k * STEP for k in _OFFSETS]), step, offset)
        step = np.where(ends_count, np.minimum(STEP, 0.25 * length), STEP) * np.ones_like(s)
        centre = np.where(ends_count, np.clip(s, 2.0 * step, np.maximum(length - 2.0 * step, 2.0 * step)), s)
        return cls(np.array([centre + k * step for k in _OFFSETS]), step, (s - centre) / step)

    def derivatives(self, f: Array) -> tuple[Array, Array, Array]:
        """Value, first and second derivative (n, m) at s of the quartic through the values f (5, n, m)."""
        h = self.step[:, None]
        first = (f[0] - 8.0 * f[1] + 8.0 * f[3] - f[4]) / (12.0 * h)
        second = (-f[0] + 16.0 * f[1] - 30.0 * f[2] + 16.0 * f[3] - f[4]) / (12.0 * h * h)
        if not self.offset.any():
            return f[2], first, second
        t = self.offset[:, None]
        third = (-f[0] + 2.0 * f[1] - 2.0 * f[3] + f[4]) / 2.0
        fourth = f[0] - 4.0 * f[1] + 6.0 * f[2] - 4.0 * f[3] + f[4]
        d, dd = first * h, second * h * h
        return (
            f[2] + t * (d + t * (dd / 2.0 + t * (third / 6.0 + t * fourth / 24.0))),
            (d + t * (dd + t * (third / 2.0 + t * fourth / 6.0))) / h,
            (dd + t * (third + t * fourth / 2.0)) / (h * h),
        )


def knot_counts(length_mm: Array, angle_rad: Array) -> Indices:
    """At how many places (n,) along paths (n,) of such lengths, with tools that turn by such angles, the residual is
    looked at; between them neither pitch nor roll turns by half a turn.
    """
    wanted = np.ceil(np.maximum(length_mm / KNOT_SPACING_MM, angle_rad / KNOT_SPACING_RAD)) + 1.0
    counts: Indices = np.clip(wanted, FEWEST_KNOTS, MOST_KNOTS).astype(np.intp)
    return counts


def check_residual(curve: OrientedCurve, tolerance_deg: float, source: Source) -> None:
    """Raise OrientationError where five joints cannot take the orientation somewhere on the way."""
    # below 1e-6 deg the arc cosine's rounding decides
    if curve.residual_deg > max(tolerance_deg, 2e-6):
        raise OrientationError(
            f"on the way the tool would have to point {curve.residual_deg:.4g} deg away from what five joints reach",
            source=source,
            place_mm=curve.residual_place,
            amount=curve.residual_deg,
            remedy="turn the approach into the vertical plane through the waist axis, or use a joint move (G0)",
        )


def _unwrapped(angles_deg: Array, near_deg: float) -> Array:
    turned: Array = np.unwrap(np.concatenate(((near_deg,), angles_deg)), period=360.0)[1:] - near_deg
    return turned


def rotation_vector(rotation: Array) -> Array:
    """Axis times angle in rad of a rotation (3, 3)."""
    skew = 0.5 * np.array(
        (rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1])
    )
    sine, cosine = float(np.linalg.norm(skew)), 0.5 * (float(np.trace(rotation)) - 1.0)
    angle = float(np.arctan2(sine, cosine))
    if sine > 1e-9:
        return skew * (angle / sine)
    if cosine > 0.0:
        return np.zeros(3)
    # half a turn: the axis is the eigenvector of R + 1
    column = int(np.argmax(np.diag(rotation)))
    axis: Array = (rotation + np.eye(3))[:, column]
    return axis / np.linalg.norm(axis) * np.pi


def _cross(axis: Array) -> Array:
    """The matrix (3, 3) of the cross product with a vector."""
    x, y, z = axis
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))

"""Orientations given as roll, pitch, yaw along many moves at once: `planner.orientation.OrientedCurve` in arrays.

The tool turns about one fixed axis v by an angle t in proportion to the way, R = R0 (1 + sin t K + (1 - cos t) K^2)
with K = [v x]; R0, R0 K and R0 K^2 are kept for every move. The arm's pitch and roll follow from place and R, their
derivatives from the same central differences. Pitch and roll run on from move to move without jumps, so one
`np.unwrap` over the places looked at serves a whole run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm, Branch
from rm501_host.kinematics.program_frame import read_wrist_rows
from rm501_host.kinematics.rotations import angles_between_deg, matrices_from_rpy
from rm501_host.planner.elements import Array, Indices
from rm501_host.planner.orientation import WELL_WITHIN, Stencil, knot_counts

Flags = NDArray[np.bool_]
Places = Callable[[Indices, Array], Array]
"""x, y, z (n, 3) in mm of moves (n,) at s (n,), by their number in the run."""

_CLEAR_MM = 1.0
"""Wrist centres nearer to the waist axis than this: one move at a time."""
_HALF_TURN_COSINE = -0.999
"""Turns next to half a turn need the axis with more care: one move at a time."""
_SMALLEST_SINE = 1e-9
_EXACT_SINE = 1e-6
"""An approach this near to the arm's plane is in it: the residual is 6e-5 deg at most."""
_SURE_TOLERANCE_DEG = 2e-4


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """How the tools of n moves turn.

    `bases` (n, 3, 3, 3): R0, R0 K, R0 K^2 of frame 5; `angle` (n,) rad; `length` (n,) mm; `ends_count` (n,): nothing is
    beyond its ends (splines); `waist_deg` (n,): what a wrist centre on the waist axis would leave it at. `first`,
    `count` (n,): each move's knots among `pitch_deg`, `roll_deg`.
    """

    arm: Arm
    branch: Branch
    bases: Array
    angle: Array
    length: Array
    ends_count: Flags
    waist_deg: Array
    first: Indices
    count: Indices
    pitch_deg: Array
    roll_deg: Array

    @property
    def end_angles_deg(self) -> Array:
        """Pitch and roll (n, 2) at the ends."""
        last = self.first + self.count - 1
        return np.stack((self.pitch_deg[last], self.roll_deg[last]), axis=1)

    def cut(self, count: int) -> Turning:
        """The first moves of it."""
        return Turning(
            self.arm,
            self.branch,
            self.bases[:count],
            self.angle[:count],
            self.length[:count],
            self.ends_count[:count],
            self.waist_deg[:count],
            self.first[:count],
            self.count[:count],
            self.pitch_deg,
            self.roll_deg,
        )

    def angles(self, places: Places, number: Indices, s: Array) -> tuple[Array, Array, Array]:
        """Pitch and roll, and their first and second derivatives, (n, 2) each, of moves `number` (n,) at s (n,)."""
        stencil = Stencil.around(s, self.length[number], self.ends_count[number])
        many = len(stencil.places)
        numbers, at = np.tile(number, many), stencil.places.ravel()
        _, pitch, roll = _read(
            self.arm, self.branch, places(numbers, at), self._rotations(numbers, at), self.waist_deg[numbers]
        )
        near_pitch, near_roll = self._near(numbers, at)
        pitch -= 360.0 * np.rint((pitch - near_pitch) / 360.0)
        roll -= 360.0 * np.rint((roll - near_roll) / 360.0)
        return stencil.derivatives(np.stack((pitch, roll), axis=1).reshape(many, len(s), 2))

    def _near(self, number: Indices, s: Array) -> tuple[Array, Array]:
        """Pitch and roll (n,) between the knots."""
        steps = self.count[number] - 1
        place = np.clip(s / self.length[number], 0.0, 1.0) * steps
        before = np.minimum(place.astype(np.intp), steps - 1)
        share, k = place - before, self.first[number] + before
        return (
            self.pitch_deg[k] + share * (self.pitch_deg[k + 1] - self.pitch_deg[k]),
            self.roll_deg[k] + share * (self.roll_deg[k + 1] - self.roll_deg[k]),
        )

    def _rotations(self, number: Indices, s: Array) -> Array:
        return rotations_along(self.bases, self.angle, self.length, number, s)


def rotations_along(bases: Array, angle: Array, length: Array, number: Indices, s: Array) -> Array:
    """Orientations (n, 3, 3) of frame 5 of moves `number` (n,) at s (n,)."""
    if not angle.any():
        still: Array = bases[number, 0]
        return still
    turned = angle[number] * (s / length[number])
    sine, versine = np.sin(turned)[:, None, None], (1.0 - np.cos(turned))[:, None, None]
    base = bases[number]
    result: Array = base[:, 0] + sine * base[:, 1] + versine * base[:, 2]
    return result


def follow_turning(
    arm: Arm,
    branch: Branch,
    places: Places,
    length: Array,
    ends_count: Flags,
    rpy_deg: Array,
    start_task: Array,
    start_deg: Array,
) -> tuple[Turning, Flags]:
    """How the tool turns along n moves of `length` (n,) mm, and which of them are plain (n,).

    `ends_count` (n,): splines. `rpy_deg` (n + 1, 3): before the first move and at the end of each; `start_task`,
    `start_deg` (5,): task values and joints before the first. Those that are not plain (residuals, half turns, next to
    the waist axis) want the general way.
    """
    n = len(length)
    tilt = np.array(arm.geometry.tilt).reshape(3, 3).T
    wanted = arm.frame.rotation @ matrices_from_rpy(rpy_deg)
    vector, angle, plain = _turns(wanted)
    bases = np.empty((n, 3, 3, 3))
    bases[:, 0] = wanted[:-1]
    cross = np.zeros((n, 3, 3))
    x, y, z = vector.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    bases[:, 1] = wanted[:-1] @ cross
    bases[:, 2] = bases[:, 1] @ cross
    bases = bases @ tilt
    count = knot_counts(length, angle)
    first = np.cumsum(count) - count
    number = np.repeat(np.arange(n), count)
    s = length[number] * (np.arange(len(number)) - first[number]) / (count[number] - 1)
    r5 = rotations_along(bases, angle, length, number, s)
    xyz = places(number, s)
    waist_deg = np.full(n, float(start_deg[0]))
    waist, pitch, roll = _read(arm, branch, xyz, r5, waist_deg[number])
    wrist = xyz - r5 @ np.array(arm.geometry.tcp_mm)
    bad = np.hypot(wrist[:, 0], wrist[:, 1]) < _CLEAR_MM
    bad |= _too_far(arm, r5, waist, pitch, roll)
    plain[number[bad]] = False
    pitch = np.unwrap(np.concatenate((start_task[3:4], pitch)), period=360.0)[1:]
    roll = np.unwrap(np.concatenate((start_task[4:5], roll)), period=360.0)[1:]
    return Turning(arm, branch, bases, angle, length, ends_count, waist_deg, first, count, pitch, roll), plain


def _read(arm: Arm, branch: Branch, xyz: Array, r5: Array, waist_deg: Array) -> tuple[Array, Array, Array]:
    return read_wrist_rows(arm.geometry, xyz, r5, branch.is_front, waist_deg)


def _turns(wanted: Array) -> tuple[Array, Array, Flags]:
    """Axis (n, 3) and angle (n,) in rad from each orientation (n + 1, 3, 3) to the next, and whether that is sure."""
    relative = np.swapaxes(wanted[:-1], 1, 2) @ wanted[1:]
    skew = 0.5 * np.stack(
        (
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        ),
        axis=1,
    )
    sine = np.sqrt((skew * skew).sum(axis=1))
    cosine = 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0)
    turns = sine > _SMALLEST_SINE
    angle = np.where(turns, np.arctan2(sine, cosine), 0.0)
    axis = skew / np.where(turns, sine, 1.0)[:, None]
    return axis, angle, cosine > _HALF_TURN_COSINE


def _too_far(arm: Arm, r5: Array, waist_deg: Array, pitch_deg: Array, roll_deg: Array) -> Flags:
    """Where (n,) what five joints reach is not well within the tolerance of the orientation."""
    waist = np.radians(waist_deg)
    out: Flags = np.abs(r5[:, 0, 2] * np.sin(waist) - r5[:, 1, 2] * np.cos(waist)) > _EXACT_SINE
    tolerance = arm.frame.tolerance_deg
    look = np.flatnonzero(out) if tolerance >= _SURE_TOLERANCE_DEG else np.arange(len(out))
    if len(look):
        still = np.zeros(len(look))
        q_deg = np.stack((waist_deg[look], still, still, pitch_deg[look], roll_deg[look]), axis=1)
        tilt = np.array(arm.geometry.tilt).reshape(3, 3)
        residual = angles_between_deg(r5[look] @ tilt, arm.fk_batch(q_deg)[1])
        out[look] = residual > WELL_WITHIN * tolerance
    return out

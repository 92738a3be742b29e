"""Moves as arrays: many consecutive lines, arcs and splines followed at once.

Long programs are mostly short moves, and an `Element` for each costs a hundred times the arithmetic that checks it.
Here a run of moves in task space becomes a few arrays, as long as nothing about them is special; the first move that
is (it does not move the tool, cannot be reached, turns whole turns, has no feed, comes close to the waist axis with an
orientation given as roll, pitch, yaw) ends the run and goes the general way.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Branch
from rm501_host.moves import ArcMove, FeedMode, LinearMove, RapidMove, Source, SplineMove
from rm501_host.planner.elements import Array, Indices
from rm501_host.planner.path import MOST_TURN_DEG_MM, SHORTEST, PathBuilder
from rm501_host.planner.splines import SplineCurve

from .turning import Turning, follow_turning

TaskMove = LinearMove | ArcMove | SplineMove | RapidMove
"""What may stand in a run; rapids only where they are lines."""

Flags = NDArray[np.bool_]

_WAIST_MM = 1e-6
"""Tips nearer to the waist axis leave the waist angle to the joints before: one at a time."""
_WAIST_RPY_MM = 1.0
_SAME_PITCH_DEG = 1e-9
_SMALLEST_RADIUS_MM = 1e-3
_LONGEST_MM = 1e6
"""Numbers beyond this are no path of an arm: whatever is wrong with them, the general way says so."""
_SAME_RADIUS = 1e-12
_SAME_POINT_MM = 1e-9
_NO_FEED = float("inf")


@dataclass(frozen=True, slots=True, eq=False)
class MoveRun:
    """Consecutive moves in task space, on one branch.

    `end` (n, 5): x, y, z in mm of the base frame, pitch, roll in deg; `start_deg` (n, 5): joints at the starts;
    `sources`: n blocks; `numbers` (n,): which move of the program each is. `length` (n,), `feed_mm_s` (n,), `rate` (n,)
    and `geometry` as of an `Element`; `splines`: curves of moves by their place in the run; `turning`: where
    orientations are given as roll, pitch, yaw.
    """

    end: Array
    length: Array
    feed_mm_s: Array
    rate: Array
    geometry: Geometry
    splines: dict[int, SplineCurve]
    turning: Turning | None
    start_deg: Array
    branch: Branch
    sources: tuple[Source, ...]
    numbers: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sources)


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Lines and arcs of n moves: `constant`, `slope` (n, 5), `cosine`, `sine` (n, 3), `omega`, `growth` (n,), as an
    `Element` has them.
    """

    constant: Array
    slope: Array
    cosine: Array
    sine: Array
    omega: Array
    growth: Array

    @classmethod
    def blank(cls, count: int) -> Geometry:
        """All zero."""
        zeros = np.zeros
        return cls(
            zeros((count, 5)), zeros((count, 5)), zeros((count, 3)), zeros((count, 3)), zeros(count), zeros(count)
        )

    def put(self, first: int, count: int, other: Geometry) -> None:
        """Take over the first `count` of another, from `first` on."""
        rows = slice(first, first + count)
        self.constant[rows], self.slope[rows] = other.constant[:count], other.slope[:count]
        self.cosine[rows], self.sine[rows] = other.cosine[:count], other.sine[:count]
        self.omega[rows], self.growth[rows] = other.omega[:count], other.growth[:count]

    def evaluate(self, number: Indices, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives of moves `number` (n,) at s (n,), (n, 5) each."""
        t = s[:, None]
        slopes = self.slope[number]
        values = self.constant[number] + t * slopes
        bends = np.zeros_like(values)
        omega = self.omega[number]
        if omega.any():
            w, g = omega[:, None], self.growth[number][:, None]
            circle, across = self._circle(number, omega * s)
            size = 1.0 + g * t
            values[:, :3] += size * circle
            slopes[:, :3] += size * w * across + g * circle
            bends[:, :3] += -size * w * w * circle + 2.0 * g * w * across
        return values, slopes, bends

    def places(self, number: Indices, s: Array) -> Array:
        """x, y, z (n, 3) of moves `number` (n,) at s (n,)."""
        t = s[:, None]
        values: Array = self.constant[number, :3] + t * self.slope[number, :3]
        omega = self.omega[number]
        if omega.any():
            values += (1.0 + self.growth[number][:, None] * t) * self._circle(number, omega * s)[0]
        return values

    def _circle(self, number: Indices, angle_rad: Array) -> tuple[Array, Array]:
        angle_cos, angle_sin = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
        e, f = self.cosine[number], self.sine[number]
        return e * angle_cos + f * angle_sin, f * angle_cos - e * angle_sin


def follow_moves(path: PathBuilder, moves: Sequence[TaskMove], first_number: int) -> MoveRun:
    """The run of the first moves that need no special care (perhaps none); `path` then stands at its end."""
    with np.errstate(all="ignore"):
        return _follow(path, moves, first_number)


def _follow(path: PathBuilder, moves: Sequence[TaskMove], first_number: int) -> MoveRun:
    arm = path.arm
    targets = np.array([move.target for move in moves], dtype=np.float64)
    plain: Flags = np.asarray(np.abs(targets).max(axis=1) < _LONGEST_MM, dtype=np.bool_)
    count = _leading(plain)
    moves, targets = moves[:count], targets[:count]
    end = np.empty((count, 5))
    end[:, :3] = arm.frame.base_from_program(targets[:, :3])
    end[:, 3:] = targets[:, 3:5]
    start = np.concatenate((path.task[None], end))[:-1]
    geometry, length, splines, plain = _shapes(path, moves, start, end)
    turning: Turning | None = None
    if arm.frame.has_rpy:
        count = _leading(plain)
        rpy_deg = np.concatenate((np.array(path.rpy_deg)[None], targets[:count, 3:]))
        places = _Places(geometry, splines)
        ends_count = np.array([isinstance(move, SplineMove) for move in moves[:count]], dtype=np.bool_)
        turning, even = follow_turning(
            arm, path.branch, places, length[:count], ends_count, rpy_deg, path.task, path.q_deg
        )
        end[:count, 3:] = turning.end_angles_deg
        plain[:count] &= even
    turn = np.linalg.norm(np.diff(end[:, 3:], axis=0, prepend=path.task[None, 3:]), axis=1)
    plain &= turn <= 0.5 * MOST_TURN_DEG_MM * length
    q_deg, ok = arm.ik_batch(end[:, :3], end[:, 3], end[:, 4], path.branch)
    ok &= plain
    radius_mm = np.hypot(end[:, 0], end[:, 1])
    if turning is None:
        ok &= np.abs(q_deg[:, 1] + q_deg[:, 2] + q_deg[:, 3] - end[:, 3]) < _SAME_PITCH_DEG
        ok &= radius_mm > _WAIST_MM
    else:
        ok &= radius_mm > _WAIST_RPY_MM
    feed_mm_s, rate = _feeds(moves, length)
    ok &= (feed_mm_s > 0.0) & (rate > 0.0)
    count = _leading(ok)
    start_deg = np.concatenate((path.q_deg[None], q_deg[:count]))[:-1]
    if count:
        rpy = targets[count - 1, 3:].tolist()
        path.go_on(q_deg[count - 1].copy(), end[count - 1].copy(), tuple(rpy) if arm.frame.has_rpy else None)
    return MoveRun(
        end[:count],
        length[:count],
        feed_mm_s[:count],
        rate[:count],
        geometry,
        {row: curve for row, curve in splines.items() if row < count},
        None if turning is None else turning.cut(count),
        start_deg,
        path.branch,
        tuple(move.source for move in moves[:count]),
        np.arange(first_number, first_number + count, dtype=np.int64),
    )


class _Places:
    """x, y, z along the moves of a run."""

    def __init__(self, geometry: Geometry, splines: dict[int, SplineCurve]) -> None:
        self._geometry = geometry
        self._splines = splines

    def __call__(self, number: Indices, s: Array) -> Array:
        values = self._geometry.places(number, s)
        for row, chosen in rows_of(number, self._splines):
            values[chosen] = self._splines[row].evaluate(s[chosen])[0][:, :3]
        return values


def rows_of(number: Indices, wanted: Collection[int]) -> Iterator[tuple[int, Indices]]:
    """Where (m,) each of the `wanted` moves stands among `number` (n,), those that do."""
    if not wanted:
        return
    order = np.argsort(number, kind="stable").astype(np.intp)
    rows = np.array(sorted(wanted), dtype=np.intp)
    ranked = number[order]
    firsts, lasts = np.searchsorted(ranked, rows, side="left"), np.searchsorted(ranked, rows, side="right")
    for row, first, last in zip(rows.tolist(), firsts.tolist(), lasts.tolist(), strict=True):
        if last > first:
            yield row, order[first:last]


def _shapes(
    path: PathBuilder, moves: Sequence[TaskMove], start: Array, end: Array
) -> tuple[Geometry, Array, dict[int, SplineCurve], Flags]:
    """Geometry and length (n,) of moves, splines among them, and which of them move in an ordinary way (n,)."""
    geometry = Geometry.blank(len(moves))
    shift = end - start
    length = np.linalg.norm(shift[:, :3], axis=1)
    plain: Flags = np.asarray(length > SHORTEST, dtype=np.bool_)
    geometry.constant[:] = start
    geometry.slope[:] = shift / length[:, None]
    arcs = [row for row, move in enumerate(moves) if isinstance(move, ArcMove)]
    if arcs:
        rows = np.array(arcs, dtype=np.intp)
        length[rows], plain[rows] = _put_arcs(path, [moves[row] for row in arcs], rows, start, end, geometry)
    splines: dict[int, SplineCurve] = {}
    for row, move in enumerate(moves):
        if isinstance(move, SplineMove):
            curve = _spline(path, move, start[row], end[row])
            plain[row] = curve is not None
            if curve is None:
                break
            splines[row] = curve
            length[row], geometry.slope[row] = curve.length_mm, 0.0
    return geometry, length, splines, plain


def _put_arcs(
    path: PathBuilder, moves: Sequence[TaskMove], rows: Indices, start: Array, end: Array, geometry: Geometry
) -> tuple[Array, Flags]:
    """Put arcs at their `rows` (n,); their lengths (n,), and which are ordinary (n,). As `planner.elements.arc`."""
    numbers = np.array([(*m.centre_mm, *m.axis, m.angle_deg) for m in moves if isinstance(m, ArcMove)])
    plain = np.abs(numbers).max(axis=1) < _LONGEST_MM
    frame = path.arm.frame
    centre, axis = frame.base_from_program(numbers[:, :3]), numbers[:, 3:6] @ frame.rotation.T
    angle_rad = np.radians(numbers[:, 6])
    first, last = start[rows], end[rows]
    offset, end_offset = first[:, :3] - centre, last[:, :3] - centre
    height = (offset * axis).sum(axis=1)
    radial = offset - height[:, None] * axis
    rise = (end_offset * axis).sum(axis=1) - height
    radius = np.linalg.norm(radial, axis=1)
    end_radius = np.linalg.norm(end_offset - (rise + height)[:, None] * axis, axis=1)
    length = np.hypot(0.5 * (radius + end_radius) * angle_rad, rise)
    geometry.constant[rows, :3] = centre + height[:, None] * axis
    geometry.slope[rows, :3] = axis * (rise / length)[:, None]
    geometry.slope[rows, 3:] = (last[:, 3:] - first[:, 3:]) / length[:, None]
    geometry.cosine[rows] = radial
    geometry.sine[rows] = np.cross(axis, radial)
    geometry.omega[rows] = angle_rad / length
    growth = (end_radius - radius) / (radius * length)
    geometry.growth[rows] = np.where(np.abs(growth * length) < _SAME_RADIUS, 0.0, growth)
    plain &= (np.abs(numbers[:, 6]) > SHORTEST) & (np.minimum(radius, end_radius) > _SMALLEST_RADIUS_MM)
    return length, np.asarray(plain & (length > SHORTEST), dtype=np.bool_)


def _spline(path: PathBuilder, move: SplineMove, start: Array, end: Array) -> SplineCurve | None:
    """The curve of a spline from `start` to `end` (5,); None where something about it is special."""
    turns = not path.arm.frame.has_rpy and np.abs(end[3:] - start[3:]).max() > _SAME_POINT_MM
    if len(move.control_points_mm) < 2 or turns:
        return None
    points = path.arm.frame.base_from_program(np.array(move.control_points_mm, dtype=np.float64))
    if not np.abs(points).max() < _LONGEST_MM or np.abs(points[0] - start[:3]).max() > _SAME_POINT_MM:
        return None
    try:
        curve = SplineCurve(points, move.weights, move.knots, move.degree, (float(start[3]), float(start[4])))
    except ValueError:
        return None
    there = curve.evaluate(np.array([curve.length_mm]))[0][0, :3]
    return curve if curve.length_mm > SHORTEST and np.abs(there - end[:3]).max() < _SAME_POINT_MM else None


def _feeds(moves: Sequence[TaskMove], length: Array) -> tuple[Array, Array]:
    """Limits of the tool's speed (n,) and of the pace along the moves (n,), infinite where there is none; 0 where a
    feed is missing.
    """
    values = np.array([_NO_FEED if isinstance(move, RapidMove) else move.feed.value for move in moves])
    inverse = np.array(
        [not isinstance(move, RapidMove) and move.feed.mode is FeedMode.INVERSE_TIME for move in moves], dtype=np.bool_
    )
    values = np.where(values > 0.0, values, 0.0) / 60.0
    if not inverse.any():
        return values, np.full(len(values), np.inf)
    return np.where(inverse, np.inf, values), np.where(inverse, length * values, np.inf)


def _leading(flags: Flags) -> int:
    """How many are true before the first that is not."""
    return len(flags) if flags.all() else int(np.argmin(flags))

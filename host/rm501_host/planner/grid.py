"""The grid on a path: where the limits are looked at, close enough that nothing slips through between.

Each element is cut into intervals; wherever a limit's left side a(s) u + b(s) x bends too much between the two ends
of an interval, the interval is halved. What is left of the bend is subtracted from the limit, so that a law that
keeps the limits at the ends keeps them everywhere:

    |a_m - (a_0 + a_1)/2| U + |b_m - (b_0 + b_1)/2| X + |b_1 - b_0| U ds / 2

is the most by which a u + b x with constant u and linear x can exceed the line between its ends (a and b taken as
quadratic in s, index m the middle; |u| <= U, x <= X in the interval). The same is done for |a| sqrt(x), the rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm

from .elements import Array, Element, ElementTable, Indices
from .errors import JointLimitError, PlanError
from .geometry import PathPoints, path_points
from .limits import Limits
from .timelaw import IntervalLines, mvc, sliced_lines, solve_lines, strips, without_dead_ends

LONGEST_INTERVAL_MM = 0.25
"""First cut of an element (deg in joint space); time-optimality wants some intervals per acceleration phase."""
FEWEST_INTERVALS = 32
"""On a whole path, however short: from rest to rest over one interval there would be no speed at all."""
MOST_FIRST_INTERVALS = 200
"""first cut of a long element; 200 cost 0.3 % of the time of a rest-to-rest line."""
BEND_TOLERANCE = 0.001
"""Largest bend, relative to its limit, that is not refined but subtracted."""
TINY_BEND_TOLERANCE = 0.01
"""The same within sharp blends that are shorter than one interval: refined as far as others, each has 260 intervals."""
_SHARP_RAD = 0.35
MARGIN = 2e-6
"""Relative distance kept from every limit, for rounding."""
LIMIT_TOLERANCE_DEG = 1e-7
CREEP_MM_S = 1e-5
"""A path that has to be passed slower than this (0.3 nm from the waist axis) counts as one through the singularity."""
_ROUNDS = 60
_MOST_HALVINGS = 4
_X_MOST = 1e14
_JOINTS = ("waist", "shoulder", "elbow", "pitch", "roll")


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Intervals along a sequence of elements, ready for the time law.

    `element` (n,): index into the elements given; `start`, `stop` (n,): the element's own s; `lines`: the limits.
    """

    element: Indices
    start: Array
    stop: Array
    lines: IntervalLines

    def __len__(self) -> int:
        return len(self.element)


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Places on the path: `a`, `b` (rows, n) of the limits; `speed`: every rate limit as |speed| sqrt(x) <= 1; `top`
    (n,): the largest squared speed that the limits allow there; joints and their first derivatives (5, n).
    """

    a: Array
    b: Array
    speed: Array
    top: Array
    q_deg: Array
    q1: Array

    def extended(self, other: _Points) -> _Points:
        return _Points(*(np.concatenate((getattr(self, name), getattr(other, name)), axis=-1) for name in _NAMES))


_NAMES = tuple(_Points.__dataclass_fields__)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The rows that bind: `matrix` (rows, 5) over the joints, and their limits (rows, 1); `bounds` of accelerations has
    those of the tool behind them.
    """

    matrix: Array
    velocity: Array
    bounds: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """Intervals: their element, its s at the start, their length, and which points their start, middle and end are."""

    element: Indices
    start: Array
    length: Array
    first: Indices
    middle: Indices
    last: Indices

    def where(self, chosen: NDArray[np.bool_] | Indices) -> _Cut:
        return _Cut(*(getattr(self, name)[chosen] for name in _Cut.__dataclass_fields__))


@dataclass(frozen=True, slots=True, eq=False)
class _Bends:
    """What a law can bend within intervals: of each limit (rows, n), relative to it or to the rates, the worst (n,);
    and the caps of the squared speeds at both ends, (n,), lowered by what the rates bend.
    """

    limit: Array
    worst: Array
    first_cap: Array
    last_cap: Array

    def where(self, chosen: NDArray[np.bool_]) -> _Bends:
        return _Bends(self.limit[:, chosen], self.worst[chosen], self.first_cap[chosen], self.last_cap[chosen])


@dataclass(frozen=True, slots=True)
class Fineness:
    """How fine a grid is: first intervals of an element (at least, at most), of all elements together (at least), and
    the largest bends, relative to their limits, that are subtracted instead of refined.
    """

    fewest_each: int
    most_each: int
    fewest: int
    bend_tolerance: float
    tiny_bend_tolerance: float


FINE = Fineness(1, MOST_FIRST_INTERVALS, FEWEST_INTERVALS, BEND_TOLERANCE, TINY_BEND_TOLERANCE)
"""For laws that are played."""
COARSE = Fineness(20, 40, FEWEST_INTERVALS, 0.004, 0.01)
"""Good enough to compare two ways."""
ROUGH = Fineness(8, 12, 8, 0.1, 0.1)
"""Of a few per cent too slow a law, at a tenth of the cost; every element has enough intervals for a law of its own."""


class GridBuilder:
    """Builds grids for one arm (with its tool) and one set of limits.

    `check_limits` False leaves joint ranges unchecked, `speed_scale` scales the rows' velocity limits.
    """

    def __init__(
        self,
        arm: Arm,
        limits: Limits,
        *,
        check_limits: bool = True,
        speed_scale: float = 1.0,
        fineness: Fineness = FINE,
    ) -> None:
        self._arm = arm
        self._fineness = fineness
        self._limits = limits
        self._check_limits = check_limits
        tcp = limits.tcp_acceleration_mm_s2
        self._tcp_angles = np.arange(8) * (np.pi / 8) if np.isfinite(tcp) else np.zeros(0)

        def rows(matrix: Array, velocity: Array, acceleration: Array) -> _Rows:
            bounds = np.append(acceleration, [tcp * np.cos(np.pi / 16)] * len(self._tcp_angles))
            kept = 1.0 - MARGIN
            return _Rows(matrix, (velocity * kept * speed_scale)[:, None], (bounds * kept)[:, None])

        self._rows = rows(limits.rows, limits.velocity, limits.acceleration)
        self._rows_without_roll = rows(*limits.without_roll())
        self._tcp_speed = limits.tcp_speed_mm_s * (1.0 - MARGIN)

    def build(self, table: ElementTable, ways: Indices | None = None) -> Grid:
        """The grid over all elements of `table`, in order; raises PlanError where the arm cannot follow.

        `ways` (elements,): which way each element belongs to, from 0, where the table holds several paths.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            return self._build(table, np.zeros(len(table), dtype=np.intp) if ways is None else ways)

    def build_each(self, runs: Sequence[Sequence[Element]]) -> list[Grid]:
        """A grid for each of several paths of elements; raises PlanError where the arm cannot follow one."""
        counts = [len(run) for run in runs]
        ways = np.repeat(np.arange(len(runs)), counts)
        grid = self.build(ElementTable([element for run in runs for element in run]), ways)
        firsts = np.concatenate((np.zeros(1, dtype=np.intp), np.cumsum(counts)))
        borders = pairwise(np.searchsorted(grid.element, firsts).tolist())
        return [
            Grid(grid.element[a:b] - first, grid.start[a:b], grid.stop[a:b], sliced_lines(grid.lines, a, b))
            for first, (a, b) in zip(firsts.tolist(), borders, strict=False)
        ]

    def _build(self, table: ElementTable, ways: Indices) -> Grid:
        tolerance = self._tolerances(table)
        rows = self._rows if table.turns_roll else self._rows_without_roll
        cut, points = self._first_cut(table, rows, ways)
        done: list[tuple[_Cut, _Bends]] = []
        for _ in range(_ROUNDS):
            bends = _bends_within(rows.bounds, points, cut)
            excess = bends.worst / tolerance[cut.element]
            split = (excess > 1.0) & (cut.length > 1e-10)
            done.append((cut.where(~split), bends.where(~split)))
            if not split.any():
                break
            # bends shrink with the square of the length
            halvings = np.clip(np.log2(excess[split]) // 2.0, 1, _MOST_HALVINGS).astype(np.intp)
            cut, points = self._halved(table, rows, cut.where(split), halvings, points)
        else:
            raise PlanError(
                "the path bends too sharply for a time law",
                source=table.elements[int(cut.element[np.argmax(excess)])].source,
                remedy="keep away from the singularity, or use a joint move (G0)",
            )
        cut = _Cut(*(np.concatenate([getattr(one, name) for one, _ in done]) for name in _Cut.__dataclass_fields__))
        order = np.lexsort((cut.start, cut.element))
        cut = cut.where(order)
        bend = np.concatenate([bends.limit for _, bends in done], axis=1)[:, order]
        first_cap = np.concatenate([bends.first_cap for _, bends in done])[order]
        last_cap = np.concatenate([bends.last_cap for _, bends in done])[order]
        _check_speeds(table, points, cut, len(rows.velocity))
        if self._check_limits:
            self._check_ranges(table, points, cut)
        limit = np.maximum(rows.bounds - 1.2 * bend, 0.5 * rows.bounds)
        (a0, a1), (b0, b1) = (
            [np.take(rows, at, axis=1) for at in (cut.first, cut.last)] for rows in (points.a, points.b)
        )
        lines = without_dead_ends(solve_lines(strips(cut.length, a0, b0, a1, b1, limit, first_cap, last_cap)))
        return Grid(cut.element, cut.start, cut.start + cut.length, lines)

    def _tolerances(self, table: ElementTable) -> Array:
        tiny = table.is_blend & (table.length < LONGEST_INTERVAL_MM) & (np.abs(table.omega) * table.length > _SHARP_RAD)
        return np.where(tiny, self._fineness.tiny_bend_tolerance, self._fineness.bend_tolerance)

    def _first_cut(self, table: ElementTable, rows: _Rows, ways: Indices) -> tuple[_Cut, _Points]:
        fineness = self._fineness
        wanted = np.ceil(table.length / LONGEST_INTERVAL_MM)
        counts = np.clip(wanted, fineness.fewest_each, fineness.most_each).astype(np.intp)
        counts *= -(-fineness.fewest // np.bincount(ways, counts).astype(np.intp))[ways]
        # ends and middles of the intervals of one element: 2 count + 1 points side by side
        sizes = 2 * counts + 1
        begins = np.cumsum(sizes) - sizes
        element = np.repeat(np.arange(len(table)), sizes)
        s = table.length[element] * ((np.arange(len(element)) - begins[element]) / (2 * counts)[element])
        points = self._points(table, rows, element, s)
        element = np.repeat(np.arange(len(table)), counts)
        within = np.arange(len(element)) - (np.cumsum(counts) - counts)[element]
        first = begins[element] + 2 * within
        return _Cut(element, s[first], s[first + 2] - s[first], first, first + 1, first + 2), points

    def _halved(
        self, table: ElementTable, rows: _Rows, cut: _Cut, halvings: Indices, points: _Points
    ) -> tuple[_Cut, _Points]:
        """Each interval halved that many times, and the points with those that this takes."""
        parts = 2**halvings
        fresh = 2 * parts - 2
        begins = np.cumsum(fresh) - fresh
        known = len(points.top)
        parent = np.repeat(np.arange(len(parts)), fresh)
        # of the places 0 to 2 parts of an interval, the first, the last and the middle one are there
        place = np.arange(len(parent)) - begins[parent] + 1
        place += place >= parts[parent]
        s = cut.start[parent] + cut.length[parent] * (place / (2 * parts)[parent])
        points = points.extended(self._points(table, rows, cut.element[parent], s))
        parent = np.repeat(np.arange(len(parts)), parts)
        within = np.arange(len(parent)) - (np.cumsum(parts) - parts)[parent]

        def point(number: Indices) -> Indices:
            middle = parts[parent]
            found = known + begins[parent] + number - 1 - (number > middle)
            found = np.where(number == 0, cut.first[parent], np.where(number == 2 * middle, cut.last[parent], found))
            return np.where(number == middle, cut.middle[parent], found)

        length = cut.length[parent] / parts[parent]
        first, middle, last = (point(2 * within + k) for k in range(3))
        return _Cut(cut.element[parent], cut.start[parent] + within * length, length, first, middle, last), points

    def _points(self, table: ElementTable, rows: _Rows, index: Indices, s: Array) -> _Points:
        points = path_points(self._arm, table, index, s)
        a, b = rows.matrix @ points.q1.T, rows.matrix @ points.q2.T
        if len(self._tcp_angles):
            tcp_a, tcp_b = self._tcp_rows(points)
            a, b = np.concatenate((a, tcp_a)), np.concatenate((b, tcp_b))
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            bad = int(np.flatnonzero(~(np.isfinite(a).all(axis=0) & np.isfinite(b).all(axis=0)))[0])
            element = table.elements[index[bad]]
            raise PlanError(
                "the path runs through a singularity, where the joints would have to jump",
                source=element.source,
                place_mm=float(s[bad]),
                q_deg=tuple(float(v) for v in points.q_deg[bad]),
                remedy="pass it at a distance, or use a joint move (G0)",
            )
        travel = np.sqrt(np.einsum("ij,ij->i", points.p1, points.p1))
        feed = np.minimum(table.feed_mm_s[index] * (1.0 - MARGIN), self._tcp_speed)
        rate = table.rate[index] * (1.0 - MARGIN)
        speed = np.concatenate(
            (np.abs(a[: len(rows.velocity)]) / rows.velocity, (travel / feed)[None], (1.0 / rate)[None])
        )
        return _Points(a, b, speed, mvc(a, b, np.broadcast_to(rows.bounds, a.shape)), points.q_deg.T, points.q1.T)

    def _tcp_rows(self, points: PathPoints) -> tuple[Array, Array]:
        travel = np.linalg.norm(points.p1, axis=1)
        safe = np.where(travel > 0.0, travel, 1.0)
        along = np.einsum("ij,ij->i", points.p1, points.p2) / safe
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", points.p2, points.p2) - along**2, 0.0))
        c, s = np.cos(self._tcp_angles)[:, None], np.sin(self._tcp_angles)[:, None]
        return c * travel, c * along + s * across

    def _check_ranges(self, table: ElementTable, points: _Points, cut: _Cut) -> None:
        """Raise JointLimitError where a joint leaves its range, also between the grid points."""
        d_a, d_b = np.take(points.q1, cut.first, axis=1) * cut.length, np.take(points.q1, cut.last, axis=1) * cut.length
        q_a, q_m, q_b = _at(points.q_deg, cut)
        turning = d_a * d_b < 0.0
        # a cubic through both ends stays within this of the nearer end where it turns
        safe = np.where(turning, d_a - d_b, 1.0)
        peak = np.where(turning, q_a + 0.5 * d_a * d_a / safe, q_a)
        low = np.minimum(np.minimum(q_a, q_b), np.minimum(q_m, peak))
        high = np.maximum(np.maximum(q_a, q_b), np.maximum(q_m, peak))
        below = self._limits.min_deg[:, None] - low
        above = high - self._limits.max_deg[:, None]
        beyond = np.maximum(below, above)
        is_bad = (beyond > LIMIT_TOLERANCE_DEG).any(axis=0)
        if not is_bad.any():
            return
        first = int(np.argmax(is_bad))
        element = int(cut.element[first])
        joint = int(np.argmax(beyond[:, first]))
        worst = float(beyond[joint, is_bad & (cut.element == element)].max())
        limit = self._limits.min_deg[joint] if below[joint, first] > 0 else self._limits.max_deg[joint]
        excess = f"would leave its range by {worst:.4g} deg (limit {limit:g} deg)"
        at_deg = tuple(float(v) for v in points.q_deg[:, cut.first[first]])
        if table.elements[element].is_blend:
            raise JointLimitError(
                f"in the blend at its end the {_JOINTS[joint]} {excess}",
                source=table.elements[element].source,
                q_deg=at_deg,
                amount=worst,
                remedy="give a smaller P in G64 before it, or G61; or move the corner",
            )
        raise JointLimitError(
            f"{_JOINTS[joint]} {excess}",
            source=table.elements[element].source,
            place_mm=float(cut.start[first]),
            q_deg=at_deg,
            amount=worst,
            remedy="move the path, go round by a neutral pose, or use a joint move (G0)",
        )


def _bends_within(bounds: Array, points: _Points, cut: _Cut) -> _Bends:
    speed_a, speed_m, speed_b = _at(points.speed, cut)
    most = np.maximum(np.maximum(speed_a, speed_b), 1e-300)
    rate_bend = 1.3 * np.abs(speed_m - 0.5 * (speed_a + speed_b)) + 0.45 * (speed_b - speed_a) ** 2 / most
    first_cap, last_cap = _squared_cap(speed_a + rate_bend), _squared_cap(speed_b + rate_bend)
    a0, am, a1 = _at(points.a, cut)
    b0, bm, b1 = _at(points.b, cut)
    x = np.minimum(np.maximum(_squared_cap(speed_m), np.maximum(first_cap, last_cap)), points.top[cut.middle])
    x = np.maximum(x, np.minimum(first_cap, points.top[cut.first]))
    x = np.maximum(x, np.minimum(last_cap, points.top[cut.last]))
    u = np.zeros(len(x))
    for a, b in ((a0, b0), (am, bm), (a1, b1)):
        u = np.maximum(u, ((bounds + np.abs(b) * x) / np.maximum(np.abs(a), 1e-300)).min(axis=0))
    bend = (
        np.abs(am - 0.5 * (a0 + a1)) * u + np.abs(bm - 0.5 * (b0 + b1)) * x + np.abs(b1 - b0) * (0.5 * u * cut.length)
    )
    worst = np.maximum((bend / bounds).max(axis=0), rate_bend.max(axis=0) * np.sqrt(x))
    return _Bends(bend, worst, first_cap, last_cap)


def _check_speeds(table: ElementTable, points: _Points, cut: _Cut, joints: int) -> None:
    """Raise PlanError where the joints, whose rates come first, let the path only be crept along: a singularity."""
    slowness = points.speed[:joints].max(axis=0)
    if float(slowness.max()) * CREEP_MM_S <= 1.0:
        return
    slowest = int(np.argmax(np.maximum(slowness[cut.first], slowness[cut.last])))
    if max(slowness[cut.first[slowest]], slowness[cut.last[slowest]]) * CREEP_MM_S <= 1.0:
        return
    raise PlanError(
        "the path runs through a singularity, where the joints would have to jump",
        source=table.elements[int(cut.element[slowest])].source,
        place_mm=float(cut.start[slowest]),
        q_deg=tuple(float(v) for v in points.q_deg[:, cut.first[slowest]]),
        remedy="pass it at a distance, or use a joint move (G0)",
    )


def _at(rows: Array, cut: _Cut) -> tuple[Array, Array, Array]:
    """Rows (k, points) at the starts, middles and ends of the intervals, (k, n) each."""
    return np.take(rows, cut.first, axis=1), np.take(rows, cut.middle, axis=1), np.take(rows, cut.last, axis=1)


def _squared_cap(speed: Array) -> Array:
    """The squared path speed (n,) at which the first of the rates (rows, n) is at its limit."""
    cap: Array = 1.0 / np.maximum(speed.max(axis=0) ** 2, 1.0 / _X_MOST)
    return cap

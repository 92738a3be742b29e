"""The grid on a path: where the limits are looked at, close enough that nothing slips through between.

Each element is cut into intervals; wherever a limit's left side a(s) u + b(s) x bends too much between the two ends
of an interval, the interval is halved. What is left of the bend is subtracted from the limit, so that a law that
keeps the limits at the ends keeps them everywhere:

    |a_m - (a_0 + a_1)/2| U + |b_m - (b_0 + b_1)/2| X + |b_1 - b_0| U ds / 2

is the most by which a u + b x with constant u and linear x can exceed the line between its ends (a and b taken as
quadratic in s, index m the middle; |u| <= U, x <= X in the interval). The same is done for |a| sqrt(x), the rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rm501_host.kinematics import Arm

from .elements import Array, ElementTable, Indices
from .errors import JointLimitError, PlanError
from .geometry import PathPoints, path_points
from .limits import Limits
from .timelaw import IntervalLines, mvc, solve_lines, strips, without_dead_ends

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


@dataclass(slots=True)
class _Rows:
    a: Array
    b: Array
    speed: Array
    q_deg: Array
    q1: Array

    def extended(self, other: _Rows) -> _Rows:
        return _Rows(
            np.concatenate((self.a, other.a)),
            np.concatenate((self.b, other.b)),
            np.concatenate((self.speed, other.speed)),
            np.concatenate((self.q_deg, other.q_deg)),
            np.concatenate((self.q1, other.q1)),
        )


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
        bounds = list(limits.acceleration) + [tcp * np.cos(np.pi / 16)] * len(self._tcp_angles)
        self._bounds = np.array(bounds) * (1.0 - MARGIN)
        self._velocity = limits.velocity * (1.0 - MARGIN) * speed_scale
        self._tcp_speed = limits.tcp_speed_mm_s * (1.0 - MARGIN)

    def build(self, table: ElementTable) -> Grid:
        """The grid over all elements of `table`, in order; raises PlanError where the arm cannot follow."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
            return self._build(table)

    def _build(self, table: ElementTable) -> Grid:
        first = self._first_cut(table)
        element, start, stop = first
        middle = 0.5 * (start + stop)
        count = len(element)
        tolerance = self._tolerances(table)
        rows = self._rows(table, np.concatenate((element, element, element)), np.concatenate((start, middle, stop)))
        ia = np.arange(count)
        im, ib = ia + count, ia + 2 * count
        for _ in range(_ROUNDS):
            bend, speed_bend, x_top = self._bends(rows, ia, im, ib, stop - start)
            worst = np.maximum((bend / self._bounds).max(axis=1), speed_bend)
            split = (worst > tolerance[element]) & (stop - start > 1e-10)
            if not split.any():
                break
            points = len(rows.a)
            keep = ~split
            e, a, m, b = element[split], start[split], middle[split], stop[split]
            k = len(e)
            rows = rows.extended(
                self._rows(table, np.concatenate((e, e)), np.concatenate((0.5 * (a + m), 0.5 * (m + b))))
            )
            fresh = points + np.arange(2 * k)
            element = np.concatenate((element[keep], e, e))
            start = np.concatenate((start[keep], a, m))
            middle_a, middle_b = 0.5 * (a + m), 0.5 * (m + b)
            stop = np.concatenate((stop[keep], m, b))
            middle = np.concatenate((middle[keep], middle_a, middle_b))
            ia, im, ib = (
                np.concatenate((ia[keep], ia[split], im[split])),
                np.concatenate((im[keep], fresh)),
                np.concatenate((ib[keep], im[split], ib[split])),
            )
        else:
            raise PlanError(
                "the path bends too sharply for a time law",
                source=table.elements[int(element[np.argmax(worst)])].source,
                remedy="keep away from the singularity, or use a joint move (G0)",
            )
        order = np.lexsort((start, element))
        element, start, stop = element[order], start[order], stop[order]
        ia, im, ib = ia[order], im[order], ib[order]
        bend, _, x_top = self._bends(rows, ia, im, ib, stop - start)
        self._check_speeds(table, rows, element, start, ia, ib)
        if self._check_limits:
            self._check_ranges(table, rows, element, start, stop, ia, im, ib)
        limit = np.maximum(self._bounds - 1.2 * bend, 0.5 * self._bounds)
        lines = without_dead_ends(
            solve_lines(strips(stop - start, rows.a[ia], rows.b[ia], rows.a[ib], rows.b[ib], limit, x_top[0], x_top[1]))
        )
        return Grid(element, start, stop, lines)

    def _tolerances(self, table: ElementTable) -> Array:
        tiny = table.is_blend & (table.length < LONGEST_INTERVAL_MM) & (np.abs(table.omega) * table.length > _SHARP_RAD)
        return np.where(tiny, self._fineness.tiny_bend_tolerance, self._fineness.bend_tolerance)

    def _first_cut(self, table: ElementTable) -> tuple[Indices, Array, Array]:
        fineness = self._fineness
        wanted = np.ceil(table.length / LONGEST_INTERVAL_MM)
        counts = np.clip(wanted, fineness.fewest_each, fineness.most_each).astype(np.intp)
        counts *= -(-fineness.fewest // int(counts.sum()))
        element = np.repeat(np.arange(len(table)), counts)
        ends = np.cumsum(counts)
        within = np.arange(len(element)) - np.repeat(ends - counts, counts)
        size = counts[element]
        length = table.length[element]
        return element, length * (within / size), length * ((within + 1) / size)

    def _rows(self, table: ElementTable, index: Indices, s: Array) -> _Rows:
        points = path_points(self._arm, table, index, s)
        a = points.q1 @ self._limits.rows.T
        b = points.q2 @ self._limits.rows.T
        if len(self._tcp_angles):
            tcp_a, tcp_b = self._tcp_rows(points)
            a, b = np.concatenate((a, tcp_a), axis=1), np.concatenate((b, tcp_b), axis=1)
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            bad = int(np.flatnonzero(~(np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)))[0])
            element = table.elements[index[bad]]
            raise PlanError(
                "the path runs through a singularity, where the joints would have to jump",
                source=element.source,
                place_mm=float(s[bad]),
                q_deg=tuple(float(v) for v in points.q_deg[bad]),
                remedy="pass it at a distance, or use a joint move (G0)",
            )
        travel = np.linalg.norm(points.p1, axis=1)
        feed = np.minimum(table.feed_mm_s[index] * (1.0 - MARGIN), self._tcp_speed)
        rate = table.rate[index] * (1.0 - MARGIN)
        # every rate limit as |speed_i| sqrt(x) <= 1
        speed = np.concatenate(
            (np.abs(a[:, : len(self._velocity)]) / self._velocity, (travel / feed)[:, None], (1.0 / rate)[:, None]),
            axis=1,
        )
        return _Rows(a, b, speed, points.q_deg, points.q1)

    def _tcp_rows(self, points: PathPoints) -> tuple[Array, Array]:
        travel = np.linalg.norm(points.p1, axis=1)
        safe = np.where(travel > 0.0, travel, 1.0)
        along = np.einsum("ij,ij->i", points.p1, points.p2) / safe
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", points.p2, points.p2) - along**2, 0.0))
        c, s = np.cos(self._tcp_angles), np.sin(self._tcp_angles)
        return travel[:, None] * c, along[:, None] * c + across[:, None] * s

    def _bends(self, rows: _Rows, ia: Indices, im: Indices, ib: Indices, length: Array) -> tuple[Array, Array, Array]:
        """Bend of each limit (n, rows), relative bend of the rates (n,), squared-speed caps at both ends (2, n)."""
        speed_a, speed_m, speed_b = _columns(rows.speed, ia, im, ib)
        most = np.maximum(np.maximum(speed_a, speed_b), 1e-300)
        rate_bend = 1.3 * np.abs(speed_m - 0.5 * (speed_a + speed_b)) + 0.45 * (speed_b - speed_a) ** 2 / most
        cap_a = 1.0 / np.maximum((speed_a + rate_bend).max(axis=0) ** 2, 1.0 / _X_MOST)
        cap_b = 1.0 / np.maximum((speed_b + rate_bend).max(axis=0) ** 2, 1.0 / _X_MOST)
        a0, am, a1 = _columns(rows.a, ia, im, ib)
        b0, bm, b1 = _columns(rows.b, ia, im, ib)
        x_plain = 1.0 / np.maximum(speed_m.max(axis=0) ** 2, 1.0 / _X_MOST)
        x_plain = np.maximum(x_plain, np.maximum(cap_a, cap_b))
        bounds = self._bounds[:, None]
        limit = np.broadcast_to(bounds, am.shape)
        x = np.minimum(x_plain, mvc(am, bm, limit, x_plain))
        x = np.maximum(x, np.minimum(cap_a, mvc(a0, b0, limit, cap_a)))
        x = np.maximum(x, np.minimum(cap_b, mvc(a1, b1, limit, cap_b)))
        u = np.zeros(len(x))
        for a, b in ((a0, b0), (am, bm), (a1, b1)):
            u = np.maximum(u, ((bounds + np.abs(b) * x) / np.maximum(np.abs(a), 1e-300)).min(axis=0))
        bend = (
            np.abs(am - 0.5 * (a0 + a1)) * u + np.abs(bm - 0.5 * (b0 + b1)) * x + np.abs(b1 - b0) * (0.5 * u * length)
        )
        speed_bend = rate_bend.max(axis=0) * np.sqrt(x)
        return bend.T, speed_bend, np.stack((cap_a, cap_b))

    def _check_speeds(
        self, table: ElementTable, rows: _Rows, element: Indices, start: Array, ia: Indices, ib: Indices
    ) -> None:
        """Raise PlanError where the joints let the path only be crept along: it runs through a singularity."""
        slowness = rows.speed[:, : len(self._velocity)].max(axis=1)
        slowest = int(np.argmax(np.maximum(slowness[ia], slowness[ib])))
        if max(slowness[ia[slowest]], slowness[ib[slowest]]) * CREEP_MM_S <= 1.0:
            return
        raise PlanError(
            "the path runs through a singularity, where the joints would have to jump",
            source=table.elements[int(element[slowest])].source,
            place_mm=float(start[slowest]),
            q_deg=tuple(float(v) for v in rows.q_deg[ia[slowest]]),
            remedy="pass it at a distance, or use a joint move (G0)",
        )

    def _check_ranges(
        self,
        table: ElementTable,
        rows: _Rows,
        element: Indices,
        start: Array,
        stop: Array,
        ia: Indices,
        im: Indices,
        ib: Indices,
    ) -> None:
        """Raise JointLimitError where a joint leaves its range, also between the grid points."""
        length = (stop - start)[:, None]
        q_a, q_b, d_a, d_b = rows.q_deg[ia], rows.q_deg[ib], rows.q1[ia] * length, rows.q1[ib] * length
        turning = d_a * d_b < 0.0
        # a cubic through both ends stays within this of the nearer end where it turns
        safe = np.where(turning, d_a - d_b, 1.0)
        peak = np.where(turning, q_a + 0.5 * d_a * d_a / safe, q_a)
        low = np.minimum(np.minimum(q_a, q_b), np.minimum(rows.q_deg[im], peak))
        high = np.maximum(np.maximum(q_a, q_b), np.maximum(rows.q_deg[im], peak))
        below = self._limits.min_deg - low
        above = high - self._limits.max_deg
        beyond = np.maximum(below, above)
        bad = np.flatnonzero((beyond > LIMIT_TOLERANCE_DEG).any(axis=1))
        if not len(bad):
            return
        first = int(bad[0])
        chosen = table.elements[element[first]]
        same = (element == element[first]) & (beyond > LIMIT_TOLERANCE_DEG).any(axis=1)
        joint = int(np.argmax(beyond[first]))
        worst = float(beyond[same][:, joint].max())
        limit = self._limits.min_deg[joint] if below[first, joint] > 0 else self._limits.max_deg[joint]
        excess = f"would leave its range by {worst:.4g} deg (limit {limit:g} deg)"
        at_deg = tuple(float(v) for v in rows.q_deg[ia[first]])
        if chosen.is_blend:
            raise JointLimitError(
                f"in the blend at its end the {_JOINTS[joint]} {excess}",
                source=chosen.source,
                q_deg=at_deg,
                amount=worst,
                remedy="give a smaller P in G64 before it, or G61; or move the corner",
            )
        raise JointLimitError(
            f"{_JOINTS[joint]} {excess}",
            source=chosen.source,
            place_mm=float(start[first]),
            q_deg=at_deg,
            amount=worst,
            remedy="move the path, go round by a neutral pose, or use a joint move (G0)",
        )


def _columns(rows: Array, *chosen: Indices) -> tuple[Array, ...]:
    """The chosen rows as columns side by side, (width, n) each: sums and extremes over few limits of many points are
    several times as fast that way.
    """
    return tuple(np.ascontiguousarray(rows[which].T) for which in chosen)

"""The time-optimal law along a given path: reachability analysis on a grid.

Theory of operation
-------------------
Along a path q(s) the joint rates are q' v and the joint accelerations q' u + q'' x, with v = ds/dt, u = d2s/dt2 and
x = v^2 (Bobrow, Dubowsky, Gibson 1985; the thesis's section 4.3.2 with its errata). So every limit is linear in
(u, x). On a grid of the path, u is constant over each interval, hence x is linear in s,

    x_next = x + 2 u ds          dt = 2 ds / (sqrt(x) + sqrt(x_next)),

and every limit is demanded at both ends of the interval (collocation). Writing u = (y - x) / (2 ds) with y = x_next,
an interval is a set of strips in the plane of its two squared speeds:

    |P_i x + Q_i y| <= C_i,      0 <= x <= X,      0 <= y <= Y.

This set is convex and contains (0, 0), so the squared speeds from which the end of the path can be reached are
intervals [0, reach_k] (Pham and Pham 2018, TOPP-RA). One pass backwards finds reach_k, one pass forwards takes the
largest y at each step; that is the fastest law of the grid. Both passes touch each interval once:

* backwards: the largest x for a given y is the lowest of the lines x <= alpha_i + beta_i y, unless y exceeds the one
  at which x is largest of all (`peak_y`); then it is that largest x (`peak_x`);
* forwards: the largest y for a given x is the lowest of y <= gamma_i + delta_i x, and at most reach_{k+1}.

Of the lines of an interval (two for each limit) few are ever the lowest. The peaks and those few are found for the
whole grid at once (`solve_lines`); the passes, which have to go interval by interval, compare four numbers each.

What lies between the grid points is the grid's matter (`grid`): it narrows each C_i by what the limit's left side can
rise between the two ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_TINY = 1e-9
_AT_ONCE = 2048
"""Columns that are worked on at a time: beyond, the arrays leave the cache."""
_BLOCK = 512
"""Intervals of a pass that are taken out of the arrays at a time."""
_MOST_STEPS = 60
_SAME = 1e-12
_DEAD_END = 0.01
"""An interval whose largest x leads to less than this share of its largest y is a dead end (tiny blends have some)."""


@dataclass(frozen=True, slots=True)
class IntervalTable:
    """Intervals of the grid as strips |p x + q y| <= c in the squared speeds x, y at their two ends.

    `p`, `q`, `c`: (rows, n), so that work on few rows of many intervals is fast; `length`: (n,), in the path's unit;
    `x_cap`, `y_cap`: (n,), squared path speeds.
    """

    length: Array
    p: Array
    q: Array
    c: Array
    x_cap: Array
    y_cap: Array


@dataclass(frozen=True, slots=True)
class IntervalLines:
    """The strips solved for either end, as far as they matter: x <= alpha + beta y for y up to `peak_y`, where x is
    largest, `peak_x`, and y <= gamma + delta x for x up to `peak_x`.

    (n, 4), or more where four lines are not enough for some of the intervals: the others repeat their fourth.
    """

    length: Array
    alpha: Array
    beta: Array
    gamma: Array
    delta: Array
    peak_x: Array
    peak_y: Array
    y_cap: Array


_NAMES = tuple(IntervalLines.__dataclass_fields__)


def strips(
    length: Array,
    first_a: Array,
    first_b: Array,
    last_a: Array,
    last_b: Array,
    limit: Array,
    x_cap: Array,
    y_cap: Array,
) -> IntervalTable:
    """Turn |a u + b x| <= limit at both ends of each interval into strips in (x, y).

    `first_a`, `first_b`, `last_a`, `last_b`, `limit`: (rows, n); `length`, `x_cap`, `y_cap`: (n,).
    """
    half_slope = 0.5 / length
    first, last = first_a * half_slope, last_a * half_slope
    p = np.concatenate((first_b - first, -last))
    q = np.concatenate((first, last_b + last))
    return IntervalTable(length, p, q, np.concatenate((limit, limit)), x_cap, y_cap)


def solve_lines(table: IntervalTable) -> IntervalLines:
    """Solve the strips for x and for y; find the largest x of each interval, the least y that allows it, and which
    lines matter up to there.
    """
    count = len(table.length)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        if count <= _AT_ONCE:
            return _solved(table, slice(None))
        return joined_lines(*(_solved(table, slice(at, at + _AT_ONCE)) for at in range(0, count, _AT_ONCE)))


def _solved(table: IntervalTable, block: slice) -> IntervalLines:
    p, q, c = table.p[:, block], table.q[:, block], table.c[:, block]
    x_cap, y_cap = table.x_cap[block], table.y_cap[block]
    size_p, size_q = np.abs(p), np.abs(q)
    top_x, top_y = _extent(p, q, c, size_p, x_cap, y_cap), _extent(q, p, c, size_q, y_cap, x_cap)
    # a strip that hardly depends on x (or y) within those extents is no bound on it: solving for it would cancel
    uses_x, uses_y = size_p * top_x > _TINY * c, size_q * top_y > _TINY * c
    alpha, beta = np.where(uses_x, c / size_p, np.inf), np.where(uses_x, -q / p, 0.0)
    gamma, delta = np.where(uses_y, c / size_q, np.inf), np.where(uses_y, -p / q, 0.0)
    peak_x, peak_y = _peaks(gamma, delta, top_x, top_y)
    alpha, beta = _lowest(alpha, beta, peak_y)
    gamma, delta = _lowest(gamma, delta, peak_x)
    return IntervalLines(table.length[block], alpha.T, beta.T, gamma.T, delta.T, peak_x, peak_y, y_cap)


def without_dead_ends(lines: IntervalLines) -> IntervalLines:
    """The lines with a little less than the largest x where that leads to rest alone, so that every law goes on.

    The fastest pass would come to rest in the middle of a path there, and a law at rest inside it never ends.
    """
    most_y = (lines.gamma + lines.delta * lines.peak_x[:, None]).min(axis=1)
    top_y = np.minimum(lines.gamma.min(axis=1), lines.y_cap)
    return replace(lines, peak_x=np.where(most_y < _DEAD_END * top_y, 0.9 * lines.peak_x, lines.peak_x))


def _extent(p: Array, q: Array, c: Array, size_p: Array, x_cap: Array, y_cap: Array) -> Array:
    """No less than the largest x of each interval's set, (n,): what each strip alone allows at the best y."""
    rise = np.maximum(-np.sign(p) * q * y_cap, 0.0)
    extent: Array = np.minimum(x_cap, np.where(size_p > 0.0, (c + rise) / size_p, np.inf).min(axis=0))
    return extent


def _peaks(gamma: Array, delta: Array, top_x: Array, y_cap: Array) -> tuple[Array, Array]:
    """The largest x of each interval's set and the least y there, (n,) each.

    For a given x, y lies between the highest of the lines delta x - gamma, at least 0, and the lowest of gamma +
    delta x, at most `y_cap`. The gap is concave in x, so from `top_x` Newton's steps, to where the highest and the
    lowest line of this x cross, come down to where it closes, and in few steps, for the lines are few.
    """
    peak_x, peak_y = top_x.copy(), np.zeros(len(top_x))
    columns = np.arange(len(top_x))
    for _ in range(_MOST_STEPS):
        x = peak_x[columns]
        middles = delta * x
        lower, upper = middles - gamma, middles + gamma
        low, high = lower.argmax(axis=0), upper.argmin(axis=0)
        at = np.arange(len(columns))
        least, most = lower[low, at], upper[high, at]
        is_least, is_most = least > 0.0, most < y_cap
        peak_y[columns] = np.where(is_least, least, 0.0)
        # the set holds (0, 0), so where the gap is below 0 its slope is, too
        gap_0 = np.where(is_most, gamma[high, at], y_cap) + np.where(is_least, gamma[low, at], 0.0)
        slope = np.where(is_least, delta[low, at], 0.0) - np.where(is_most, delta[high, at], 0.0)
        closes = gap_0 / np.where(slope > 0.0, slope, 1.0)
        is_open = (slope > 0.0) & (closes < x * (1.0 - _SAME))
        if not is_open.any():
            break
        columns, y_cap = columns[is_open], y_cap[is_open]
        peak_x[columns] = closes[is_open]
        gamma, delta = gamma[:, is_open], delta[:, is_open]
    return peak_x, peak_y


def _lowest(offset: Array, slope: Array, last: Array) -> tuple[Array, Array]:
    """Offsets and slopes (4, n) of the lines whose lowest is that of all the lines, (rows, n), on [0, last]: the lowest
    at both ends, the lowest where those two cross, and at the worse of the two crossings with that. Should that not
    be enough somewhere, all the others follow, (4 + rows, n).
    """
    begin, end = _active(offset, slope, np.zeros(len(last)))[0], _active(offset, slope, last)[0]
    middle, _ = _at_crossing(offset, slope, begin, end, last)
    early, early_excess = _at_crossing(offset, slope, begin, middle, last)
    late, late_excess = _at_crossing(offset, slope, middle, end, last)
    is_late = late_excess > early_excess
    second, third = np.where(is_late, middle, early), np.where(is_late, late, middle)
    lines = np.stack((begin, second, third, end))
    columns = np.flatnonzero(np.maximum(early_excess, late_excess) > _SAME * np.abs(middle[0]))
    if len(columns):
        some, some_slopes, some_last = offset[:, columns], slope[:, columns], last[columns]
        excess = [
            _at_crossing(some, some_slopes, one, two, some_last)[1] for one, two in pairwise(lines[:, :, columns])
        ]
        columns = columns[np.maximum.reduce(excess) > _SAME * np.abs(middle[0, columns])]
    if len(columns):
        others = np.repeat(lines[-1:], len(offset), axis=0)
        others[:, 0, columns], others[:, 1, columns] = offset[:, columns], slope[:, columns]
        lines = np.concatenate((lines, others))
    return lines[:, 0], lines[:, 1]


def _active(offset: Array, slope: Array, place: Array) -> tuple[Array, Array]:
    """The lowest line at each place (n,): offset and slope (2, n), and its value there."""
    columns = np.arange(len(place))
    values = offset + slope * place
    rows = values.argmin(axis=0)
    return np.stack((offset[rows, columns], slope[rows, columns])), values[rows, columns]


def _at_crossing(offset: Array, slope: Array, first: Array, second: Array, last: Array) -> tuple[Array, Array]:
    """The lowest line (2, n) where two of them, (2, n), cross within [0, last], and how far it is below them there;
    the first and 0 where they do not cross.
    """
    apart = first[1] - second[1]
    crosses = apart > 0.0
    place = np.where(crosses, np.clip((second[0] - first[0]) / np.where(crosses, apart, 1.0), 0.0, last), 0.0)
    line, value = _active(offset, slope, place)
    return np.where(crosses, line, first), np.where(crosses, first[0] + first[1] * place - value, 0.0)


def mvc(a: Array, b: Array, limit: Array) -> Array:
    """Largest squared speed at single points where some u satisfies |a u + b x| <= limit; (rows, n) -> (n,).

    The least of (c_i |a_j| + c_j |a_i|) / |a_i b_j - a_j b_i| over all pairs of rows (Fourier, Motzkin).
    """
    count = a.shape[1]
    best = np.empty(count)
    first, second = _pairs(len(a))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        for at in range(0, count, _AT_ONCE):
            block = slice(at, at + _AT_ONCE)
            p, q, c = a[:, block], b[:, block], limit[:, block]
            size = np.abs(p)
            p1, p2 = p[first], p[second]
            determinant = np.abs(p1 * q[second] - p2 * q[first])
            bounds = (c[first] * size[second] + c[second] * size[first]) / determinant
            alone = np.where(size == 0.0, c / np.abs(q), np.inf)
            best[block] = np.fmin(np.fmin.reduce(bounds, axis=0, initial=np.inf), np.fmin.reduce(alone, axis=0))
    return best


@cache
def _pairs(rows: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(rows, 1)
    return first, second


def backward_pass(
    lines: IntervalLines, last_x: float, first: int = 0, stop: int | None = None, *, known: Array | None = None
) -> Array:
    """Largest squared speeds at grid points first..stop from which `last_x` at `stop` (or less) is reachable.

    `known` (stop - first + 1,): those from another end; where both meet, the rest is the same and taken from there.
    Returns (stop - first + 1,).
    """
    stop = len(lines.length) if stop is None else stop
    reach = np.empty(stop - first + 1)
    y = last_x
    for begin in range(stop, first, -_BLOCK):
        end = max(first, begin - _BLOCK)
        rows = slice(end, begin)
        few = _few(lines.alpha[rows][::-1], lines.beta[rows][::-1])
        caps = (lines.peak_x[rows][::-1].tolist(), lines.peak_y[rows][::-1].tolist(), lines.y_cap[rows][::-1].tolist())
        found = []
        for a0, a1, a2, a3, b0, b1, b2, b3, others, peak_x, peak_y, y_cap in zip(*few, *caps, strict=True):
            if y > y_cap:
                y = y_cap
            found.append(y)
            if y >= peak_y:
                y = peak_x
                continue
            x, other = a0 + b0 * y, a1 + b1 * y
            if other < x:
                x = other
            other = a2 + b2 * y
            if other < x:
                x = other
            other = a3 + b3 * y
            if other < x:
                x = other
            if others is not None:
                x = min(x, *(a + b * y for a, b in others))
            y = peak_x if x > peak_x else x if x > 0.0 else 0.0
        reach[end + 1 - first : begin + 1 - first] = found[::-1]
        if known is not None and known[end - first] == y:
            reach[: end + 1 - first] = known[: end + 1 - first]
            return reach
    reach[0] = y
    return reach


def forward_pass(lines: IntervalLines, first_x: float, reach: Array, first: int = 0) -> Array:
    """The fastest squared speeds from `first_x` at grid point `first` on that stay within `reach`; (len(reach),)."""
    x = min(first_x, float(reach[0]))
    speeds = [x]
    for begin in range(0, len(reach) - 1, _BLOCK):
        end = min(begin + _BLOCK, len(reach) - 1)
        rows = slice(first + begin, first + end)
        bounds = reach[begin + 1 : end + 1].tolist()
        few = _few(lines.gamma[rows], lines.delta[rows])
        for c0, c1, c2, c3, d0, d1, d2, d3, others, bound in zip(*few, bounds, strict=True):
            y, other = c0 + d0 * x, c1 + d1 * x
            if other < y:
                y = other
            other = c2 + d2 * x
            if other < y:
                y = other
            other = c3 + d3 * x
            if other < y:
                y = other
            if others is not None:
                y = min(y, *(c + d * x for c, d in others))
            x = bound if y >= bound else y if y > 0.0 else 0.0
            speeds.append(x)
    return np.array(speeds)


def _few(offsets: Array, slopes: Array) -> list[list[Any]]:
    """The first four offsets and slopes of each interval, then the others as pairs, None where there are none."""
    columns: list[list[Any]] = [*offsets[:, :4].T.tolist(), *slopes[:, :4].T.tolist()]
    others: list[list[tuple[float, float]] | None] = [None] * len(offsets)
    if offsets.shape[1] > 4:
        differ = (offsets[:, 4:] != offsets[:, 3:4]) | (slopes[:, 4:] != slopes[:, 3:4])
        for k in np.flatnonzero(differ.any(axis=1)).tolist():
            others[k] = list(zip(offsets[k, 4:].tolist(), slopes[k, 4:].tolist(), strict=True))
    return [*columns, others]


def fastest_speeds(lines: IntervalLines, first_x: float = 0.0, last_x: float = 0.0) -> Array:
    """Squared path speeds at the grid points (n + 1,) of the fastest law from `first_x` to `last_x`."""
    return forward_pass(lines, first_x, backward_pass(lines, last_x))


def law_durations(length: Array, speeds: Array) -> Array:
    """Times in s that intervals of these lengths (n,) take at these squared speeds (n + 1,) of their ends, (n,)."""
    roots = np.sqrt(speeds)
    durations: Array = 2.0 * length / (roots[:-1] + roots[1:])
    return durations


def law_duration(length: Array, speeds: Array) -> float:
    """The time in s of all of them."""
    return float(np.sum(law_durations(length, speeds)))


def stopping_lines(lines: IntervalLines, begins: Indices) -> IntervalLines:
    """The intervals with a stop before each of those at `begins`, rising, from 0: several ways as one."""
    caps = lines.y_cap.copy()
    caps[begins[1:] - 1] = 0.0
    return replace(lines, y_cap=caps)


def joined_lines(*parts: IntervalLines) -> IntervalLines:
    """The intervals of all, one part after another."""
    return IntervalLines(*(_joined([getattr(part, name) for part in parts]) for name in _NAMES))


def _joined(parts: list[Array]) -> Array:
    width = max(part.shape[-1] for part in parts)
    if parts[0].ndim == 2 and any(part.shape[1] < width for part in parts):
        parts = [np.pad(part, ((0, 0), (0, width - part.shape[1])), "edge") for part in parts]
    return np.concatenate(parts)


def sliced_lines(lines: IntervalLines, first: int, stop: int | None = None) -> IntervalLines:
    """The intervals from `first` to before `stop`."""
    return IntervalLines(*(getattr(lines, name)[first:stop] for name in _NAMES))

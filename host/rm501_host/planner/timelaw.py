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
  at which x is largest of all (`peak_y`); then it is that largest x (`peak_x`). `peak_x` comes from eliminating y
  from all pairs of strips (Fourier, Motzkin), vectorised over the grid;
* forwards: the largest y for a given x is the lowest of y <= gamma_i + delta_i x, and at most reach_{k+1}.

What lies between the grid points is covered by `widening`: see `constraints.py`, which narrows each C_i by what the
limit's left side can rise between the two ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TINY = 1e-9
_AT_ONCE = 8192
"""Pairs of rows times intervals that are worked out in one array: beyond, it leaves the cache."""
_DEAD_END = 0.01
"""An interval whose largest x leads to less than this share of its largest y is a dead end (tiny blends have some)."""


@dataclass(frozen=True, slots=True)
class IntervalTable:
    """Intervals of the grid as strips |p x + q y| <= c in the squared speeds x, y at their two ends.

    `p`, `q`, `c`: (n, rows); `length`: (n,), in the path's unit; `x_cap`, `y_cap`: (n,), squared path speeds.
    """

    length: Array
    p: Array
    q: Array
    c: Array
    x_cap: Array
    y_cap: Array


@dataclass(frozen=True, slots=True)
class IntervalLines:
    """The strips solved for either end: x <= alpha + beta y and y <= gamma + delta x, (n, rows), and the peak."""

    length: Array
    alpha: Array
    beta: Array
    gamma: Array
    delta: Array
    peak_x: Array
    peak_y: Array
    y_cap: Array


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

    `first_a`, `first_b`, `last_a`, `last_b`, `limit`: (n, rows); `length`, `x_cap`, `y_cap`: (n,).
    """
    half_slope = 0.5 / length[:, None]
    p = np.concatenate((first_b - first_a * half_slope, -last_a * half_slope), axis=1)
    q = np.concatenate((first_a * half_slope, last_b + last_a * half_slope), axis=1)
    return IntervalTable(length, p, q, np.concatenate((limit, limit), axis=1), x_cap, y_cap)


def solve_lines(table: IntervalTable) -> IntervalLines:
    """Solve the strips for x and for y and find the largest x of each interval with the least y that allows it."""
    p, q, c = table.p, table.q, table.c
    size_p, size_q = np.abs(p), np.abs(q)
    peak_x, top_y = _extents(table, size_p, size_q)
    # a strip that hardly depends on x (or y) within those extents is no bound on it: solving for it would cancel
    uses_x = size_p * peak_x[:, None] > _TINY * c
    uses_y = size_q * top_y[:, None] > _TINY * c
    safe_p = np.where(uses_x, p, 1.0)
    safe_q = np.where(uses_y, q, 1.0)
    alpha = np.where(uses_x, c / np.abs(safe_p), np.inf)
    beta = np.where(uses_x, -q / safe_p, 0.0)
    gamma = np.where(uses_y, c / np.abs(safe_q), np.inf)
    delta = np.where(uses_y, -p / safe_q, 0.0)
    least_y = np.where(uses_y, -gamma + delta * peak_x[:, None], -np.inf).max(axis=1)
    peak_y = np.clip(least_y, 0.0, table.y_cap)
    return IntervalLines(table.length, alpha, beta, gamma, delta, peak_x, peak_y, table.y_cap)


def without_dead_ends(lines: IntervalLines) -> IntervalLines:
    """The lines with a little less than the largest x where that leads to rest alone, so that every law goes on.

    The fastest pass would come to rest in the middle of a path there, and a law at rest inside it never ends.
    """
    most_y = (lines.gamma + lines.delta * lines.peak_x[:, None]).min(axis=1)
    top_y = np.minimum(lines.gamma.min(axis=1), lines.y_cap)
    return replace(lines, peak_x=np.where(most_y < _DEAD_END * top_y, 0.9 * lines.peak_x, lines.peak_x))


def _extents(table: IntervalTable, size_p: Array, size_q: Array) -> tuple[Array, Array]:
    """Largest x and largest y of each interval's set, (n,) each, by eliminating the other from all pairs of strips."""
    p, q, c, size_p, size_q = (np.ascontiguousarray(rows.T) for rows in (table.p, table.q, table.c, size_p, size_q))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        rise_x = np.maximum(-np.sign(p) * q * table.y_cap, 0.0)
        rise_y = np.maximum(-np.sign(q) * p * table.x_cap, 0.0)
        alone_x = np.where(size_p > 0.0, (c + rise_x) / size_p, np.inf).min(axis=0)
        alone_y = np.where(size_q > 0.0, (c + rise_y) / size_q, np.inf).min(axis=0)
    paired_x, paired_y = _eliminated(p, q, c, size_q, size_p)
    return np.minimum(np.minimum(table.x_cap, alone_x), paired_x), np.minimum(
        np.minimum(table.y_cap, alone_y), paired_y
    )


def mvc(a: Array, b: Array, limit: Array, x_cap: Array) -> Array:
    """Largest squared speed at single points where some u satisfies |a u + b x| <= limit; (rows, n) -> (n,)."""
    size_a = np.abs(a)
    (paired,) = _eliminated(a, b, limit, size_a)
    no_u = (size_a == 0.0) & (b != 0.0)
    best: Array = np.minimum(x_cap, paired)
    if no_u.any():
        np.minimum(best, np.where(no_u, limit / np.where(no_u, np.abs(b), 1.0), np.inf).min(axis=0), out=best)
    return best


def _eliminated(p: Array, q: Array, c: Array, *weights: Array) -> list[Array]:
    """The least of (c_i w_j + c_j w_i) / |p_i q_j - p_j q_i| over all pairs of rows, for each of the weights w.

    All (rows, n) -> (n,): the columns lie side by side in memory, which is what makes this fast.
    """
    rows, count = p.shape
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        if rows * (rows - 1) // 2 * count <= _AT_ONCE:
            i, j = _pairs(rows)
            determinant = np.abs(p[i] * q[j] - p[j] * q[i])
            return [np.fmin.reduce((c[i] * w[j] + c[j] * w[i]) / determinant, axis=0, initial=np.inf) for w in weights]
        least = [np.full(count, np.inf) for _ in weights]
        for first in range(rows - 1):
            rest = slice(first + 1, rows)
            determinant = np.abs(p[first] * q[rest] - p[rest] * q[first])
            for best, w in zip(least, weights, strict=True):
                bounds = (c[first] * w[rest] + c[rest] * w[first]) / determinant
                np.fmin(best, np.fmin.reduce(bounds, axis=0, initial=np.inf), out=best)
        return least


@cache
def _pairs(rows: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(rows, 1)
    return first, second


def backward_pass(lines: IntervalLines, last_x: float, first: int = 0, stop: int | None = None) -> Array:
    """Largest squared speeds at grid points first..stop from which `last_x` at `stop` (or less) is reachable.

    Returns (stop - first + 1,).
    """
    stop = len(lines.length) if stop is None else stop
    reach = np.empty(stop - first + 1)
    alpha, beta = lines.alpha, lines.beta
    peak_x, peak_y = lines.peak_x.tolist(), lines.peak_y.tolist()
    y_caps = lines.y_cap.tolist()
    lowest = np.minimum.reduce
    y = last_x
    for k in range(stop - 1, first - 1, -1):
        y = min(y, y_caps[k])
        reach[k + 1 - first] = y
        if y >= peak_y[k]:
            y = peak_x[k]
        else:
            x = float(lowest(alpha[k] + beta[k] * y))
            y = min(max(x, 0.0), peak_x[k])
    reach[0] = y
    return reach


def forward_pass(lines: IntervalLines, first_x: float, reach: Array, first: int = 0) -> Array:
    """The fastest squared speeds from `first_x` at grid point `first` on that stay within `reach`; (len(reach),)."""
    speeds = np.empty(len(reach))
    gamma, delta = lines.gamma, lines.delta
    bounds = reach.tolist()
    lowest = np.minimum.reduce
    x = min(first_x, bounds[0])
    speeds[0] = x
    for k in range(len(reach) - 1):
        y = float(lowest(gamma[first + k] + delta[first + k] * x))
        bound = bounds[k + 1]
        x = bound if y >= bound else max(y, 0.0)
        speeds[k + 1] = x
    return speeds


def fastest_speeds(lines: IntervalLines, first_x: float = 0.0, last_x: float = 0.0) -> Array:
    """Squared path speeds at the grid points (n + 1,) of the fastest law from `first_x` to `last_x`."""
    return forward_pass(lines, first_x, backward_pass(lines, last_x))


def law_duration(length: Array, speeds: Array) -> float:
    """Time in s that intervals of these lengths (n,) take at these squared speeds (n + 1,) of their ends."""
    roots = np.sqrt(speeds)
    return float(np.sum(2.0 * length / (roots[:-1] + roots[1:])))


def joined_lines(first: IntervalLines, second: IntervalLines) -> IntervalLines:
    """The intervals of both, one after another."""
    return IntervalLines(
        *(np.concatenate((getattr(first, name), getattr(second, name))) for name in IntervalLines.__dataclass_fields__)
    )


def sliced_lines(lines: IntervalLines, first: int, stop: int | None = None) -> IntervalLines:
    """The intervals from `first` to before `stop`."""
    return IntervalLines(*(getattr(lines, name)[first:stop] for name in IntervalLines.__dataclass_fields__))

"""Slowing down a base law where its average breaks a limit (`jerk`, `jerk_window`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .elements import Array, Indices
from .timelaw import IntervalLines


def slowed(lines: IntervalLines, scale: Array, cap: Array) -> IntervalLines:
    """The limits with accelerations times `scale` and squared speeds at most `cap`, (n,) each."""
    column = scale[:, None]
    return replace(
        lines,
        alpha=lines.alpha * column,
        gamma=lines.gamma * column,
        peak_x=np.minimum(lines.peak_x * scale, cap),
        peak_y=lines.peak_y * scale,
        y_cap=np.minimum(lines.y_cap, cap),
    )


def needed_scale(lines: IntervalLines, squared: Array) -> Array:
    """The least share of the accelerations with which a law (m + 1,) of the first m intervals is possible, (m,)."""
    count = len(squared) - 1
    x, y = squared[:-1, None], squared[1:, None]
    first = ((x - lines.beta[:count] * y) / lines.alpha[:count]).max(axis=1)
    last = ((y - lines.delta[:count] * x) / lines.gamma[:count]).max(axis=1)
    share: Array = np.clip(np.maximum(np.maximum(first, last), squared[:-1] / lines.peak_x[:count]) * 1.001, 0.0, 1.0)
    return share


def slowdown_of_intervals(base_s: Array, times: Array, ratios: Array, window_s: float) -> Array:
    """The largest of the `ratios` (n,) at `times` (n,) whose averages over the window contain each interval of the base
    law, whose grid points are passed at `base_s` (m + 1,); (m,), at least 1.
    """
    first = np.searchsorted(times, base_s[:-1], side="left")
    last = np.searchsorted(times, base_s[1:] + window_s, side="right")
    return np.maximum(_largest(ratios, first, last), 1.0)


def _largest(values: Array, first: Indices, last: Indices) -> Array:
    """The largest of `values` from each of `first` to before each of `last` (n,); 0 where there are none.

    Every range is covered by two that may overlap, whose lengths are a power of two.
    """
    sizes = np.maximum(last - first, 1)
    level = np.frexp(sizes.astype(np.float64))[1] - 1
    result = np.zeros(len(first))
    row, span = values, 1
    for k in range(int(level.max(initial=0)) + 1):
        here = np.flatnonzero((level == k) & (last > first))
        result[here] = np.maximum(row[first[here]], row[last[here] - span])
        row = np.maximum(row[:-span], row[span:]) if len(row) > span else row
        span *= 2
    return result

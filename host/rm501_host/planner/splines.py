"""NURBS curves (G5, G5.1, G5.2) parametrised by their arc length.

The curve is evaluated by de Boor's algorithm in homogeneous coordinates. Its arc length over each knot span comes
from Gauss-Legendre quadrature on subdivisions that are halved until two orders agree to 1e-12 of the span; s is
inverted by Newton's method from a table, so |dp/ds| = 1 up to rounding:

    du/ds = 1 / |p_u|,     d2u/ds2 = -(p_u . p_uu) / |p_u|^4
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from .elements import Array, Indices

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NEWTON_STEPS = 8
_SHORTEST_SPEED = 1e-9


class SplineCurve:
    """A NURBS curve in space with constant pitch and roll; `length_mm` is its arc length.

    `points_mm` (n, 3) and `weights` (n,); `knots` (n + degree + 1,), non-decreasing; `angles_deg`: pitch, roll.
    Raises ValueError for data that describe no curve.
    """

    def __init__(
        self,
        points_mm: Array,
        weights: Sequence[float],
        knots: Sequence[float],
        degree: int,
        angles_deg: tuple[float, float],
    ) -> None:
        n = len(points_mm)
        if len(weights) != n or len(knots) != n + degree + 1 or n < degree + 1 or degree < 1:
            raise ValueError(
                f"{n} points, {len(weights)} weights and {len(knots)} knots make no curve of degree {degree}"
            )
        if min(weights) <= 0.0:
            raise ValueError("a weight is not above 0")
        weight = np.array(weights, dtype=np.float64)[:, None]
        self._poles = np.concatenate((points_mm * weight, weight), axis=1)
        self._knots = np.array(knots, dtype=np.float64)
        self._degree = degree
        self._angles = angles_deg
        low, high = float(self._knots[degree]), float(self._knots[n])
        if not high > low:
            raise ValueError("the knots span nothing")
        spans = np.unique(np.clip(self._knots, low, high))
        breaks = np.concatenate([np.linspace(a, b, 33)[:-1] for a, b in pairwise(spans.tolist())])
        self._u = np.append(breaks, high)
        pieces = self._lengths(self._u[:-1], self._u[1:])
        self._s = np.concatenate((np.zeros(1), np.cumsum(pieces)))
        self.length_mm = float(self._s[-1])

    def _lengths(self, a: Array, b: Array) -> Array:
        half = 0.5 * (b - a)
        u = (0.5 * (a + b))[:, None] + half[:, None] * _NODES
        _, first, _ = self._at(u.ravel())
        speed = np.linalg.norm(first, axis=1).reshape(u.shape)
        lengths: Array = half * (speed @ _WEIGHTS)
        return lengths

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives with respect to the arc length, each (n, 5)."""
        inside = np.clip(s, 0.0, self.length_mm)
        k = np.clip(np.searchsorted(self._s, inside, side="right") - 1, 0, len(self._u) - 2)
        low, high = self._u[k], self._u[k + 1]
        share = (inside - self._s[k]) / np.maximum(self._s[k + 1] - self._s[k], 1e-300)
        u = low + share * (high - low)
        for _ in range(_NEWTON_STEPS):
            _, first, _ = self._at(u)
            speed = np.maximum(np.linalg.norm(first, axis=1), _SHORTEST_SPEED)
            error = self._s[k] + self._lengths(low, u) - inside
            step = error / speed
            u = np.clip(u - step, low, high)
            if float(np.abs(error).max(initial=0.0)) < 1e-12 * max(1.0, self.length_mm):
                break
        place, first, second = self._at(u)
        speed = np.maximum(np.linalg.norm(first, axis=1), _SHORTEST_SPEED)[:, None]
        tangent = first / speed
        bend = second / speed**2 - tangent * (np.einsum("ni,ni->n", first, second)[:, None] / speed**3)
        n = len(s)
        values, slopes, bends = np.zeros((n, 5)), np.zeros((n, 5)), np.zeros((n, 5))
        values[:, :3], slopes[:, :3], bends[:, :3] = place, tangent, bend
        values[:, 3], values[:, 4] = self._angles
        return values, slopes, bends

    def _at(self, u: Array) -> tuple[Array, Array, Array]:
        """Point, first and second derivative (n, 3) with respect to the knot parameter u (n,)."""
        p, knots = self._degree, self._knots
        count = len(self._poles)
        span: Indices = np.clip(np.searchsorted(knots, u, side="right") - 1, p, count - 1).astype(np.intp)
        # a span of zero length at the very end: step back to the last real one
        while True:
            empty = (knots[span + 1] <= knots[span]) & (span > p)
            if not empty.any():
                break
            span = np.where(empty, span - 1, span)
        h0 = self._de_boor(self._poles, span, u, p)
        h1 = self._derivative(span, u, 1)
        h2 = self._derivative(span, u, 2)
        w, w1, w2 = h0[:, 3:], h1[:, 3:], h2[:, 3:]
        place = h0[:, :3] / w
        first = (h1[:, :3] - w1 * place) / w
        second = (h2[:, :3] - 2.0 * w1 * first - w2 * place) / w
        return place, first, second

    def _de_boor(self, poles: Array, span: Indices, u: Array, degree: int) -> Array:
        index = span[:, None] - degree + np.arange(degree + 1)
        d = poles[index]
        knots = self._knots
        for r in range(1, degree + 1):
            for j in range(degree, r - 1, -1):
                left = knots[index[:, j]]
                right = knots[index[:, j] + degree - r + 1]
                alpha = ((u - left) / np.where(right > left, right - left, 1.0))[:, None]
                d[:, j] = (1.0 - alpha) * d[:, j - 1] + alpha * d[:, j]
        result: Array = d[:, degree]
        return result

    def _derivative(self, span: Indices, u: Array, order: int) -> Array:
        p, knots = self._degree, self._knots
        if order > p:
            return np.zeros((len(u), 4))
        index = span[:, None] - p + np.arange(p + 1)
        d = self._poles[index]
        degree = p
        for _ in range(order):
            # Q_i = p (P_{i+1} - P_i) / (t_{i+p+1} - t_{i+1})
            low = knots[index[:, 1:]]
            high = knots[index[:, 1:] + degree]
            gap = np.where(high > low, high - low, 1.0)[:, :, None]
            d = degree * (d[:, 1:] - d[:, :-1]) / gap
            index = index[:, 1:]
            degree -= 1
        # the derivative's control points, blended by de Boor with the same knots
        for r in range(1, degree + 1):
            for j in range(degree, r - 1, -1):
                left = knots[index[:, j]]
                right = knots[index[:, j] + degree - r + 1]
                alpha = ((u - left) / np.where(right > left, right - left, 1.0))[:, None]
                d[:, j] = (1.0 - alpha) * d[:, j - 1] + alpha * d[:, j]
        result: Array = d[:, degree]
        return result

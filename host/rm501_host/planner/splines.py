"""NURBS curves (G5, G5.1, G5.2) parametrised by their arc length.

The curve is evaluated in homogeneous coordinates, from its polynomials on the knot spans (from the derivatives at their
beginnings, by de Boor's algorithm). Its arc length comes from Gauss-Legendre
quadrature of order 12 on parts of the knot spans that are halved until that changes the length by less than 1e-13 of
the whole (or of the coordinates); s is inverted by Newton's method from a table, so |dp/ds| = 1 up to rounding:

    du/ds = 1 / |p_u|,     d2u/ds2 = -(p_u . p_uu) / |p_u|^4

A curve may have corners inside: at knots that are repeated, at cusps and where control points coincide (p_u = 0).
`smooth_parts` cuts it there, and where the curvature jumps, so that each part is smooth and a corner is what it is
anywhere else: a stop, or a blend. A part of which an end has p_u = 0 takes its derivatives a little beside that end.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import factorial, sqrt

import numpy as np

from .elements import Array, Indices

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NEWTON_STEPS = 40
"""Two or three where p_u is not small; near p_u = 0 the step only halves the way."""
_SHORTEST_SPEED = 1e-9
_STATIONARY = 1e-6
"""|p_u| below this share of its mean counts as 0."""
_BESIDE = 1e-5
"""How far beside p_u = 0 derivatives are taken, of the part's parameter range."""
_CORNER = 1e-7
"""Tangents that differ by more than this (rad) make a corner."""
_CURVATURE_JUMP = 1e-7
"""Curvatures that differ by more than this share make a jump."""
_SAMPLES = 32
_GOLDEN_STEPS = 80
_HALVINGS = 24


class SplineCurve:
    """A NURBS curve in space with constant pitch and roll; `length_mm` is its arc length.

    `points_mm` (n, 3) and `weights` (n,); `knots` (n + degree + 1,), non-decreasing; `angles_deg`: pitch, roll;
    `between`: the part of the knot parameter that is meant, else all of it. Raises ValueError for data that describe
    no curve.
    """

    def __init__(
        self,
        points_mm: Array,
        weights: Sequence[float],
        knots: Sequence[float],
        degree: int,
        angles_deg: tuple[float, float],
        between: tuple[float, float] | None = None,
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
        low, high = between or (low, high)
        self._low, self._high = low, high
        # the knot spans that the part lies in: its ends belong to them, not to their neighbours
        self._first_span = max(degree, int(np.searchsorted(self._knots, low, side="right")) - 1)
        self._last_span = min(n - 1, int(np.searchsorted(self._knots, high, side="left")) - 1)
        self._widths = np.diff(self._knots)
        self._polynomials = self._expanded()
        self._beside_low = self._beside_high = 0.0
        self._spans = np.unique(np.clip(self._knots, low, high))
        breaks = np.concatenate([np.linspace(a, b, _SAMPLES + 1)[:-1] for a, b in pairwise(self._spans.tolist())])
        self._u, pieces = self._measured(np.append(breaks, high))
        self._s = np.concatenate((np.zeros(1), np.cumsum(pieces)))
        self.length_mm = float(self._s[-1])
        least = _STATIONARY * self.length_mm / (high - low)
        ends = self._speeds(np.array([low, high]))
        beside = _BESIDE * (high - low)
        self._beside_low, self._beside_high = (beside if speed <= least else 0.0 for speed in ends.tolist())

    def smooth_parts(self) -> list[SplineCurve]:
        """The curve in parts that are smooth inside: no corners, no jumps of curvature. In order; itself if it is."""
        places = [self._low, *self._breaks(), self._high]
        if len(places) == 2:
            return [self]
        parts = [self._part(a, b) for a, b in pairwise(places)]
        return [part for part in parts if part.length_mm > 0.0]

    def _part(self, low: float, high: float) -> SplineCurve:
        weights = self._poles[:, 3]
        points = self._poles[:, :3] / weights[:, None]
        return SplineCurve(points, weights.tolist(), self._knots.tolist(), self._degree, self._angles, (low, high))

    def _breaks(self) -> list[float]:
        """Parameters inside at which it has to be cut, rising."""
        speeds = self._speeds(self._u)
        least = _STATIONARY * self.length_mm / (self._high - self._low)
        found = [u for u in self._slowest(speeds) if float(self._speeds(np.array([u]))[0]) <= least]
        for before, knot, after in zip(self._spans[:-2], self._spans[1:-1], self._spans[2:], strict=True):
            if int((self._knots == knot).sum()) >= self._degree - 1 and not self._is_smooth_at(before, knot, after):
                found.append(float(knot))
        width = self._high - self._low
        kept: list[float] = []
        for u in sorted(found):
            if u - (kept[-1] if kept else self._low) > _BESIDE * width and self._high - u > _BESIDE * width:
                kept.append(u)
        return kept

    def _slowest(self, speeds: Array) -> list[float]:
        """Knots, and places between where |p_u| has a minimum that may be 0."""
        found: list[float] = self._spans[1:-1].tolist()
        mean = self.length_mm / (self._high - self._low)
        dips = np.flatnonzero(
            (speeds[1:-1] <= speeds[:-2]) & (speeds[1:-1] <= speeds[2:]) & (speeds[1:-1] < 0.1 * mean)
        )
        ratio = 0.5 * (sqrt(5.0) - 1.0)
        for k in dips.tolist():
            low, high = float(self._u[k]), float(self._u[k + 2])
            for _ in range(_GOLDEN_STEPS):
                a, b = high - ratio * (high - low), low + ratio * (high - low)
                first, second = self._speeds(np.array([a, b])).tolist()
                low, high = (low, b) if first < second else (a, high)
            found.append(0.5 * (low + high))
        return found

    def _is_smooth_at(self, before: float, knot: float, after: float) -> bool:
        """Whether tangent and curvature are the same on both sides."""
        sides = []
        for a, b in ((before, knot), (knot, after)):
            part = self._part(a, b)
            _, slopes, bends = part.evaluate(np.array([part.length_mm if b == knot else 0.0]))
            sides.append((slopes[0], bends[0]))
        (slope, bend), (other_slope, other_bend) = sides
        size = max(float(np.abs(bend).max()), float(np.abs(other_bend).max()), 1e-12)
        return bool(
            np.abs(slope - other_slope).max() <= _CORNER and np.abs(bend - other_bend).max() <= _CURVATURE_JUMP * size
        )

    def _speeds(self, u: Array) -> Array:
        h0, h1, _ = self._homogeneous(u)
        first = (h1[:, :3] - h1[:, 3:] * (h0[:, :3] / h0[:, 3:])) / h0[:, 3:]
        speeds: Array = np.sqrt(np.einsum("ni,ni->n", first, first))
        return speeds

    def _measured(self, u: Array) -> tuple[Array, Array]:
        """Parameters from `u` with halves where needed, and the lengths between them."""
        pieces = self._lengths(u[:-1], u[1:])
        # below what the coordinates are rounded to there is nothing to be gained
        least = 1e-13 * max(float(pieces.sum()), float(np.abs(self._poles).max()))
        fresh = np.ones(len(pieces), dtype=bool)
        for _ in range(_HALVINGS):
            a, b = u[:-1][fresh], u[1:][fresh]
            middle = 0.5 * (a + b)
            first, second = self._lengths(a, middle), self._lengths(middle, b)
            rough = np.abs(first + second - pieces[fresh]) > least
            if not rough.any():
                break
            at = np.flatnonzero(fresh)[rough]
            u = np.insert(u, at + 1, middle[rough])
            pieces[at] = second[rough]
            pieces = np.insert(pieces, at, first[rough])
            halves = at + np.arange(len(at))
            fresh = np.zeros(len(pieces), dtype=bool)
            fresh[halves] = fresh[halves + 1] = True
        return u, pieces

    def _lengths(self, a: Array, b: Array) -> Array:
        half = 0.5 * (b - a)
        u = (0.5 * (a + b))[:, None] + half[:, None] * _NODES
        speed = self._speeds(u.ravel()).reshape(u.shape)
        lengths: Array = half * (speed @ _WEIGHTS)
        return lengths

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        """Values, first and second derivatives with respect to the arc length, each (n, 5)."""
        inside = np.clip(s, 0.0, self.length_mm)
        k = np.clip(np.searchsorted(self._s, inside, side="right") - 1, 0, len(self._u) - 2)
        low, high = self._u[k], self._u[k + 1]
        share = (inside - self._s[k]) / np.maximum(self._s[k + 1] - self._s[k], 1e-300)
        u = low + share * (high - low)
        left = np.arange(len(u))
        for _ in range(_NEWTON_STEPS):
            start, guess = low[left], u[left]
            error = self._s[k[left]] + self._lengths(start, guess) - inside[left]
            step = error / np.maximum(self._speeds(guess), _SHORTEST_SPEED)
            u[left] = np.clip(guess - step, start, high[left])
            left = left[(np.abs(error) >= 1e-12 * max(1.0, self.length_mm)) & (u[left] != guess)]
            if not len(left):
                break
        place, first, second = self._at(u)
        if self._beside_low or self._beside_high:
            beside = np.clip(u, self._low + self._beside_low, self._high - self._beside_high)
            _, first, second = self._at(beside)
        speed = np.maximum(np.linalg.norm(first, axis=1), _SHORTEST_SPEED)[:, None]
        tangent = first / speed
        bend = second / speed**2 - tangent * (np.einsum("ni,ni->n", first, second)[:, None] / speed**3)
        n = len(s)
        values, slopes, bends = np.zeros((n, 5)), np.zeros((n, 5)), np.zeros((n, 5))
        values[:, :3], slopes[:, :3], bends[:, :3] = place, tangent, bend
        values[:, 3], values[:, 4] = self._angles
        return values, slopes, bends

    def _span_of(self, u: Array) -> Indices:
        knots = self._knots
        found = np.clip(np.searchsorted(knots, u, side="right") - 1, self._first_span, self._last_span)
        span: Indices = found.astype(np.intp)
        # a span of zero length at the very end: step back to the last real one
        while True:
            empty = (knots[span + 1] <= knots[span]) & (span > self._degree)
            if not empty.any():
                return span
            span = np.where(empty, span - 1, span)

    def _at(self, u: Array) -> tuple[Array, Array, Array]:
        """Point, first and second derivative (n, 3) with respect to the knot parameter u (n,)."""
        h0, h1, h2 = self._homogeneous(u)
        w, w1, w2 = h0[:, 3:], h1[:, 3:], h2[:, 3:]
        place = h0[:, :3] / w
        first = (h1[:, :3] - w1 * place) / w
        second = (h2[:, :3] - 2.0 * w1 * first - w2 * place) / w
        return place, first, second

    def _homogeneous(self, u: Array) -> tuple[Array, Array, Array]:
        """Homogeneous point, first and second derivative (n, 4) with respect to u (n,), by Horner's rule from the
        nearer end of the knot span: so nothing cancels where control points coincide.
        """
        span = self._span_of(u)
        width = self._widths[span]
        is_late = u - self._knots[span] > 0.5 * width
        t = ((u - self._knots[span + is_late]) / width)[:, None]
        index = 2 * span + is_late
        value = self._polynomials[-1][index]
        first, second = np.zeros_like(value), np.zeros_like(value)
        for coefficients in self._polynomials[-2::-1]:
            second = second * t + first
            first = first * t + value
            value = value * t + coefficients[index]
        scale = 1.0 / width[:, None]
        return value, first * scale, 2.0 * second * scale**2

    def _expanded(self) -> Array:
        """Coefficients (degree + 1, 2 spans, 4) of the powers of (u - knot) / width about both ends of every knot span
        in use.
        """
        found = np.zeros((self._degree + 1, 2 * (self._last_span + 1), 4))
        for k in range(self._first_span, self._last_span + 1):
            width = float(self._widths[k])
            if width <= 0.0:
                continue
            span = np.array([k], dtype=np.intp)
            for side in (0, 1):
                u, row = self._knots[k + side : k + side + 1], 2 * k + side
                found[0, row] = self._de_boor(self._poles, span, u, self._degree)[0]
                for order in range(1, self._degree + 1):
                    found[order, row] = self._derivative(span, u, order)[0] * width**order / factorial(order)
        return found

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

"""Clock synchronisation: where the board's clock is, seen from the host's, and how well that is known.

Theory of operation. A query leaves the host at t0, arrives at the board at t1, the reply leaves it at t2 and arrives
at t3. With the offset theta = board - host, both one-way measurements are bounded by delays that can only be too
long::

    f = t1 - t0 =  theta + d_out     with d_out >= its minimum
    b = t3 - t2 = -theta + d_in      with d_in  >= its minimum

Over a window theta is a line, theta(t) = c + s t. For a slope s let F(s) = min(f - s t) and B(s) = min(b + s t), each
direction's own lower envelope. F(s) + B(s) is the smallest round trip that the slope leaves; a wrong slope tilts the
envelopes and makes it smaller. It is concave in s, so its maximum (the tightest pair of parallel lines that all
measurements allow) is found by a search, and

    c = (F(s) - B(s)) / 2.

Each direction needs only its own quick packets, not both in the same round trip, so it converges faster than a
regression over the smallest round trips; and delayed packets, however many, cannot pull a lower envelope. What no
two-way method can see is a constant difference between the two minimal delays: half of it remains as an error; half
the smallest round trip bounds it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

__all__ = ["ClockEstimator", "ClockQuality"]

WINDOW_SAMPLES = 600
"""60 s at 10 Hz: long enough to meet quick packets in both directions, short enough for a wandering oscillator."""
MAX_DRIFT_PPM = 500.0
_JUMP_US, _JUMP_EARLY_US = 200, 500
"""A measurement too quick by more than this, in one direction, is evidence for a jump of a clock; the second while the
envelopes still settle.
"""
_JUMP_SAMPLES = 3
_ACQUIT_SAMPLES = 30
"""So many ordinary measurements after a suspicious one acquit it."""
_SETTLED_SAMPLES = 10
_ENVELOPE_SAMPLES = 100
_REFIT_SAMPLES = 20
"""Samples after which the fit that jumps are judged by is made anew, even if nobody asks for it."""
_SLOPE_SPAN_US = 8_000_000
"""Measurements over less time than this give a worse drift than the one known from before a jump."""
_BIAS_RANK = 6
_BIAS = 2.5
"""Between 1 (delays with an exponential tail) and 3.5 (sums of two such, as with a polling host): `_lower_end`."""
_WRAP = 1 << 32


@dataclass(frozen=True, slots=True)
class ClockQuality:
    """How good the estimate is, for the user to read."""

    samples: int
    """Measurements in the window."""
    drift_ppm: float
    """How much faster the board's clock runs."""
    min_round_trip_us: float
    """Smallest round trip that the window's envelopes allow."""
    bound_us: float
    """The offset is known to be at most this wrong, whatever the two directions' delays are."""
    jumps: int
    """Jumps of a clock seen so far."""
    last_jump_us: float
    """Size of the last one, board against host."""


@dataclass(frozen=True, slots=True)
class _Fit:
    reference_us: int
    offset_us: float  # at reference_us, relative to _base
    slope: float
    envelope_out_us: float
    envelope_in_us: float


class ClockEstimator:
    """Estimates the board's clock from two-way stamps. Host clocks are integer microseconds and never wrap; the
    board's ticks are u32.

    `ticks_per_us` is the board's clock rate divided by 1e6 (`Identify.clock_hz`).
    """

    def __init__(self, ticks_per_us: float = 1.0) -> None:
        self._ticks_per_us = ticks_per_us
        self._samples: deque[tuple[int, int, int]] = deque(maxlen=WINDOW_SAMPLES)  # t, f, b; microseconds
        self._fit: _Fit | None = None
        self._fresh = False
        self._last_ticks: int | None = None
        self._held: list[tuple[int, int, int]] = []
        self._unsuspected = 0
        self._unfitted = 0
        self._known_slope: float | None = None  # survives a jump: the oscillator is still the same
        self._last_suspect_us = 0.0
        self._jumps = 0
        self._last_jump_us = 0.0

    def restart(self, ticks_per_us: float | None = None) -> None:
        """Forget everything but the count of jumps: a new board, or one that restarted; perhaps with another rate."""
        if ticks_per_us is not None:
            self._ticks_per_us = ticks_per_us
        self._samples.clear()
        self._fit = None
        self._fresh = False
        self._last_ticks = None
        self._known_slope = None
        self._held.clear()

    def add(
        self,
        sent_us: int,
        received_ticks: int,
        replied_ticks: int,
        arrived_us: int,
        line_out_us: int = 0,
        line_in_us: int = 0,
    ) -> None:
        """Take one exchange: host time of the query, board ticks (u32) of its arrival and of the reply, host time of
        the reply's arrival.

        `line_out_us` and `line_in_us` are the parts of the two ways that are known to be line time; they are taken
        off.
        """
        if arrived_us < sent_us:
            return
        received = self._extend(received_ticks)
        replied = received + ((replied_ticks - received_ticks) % _WRAP)
        self._last_ticks = replied
        middle_us = (sent_us + arrived_us) // 2
        out_us = round(received / self._ticks_per_us) - sent_us - line_out_us
        in_us = arrived_us - round(replied / self._ticks_per_us) - line_in_us
        sample = (middle_us, out_us, in_us)
        if self._is_suspect(sample):
            self._held.append(sample)
            if len(self._held) < _JUMP_SAMPLES:
                return
            self._jumps += 1
            self._last_jump_us = self._last_suspect_us
            self._samples.clear()
            self._fit = None
            self._release()
        else:
            if self._held:
                self._unsuspected += 1
                if self._unsuspected > _ACQUIT_SAMPLES:
                    self._release()
            self._samples.append(sample)
        self._fresh = False
        self._unfitted += 1
        if self._unfitted >= _REFIT_SAMPLES:
            self._fitted()

    @property
    def ready(self) -> bool:
        """Whether there is an estimate."""
        return bool(self._samples)

    def board_us(self, host_us: int) -> float:
        """The board's clock, extended beyond 32 bits, in microseconds, at a host time; raises ValueError without
        samples.
        """
        fit = self._fitted()
        return host_us + fit.offset_us + fit.slope * (host_us - fit.reference_us)

    def host_us(self, board_us: float) -> float:
        """The host time at which the board's extended clock showed `board_us`; raises ValueError without samples."""
        fit = self._fitted()
        elapsed = (board_us - fit.offset_us - fit.reference_us) / (1.0 + fit.slope)
        return fit.reference_us + elapsed

    def extend_ticks(self, ticks: int) -> int:
        """The 64-bit clock nearest to the last one seen whose low 32 bits are `ticks`; right for stamps within half a
        wrap.
        """
        last = self._last_ticks
        if last is None:
            return ticks % _WRAP
        return last + ((ticks - last + _WRAP // 2) % _WRAP - _WRAP // 2)

    @property
    def quality(self) -> ClockQuality:
        """Figures for the user; zeros and an infinite bound without samples."""
        if not self._samples:
            return ClockQuality(0, 0.0, 0.0, float("inf"), self._jumps, self._last_jump_us)
        fit = self._fitted()
        trip_us = max(0.0, fit.envelope_out_us + fit.envelope_in_us)
        return ClockQuality(len(self._samples), fit.slope * 1e6, trip_us, trip_us / 2, self._jumps, self._last_jump_us)

    # ------------------------------------------------------------------------------------- inside

    def _extend(self, ticks: int) -> int:
        return self.extend_ticks(ticks)

    def _is_suspect(self, sample: tuple[int, int, int]) -> bool:
        """A jump makes one way too quick and the other too slow by the same amount; a few of a kind are one."""
        fit = self._fit
        if fit is None or len(self._samples) < _SETTLED_SAMPLES:
            return False
        time_us, out_us, in_us = sample
        theta = fit.offset_us + fit.slope * (time_us - fit.reference_us)
        spare_out = out_us - theta - fit.envelope_out_us
        spare_in = in_us + theta - fit.envelope_in_us
        settled = len(self._samples) >= _ENVELOPE_SAMPLES
        tolerance_us = (_JUMP_US if settled else _JUMP_EARLY_US) + abs(time_us - fit.reference_us) * 20e-6
        if spare_out < -tolerance_us and spare_in > tolerance_us / 2:
            size_us = spare_out
        elif spare_in < -tolerance_us and spare_out > tolerance_us / 2:
            size_us = -spare_in
        else:
            return False
        if self._held and (size_us > 0) != (self._last_suspect_us > 0):
            self._release()
        self._last_suspect_us = size_us
        return True

    def _release(self) -> None:
        """Take the suspects for what they are: ordinary samples, or the first after a jump."""
        ordered = sorted((*self._samples, *self._held))
        self._samples.clear()
        self._samples.extend(ordered)
        self._held.clear()
        self._unsuspected = 0

    def _fitted(self) -> _Fit:
        if self._fresh and self._fit is not None:
            return self._fit
        if not self._samples:
            raise ValueError("no clock samples yet")
        reference_us, base, _ = self._samples[-1]
        out = [(t - reference_us, f - base) for t, f, _ in self._samples]
        back = [(t - reference_us, b + base) for t, _, b in self._samples]
        if out[-1][0] - out[0][0] >= _SLOPE_SPAN_US:
            slope = self._known_slope = _best_slope(out, back)
        elif self._known_slope is not None:
            slope = self._known_slope
        else:
            slope = _best_slope(out, back)
        low_out = _lower_end(sorted(f - slope * t for t, f in out))
        low_in = _lower_end(sorted(b + slope * t for t, b in back))
        centre = (low_out - low_in) / 2
        self._fit = _Fit(reference_us, base + centre, slope, low_out - centre, low_in + centre)
        self._fresh = True
        self._unfitted = 0
        return self._fit


def _lower_end(values: list[float]) -> float:
    """Where the delays begin, from sorted measurements: the smallest lies above it by about what the next ones lie
    above the smallest.
    """
    rank = min(_BIAS_RANK, len(values) // 8)
    if rank < 2:
        return values[0]
    return values[0] - _BIAS * (values[rank - 1] - values[0]) / (rank - 1)


def _lower_hull(points: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The lower convex hull of points in rising order of time: all that a supporting line from below can touch."""
    hull: list[tuple[int, int]] = []
    for t, value in points:
        while len(hull) >= 2:
            (t0, v0), (t1, v1) = hull[-2], hull[-1]
            if (v1 - v0) * (t - t0) < (value - v0) * (t1 - t0):
                break
            hull.pop()
        hull.append((t, value))
    return hull


def _best_slope(out: list[tuple[int, int]], back: list[tuple[int, int]]) -> float:
    """The slope that maximises the sum of both envelopes: ternary search over a concave function."""
    span_us = out[-1][0] - out[0][0]
    if len(out) < 8 or span_us < 500_000:
        return 0.0
    low_out, low_back = _lower_hull(out), _lower_hull(back)

    def height(slope: float) -> float:
        return min(f - slope * t for t, f in low_out) + min(b + slope * t for t, b in low_back)

    low, high = -MAX_DRIFT_PPM * 1e-6, MAX_DRIFT_PPM * 1e-6
    while high - low > 0.1e-6:
        third = (high - low) / 3
        if height(low + third) < height(high - third):
            low += third
        else:
            high -= third
    return (low + high) / 2

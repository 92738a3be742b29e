"""Retransmission timeout from measured round trips, after RFC 6298, in integers."""

from __future__ import annotations

__all__ = ["RTO_FIRST_US", "RTO_MAX_US", "RTO_MIN_US", "RoundTrip"]

RTO_FIRST_US = 30_000
RTO_MAX_US = 250_000
RTO_MIN_US = 12_000
"""Below this the receiver's own scheduling (a USB adapter's 1 to 16 ms, an event loop) would look like loss."""
_GRANULARITY_US = 1_000


class RoundTrip:
    """Smoothed round trip time and its variation; `rto_us` is the timeout that follows, doubled by every `back_off`."""

    __slots__ = ("_backoff", "rttvar_us", "srtt_us")

    def __init__(self) -> None:
        self.srtt_us = 0
        """Smoothed round trip, 0 before the first sample."""
        self.rttvar_us = 0
        self._backoff = 0

    def sample(self, rtt_us: int) -> None:
        """Take a round trip of a packet that was sent once only (Karn's rule is the caller's)."""
        rtt_us = max(0, rtt_us)
        if self.srtt_us == 0:
            self.srtt_us = max(1, rtt_us)
            self.rttvar_us = rtt_us // 2
        else:
            self.rttvar_us += (abs(self.srtt_us - rtt_us) - self.rttvar_us) // 4
            self.srtt_us = max(1, self.srtt_us + (rtt_us - self.srtt_us) // 8)

    def progress(self) -> None:
        """Something new was acknowledged: take back the doubling."""
        self._backoff = 0

    def back_off(self) -> None:
        """A timeout passed: double the next one."""
        self._backoff = min(self._backoff + 1, 8)

    @property
    def rto_us(self) -> int:
        """Present timeout in microseconds."""
        base = RTO_FIRST_US
        if self.srtt_us:
            base = self.srtt_us + max(_GRANULARITY_US, 4 * self.rttvar_us)
        return min(max(base, RTO_MIN_US) << self._backoff, RTO_MAX_US)

"""A serial line as a queue in time: bytes take their time, in order, and may suffer on the way.

Sans-IO: `send` says when which bytes arrive; the caller owns the clock. Damage is drawn byte by byte from a seeded
stream, so a run repeats exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

# 8N1: start bit, eight data bits, stop bit.
BITS_PER_BYTE = 10


@dataclass(slots=True)
class LineDamage:
    """What happens to bytes on one direction of the line; probabilities per byte, times in seconds.

    What is sent before `silent_until_s` is lost; what would arrive before `frozen_until_s` arrives then.
    """

    flip_probability: float = 0.0
    drop_probability: float = 0.0
    insert_probability: float = 0.0
    duplicate_probability: float = 0.0
    delay_s: float = 0.0
    silent_until_s: float = float("-inf")
    frozen_until_s: float = float("-inf")
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def any(self) -> bool:
        """Whether bytes are touched at all (delays and silence aside)."""
        return bool(
            self.flip_probability or self.drop_probability or self.insert_probability or self.duplicate_probability
        )


class LineModel:
    """One direction of a serial line at `bytes_per_second` (None: no line time)."""

    def __init__(self, bytes_per_second: float | None, rng: np.random.Generator) -> None:
        self.bytes_per_second = bytes_per_second
        self.damage = LineDamage()
        self.bytes_sent = 0
        self._rng = rng
        self._free_at_s = float("-inf")
        self._last_arrival_s = float("-inf")

    def send(self, data: bytes, now_s: float) -> tuple[float, bytes]:
        """When the last byte of `data` arrives and what is left of it by then."""
        start_s = max(now_s, self._free_at_s)
        if self.bytes_per_second is not None:
            start_s += len(data) / self.bytes_per_second
        self._free_at_s = start_s
        self.bytes_sent += len(data)
        damage = self.damage
        if now_s < damage.silent_until_s:
            self._count("silenced", len(data))
            return start_s, b""
        if damage.any:
            data = self._harm(data)
        # Never overtakes: a delay that shrinks does not reorder a wire.
        arrival_s = max(start_s + damage.delay_s, damage.frozen_until_s, self._last_arrival_s)
        self._last_arrival_s = arrival_s
        return arrival_s, data

    def _harm(self, data: bytes) -> bytes:
        damage = self.damage
        draws = self._rng.random((len(data), 4))
        limits = (
            damage.flip_probability,
            damage.drop_probability,
            damage.insert_probability,
            damage.duplicate_probability,
        )
        if not (draws < limits).any():
            return data
        out = bytearray()
        for value, (flip, drop, insert, duplicate) in zip(data, draws.tolist(), strict=True):
            if insert < damage.insert_probability:
                out.append(int(self._rng.integers(0, 256)))
                self._count("inserted")
            if drop < damage.drop_probability:
                self._count("dropped")
                continue
            if flip < damage.flip_probability:
                value ^= 1 << int(self._rng.integers(0, 8))
                self._count("flipped")
            out.append(value)
            if duplicate < damage.duplicate_probability:
                out.append(value)
                self._count("duplicated")
        return bytes(out)

    def _count(self, what: str, number: int = 1) -> None:
        self.damage.counts[what] = self.damage.counts.get(what, 0) + number

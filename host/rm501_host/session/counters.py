"""Frame counters of the board, u32 on the wire, extended to numbers that never wrap."""

from __future__ import annotations

from rm501_protocol.motion_map import extend_u32


class FrameCounter:
    """Follows a wrapping u32 counter; right as long as two readings lie less than 2^31 apart (7.9 days of frames)."""

    def __init__(self) -> None:
        self._value: int | None = None

    @property
    def value(self) -> int:
        """The newest reading, extended; 0 before the first."""
        return self._value or 0

    def read(self, wrapped: int) -> int:
        """Take a u32 reading; a reading a little older than the newest goes back, as signed distance says."""
        self._value = self.extend(wrapped)
        return self._value

    def extend(self, wrapped: int) -> int:
        """The extended number nearest to the newest reading; does not take it."""
        return wrapped if self._value is None else extend_u32(wrapped, self._value)

"""From motion time to real time and back, as the board's status tells it.

The board advances motion time by `rate` (Q0.24) motion frames per real frame and reports both counters and the part
of a motion frame already accumulated (`phase`). Between two reports the rate is taken as constant, so the map is
exact while nothing ramps and says so otherwise.
"""

from __future__ import annotations

from .messages import RATE_ONE, Status

__all__ = ["MotionMap", "extend_u32"]

_WRAP = 1 << 32


def extend_u32(value: int, near: int) -> int:
    """The integer nearest to `near` whose low 32 bits are `value`: right for counters within half a wrap of it."""
    return near + ((value - near + _WRAP // 2) % _WRAP - _WRAP // 2)


class MotionMap:
    """Extends both frame counters to 64 bits and maps one to the other. Feed it every Status; all integers."""

    __slots__ = ("_motion", "_phase", "_rate", "_real", "ready", "steady")

    def __init__(self) -> None:
        self._real = self._motion = self._phase = self._rate = 0
        self.ready = False
        """Whether there was a status."""
        self.steady = False
        """Whether the last two reports agree with a constant rate: then predictions between them are exact."""

    def update(self, status: Status) -> None:
        """Take a status of the present session; one older than the last is ignored."""
        real = extend_u32(status.real_frame, self._real) if self.ready else status.real_frame
        motion = extend_u32(status.motion_frame, self._motion) if self.ready else status.motion_frame
        if self.ready and real < self._real:
            return
        if self.ready:
            self.steady = status.rate == self._rate and self._position(real) == (motion << 24) + status.phase
        self._real, self._motion = real, motion
        self._phase, self._rate = status.phase, status.rate
        self.ready = True

    def motion_frame_at(self, real_frame: int) -> int:
        """Motion frame (64 bits) at a real frame (64 bits), the present rate assumed; raises ValueError before the
        first status.
        """
        self._require()
        return self._position(real_frame) >> 24

    def real_frame_at(self, motion_frame: int) -> int | None:
        """First real frame (64 bits) at which motion time has reached `motion_frame`; None while motion time stands
        still short of it.
        """
        self._require()
        missing = (motion_frame << 24) - (self._motion << 24) - self._phase
        if missing <= 0:
            return self._real
        return None if self._rate == 0 else self._real - (-missing // self._rate)

    @property
    def rate(self) -> float:
        """Present rate, 1 = motion time runs as fast as real time."""
        return self._rate / RATE_ONE

    def _position(self, real_frame: int) -> int:
        return (self._motion << 24) + self._phase + (real_frame - self._real) * self._rate

    def _require(self) -> None:
        if not self.ready:
            raise ValueError("no status yet")

"""Whether what a board reports can be: counters that only go forward, positions that motion can explain.

A status may come late, behind a newer one, and is then nobody's; a board that goes on counting from there has lost
count. Between two of them motion time advances by at most a frame per real frame, and a
motor makes at most a step per step length + step space of motion frames (`docs/firmware.md`); nothing else moves a
position but SetPositions. An end of motion tells a place near the newest status in the same sense. Whoever breaks
these rules, with a good checksum, in this session, has lost count.

Not judged: what nobody can see from here (that the arm stands where the steps say), the hand, whose pulses run on real
frames, and anything while SetPositions is on its way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rm501_protocol.board_config import BoardConfig
from rm501_protocol.messages import MotionEnded, SetPositions, Status
from rm501_protocol.motion_map import extend_u32
from rm501_protocol.segment import steps_of

__all__ = ["Consistency"]

_SLACK_STEPS = 2
"""The step of a half-open interval, and one that was late."""
_STATUSES_AFTER_SETTING = 2
"""A status that was waiting to leave may carry the acknowledgement of what it does not show yet."""
_OUTDATED_US = 5_000_000
"""A line that stood still hands over what it has kept at once."""
_NEAR_FRAMES = 1 << 22
"""22 minutes: far above what a retransmission can delay a report by, far below half the range of a counter."""


class Consistency:
    """Judges the reports of one session. `config` is the board's; `is_on_its_way` tells whether the board may still
    obey a message of which it has not told that it has.
    """

    def __init__(self, config: BoardConfig, is_on_its_way: Callable[[SetPositions], bool]) -> None:
        timing = config.timing
        self._frames_per_step = timing.step_length_frames + timing.step_space_frames
        self._hand = config.hand.motor
        self._is_on_its_way = is_on_its_way
        self._setting: list[SetPositions] = []
        self._free = 0
        self._last: Status | None = None
        self._outdated_since_us: int | None = None

    def positions_set(self, message: SetPositions) -> None:
        """The host is about to define positions."""
        self._setting.append(message)

    def is_outdated(self, status: Status, now_us: int) -> bool:
        """Whether a status is older than the newest; never for longer than 5 s, for then it is a contradiction."""
        if self._last is None or _signed(status.real_frame, self._last.real_frame) >= 0:
            self._outdated_since_us = None
            return False
        if self._outdated_since_us is None:
            self._outdated_since_us = now_us
        return now_us - self._outdated_since_us <= _OUTDATED_US

    def contradiction_in(self, report: Status | MotionEnded) -> str | None:
        """What cannot be, in words; None when all can. A sound status becomes what the next report is compared to."""
        found = self._of_status(report) if isinstance(report, Status) else self._of_end(report)
        if found is None and isinstance(report, Status):
            self._last = report
        return found

    def _of_status(self, status: Status) -> str | None:
        may_jump = self._positions_may_jump()
        last = self._last
        if last is None:
            return None
        real_frames = _signed(status.real_frame, last.real_frame)
        motion_frames = _signed(status.motion_frame, last.motion_frame)
        if real_frames < 0:
            return f"its count of frames went back by {-real_frames}"
        if not 0 <= motion_frames <= real_frames:
            return f"motion time advanced by {motion_frames} frames within {real_frames} real ones"
        return None if may_jump else self._jump(last.positions_steps, status.positions_steps, motion_frames)

    def _of_end(self, ended: MotionEnded) -> str | None:
        last = self._last
        if last is None:
            return None
        real_frames = _signed(ended.real_frame, last.real_frame)
        motion_frames = _signed(ended.motion_frame, last.motion_frame)
        if max(abs(real_frames), abs(motion_frames)) > _NEAR_FRAMES:
            return f"it reports an end of motion {real_frames} real and {motion_frames} motion frames from its status"
        if self._setting or self._free:
            return None
        steps = [steps_of(position) for position in ended.positions_q48]
        return self._jump(last.positions_steps, steps, abs(motion_frames))

    def _jump(self, before: Sequence[int], after: Sequence[int], motion_frames: int) -> str | None:
        most = motion_frames // self._frames_per_step + _SLACK_STEPS
        for motor, (old, new) in enumerate(zip(before, after, strict=False)):
            if motor != self._hand and abs(new - old) > most:
                return f"motor {motor} went {new - old} steps within {motion_frames} motion frames"
        return None

    def _positions_may_jump(self) -> bool:
        if self._setting:
            self._setting = [message for message in self._setting if self._is_on_its_way(message)]
            self._free = _STATUSES_AFTER_SETTING
            return True
        self._free = max(0, self._free - 1)
        return self._free > 0


def _signed(wrapped: int, reference: int) -> int:
    """How far one u32 counter reading is ahead of another."""
    return extend_u32(wrapped, reference) - reference

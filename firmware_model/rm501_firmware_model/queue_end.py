"""Where the queue ends: what may be appended there, where motion can end before, and what an early end leaves behind.

This is firmware: integers, arrays of fixed size, no allocation.
"""

from __future__ import annotations

from rm501_protocol.enums import EventKind, SegmentFlag

from .core_state import CoreState, Report
from .segment_queue import FRAME_MASK

__all__ = ["QueueEnd"]


class QueueEnd(CoreState):
    """The end of the queue: gates, boundaries, cuts, and motion that is over."""

    __slots__ = ()

    def may_gate(self) -> int:
        """Whether a segment with a real frame may be appended: after rest, and no other one waits."""
        queue = self.queue
        for index in range(queue.count):
            if queue.flags[queue.slot_of(index)] & SegmentFlag.START_AT_REAL_FRAME:
                return 0
        if queue.count == 0:
            return 1
        return 1 if queue.flags[queue.slot_of(queue.count - 1)] & SegmentFlag.ENDS_AT_REST else 0

    def boundary(self, segments: int) -> int:
        """Motion frame at which the first `segments` queued segments end."""
        queue = self.queue
        frame = self.motion.motion_frame - self.motion.played
        for index in range(segments):
            frame += queue.length[queue.slot_of(index)]
        return frame & FRAME_MASK

    def can_end(self, segments: int) -> int:
        """Whether motion as it is now can stop within the first `segments` queued segments."""
        if self.motion.moving == 0:
            return 1 if segments or self.motion.played == 0 else 0
        queue = self.queue
        room = 0
        for index in range(segments):
            if queue.flags[queue.slot_of(index)] & SegmentFlag.ENDS_AT_REST:
                return 1
            room += queue.share(index, self.motion.played if index == 0 else 0)
        if segments == 0 or self.motion.outruns(self.motion.rate, room):
            return 0
        return 1

    def earliest_end(self) -> int:
        """The first boundary in the queue at which motion can end."""
        for segments in range(self.queue.count):
            if self.can_end(segments):
                return self.boundary(segments)
        return self.checker.end_frame

    def cut_queue(self, keep: int) -> None:
        """Drop all but the first `keep` queued segments; the state at the end of the queue follows."""
        queue = self.queue
        motion = self.motion
        stepgen = self.stepgen
        checker = self.checker
        if keep == 0:
            self.start_pending = 0
        end_frame = self.boundary(keep)
        queue.keep(keep, end_frame, motion.played)
        checker.rebuild(motion.motion_frame, self.hand.pending)
        for motor in range(self.layout.motor_count):
            checker.end_position[motor] = stepgen.position[motor]
        for index in range(keep):
            slot = queue.slot_of(index)
            frames = queue.length[slot]
            for motor in range(queue.motors):
                place = slot * queue.motors + motor
                v, a, j = queue.v[place], queue.a[place], queue.j[place]
                if index == 0 and motion.played:
                    frames = queue.length[slot] - motion.played
                    v, a, j = stepgen.velocity[motor], stepgen.acceleration[motor], stepgen.jerk[motor]
                checker.advance(motor, v, a, j, frames)
        checker.end_frame = end_frame
        for index in range(queue.event_count):
            at = queue.event_slot(index)
            if queue.event_kind[at] == EventKind.HAND:
                checker.take_hand(queue.event_frame[at], queue.event_value[at])

    def motion_over(self, cause: int) -> None:
        """Drop all motion where it stands and report where that is."""
        self.motion.drop()
        self.causes = 0
        self.resting = 1
        self.start_pending = 0
        self.settling = 1
        checker = self.checker
        checker.rebuild(self.motion.motion_frame, self.hand.pending)
        for motor in range(self.layout.motor_count):
            checker.end_position[motor] = self.stepgen.position[motor]
        self.ended_cause = cause
        self.ended_frame = self.real_frame & FRAME_MASK
        self.reports |= Report.ENDED

    def place(self, mask: int, positions: tuple[int, ...]) -> None:
        """Define the positions of some motors at rest and trust them."""
        for motor in range(self.layout.motor_count):
            if mask >> motor & 1:
                if motor == self.layout.hand_motor:
                    self.hand.count = positions[motor]
                else:
                    self.stepgen.place(motor, positions[motor])
                    self.checker.end_position[motor] = self.stepgen.position[motor]
        self.trusted |= mask
        self.reports |= Report.STATUS

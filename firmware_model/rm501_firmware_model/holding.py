"""Start, hold, resume, early ends, stops, power and reset: whatever makes motion wait or end, except faults.

This is firmware: integers, arrays of fixed size, no allocation.
"""

from __future__ import annotations

from rm501_protocol.enums import BoardState, EndCause, HoldCause, SegmentFlag
from rm501_protocol.faults import FaultCode

from .core_state import Report
from .segment_queue import FRAME_MASK
from .states import Stimulus
from .transitions import Transitions

__all__ = ["Holding"]

USER_CAUSES = 1 << HoldCause.USER | 1 << HoldCause.BUTTON | 1 << HoldCause.LOW_WATER
SHOWN_CAUSES = (
    HoldCause.LINK_LOST,
    HoldCause.USER,
    HoldCause.BUTTON,
    HoldCause.LOW_WATER,
    HoldCause.OVERRIDE,
)
HALF_RANGE = 1 << 31


class Holding(Transitions):
    """Start, hold, resume, ends, stops."""

    __slots__ = ()

    def try_start(self) -> None:
        """Start from READY if the queue allows it; otherwise it stays pending."""
        if not self.motion.can_start():
            return
        self.motion.start()
        self.start_pending = 0
        self.resting = 0
        self.settling = 0
        if self.motion.target:
            self.enter(BoardState.RUNNING)
        else:
            self.causes |= 1 << HoldCause.OVERRIDE
            self.motion.braking = 1
            self.enter(BoardState.HOLDING)

    def hold(self, cause: int) -> None:
        """Ramp to 0 on the path and stay there until every cause is gone."""
        self.causes |= 1 << cause
        self.reports |= Report.STATUS
        if self.state == BoardState.RUNNING:
            self.motion.braking = 1
            self.enter(BoardState.HOLDING)
        elif self.state == BoardState.READY:
            self.enter(BoardState.HELD)

    def release(self, causes: int) -> None:
        """Take causes of the hold away; without any left, go on."""
        self.causes &= ~causes
        self.reports |= Report.STATUS
        if self.causes:
            return
        if self.state == BoardState.HOLDING:
            self.motion.resume()
            self.enter(BoardState.RUNNING)
        elif self.state == BoardState.HELD:
            if not self.resting:
                self.motion.resume()
                self.enter(BoardState.RUNNING)
                return
            self.enter(BoardState.READY)
            if self.start_pending:
                self.stimulus = Stimulus.START
                self.try_start()

    def release_by_user(self) -> None:
        """A user resumes: everything but an override of 0, and a lost link only once it is heard again."""
        causes = USER_CAUSES
        if not self.link_silent:
            causes |= 1 << HoldCause.LINK_LOST
        self.release(causes)

    def session_opened(self) -> None:
        """A host has connected: motion under way holds until a user resumes, a start that waits is forgotten."""
        if self.state in (BoardState.RUNNING, BoardState.HOLDING):
            self.hold(HoldCause.LINK_LOST)
        elif self.state == BoardState.READY:
            self.start_pending = 0
        self.reports |= Report.STATUS

    def shown_cause(self) -> int:
        """The one cause of a hold that decides most about who may resume."""
        for cause in SHOWN_CAUSES:
            if self.causes >> cause & 1:
                return cause
        return HoldCause.NONE

    def end_motion(self, cause: int) -> None:
        """Ramp down on the path and drop the queue; at rest at once."""
        if self.state in (BoardState.RUNNING, BoardState.HOLDING):
            self.end_cause = cause
            self.motion.braking = 2 if cause == EndCause.STOP else 1
            self.enter(BoardState.STOPPING)
        elif self.state == BoardState.HELD:
            self.motion_over(cause)
            self.enter(BoardState.READY)
        elif self.queue.count:
            self.motion_over(cause)

    def stop(self) -> None:
        """STOP, category 1: ramp down at the stop slope, then motor power off."""
        self.answers(Stimulus.STOP)
        if self.state == BoardState.STOPPING:
            if self.end_cause != EndCause.FAULT:
                self.end_cause = EndCause.STOP
            self.motion.braking = 2
        elif self.state in (BoardState.RUNNING, BoardState.HOLDING):
            self.end_motion(EndCause.STOP)
        elif self.state in (BoardState.READY, BoardState.HELD):
            self.switch_off(EndCause.STOP)
            self.stop_latched = 1
        elif self.state == BoardState.IDLE:
            self.stop_latched = 1

    def kill(self) -> None:
        """KILL, category 0: no step from the next frame on, outputs at their safe levels."""
        self.answers(Stimulus.KILL)
        self.set_outputs(0xFF, 0)
        self.hard_stop(FaultCode.KILLED, 0, 0, 0)

    def lease_over(self) -> None:
        """The jog lease ended: if a jog is queued it ends with a ramp."""
        queue = self.queue
        for index in range(queue.count):
            if queue.flags[queue.slot_of(index)] & SegmentFlag.JOG:
                if self.answers(Stimulus.LEASE_OVER):
                    self.reports |= Report.NEW_GENERATION
                    self.end_motion(EndCause.LEASE)
                return

    def switch_off(self, cause: int) -> None:
        """Motor power off at rest, dropping what is queued."""
        if self.queue.count or self.state == BoardState.HELD:
            self.motion_over(cause)
        self.power_off()
        self.enter(BoardState.IDLE)

    def power_on(self) -> None:
        """Motor power on."""
        self.power = 1
        self.line_word ^= self.layout.power_mask
        self.stepgen.enabled = 1
        self.enter(BoardState.READY)

    def truncate_at(self, frame: int) -> int:
        """Drop what starts at motion frame `frame` or later; 0 when that is too near to stop."""
        motion = self.motion
        if self.state == BoardState.HELD and (motion.motion_frame - frame) & FRAME_MASK < HALF_RANGE:
            self.motion_over(EndCause.TRUNCATED)
            self.enter(BoardState.READY)
            return 1
        keep = 0
        while keep < self.queue.count and (self.boundary(keep) - frame) & FRAME_MASK >= HALF_RANGE:
            keep += 1
        if keep == self.queue.count:
            return 1
        if not self.can_end(keep):
            return 0
        self.cut_queue(keep)
        return 1

    def reset(self, pulse_frames: int) -> None:
        """Clear the latched fault or stop; pulse MASTER RESET if asked to."""
        self.fault = FaultCode.NONE
        self.later_faults = 0
        self.stop_latched = 0
        self.reports |= Report.STATUS
        if pulse_frames:
            if self.master_reset_end == 0:
                self.line_word ^= self.layout.master_reset_mask
            self.master_reset_end = self.real_frame + pulse_frames
            self.wake = 0
        if self.state == BoardState.FAULT:
            self.stepgen.enabled = self.power
            if not self.configured:
                self.enter(BoardState.BOOT)
            else:
                self.enter(BoardState.READY if self.power else BoardState.IDLE)

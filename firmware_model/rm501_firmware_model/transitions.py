"""From state to state by the one table, and the faults: what it does not list latches one, the first is kept.

This is firmware: integers, arrays of fixed size, no allocation.
"""

from __future__ import annotations

from rm501_protocol.enums import BoardState, EndCause
from rm501_protocol.faults import FaultCode

from .core_state import Report
from .queue_end import QueueEnd
from .segment_queue import FRAME_MASK
from .states import Stimulus, Verdict, rule

__all__ = ["Transitions"]

COUNTER_MAX = 0xFFFF


class Transitions(QueueEnd):
    """States and faults."""

    __slots__ = ()

    def answers(self, stimulus: int) -> int:
        """Whether to act on an event in this state; an impossible one latches a fault."""
        self.stimulus = stimulus
        verdict = rule(self.state, stimulus).verdict
        if verdict == Verdict.BAD:
            self.illegal(stimulus)
        return 1 if verdict == Verdict.DO else 0

    def illegal(self, stimulus: int) -> None:
        """The transition table was violated."""
        state = self.state
        self.stimulus = Stimulus.HARD_FAULT
        self.hard_stop(FaultCode.ILLEGAL_TRANSITION, state, stimulus, 0)

    def enter(self, state: BoardState) -> None:
        """Enter a state that the table lets the present stimulus lead to."""
        if state == self.state:
            return
        if state not in rule(self.state, self.stimulus).targets:
            self.illegal(self.stimulus)
            return
        self.state = state
        self.reports |= Report.STATUS
        self.wake = 0

    def hard_stop(self, fault: int, source: int, value: int, limit: int) -> None:
        """Latch a fault and make no more steps from this frame on."""
        self.latch(fault, source, value, limit)
        untrusted = 0xFF
        cause: int = EndCause.FAULT
        if fault == FaultCode.OVERFLOW:
            untrusted = value
        elif fault in (FaultCode.STEP_LATE, FaultCode.POSITION_RANGE):
            untrusted = 1 << source
        elif fault == FaultCode.HAND_TIME:
            untrusted = 0
        elif fault == FaultCode.ESTOP:
            cause = EndCause.ESTOP
        elif fault == FaultCode.KILLED:
            cause = EndCause.KILL
        if self.state == BoardState.FAULT:
            self.trusted &= ~untrusted
            if fault in (FaultCode.ESTOP, FaultCode.KILLED, FaultCode.CONFIG_CORRUPT):
                self.power_off()
            return
        self.stepgen.silence()
        if fault != FaultCode.KILLED:
            self.reports |= Report.NEW_GENERATION
        if self.queue.count or not self.resting:
            self.motion_over(cause)
        self.settling = 1
        self.hand.cancel()
        if fault in (FaultCode.ESTOP, FaultCode.KILLED, FaultCode.CONFIG_CORRUPT):
            self.power_off()
        self.trusted &= ~untrusted
        self.causes = 0
        self.enter(BoardState.FAULT)

    def soft_fault(self, fault: int, source: int, value: int, limit: int) -> None:
        """Latch a fault that lets the arm stop on its path first."""
        self.answers(Stimulus.SOFT_FAULT)
        if self.state in (BoardState.RUNNING, BoardState.HOLDING, BoardState.STOPPING):
            self.latch(fault, source, value, limit)
            self.hand.cancel()
            self.reports |= Report.NEW_GENERATION
            self.end_cause = EndCause.FAULT
            self.motion.braking = 2
            self.enter(BoardState.STOPPING)
            return
        self.hard_stop(fault, source, value, limit)

    def latch(self, fault: int, source: int, value: int, limit: int) -> None:
        """Keep the first fault with all that belongs to it; count the later ones."""
        if self.fault != FaultCode.NONE:
            if self.later_faults < COUNTER_MAX:
                self.later_faults += 1
            return
        self.fault = fault
        self.fault_source = source
        self.fault_value = value
        self.fault_limit = limit
        self.fault_frame = self.real_frame & FRAME_MASK
        self.fault_motion_frame = self.motion.motion_frame
        self.reports |= Report.FAULT | Report.STATUS

    def active_fault(self) -> int:
        """The fault whose cause is there at this moment, 0 for none."""
        if self.inputs.active & self.layout.estop_mask:
            return FaultCode.ESTOP
        if self.inputs.active & self.layout.overflow_mask:
            return FaultCode.OVERFLOW
        return FaultCode.NONE

"""What the board remembers beyond its parts: state, causes, power, trust, fault, timers; and its lines.

`CoreState`, `QueueEnd`, `Transitions`, `Holding` and `Core` are one object in layers, each of one idea, that call only
downwards: fields and lines, the end of the queue, states and faults, holds and stops, the frame. The widths are
declared in `memory`.

This is firmware: integers, arrays of fixed size, no allocation.
"""

from __future__ import annotations

from enum import IntFlag

from rm501_protocol.enums import BoardState, EndCause
from rm501_protocol.faults import FaultCode

from .hand import Hand
from .inputs import Inputs, Triggers
from .layout import DIGITAL_OUTPUTS, BoardLayout
from .limits import SegmentChecker
from .motion import Motion
from .segment_queue import SegmentQueue
from .states import Stimulus
from .stepgen import StepGenerator

__all__ = ["CoreState", "Report"]


class Report(IntFlag):
    """What the host is to be told."""

    NONE = 0
    STATUS = 1
    ENDED = 2
    FAULT = 4
    TRIGGER = 8
    NEW_GENERATION = 16


class CoreState:
    """The fields of one board with one configuration, and the output lines."""

    __slots__ = (
        "causes",
        "checker",
        "configured",
        "digital",
        "end_cause",
        "ended_cause",
        "ended_frame",
        "fault",
        "fault_frame",
        "fault_limit",
        "fault_motion_frame",
        "fault_source",
        "fault_value",
        "fired",
        "hand",
        "heard_frame",
        "inputs",
        "later_faults",
        "layout",
        "lease_end",
        "line_word",
        "link_silent",
        "master_reset_end",
        "motion",
        "power",
        "queue",
        "real_frame",
        "reports",
        "resting",
        "sampled",
        "settling",
        "start_pending",
        "state",
        "status_due",
        "status_frames",
        "stepgen",
        "stimulus",
        "stop_latched",
        "triggers",
        "trusted",
        "wake",
        "words",
    )

    def __init__(self, layout: BoardLayout, queue_slots: int, configured: int) -> None:
        self.layout = layout
        self.stepgen = StepGenerator(layout)
        self.queue = SegmentQueue(queue_slots, layout.motor_count)
        self.motion = Motion(layout, self.queue, self.stepgen)
        self.checker = SegmentChecker(layout, self.queue)
        self.hand = Hand(layout)
        self.inputs = Inputs(layout)
        self.triggers = Triggers(layout.motor_count)
        self.configured = configured  # u1
        self.state: BoardState = BoardState.IDLE if configured else BoardState.BOOT  # u8
        self.stimulus: int = Stimulus.STOP  # u8, what is being answered
        self.real_frame = 0  # u64, the frame being made or about to be made
        self.causes = 0  # u8, bit per HoldCause
        self.resting = 1  # u1: no motion is under way
        self.start_pending = 0  # u1: start as soon as the queue allows
        self.settling = 0  # u1: levels still change without motion
        self.end_cause: int = EndCause.STOP  # u8, why STOPPING
        self.stop_latched = 0  # u1: Reset(NONE) needed
        self.power = 0  # u1
        self.trusted = 0  # u8, bit per motor
        self.digital = 0  # u8
        self.fault: int = FaultCode.NONE  # u8
        self.fault_source = 0  # u8
        self.fault_value = 0  # s32
        self.fault_limit = 0  # s32
        self.fault_frame = 0  # u32
        self.fault_motion_frame = 0  # u32
        self.later_faults = 0  # u16
        self.ended_cause: int = EndCause.STOP  # u8
        self.ended_frame = 0  # u32
        self.fired = 0  # u8, triggers to report
        self.reports = 0  # u8
        self.heard_frame = 0  # u64
        self.link_silent = 0  # u2: silence taken notice of, 1 while moving, 2 at rest
        self.lease_end = 0  # u64
        self.master_reset_end = 0  # u64
        self.status_frames = layout.status_frames  # u32
        self.status_due = 0  # u64
        self.sampled = 0  # u1: the inputs' first levels are taken
        self.wake = 0  # u64, next frame with a timer
        self.line_word = 0  # u32
        self.words = [0] * layout.periods  # u32 each

    def number_from(self, real_frame: int, motion_frame: int) -> None:
        """Number the real and the motion frames to come from here on, before the first of them is made."""
        self.real_frame = real_frame
        self.heard_frame = real_frame
        self.status_due = real_frame
        self.motion.motion_frame = motion_frame
        self.checker.rebuild(motion_frame, 0)

    def set_outputs(self, mask: int, levels: int) -> None:
        """Set digital outputs."""
        flips = (self.digital ^ levels) & mask
        self.digital ^= flips
        for output in range(DIGITAL_OUTPUTS):
            if flips >> output & 1:
                self.line_word ^= self.layout.digital_mask[output]

    def fitted_outputs(self) -> int:
        """Mask of the digital outputs that have a pin."""
        mask = 0
        for output in range(DIGITAL_OUTPUTS):
            if self.layout.digital_mask[output]:
                mask |= 1 << output
        return mask

    def power_off(self) -> None:
        """Motor power off; without it the arm sinks, so the positions are trusted no longer if the line is fitted."""
        self.hand.cancel()
        if self.power:
            self.power = 0
            self.line_word ^= self.layout.power_mask
        if self.layout.power_mask and not self.layout.trust_without_power:
            self.trusted = 0

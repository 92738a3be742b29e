"""The board without its link: the frame in which states, motion, inputs and faults meet the pins.

Order within one real frame: timers; the input sample, its faults, buttons and triggers; motion time; events of the
motion frame about to be played; the motion frame; the hand; the port words. Whatever a frame changes is on the pins in
that same frame. Holds, states, faults and the queue's end are the layers below (`core_state`).

What has to be told to the host is left as bits in `reports`; `board` turns them into messages outside the tick path.

This is firmware: integers, arrays of fixed size, no allocation. The widths are declared in `memory`.
"""

from __future__ import annotations

from rm501_protocol.enums import BoardState, EndCause, EventKind, HoldCause, TriggerAction
from rm501_protocol.faults import FaultCode
from rm501_protocol.messages import NO_MOTOR
from rm501_protocol.segment import FRACTION_BITS

from .core_state import Report
from .holding import Holding
from .inputs import TRIGGER_SLOTS
from .motion import Notice
from .segment_queue import FRAME_MASK
from .states import Stimulus

__all__ = ["MASTER_RESET_FRAMES", "Core"]

MASTER_RESET_FRAMES = 32
"""Length of the MASTER RESET pulse: 10 ms, long against anything on the driver boards."""
NEVER = (1 << 64) - 1


class Core(Holding):
    """The tick path of one board with one configuration."""

    __slots__ = ()

    def frame(self, pins: int) -> None:
        """Make one real frame from its input word; the port words are in `words` afterwards."""
        real_frame = self.real_frame
        if self.sampled == 0:
            self.sampled = 1
            self.inputs.preset(pins)
        if real_frame >= self.wake:
            self.timers()
        if not self.inputs.quiet(pins):
            self.sample(pins)
        motion = self.motion
        if motion.moving:
            if motion.frame(real_frame & FRAME_MASK):
                if motion.notices and motion.notices & Notice.EVENT:
                    self.fire_events()
                motion.play()
                if self.stepgen.late:
                    self.step_late()
            if motion.notices:
                self.take_notices()
        elif self.settling:
            self.stepgen.levels()
            self.settling = self.stepgen.busy()
        hand = self.hand
        if hand.pending or hand.high_frames or hand.rise_wait or hand.dir_wait:
            hand.frame()
        layout = self.layout
        if self.state != BoardState.FAULT:
            self.line_word ^= layout.heartbeat_mask
        words = self.words
        line_word = self.line_word
        slot_words = layout.slot_words
        entry_words = layout.entry_words
        entry_slots = layout.entry_slots
        for period in range(layout.periods):
            words[period] = entry_words[period] ^ slot_words[entry_slots[period]] ^ line_word
        self.real_frame = real_frame + 1

    def timers(self) -> None:
        """Everything that happens because time has passed; sets the next time to look."""
        now = self.real_frame
        layout = self.layout
        wake = NEVER
        if self.status_frames:
            if now >= self.status_due:
                self.reports |= Report.STATUS
                self.status_due = now + self.status_frames
            wake = self.status_due
        if self.master_reset_end:
            if now >= self.master_reset_end:
                self.master_reset_end = 0
                self.line_word ^= layout.master_reset_mask
                self.check_overflow(self.inputs.active)
            elif self.master_reset_end < wake:
                wake = self.master_reset_end
        if self.lease_end:
            if now >= self.lease_end:
                self.lease_end = 0
                self.lease_over()
            elif self.lease_end < wake:
                wake = self.lease_end
        self.wake = wake
        self.link_timers(now)

    def link_timers(self, now: int) -> None:
        """Silence of the link: while moving it holds; long at rest, also after such a hold, it switches power off."""
        layout = self.layout
        moving = self.motion.moving
        limit = layout.link_timeout_frames if moving else layout.idle_power_off_frames
        if limit == 0 or self.link_silent > (0 if moving else 1):
            return
        due = self.heard_frame + limit
        if now < due:
            if due < self.wake:
                self.wake = due
            return
        self.link_silent = 1 if moving else 2
        if moving:
            if self.answers(Stimulus.LINK_LOST):
                self.hold(HoldCause.LINK_LOST)
        elif self.answers(Stimulus.LINK_IDLE):
            self.switch_off(EndCause.POWER_OFF)

    def heard(self) -> None:
        """A good packet arrived."""
        self.heard_frame = self.real_frame
        self.link_silent = 0
        self.wake = 0

    def sample(self, pins: int) -> None:
        """Take an input sample that is not the same as the last stable one."""
        inputs = self.inputs
        layout = self.layout
        changed = inputs.frame(
            pins, self.real_frame & FRAME_MASK, self.motion.motion_frame, self.stepgen.count, self.triggers
        )
        if changed == 0:
            return
        risen = changed & inputs.active
        for trigger in range(TRIGGER_SLOTS):
            if inputs.fires(trigger, self.triggers):
                self.fire(trigger)
        if risen & layout.estop_mask and self.answers(Stimulus.ESTOP):
            self.hard_stop(FaultCode.ESTOP, lowest_bit(risen & layout.estop_mask), 0, 0)
        if self.master_reset_end == 0:
            self.check_overflow(risen)
        if risen & layout.hold_mask and self.answers(Stimulus.HOLD_BUTTON):
            self.hold(HoldCause.BUTTON)
        if risen & layout.cycle_start_mask and self.answers(Stimulus.CYCLE_START):
            self.release_by_user()

    def check_overflow(self, active: int) -> None:
        """Fault OVERFLOW for the first of these inputs that is an OVERFLOW line."""
        lines = active & self.layout.overflow_mask
        if lines and self.answers(Stimulus.OVERFLOW):
            source = lowest_bit(lines)
            motors = 0
            for number in range(self.layout.input_count):
                if lines >> number & 1:
                    motors |= self.layout.input_motors[number]
            self.hard_stop(FaultCode.OVERFLOW, source, motors, 0)

    def fire(self, trigger: int) -> None:
        """An armed trigger's edge is confirmed: report what it latched, and stop if it says so."""
        triggers = self.triggers
        if triggers.latched[trigger] == 0:
            triggers.latch(trigger, self.real_frame & FRAME_MASK, self.motion.motion_frame, self.stepgen.count)
        stops = triggers.action[trigger] == TriggerAction.LATCH_AND_STOP
        triggers.disarm(trigger)
        self.fired |= 1 << trigger
        self.reports |= Report.TRIGGER
        if stops:
            self.reports |= Report.NEW_GENERATION  # what the host has in flight was meant for an armed trigger
            if self.answers(Stimulus.TRIGGER_STOP):
                self.end_motion(EndCause.TRIGGER)

    def fire_events(self) -> None:
        """Every event of the motion frame that is played next."""
        queue = self.queue
        motion = self.motion
        motion.notices &= ~Notice.EVENT
        while queue.event_count and queue.event_frame[queue.event_head] == motion.motion_frame:
            value = queue.event_value[queue.event_head]
            if queue.event_kind[queue.event_head] == EventKind.OUTPUT:
                self.set_outputs(value >> 8 & 0xFF, value & 0xFF)
            elif not self.hand.command(value):
                self.soft_fault(FaultCode.HAND_TIME, NO_MOTOR, value, self.layout.hand_max_pulses)
            queue.pop_event()

    def take_notices(self) -> None:
        """What motion time has come to in this frame."""
        notices = self.motion.notices
        self.motion.notices = 0
        if notices & Notice.HALF_EMPTY:
            self.reports |= Report.STATUS
        if notices & Notice.LOW_WATER and self.answers(Stimulus.LOW_WATER):
            self.hold(HoldCause.LOW_WATER)
        if notices & Notice.UNDERRUN and self.answers(Stimulus.UNDERRUN):
            self.hard_stop(FaultCode.MOTION_UNDERRUN, 0, self.motion.target, 0)
        if notices & Notice.DRAINED and self.answers(Stimulus.DRAINED):
            self.resting = 1
            self.settling = 1
            self.came_to_rest(BoardState.READY)
        if notices & Notice.RATE_ZERO and self.answers(Stimulus.RATE_ZERO):
            self.came_to_rest(BoardState.HELD)

    def came_to_rest(self, running_target: BoardState) -> None:
        """The rate is 0: go where the state leads from here."""
        if self.state == BoardState.STOPPING:
            self.motion_over(self.end_cause)
            if self.end_cause == EndCause.STOP:
                self.power_off()
                self.stop_latched = 1
                self.enter(BoardState.IDLE)
            elif self.end_cause == EndCause.FAULT:
                self.enter(BoardState.FAULT)
            else:
                self.enter(BoardState.READY)
        elif self.state == BoardState.HOLDING:
            self.enter(BoardState.HELD)
        else:
            self.enter(running_target)

    def step_late(self) -> None:
        """A step generator fell behind: legal segments cannot do this."""
        motor = self.stepgen.late - 1
        self.stepgen.late = 0
        lag = self.stepgen.position[motor] - (self.stepgen.count[motor] << FRACTION_BITS)
        self.answers(Stimulus.HARD_FAULT)
        self.hard_stop(FaultCode.STEP_LATE, motor, lag >> 32, 1 << 16)


def lowest_bit(mask: int) -> int:
    """Number of the lowest set bit of a mask that is not 0."""
    number = 0
    while mask & 1 == 0:
        mask >>= 1
        number += 1
    return number

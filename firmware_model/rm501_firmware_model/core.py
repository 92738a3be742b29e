"""The board without its link: states, holds, stops, faults, power, and the frame in which all of it meets the pins.

Order within one real frame: timers; the input sample, its faults, buttons and triggers; motion time; events of the
motion frame about to be played; the motion frame; the hand; the port words. Whatever a frame changes is on the pins in
that same frame.

What has to be told to the host is left as bits in `reports`; `board` turns them into messages outside the tick path.

This is firmware: integers, arrays of fixed size, no allocation. The widths are declared in `memory`.
"""

from __future__ import annotations

from enum import IntFlag

from rm501_protocol.enums import BoardState, EndCause, EventKind, HoldCause, SegmentFlag, TriggerAction
from rm501_protocol.faults import FaultCode
from rm501_protocol.messages import NO_MOTOR
from rm501_protocol.segment import FRACTION_BITS

from .hand import Hand
from .inputs import TRIGGER_SLOTS, Inputs, Triggers
from .layout import DIGITAL_OUTPUTS, BoardLayout
from .limits import SegmentChecker
from .motion import Motion, Notice
from .segment_queue import FRAME_MASK, SegmentQueue
from .states import Stimulus, Verdict, rule
from .stepgen import StepGenerator

__all__ = ["MASTER_RESET_FRAMES", "Core", "Report"]

MASTER_RESET_FRAMES = 32
"""Length of the MASTER RESET pulse: 10 ms, long against anything on the driver boards."""
COUNTER_MAX = 0xFFFF
HALF_RANGE = 1 << 31
NEVER = (1 << 64) - 1
USER_CAUSES = 1 << HoldCause.USER | 1 << HoldCause.BUTTON | 1 << HoldCause.LOW_WATER
SHOWN_CAUSES = (
    HoldCause.LINK_LOST,
    HoldCause.USER,
    HoldCause.BUTTON,
    HoldCause.LOW_WATER,
    HoldCause.OVERRIDE,
)


class Report(IntFlag):
    """What the host is to be told."""

    NONE = 0
    STATUS = 1
    ENDED = 2
    FAULT = 4
    TRIGGER = 8
    NEW_GENERATION = 16


class Core:
    """The tick path of one board with one configuration."""

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

    # ------------------------------------------------------------------------------------------------------ one frame

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

    # ----------------------------------------------------------------------------------------------- inputs, triggers

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

    # ------------------------------------------------------------------------------------------------- notices, events

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

    # ---------------------------------------------------------------------------------------------------------- states

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

    # ---------------------------------------------------------------------------------------------- start, hold, resume

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

    # ------------------------------------------------------------------------------------------------------- ends,
    # stops

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

    def power_off(self) -> None:
        """Motor power off; without it the arm sinks, so the positions are trusted no longer if the line is fitted."""
        self.hand.cancel()
        if self.power:
            self.power = 0
            self.line_word ^= self.layout.power_mask
        if self.layout.power_mask and not self.layout.trust_without_power:
            self.trusted = 0

    def set_outputs(self, mask: int, levels: int) -> None:
        """Set digital outputs."""
        flips = (self.digital ^ levels) & mask
        self.digital ^= flips
        for output in range(DIGITAL_OUTPUTS):
            if flips >> output & 1:
                self.line_word ^= self.layout.digital_mask[output]

    # -------------------------------------------------------------------------------------------- what commands ask for

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

    def active_fault(self) -> int:
        """The fault whose cause is there at this moment, 0 for none."""
        if self.inputs.active & self.layout.estop_mask:
            return FaultCode.ESTOP
        if self.inputs.active & self.layout.overflow_mask:
            return FaultCode.OVERFLOW
        return FaultCode.NONE

    def fitted_outputs(self) -> int:
        """Mask of the digital outputs that have a pin."""
        mask = 0
        for output in range(DIGITAL_OUTPUTS):
            if self.layout.digital_mask[output]:
                mask |= 1 << output
        return mask

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

    # ---------------------------------------------------------------------------------------------------------- faults

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


def lowest_bit(mask: int) -> int:
    """Number of the lowest set bit of a mask that is not 0."""
    number = 0
    while mask & 1 == 0:
        mask >>= 1
        number += 1
    return number

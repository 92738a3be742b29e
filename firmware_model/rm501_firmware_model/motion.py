"""Motion time: how fast the queued segments are played, from standing still to one motion frame per real frame.

Theory of operation. Every real frame adds `rate`, 0 to 1 in Q0.24, to `phase`; when phase overflows, one motion frame
is played, otherwise the levels of the frame before are repeated. Hold, resume, override, low water, stop, trigger and
jog end are all the same thing: the rate ramps, at a slope that the segment being played allows, and the arm slows
down along its path.

The slope belongs to the segment whose frame is played next, so at every instant the acceleration added by a ramp,
slope x speed, is what the host allowed for just that piece of path, however the slopes of neighbouring segments
differ.

Low water. Braking at slope s takes rate^2 / 2s motion frames. With slopes that differ from segment to segment the
exact statement is additive: braking from `rate` succeeds when rate^2 <= 2 x (sum of the slopes of all frames left).
`SegmentQueue.room` keeps that sum, an addition per segment and a subtraction per frame. One frame may be lost to
phase and one to deciding once a frame only, hence ::

    brake when  rate^2 >= 2 (room - 2 slope)

which always ends before the last frame. A queued segment that ends at rest needs no braking: there the path itself
stands still, so the rate may change at once. Hence at such a point the rule is applied to what lies behind it, and if
that is too short the rate goes to 0 right there.

rate^2 is taken from the upper 15 bits, rounded up, so that 32-bit arithmetic does: rate15^2 against room x 2^11.

This is firmware: integers, arrays of fixed size, no allocation. The widths are declared in `memory`.
"""

from __future__ import annotations

from enum import IntFlag

from rm501_protocol.enums import SegmentFlag

from .layout import BoardLayout
from .segment_queue import FRAME_MASK, SegmentQueue
from .stepgen import StepGenerator

__all__ = ["RATE_ONE", "Motion", "Notice"]

RATE_ONE = 1 << 24
SLOPE_SHIFT = 4  # slopes are in 2^-20, the rate in 2^-24
ROOM_FULL = 1 << 19  # sum of slopes that brakes from rate 1
RATE_SHIFT = 9
RATE_ROUND = (1 << RATE_SHIFT) - 1
ROOM_SHIFT = 11
HALF_RANGE = 1 << 31


class Notice(IntFlag):
    """What motion time tells the board after a frame."""

    NONE = 0
    LOW_WATER = 1  # braking because the queue is nearly empty
    RATE_ZERO = 2  # a ramp to 0 has ended
    DRAINED = 4  # the queue is empty and the arm at rest
    UNDERRUN = 8  # the queue is empty at speed: never with checked segments
    EVENT = 16  # an event is due before this motion frame
    HALF_EMPTY = 32  # the queue has just become half empty: a host that waits for free slots should know


class Motion:
    """The rate, the phase, and which frame of which segment is played next."""

    __slots__ = (
        "braking",
        "gated",
        "motion_frame",
        "moving",
        "notices",
        "phase",
        "played",
        "queue",
        "rate",
        "start_frame",
        "stepgen",
        "target",
    )

    def __init__(self, layout: BoardLayout, queue: SegmentQueue, stepgen: StepGenerator) -> None:
        self.queue = queue
        self.stepgen = stepgen
        self.motion_frame = 0  # u32, motion frames played
        self.played = 0  # u16, frames of the head segment played
        self.rate = 0  # u25, Q0.24
        self.phase = 0  # u24, Q0.24
        self.target = RATE_ONE  # u25, override
        self.moving = 0  # u1: motion time may advance
        self.braking = 0  # u2: 0 towards target, 1 to 0 at the hold slope, 2 to 0 at the stop slope
        self.gated = 0  # u1: waits for start_frame at a point of rest
        self.start_frame = 0  # u32, real frame
        self.notices = 0  # u8

    def must_brake(self, rate: int) -> int:
        """Whether motion at `rate` has to brake now in order not to outrun the queue."""
        queue = self.queue
        if queue.rest_points:
            return 0
        return self.outruns(rate, queue.room)

    def outruns(self, rate: int, room: int) -> int:
        """Whether braking from `rate`, begun one frame later, would need more than `room`."""
        room -= 2 * self.queue.hold_slope[self.queue.head]
        if room > ROOM_FULL:
            return 0
        if room <= 0:
            return 1
        rate_15 = (rate + RATE_ROUND) >> RATE_SHIFT
        return 1 if rate_15 * rate_15 >= room << ROOM_SHIFT else 0

    def can_start(self) -> int:
        """Whether what is queued lets motion start at the full target rate."""
        if self.queue.count == 0 or self.must_brake(self.target):
            return 0
        return 1

    def start(self) -> None:
        """Leave a state of rest; `can_start` was asked before. The arm stands, so the rate needs no ramp."""
        self.moving = 1
        self.braking = 0
        self.phase = 0
        self.rate = self.target
        if self.queue.flags[self.queue.head] & SegmentFlag.START_AT_REAL_FRAME:
            self.gated = 1

    def frame(self, real_frame: int) -> int:
        """One real frame, asked for only while `moving`: ramp, accumulate; 1 when a motion frame is to be played.

        `play` does that, after the events of that motion frame.
        """
        queue = self.queue
        if self.gated and not self.gate(real_frame):
            return 0
        slot = queue.head
        rate = self.rate
        if self.braking:
            slope = queue.hold_slope[slot] if self.braking == 1 else queue.stop_slope[slot]
            rate -= slope << SLOPE_SHIFT
        else:
            slope = queue.hold_slope[slot] << SLOPE_SHIFT
            wanted = self.target
            if rate != wanted:
                if rate < wanted:
                    wanted = rate + slope if rate + slope < wanted else wanted
                elif rate - slope > wanted:
                    wanted = rate - slope
            if self.must_brake(wanted):
                self.braking = 1
                self.notices |= Notice.LOW_WATER
                wanted = rate - slope
            rate = wanted
        if rate <= 0:
            self.stand()
            return 0
        self.rate = rate
        phase = self.phase + rate
        if phase < RATE_ONE:
            self.phase = phase
            return 0
        self.phase = phase - RATE_ONE
        if queue.event_count and queue.event_frame[queue.event_head] == self.motion_frame:
            self.notices |= Notice.EVENT
        return 1

    def gate(self, real_frame: int) -> int:
        """Wait at a point of rest for the head segment's real frame; 1 in the frame that opens the gate, unless what is
        queued by then does not allow to stop again.
        """
        if self.braking:
            self.stand()
            return 0
        if (real_frame - self.start_frame) & FRAME_MASK >= HALF_RANGE:
            return 0
        self.gated = 0
        if self.must_brake(self.target):
            # the queue was cut, or the override raised, since the gate was closed
            self.braking = 1
            self.notices |= Notice.LOW_WATER
            self.stand()
            return 0
        self.rate = self.target
        self.phase = 0
        return 1

    def stand(self) -> None:
        """The rate has reached 0."""
        self.rate = 0
        self.moving = 0
        self.notices |= Notice.RATE_ZERO

    def play(self) -> None:
        """Play the next motion frame of the head segment."""
        queue = self.queue
        slot = queue.head
        if self.played == 0:
            self.load(slot)
            before = queue.last_slope
            slope = queue.hold_slope[slot]
            queue.room -= before if before < slope else slope
        else:
            queue.room -= queue.hold_slope[slot]
        self.stepgen.play()
        self.motion_frame = (self.motion_frame + 1) & FRAME_MASK
        self.played += 1
        if self.played == queue.length[slot]:
            self.finish()

    def load(self, slot: int) -> None:
        """Give the step generators the terms of a segment."""
        queue = self.queue
        stepgen = self.stepgen
        base = slot * queue.motors
        for motor in range(queue.motors):
            stepgen.velocity[motor] = queue.v[base + motor]
            stepgen.acceleration[motor] = queue.a[base + motor]
            stepgen.jerk[motor] = queue.j[base + motor]

    def finish(self) -> None:
        """The head segment is played: give its slot free and look at what follows."""
        queue = self.queue
        at_rest = queue.flags[queue.head] & SegmentFlag.ENDS_AT_REST
        queue.pop()
        self.played = 0
        if queue.count == queue.slots >> 1:
            self.notices |= Notice.HALF_EMPTY
        if queue.count == 0:
            self.rate = 0
            self.moving = 0
            self.stepgen.rest()
            self.notices |= Notice.DRAINED if at_rest else Notice.UNDERRUN
        elif at_rest:
            if self.must_brake(self.rate):
                if self.braking == 0:
                    self.braking = 1
                    self.notices |= Notice.LOW_WATER
                self.stand()
            if queue.flags[queue.head] & SegmentFlag.START_AT_REAL_FRAME:
                self.gated = 1
                self.rate = 0

    def resume(self) -> None:
        """Ramp towards the target again."""
        self.braking = 0
        self.moving = 1

    def drop(self) -> None:
        """End motion where it stands: the queue is gone, the positions stay as they are."""
        self.queue.clear()
        self.stepgen.rest()
        self.played = 0
        self.rate = 0
        self.moving = 0
        self.braking = 0
        self.gated = 0

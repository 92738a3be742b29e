"""What a segment must satisfy before it may enter the queue: exact, in integers, and as a whole or not at all.

Within a segment v(n) is a quadratic in n and a(n) = a + n j is linear, so over the frames of the segment a takes its
extremes at the ends, and v takes its own at the ends or where a changes sign. That frame is found by bisection: 16
multiplications, no division. Position needs no extremes: in 65,535 frames at less than half a step a frame it moves
by less than 2^15 steps, and the end is kept 2^16 steps within s32.
"""

from __future__ import annotations

from rm501_protocol.enums import EventKind, SegmentFlag
from rm501_protocol.faults import RefusalReason
from rm501_protocol.messages import NO_MOTOR
from rm501_protocol.segment import A_SHIFT, FRACTION_BITS, MAX_LENGTH_CUBIC_FRAMES, V_SHIFT
from rm501_protocol.segment_message import Segment

from .layout import BoardLayout
from .segment_queue import EVENT_RING_SLOTS, FRAME_MASK, SegmentQueue, triangle

__all__ = ["Refusal", "SegmentChecker", "speed_at", "turning_frame"]

POSITION_LIMIT = ((1 << 31) - (1 << 16)) << FRACTION_BITS
HALF_RANGE = 1 << 31
THIRD = 0xAAAAAAAAAAAAAAAB
WORD_64 = 0xFFFFFFFFFFFFFFFF
HAND_IDLE = 0
HAND_PULSES = 1


def speed_at(v: int, a: int, j: int, frames: int) -> int:
    """v after `frames` motion frames; all in 2^-48 step/frame^n, exact."""
    return v + frames * a + triangle(frames) * j


def turning_frame(a: int, j: int, last: int) -> int:
    """The first frame in 0..last at which a + n j has another sign than a, or `last`: v has an extreme there."""
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) >> 1
        if (a < 0) == (a + middle * j < 0):
            low = middle
        else:
            high = middle
    return high


class Refusal:
    """The last refusal: reason 0 when there was none; value and limit as the protocol's table of refusals defines
    them.
    """

    __slots__ = ("limit", "motor", "reason", "value")

    def __init__(self) -> None:
        self.reason = 0
        self.motor: int = NO_MOTOR
        self.value = 0
        self.limit = 0

    def set(self, reason: int, motor: int = NO_MOTOR, value: int = 0, limit: int = 0) -> int:
        """Record a refusal; always 0, so that a check can return it."""
        self.reason = reason
        self.motor = motor
        self.value = value
        self.limit = limit
        return 0


class SegmentChecker:
    """The state at the end of the queue, and the checks of a segment that wants to be appended there."""

    __slots__ = ("end_frame", "end_position", "end_speed", "hand_free", "hand_known", "layout", "queue", "refusal")

    def __init__(self, layout: BoardLayout, queue: SegmentQueue) -> None:
        self.layout = layout
        self.queue = queue
        self.end_frame = 0  # u32, motion frame at which the queue ends
        self.end_speed = [0] * layout.motor_count  # s48 per motor at that frame
        self.end_position = [0] * layout.motor_count  # s80
        self.hand_free = 0  # u32, motion frame from which the hand is free again
        self.hand_known = HAND_IDLE  # u1: whether hand_free means anything
        self.refusal = Refusal()

    def accepts(self, segment: Segment, lease: int) -> int:
        """1 when `segment` may be pushed; otherwise 0 and `refusal` says why. Nothing changes either way."""
        return (
            self.fits(segment, lease)
            and self.motors_known(segment)
            and self.motors_within(segment)
            and self.events_fit(segment)
        )

    def fits(self, segment: Segment, lease: int) -> int:
        """Room, place in time, slopes, lease."""
        refusal = self.refusal
        queue = self.queue
        if queue.count == queue.slots:
            return refusal.set(RefusalReason.QUEUE_FULL, NO_MOTOR, 0, self.end_frame)
        if segment.start_frames != self.end_frame:
            behind = (segment.start_frames - self.end_frame) & FRAME_MASK
            reason = RefusalReason.GAP if behind < HALF_RANGE else RefusalReason.OVERLAP
            return refusal.set(reason, NO_MOTOR, segment.start_frames, self.end_frame)
        if segment.length_frames == 0:
            return refusal.set(RefusalReason.LENGTH, NO_MOTOR, 0, 0xFFFF)
        if segment.length_frames > MAX_LENGTH_CUBIC_FRAMES:
            for term in segment.motors:
                if term.j:
                    return refusal.set(RefusalReason.LENGTH, term.motor, segment.length_frames, MAX_LENGTH_CUBIC_FRAMES)
        if segment.hold_slope == 0 or segment.stop_slope < segment.hold_slope:
            return refusal.set(RefusalReason.SLOPE, NO_MOTOR, segment.hold_slope, segment.stop_slope)
        if segment.flags & SegmentFlag.JOG and not lease:
            return refusal.set(RefusalReason.NO_LEASE)
        return 1

    def motors_known(self, segment: Segment) -> int:
        """Every motor named is one that segments move."""
        layout = self.layout
        for term in segment.motors:
            if term.motor >= layout.motor_count or layout.max_speed[term.motor] == 0:
                return self.refusal.set(RefusalReason.UNKNOWN_MOTOR, term.motor, term.motor, layout.motor_count)
        return 1

    def motors_within(self, segment: Segment) -> int:
        """Speed, acceleration, jump of speed and position of every motor, also of those that stand still from here
        on.
        """
        layout = self.layout
        at_rest = segment.flags & SegmentFlag.ENDS_AT_REST
        length = segment.length_frames
        index = 0
        for motor in layout.moved:
            v = a = j = 0
            if index < len(segment.motors) and segment.motors[index].motor == motor:
                term = segment.motors[index]
                index += 1
                v, a, j = term.v << V_SHIFT, term.a << A_SHIFT, term.j
            jump = v - self.end_speed[motor]
            if not -layout.max_speed_jump <= jump <= layout.max_speed_jump:
                return self.refuse_speed(RefusalReason.VELOCITY_STEP, motor, jump, layout.max_speed_jump)
            if not self.acceleration_within(motor, a, a + (length - 1) * j):
                return 0
            if not self.speed_within(motor, v, a, j, length):
                return 0
            end = speed_at(v, a, j, length)
            if at_rest and not -layout.max_speed_jump <= end <= layout.max_speed_jump:
                return self.refuse_speed(RefusalReason.ENDS_AT_SPEED, motor, end, layout.max_speed_jump)
            place = self.end_position[motor] + self.displacement(v, a, j, length)
            if not -POSITION_LIMIT <= place <= POSITION_LIMIT:
                return self.refusal.set(
                    RefusalReason.POSITION_RANGE, motor, place >> FRACTION_BITS, POSITION_LIMIT >> FRACTION_BITS
                )
        return 1

    def acceleration_within(self, motor: int, first: int, last: int) -> int:
        """Both ends of a linear acceleration are within the motor's limit."""
        limit = self.layout.max_acceleration[motor]
        for value in (first, last):
            if not -limit <= value <= limit:
                return self.refusal.set(RefusalReason.ACCELERATION_LIMIT, motor, value >> A_SHIFT, limit >> A_SHIFT)
        return 1

    def speed_within(self, motor: int, v: int, a: int, j: int, length: int) -> int:
        """v at the start, at the end and at its turning point is within the motor's limit."""
        limit = self.layout.max_speed[motor]
        for frame in (0, turning_frame(a, j, length), length):
            speed = speed_at(v, a, j, frame)
            if not -limit <= speed <= limit:
                return self.refuse_speed(RefusalReason.RATE_LIMIT, motor, speed, limit)
        return 1

    def refuse_speed(self, reason: int, motor: int, speed: int, limit: int) -> int:
        """Refuse for a speed, in the wire's unit, rounded away from 0 and within s32."""
        value = (abs(speed) + (1 << V_SHIFT) - 1) >> V_SHIFT
        if value >= HALF_RANGE:
            value = HALF_RANGE - 1
        return self.refusal.set(reason, motor, -value if speed < 0 else value, limit >> V_SHIFT)

    def displacement(self, v: int, a: int, j: int, frames: int) -> int:
        """Steps moved in `frames`, 2^-48, exact: v(n) summed, the third difference by n(n-1)(n-2)/6 = sum of
        triangles.
        """
        return frames * v + triangle(frames) * a + pyramid(frames) * j

    def events_fit(self, segment: Segment) -> int:
        """Events lie in the segment, in order, and the hand has time for each of its strokes."""
        refusal = self.refusal
        layout = self.layout
        if self.queue.event_count + len(segment.events) > EVENT_RING_SLOTS:
            return refusal.set(RefusalReason.QUEUE_FULL, NO_MOTOR, len(segment.events), self.end_frame)
        before = 0
        free, known = self.hand_free, self.hand_known
        for event in segment.events:
            if not before <= event.offset_frames < segment.length_frames:
                return refusal.set(RefusalReason.EVENT, NO_MOTOR, event.offset_frames, segment.length_frames)
            before = event.offset_frames
            if event.kind == EventKind.OUTPUT:
                for output in range(8):
                    if event.mask >> output & 1 and layout.digital_mask[output] == 0:
                        return refusal.set(RefusalReason.OUTPUT_NOT_FITTED, NO_MOTOR, event.mask)
                continue
            if event.value == 0:
                known = HAND_IDLE
                continue
            pulses = abs(event.value)
            if layout.hand_pulse_mask == 0 or pulses > layout.hand_max_pulses:
                return refusal.set(RefusalReason.HAND_LIMIT, NO_MOTOR, pulses, layout.hand_max_pulses)
            at = (segment.start_frames + event.offset_frames) & FRAME_MASK
            if known and (at - free) & FRAME_MASK >= HALF_RANGE:
                return refusal.set(RefusalReason.HAND_BUSY, NO_MOTOR, at, free)
            free, known = self.hand_end(at, event.value), HAND_PULSES
        return 1

    def hand_end(self, at: int, pulses: int) -> int:
        """Motion frame by which a stroke begun at `at` is certainly over: real frames pass at least as fast."""
        count = pulses if pulses > 0 else self.layout.hand_grip_pulses - pulses
        return (at + self.layout.hand_frames(count)) & FRAME_MASK

    def rebuild(self, end_frame: int, hand_pending: int) -> None:
        """The queue was emptied: motion stands at `end_frame`, the hand still has `hand_pending` pulses to make."""
        self.end_frame = end_frame
        for motor in range(self.layout.motor_count):
            self.end_speed[motor] = 0
        self.hand_known = HAND_PULSES if hand_pending else HAND_IDLE
        self.hand_free = (end_frame + self.layout.hand_frames(abs(hand_pending))) & FRAME_MASK

    def hand_at_rest(self) -> None:
        """Nothing is queued and the hand has no pulse to make: its next stroke may begin at once, although motion time
        may not have come to `hand_free`: it stands where motion was ended, and pulses run on real frames.
        """
        self.hand_known = HAND_IDLE

    def advance(self, motor: int, v: int, a: int, j: int, frames: int) -> None:
        """Move the state of one motor at the end of the queue on by `frames` of these terms."""
        self.end_speed[motor] = speed_at(v, a, j, frames)
        self.end_position[motor] += self.displacement(v, a, j, frames)

    def take_hand(self, at: int, pulses: int) -> None:
        """The hand will begin a stroke at motion frame `at`."""
        self.hand_free = self.hand_end(at, pulses)
        self.hand_known = HAND_PULSES if pulses else HAND_IDLE

    def append(self, segment: Segment) -> None:
        """Take an accepted segment into the state at the end of the queue."""
        for motor in self.layout.moved:
            self.end_speed[motor] = 0
        for term in segment.motors:
            self.advance(term.motor, term.v << V_SHIFT, term.a << A_SHIFT, term.j, segment.length_frames)
        for event in segment.events:
            if event.kind == EventKind.HAND:
                self.take_hand((segment.start_frames + event.offset_frames) & FRAME_MASK, event.value)
        self.end_frame = segment.end_frames


def pyramid(frames: int) -> int:
    """n (n-1) (n-2) / 6 for n < 2^16: the product is a multiple of 3, so multiplying by 1/3 modulo 2^64 is exact."""
    return (triangle(frames) * (frames - 2) * THIRD) & WORD_64

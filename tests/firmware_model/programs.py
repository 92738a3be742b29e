"""Random programs for the board: legal motion, and everything that a user, a machine or a fault may do meanwhile."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace

from rm501_firmware_model import BoardLayout
from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.segment import A_SHIFT, ONE_STEP, V_SHIFT, motor_extremes, position_q48, velocity_q48
from rm501_protocol.segment_message import MotorTerm, Segment, SegmentEvent, hand_event

FRAME_MASK = 0xFFFFFFFF


class LegalMotion:
    """Makes segments that the board must accept: continuous speed, rate and acceleration within the limits.

    Every so many segments the motion is brought to rest. `lively` motors turn round often, some oscillate about
    half-integers.
    """

    def __init__(self, rng: random.Random, config: BoardConfig = RM501_BOARD, start_frames: int = 0) -> None:
        self.rng = rng
        self.layout = BoardLayout(config)
        self.frame = start_frames
        self.speed = [0] * self.layout.motor_count
        self.position = [0] * self.layout.motor_count

    def term(self, motor: int, length: int, wanted: int) -> MotorTerm:
        """Go to the wanted speed (2^-48 step/frame) as far as acceleration lets it; v starts where the last one
        ended.
        """
        limit = self.layout.max_acceleration[motor] * 9 // 10
        v0 = self.speed[motor]
        cubic = self.rng.random() < 0.5 and limit // length < 1 << 30
        change = wanted - v0
        most = limit * length // (2 if cubic else 1)
        change = max(-most, min(most, change))
        if cubic:
            # acceleration 0 -> peak or peak -> 0, linear
            j = 2 * change // (length * length)
            a = 0
            if self.rng.random() < 0.5:
                a, j = j * length, -j
        else:
            a, j = change // length, 0
        v = v0 >> V_SHIFT
        return MotorTerm(motor, v, a >> A_SHIFT, j)

    def segment(
        self,
        length: int,
        targets: dict[int, int],
        *,
        flags: SegmentFlag = SegmentFlag.NONE,
        hold: int = 300,
        stop: int = 600,
        events: tuple[SegmentEvent, ...] = (),
    ) -> Segment:
        """A segment in which each motor of `targets` heads for a speed."""
        terms = tuple(self.term(motor, length, targets[motor]) for motor in sorted(targets))
        if any(term.j for term in terms):
            flags |= SegmentFlag.CUBIC
        return Segment(self.frame, length, terms, flags, hold, stop, events)

    def take(self, segment: Segment) -> Segment:
        """The board has taken this segment: move the mirror to its end."""
        terms = {term.motor: term for term in segment.motors}
        for motor in range(self.layout.motor_count):
            term = terms.get(motor, MotorTerm(motor, 0))
            self.speed[motor] = velocity_q48(term, segment.length_frames)
            self.position[motor] = position_q48(self.position[motor], term, segment.length_frames)
        self.frame = segment.end_frames
        return segment

    def wanted_speed(self, motor: int, length: int) -> int:
        """A random speed; sometimes one that makes the motor swing about the nearest half step or whole step."""
        limit = self.layout.max_speed[motor] * 9 // 10
        kind = self.rng.random()
        if kind < 0.4:
            return self.rng.randint(-limit, limit)
        if kind < 0.6:
            return -self.speed[motor]
        if kind < 0.9:
            half = ONE_STEP >> 1
            nearest = (self.position[motor] + half // 2) // half * half
            return max(-limit, min(limit, 2 * (nearest - self.position[motor]) // length))
        return 0

    def peek_random(self, longest: int = 400) -> Segment:
        """A random legal segment, not yet taken."""
        rng = self.rng
        length = rng.choice((rng.randint(1, 12), rng.randint(12, 60), rng.randint(60, longest)))
        targets = {}
        for motor in self.layout.moved:
            if abs(self.speed[motor]) > self.layout.max_speed_jump // 2 or rng.random() < 0.7:
                targets[motor] = self.wanted_speed(motor, length)
        slope = rng.randint(150, 2000)
        return self.segment(length, targets, hold=slope, stop=slope * rng.randint(1, 3))

    def run(self, count: int, *, longest: int = 400, hand: bool = True) -> Iterator[Segment]:
        """`count` random segments and then as many as it takes to come to rest, the last one flagged so."""
        rng = self.rng
        moved = self.layout.moved
        hand_at = 0
        for _ in range(count):
            length = rng.choice((rng.randint(1, 12), rng.randint(20, longest)))
            targets = {}
            for motor in moved:
                if abs(self.speed[motor]) > self.layout.max_speed_jump // 2 or rng.random() < 0.7:
                    targets[motor] = self.wanted_speed(motor, length)
            events = []
            for offset in sorted(rng.randrange(length) for _ in range(rng.choice((0, 0, 0, 1, 2)))):
                pulses = rng.choice((1, -1)) * rng.randint(1, 60)
                if hand and self.frame + offset >= hand_at:
                    events.append(hand_event(offset, pulses))
                    hand_at = self.frame + offset + 3 * abs(pulses) + 10
            slope = rng.randint(150, 2000)
            yield self.take(
                self.segment(length, targets, hold=slope, stop=slope * rng.randint(1, 3), events=tuple(events))
            )
        for segment in self.plan_rest():
            yield self.take(segment)

    def plan_rest(self) -> Iterator[Segment]:
        """Segments that end at rest, each to be taken before the next is asked for."""
        while any(abs(speed) > 1 << 20 for speed in self.speed):
            frames = 1
            for motor in self.layout.moved:
                frames = max(frames, abs(self.speed[motor]) * 10 // (8 * self.layout.max_acceleration[motor]) + 2)
            length = min(frames, 20_000)
            yield self.segment(length, dict.fromkeys(self.layout.moved, 0))
        yield self.segment(10, {}, flags=SegmentFlag.ENDS_AT_REST)


def slopes_for(layout: BoardLayout, segment: Segment, ratio: int = 2) -> tuple[int, int]:
    """Hold and stop slopes so that no motor exceeds `ratio` (hold) or `ratio + 1` (stop) times its limit while ramping.

    slope = (ratio A - |a|) / |v| in rate per frame, the least over the motors, in 2^-20.
    """
    hold = stop = 0xFFFF
    for term in segment.motors:
        v_min, v_max, a_min, a_max = motor_extremes(term, segment.length_frames)
        v, a = max(-v_min, v_max, 1), max(-a_min, a_max)
        limit = layout.max_acceleration[term.motor]
        hold = min(hold, ((ratio * limit - a) << 20) // v)
        stop = min(stop, (((ratio + 1) * limit - a) << 20) // v)
    return max(1, hold), max(1, stop)


def swinging_program(rng: random.Random, swings: int, config: BoardConfig = RM501_BOARD) -> list[Segment]:
    """A program like an arm's: all motors come near full speed and to rest again, over and over, with hand strokes.

    Slopes are those that the host would declare, so ramps use the acceleration limits fully.
    """
    motion = LegalMotion(rng, config)
    layout = motion.layout
    made: list[Segment] = []

    def add(segment: Segment) -> None:
        hold, stop = slopes_for(layout, segment)
        made.append(motion.take(replace(segment, hold_slope=hold, stop_slope=stop)))

    for _ in range(swings):
        share = rng.uniform(0.3, 1.0)
        top = {motor: int(layout.max_speed[motor] * 0.95 * rng.uniform(-share, share)) for motor in layout.moved}
        length = max(abs(top[motor]) * 10 // (8 * layout.max_acceleration[motor]) + 2 for motor in layout.moved)
        pieces = rng.randint(1, 4)
        for piece in range(1, pieces + 1):
            add(motion.segment(length // pieces + 1, {m: top[m] * piece // pieces for m in top}))
        for _ in range(rng.randint(0, 3)):
            add(motion.segment(rng.randint(5, 600), top))
        for segment in motion.plan_rest():
            add(segment)
        if rng.random() < 0.3:
            pulses = rng.choice((1, -1)) * rng.randint(10, 300)
            add(
                motion.segment(
                    3 * abs(pulses) + 10, {}, flags=SegmentFlag.ENDS_AT_REST, events=(hand_event(0, pulses),)
                )
            )
    return made

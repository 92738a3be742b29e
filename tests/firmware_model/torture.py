"""Random segments by the thousand, legal and malicious, judged by their own arithmetic and by the pins alone.

Run as part of the tests with a few hundred segments and from `benchmarks.stepgen` with 1e5. Every segment is offered
to the board and to `judge`, which steps through it frame by frame or uses the protocol's extremes; both must agree on
whether it is legal. The recorded port words are decoded as the driver boards do, and in every frame the count of
steps at the pins is compared with the exact position.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rm501_firmware_model import BoardLayout
from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.config_pages import ConfigMotors, MotorLimits
from rm501_protocol.enums import BoardState, ResumeCause, SegmentFlag
from rm501_protocol.messages import Refused, Resume, SetOverride, Start
from rm501_protocol.segment import A_SHIFT, FRACTION_BITS, ONE_STEP, V_SHIFT, motor_extremes, velocity_q48
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import RecordingPins, Rig
from tests.firmware_model.waves import motor_waves, timing_violations

S32 = (-(1 << 31), (1 << 31) - 1)

HOT_BOARD = replace(
    RM501_BOARD, motors=ConfigMotors((*(MotorLimits(1562, 18_000),) * 5, MotorLimits(0, 0)), margin_permille=5)
)
"""Every motor at the rate that the scan allows, and at nearly the largest acceleration that the wire can say."""
CONFIGS = (RM501_BOARD, HOT_BOARD)


@dataclass(slots=True)
class Verdicts:
    """What a torture run found."""

    segments: int = 0
    accepted: int = 0
    refused: int = 0
    refused_for: dict[str, int] = field(default_factory=dict)
    frames: int = 0
    steps: int = 0
    timing_violations: int = 0
    wrong_counts: int = 0
    disagreements: int = 0
    worst_lag: float = 0.0
    first_problem: str = ""

    def problem(self, text: str) -> None:
        """Keep the first problem in words."""
        self.first_problem = self.first_problem or text


class FramePins(RecordingPins):
    """Also keeps, per real frame, the motion frame that was on the pins."""

    def __init__(self, config: BoardConfig) -> None:
        super().__init__(config)
        self.motion_frames: list[int] = []
        self.rig: Rig | None = None

    def write_frame(self, frame: int, words: object) -> None:
        super().write_frame(frame, words)  # type: ignore[arg-type]  # the board's list, as in the base
        self.motion_frames.append(self.rig.core.motion.motion_frame if self.rig else 0)


def judge(layout: BoardLayout, motion: LegalMotion, segment: Segment) -> bool:
    """Whether a segment is legal at the end of `motion`, by the protocol's own extremes and plain comparisons."""
    if segment.start_frames != motion.frame or not 1 <= segment.length_frames <= 65_535:
        return False
    if segment.length_frames > 32_767 and any(term.j for term in segment.motors):
        return False
    if segment.hold_slope == 0 or segment.stop_slope < segment.hold_slope or segment.flags & SegmentFlag.JOG:
        return False
    terms = {term.motor: term for term in segment.motors}
    if not set(terms) <= set(layout.moved):
        return False
    for motor in layout.moved:
        term = terms.get(motor, MotorTerm(motor, 0))
        if abs((term.v << V_SHIFT) - motion.speed[motor]) > layout.max_speed_jump:
            return False
        v_min, v_max, a_min, a_max = motor_extremes(term, segment.length_frames)
        if max(-v_min, v_max) > layout.max_speed[motor] or max(-a_min, a_max) > layout.max_acceleration[motor]:
            return False
        end = velocity_q48(term, segment.length_frames)
        if segment.flags & SegmentFlag.ENDS_AT_REST and abs(end) > layout.max_speed_jump:
            return False
    return all(event.offset_frames < segment.length_frames for event in segment.events)


def spoil(rng: random.Random, good: Segment) -> Segment:
    """Make something of a good segment that may or may not still be legal."""
    kind = rng.randrange(12)
    if kind == 0:
        return replace(good, start_frames=(good.start_frames + rng.choice((-1, 1, 7, 1 << 31))) & 0xFFFFFFFF)
    if kind == 1:
        return replace(good, length_frames=rng.choice((0, 1, good.length_frames * 3, 40_000)) & 0xFFFF)
    if kind == 2:
        return replace(good, hold_slope=rng.choice((0, 1, 0xFFFF)), stop_slope=rng.choice((0, 1, 0xFFFF)))
    if kind == 3:
        return replace(good, flags=good.flags | rng.choice((SegmentFlag.JOG, SegmentFlag.ENDS_AT_REST)))
    if kind == 4:
        return replace(good, motors=(*good.motors, MotorTerm(rng.choice((5, 6, 7)), rng.randint(-5, 5))))
    if kind == 5:
        return replace(good, motors=tuple(term for term in good.motors if rng.random() < 0.5))
    if not good.motors:
        return good
    index = rng.randrange(len(good.motors))
    term = good.motors[index]
    cubic = bool(good.flags & SegmentFlag.CUBIC)
    size = rng.choice((1, 1 << 10, 1 << 16, 1 << 22, 1 << 31))

    def near(value: int) -> int:
        return max(S32[0], min(S32[1], value + rng.randint(-size, size)))

    if kind < 8:
        term = replace(term, v=near(term.v))
    elif kind < 10:
        term = replace(term, a=near(term.a))
    elif cubic:
        term = replace(term, j=near(term.j))
    else:
        term = MotorTerm(term.motor, rng.randint(*S32), rng.randint(*S32))
    return replace(good, motors=(*good.motors[:index], term, *good.motors[index + 1 :]))


class Torture:
    """One board that gets `batch` segments at a time, comes to rest, and is judged."""

    def __init__(self, seed: int, config: BoardConfig = RM501_BOARD) -> None:
        self.rng = random.Random(seed)
        self.config = config
        self.pins = FramePins(config)
        self.rig = Rig(config, pins=self.pins)
        self.pins.rig = self.rig
        self.motion = LegalMotion(self.rng, config)
        self.found = Verdicts()
        self.played: list[tuple[Segment, list[int]]] = []

    def offer(self, segment: Segment) -> bool:
        """Offer a segment; whether it was taken. The judge must agree."""
        legal = judge(self.motion.layout, self.motion, segment)
        self.rig.messages.clear()
        self.rig.send(segment)
        refused = self.rig.got(Refused)
        self.found.segments += 1
        if len(refused) > 1 or legal == bool(refused):
            self.found.disagreements += 1
            self.found.problem(f"judge says legal={legal}, board says {refused} of {segment}")
        if refused:
            self.found.refused += 1
            name = refused[0].reason.name
            self.found.refused_for[name] = self.found.refused_for.get(name, 0) + 1
            return False
        self.found.accepted += 1
        self.played.append((segment, list(self.motion.position)))
        self.motion.take(segment)
        return True

    def batch(self, count: int) -> None:
        """Offer `count` segments, legal ones and spoilt ones, play what was taken, come to rest, compare."""
        start_frame = self.motion.frame
        while self.found.segments < count:
            self.make_room()
            self.offer_one()
        for segment in self.motion.plan_rest():
            self.make_room()
            self.offer(segment)
        self.rig.send(Start())
        self.run_dry()
        self.compare(start_frame)

    def offer_one(self) -> None:
        """One random segment, as it is or spoilt."""
        motion = self.motion
        good = motion.peek_random()
        segment = spoil(self.rng, good) if self.rng.random() < 0.35 else good
        self.offer(segment)

    def make_room(self) -> None:
        """Wait until the queue has a free slot, resuming after low water as a host does."""
        rig = self.rig
        while rig.core.queue.count >= rig.core.queue.slots - 1:
            if rig.state is BoardState.READY:
                rig.send(Start())
                if rig.state is BoardState.READY:
                    # 31 segments too short for the slope at full speed: a slower start needs less room
                    rig.send(SetOverride(rig.core.motion.target // 2 or 1))
                    rig.send(Start())
            elif rig.state is BoardState.HELD:
                rig.send(Resume(ResumeCause.REFILLED))
            elif rig.core.motion.target < 1 << 24:
                rig.send(SetOverride(1 << 24))
            rig.run(40, 40)

    def run_dry(self) -> None:
        """Run until everything is played and the levels are quiet."""
        rig = self.rig
        rig.send(SetOverride(1 << 24))
        limit = rig.board.frame + 10_000_000
        while rig.core.queue.count:
            if rig.state is BoardState.HELD:
                rig.send(Resume(ResumeCause.REFILLED))
            elif rig.state is BoardState.READY:
                rig.send(Start())
            rig.run(500, 500)
            assert rig.board.frame < limit, "never comes to rest"
        rig.run(8, 8)

    def compare(self, start_frame: int) -> None:
        """Count of steps at the pins against the exact position, frame by frame, and the timing rules."""
        found = self.found
        frames = np.array(self.pins.motion_frames, dtype=np.int64)
        self.waves = waves = motor_waves(self.pins.words(), self.config)
        found.frames += len(frames)
        for motor in self.motion.layout.moved:
            wave = waves[motor]
            violations = timing_violations(wave, self.config)
            found.timing_violations += len(violations)
            if violations:
                found.problem(f"motor {motor}: {violations[0]}")
            ideal = self.ideal(motor, start_frame)
            counts = wave.counts()
            found.steps += len(wave.rises())
            lag = np.abs(ideal[frames - start_frame] - counts)
            worst = float(lag.max())
            found.worst_lag = max(found.worst_lag, worst)
            if worst > 0.54:
                found.problem(f"motor {motor}: lag {worst} at real frame {int(lag.argmax())}")
            final = (self.motion.position[motor] + ONE_STEP // 2) >> FRACTION_BITS
            if int(counts[-1]) != final or self.rig.board.positions_q48[motor] != self.motion.position[motor]:
                found.wrong_counts += 1
                found.problem(f"motor {motor}: {int(counts[-1])} steps, should be {final}")

    def ideal(self, motor: int, start_frame: int) -> NDArray[np.float64]:
        """Positions in steps at every motion frame from the first on; the rounding to float is 2^-30 step here."""
        parts = [np.zeros(1)]
        for segment, before in self.played:
            n = np.arange(1, segment.length_frames + 1, dtype=np.int64)
            term = next((term for term in segment.motors if term.motor == motor), MotorTerm(motor, 0))
            fraction = before[motor] & (ONE_STEP - 1)
            whole = before[motor] >> FRACTION_BITS
            pairs = n * (n - 1) // 2
            # at most 2^16 frames at half a step: 2^15 steps and 48 bits of fraction fit an int64
            exact = (
                np.int64(fraction)
                + n * np.int64(term.v << V_SHIFT)
                + pairs * np.int64(term.a << A_SHIFT)
                + pairs * (n - 2) // 3 * np.int64(term.j)
            )
            parts.append(whole + exact / float(ONE_STEP))
        return np.concatenate(parts)


def torture(count: int, seed: int, batch: int = 400) -> Verdicts:
    """`count` segments in batches, each on a board of its own; the sum of what was found."""
    total = Verdicts()
    number = 0
    while total.segments < count:
        run = Torture(seed * 100_003 + number, CONFIGS[number % len(CONFIGS)])
        run.batch(min(batch, count - total.segments))
        number += 1
        found = run.found
        for name in ("segments", "accepted", "refused", "frames", "steps", "timing_violations", "wrong_counts"):
            setattr(total, name, getattr(total, name) + getattr(found, name))
        total.disagreements += found.disagreements
        total.worst_lag = max(total.worst_lag, found.worst_lag)
        for name, times in found.refused_for.items():
            total.refused_for[name] = total.refused_for.get(name, 0) + times
        total.problem(found.first_problem)
    return total

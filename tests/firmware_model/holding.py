"""Holding and resuming a program over and over, and stalling its host: what must stay the same, how hard it brakes.

Used by the tests with a few holds and by `benchmarks.stepgen` with a thousand.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.enums import BoardState, HoldCause, ResumeCause
from rm501_protocol.messages import Hold, Refused, Resume, SetOverride, SetPositions, Start
from rm501_protocol.segment import A_SHIFT, ONE_STEP, V_SHIFT
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.rig import ONE, RecordingPins, Rig
from tests.firmware_model.waves import hand_wave, motor_waves

MOTORS = range(5)
Index = NDArray[np.int64] | int


class TimePins(RecordingPins):
    """Also keeps motion frame, phase, and whether steps may be counted as motion, per real frame."""

    def __init__(self, config: BoardConfig = RM501_BOARD) -> None:
        super().__init__(config)
        self.rig: Rig | None = None
        self.motion_frames: list[int] = []
        self.phases: list[int] = []

    def write_frame(self, frame: int, words: Sequence[int]) -> None:
        super().write_frame(frame, words)
        motion = self.rig.core.motion if self.rig else None
        self.motion_frames.append(motion.motion_frame if motion else 0)
        self.phases.append(motion.phase if motion else 0)


class Player:
    """A host that streams segments, keeps the queue filled and resumes after low water; the segments start at motion
    frame 0.
    """

    def __init__(self, segments: Sequence[Segment], start_steps: Sequence[int] = (0,) * 6) -> None:
        self.pins = TimePins()
        self.rig = Rig(pins=self.pins)
        self.pins.rig = self.rig
        self.waiting = list(segments)
        self.sent = 0
        self.rig.send(SetPositions(0x3F, tuple(start_steps)))

    @property
    def done(self) -> bool:
        """Everything was sent and played."""
        return self.sent == len(self.waiting) and self.rig.core.queue.count == 0

    def top_up(self, lead_frames: int = 1 << 30) -> None:
        """Send what the queue has room for, up to `lead_frames` ahead of the motion."""
        core = self.rig.core
        while self.sent < len(self.waiting) and self.rig.host.segment_credit > 0:
            ahead = (core.checker.end_frame - core.motion.motion_frame) & 0xFFFFFFFF
            if ahead >= lead_frames:
                break
            self.rig.send(self.waiting[self.sent])
            assert not self.rig.got(Refused), self.rig.got(Refused)
            self.sent += 1

    def host(self, lead_frames: int = 1 << 30) -> None:
        """One turn of the host: top up, start, resume after low water."""
        self.top_up(lead_frames)
        rig = self.rig
        if rig.state is BoardState.READY and rig.core.queue.count:
            rig.send(Start())
        elif rig.state is BoardState.HELD and rig.core.causes == 1 << HoldCause.LOW_WATER:
            rig.send(Resume(ResumeCause.REFILLED))

    def play(self, frames: int = 1 << 40, turn: int = 50, lead_frames: int = 1 << 30) -> None:
        """Let the program run for so many frames or to its end."""
        end = self.rig.board.frame + frames
        while not self.done and self.rig.board.frame < end:
            self.host(lead_frames)
            self.rig.run(min(turn, end - self.rig.board.frame), turn)

    def settle(self) -> None:
        """Let the levels and the hand come to an end."""
        self.rig.run(4000, 1000)


@dataclass(frozen=True, slots=True)
class Trace:
    """What a run put on the pins, as a function of motion time."""

    levels: NDArray[np.int64]
    """STEP and DIR of all motors as one number per real frame, repeated frames removed."""
    by_motion_frame: NDArray[np.int64]
    """The same number by motion frame, -1 where it was not the same in every real frame of that motion frame."""
    counts: tuple[int, ...]
    hand: tuple[int, ...]
    """Direction of every power pulse."""
    hand_starts: tuple[int, ...]
    """Motion frames in which a stroke of the hand began."""
    motion_time: NDArray[np.float64]
    """Motion frames and phase at the end of each real frame."""


def trace(player: Player) -> Trace:
    """Read a finished run from its pins."""
    words = player.pins.words()
    frames = np.array(player.pins.motion_frames, dtype=np.int64)
    phases = np.array(player.pins.phases, dtype=np.float64)
    waves = motor_waves(words)
    code = np.zeros(len(words), dtype=np.int64)
    for motor in MOTORS:
        code = code * 4 + waves[motor].step * 2 + waves[motor].direction
    changed = np.concatenate(([True], code[1:] != code[:-1]))
    # the last motion frame of the run also holds what settles afterwards: leave it to `levels`
    by_frame = np.zeros(int(frames[-1]), dtype=np.int64)
    inside = frames < frames[-1]
    by_frame[frames[inside]] = code[inside]
    unsteady = inside & (by_frame[np.minimum(frames, frames[-1] - 1)] != code)
    by_frame[frames[unsteady]] = -1
    hand = hand_wave(words)
    pulses = hand.rises()
    starts = pulses[np.concatenate(([True], np.diff(pulses) > 40))] if len(pulses) else pulses
    return Trace(
        code[changed],
        by_frame,
        tuple(int(waves[motor].counts()[-1]) for motor in MOTORS),
        tuple(np.where(hand.direction[pulses], -1, 1).tolist()),
        tuple(frames[starts].tolist()),
        frames + phases / ONE,
    )


class Ideal:
    """Position and speed of every motor as functions of motion time, in steps and frames, from the segments."""

    def __init__(self, segments: Sequence[Segment]) -> None:
        self.starts = np.array([segment.start_frames for segment in segments], dtype=np.float64)
        count = len(segments)
        self.v = np.zeros((5, count))
        self.a = np.zeros((5, count))
        self.j = np.zeros((5, count))
        self.p = np.zeros((5, count + 1))
        for index, segment in enumerate(segments):
            terms = {term.motor: term for term in segment.motors}
            n = float(segment.length_frames)
            for motor in MOTORS:
                term = terms.get(motor, MotorTerm(motor, 0))
                v, a, j = ((term.v << V_SHIFT) / ONE_STEP, (term.a << A_SHIFT) / ONE_STEP, term.j / ONE_STEP)
                # the polynomial through the stepped positions: p(n) = p + n v + n(n-1)/2 a + n(n-1)(n-2)/6 j
                self.v[motor, index] = v - a / 2 + j / 3
                self.a[motor, index] = a - j
                self.j[motor, index] = j
                self.p[motor, index + 1] = self.p[motor, index] + self._offset(motor, index, n)

    def _offset(self, motor: int, index: Index, n: NDArray[np.float64] | float) -> NDArray[np.float64]:
        v, a, j = self.v[motor, index], self.a[motor, index], self.j[motor, index]
        return np.asarray(((j / 6 * n + a / 2) * n + v) * n)

    def positions(self, motor: int, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Position in steps at these motion times."""
        index = np.clip(np.searchsorted(self.starts, time, side="right") - 1, 0, len(self.starts) - 1)
        return self.p[motor, index] + self._offset(motor, index, time - self.starts[index])


def worst_acceleration(ideal: Ideal, time: NDArray[np.float64], motor: int, window: int = 25) -> float:
    """Largest acceleration in steps/frame^2 over `window` frames (8 ms): mean speed before against mean speed after."""
    position = ideal.positions(motor, time)
    second = position[2 * window :] - 2 * position[window:-window] + position[: -2 * window]
    return float(np.abs(second).max()) / window**2


def hold_often(segments: Sequence[Segment], holds: int, seed: int, start_steps: Sequence[int] = (0,) * 6) -> Player:
    """Play a program with `holds` holds at random instants, some with overrides, each resumed after a random time.

    A program is over sooner than a thousand holds are: the rest are spread so that all of them fall into it.
    """
    rng = random.Random(seed)
    player = Player(segments, start_steps)
    total = sum(segment.length_frames for segment in segments)
    instants = sorted(rng.randrange(total) for _ in range(holds))
    rig = player.rig
    for instant in instants:
        while rig.core.motion.motion_frame < instant and not player.done:
            player.host()
            rig.run(max(1, min(50, instant - rig.core.motion.motion_frame)), 50)
        if player.done:
            break
        if rng.random() < 0.1:
            rig.send(SetOverride(rng.choice((ONE // 2, ONE // 5, ONE))))
        rig.send(Hold())
        if rng.random() < 0.7:
            rig.run_to(BoardState.HELD, step=1 if rng.random() < 0.2 else 37)
            rig.run(rng.randint(0, 200))
        else:
            rig.run(rng.randint(0, 300))  # resumed while still slowing down
        rig.send(Resume())
        assert not rig.got(Refused), rig.got(Refused)
    rig.send(SetOverride(ONE))
    player.play()
    player.settle()
    return player


@dataclass(frozen=True, slots=True)
class Stall:
    """What a host stall did."""

    stall_s: float
    state: BoardState
    cause: HoldCause
    stopped_after_s: float
    steps_lost: int
    same_levels: bool
    trusted: bool


def stall(segments: Sequence[Segment], at_frame: int, stall_s: float, lead_frames: int, reference: Trace) -> Stall:
    """Stream a program, let the host be silent for `stall_s` in the middle, then let it go on; a user resumes a lost
    link.
    """
    player = Player(segments)
    rig = player.rig
    while rig.core.motion.motion_frame < at_frame:
        player.play(20, 20, lead_frames)
    silent_from = rig.board.frame
    stopped = -1
    rig.cut = True
    for _ in range(int(stall_s / (rig.board.frame_us * 1e-6)) // 25):
        rig.board.run_until(rig.board.frame + 25)
        if stopped < 0 and rig.core.motion.rate == 0:
            stopped = rig.board.frame - silent_from
    rig.cut = False
    rig.run(200, 10)  # the links find each other
    state, cause = rig.state, HoldCause(rig.core.shown_cause())
    player.top_up(lead_frames)
    if cause is HoldCause.LINK_LOST:
        rig.send(Resume(ResumeCause.USER))
    player.play(lead_frames=lead_frames)
    player.settle()
    after = trace(player)
    lost = sum(abs(a - b) for a, b in zip(after.counts, reference.counts, strict=True))
    return Stall(
        stall_s,
        state,
        cause,
        stopped * rig.board.frame_us * 1e-6,
        lost,
        bool(np.array_equal(after.levels, reference.levels)),
        rig.core.trusted & 0x1F == 0x1F,
    )

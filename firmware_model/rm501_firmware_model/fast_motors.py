"""The motors of the fast path: their levels over the motion frames that follow, made once for several stretches.

A stretch is as short as the pause between two packets, some dozen frames, and an array operation costs about the same
for those as for some hundred. So the levels are made for as many frames as the segment has left, up to `AHEAD_FRAMES`,
and handed out as they are asked for. They are used only while the step generators stand exactly where these levels
lead: whatever else has happened meanwhile (a stop, another segment), what does not match is made anew. After every
stretch the step generators are given the state in which the reference would leave them.

A motor whose speed does not change its sign makes a step in every frame in which floor(p + 1/2) changes, as long as
two of them are far enough apart; that is an array operation. A motor that turns round, or whose steps are late, is
stepped frame by frame.

All arithmetic is in int64 relative to the step count at the start: with at most 8192 frames at less than half a step a
frame it stays below 2^60. Products of the closed form may wrap, sums of them do not.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from rm501_protocol.segment import FRACTION_BITS

from .core import Core
from .limits import pyramid, speed_at, turning_frame
from .segment_queue import FRAME_MASK, triangle
from .stepgen import HALF_STEP, StepGenerator

__all__ = ["AHEAD_FRAMES", "MAX_STRETCH_FRAMES", "MotorsAhead", "Words"]

MAX_STRETCH_FRAMES = 8192
AHEAD_FRAMES = 512

_FRAMES = np.arange(MAX_STRETCH_FRAMES + 1, dtype=np.int64)
_TRIANGLES = _FRAMES * (_FRAMES - 1) // 2
_PYRAMIDS = _TRIANGLES * (_FRAMES - 2) // 3

Levels = NDArray[np.bool_]
Words = NDArray[np.uint32]
Due = NDArray[np.int64]
State = tuple[list[int], ...]


def _state(stepgen: StepGenerator) -> State:
    """The lists that change while motors play; whoever writes into them writes into the step generators."""
    return (
        stepgen.position,
        stepgen.velocity,
        stepgen.acceleration,
        stepgen.jerk,
        stepgen.count,
        stepgen.high_frames,
        stepgen.rise_wait,
        stepgen.dir_wait,
        stepgen.dir_level,
    )


class MotorsAhead:
    """Levels of all moving motors from one motion frame on; index 0 is the state before the first frame."""

    def __init__(self) -> None:
        self._core: Core | None = None
        self._frames = -1  # made ahead
        self._at = 0  # index up to which they have been handed out
        self._motion_frame = 0  # the one at that index
        self._ways: list[_Way] = []
        self._slot_bits: list[tuple[int, Words]] = []  # bits of the moving motors, for slots that have any
        self._words: Words = np.zeros((0, 0), dtype=np.uint32)
        self._state: State = ()

    def play(self, core: Core, plays: int) -> Words:
        """Play `plays` motion frames: which bits have changed after each since before the first, (plays + 1, periods).

        They must lie within one segment, the last frame of which is not among them. Positions, counts, waits and the
        slots' words are afterwards as if the reference had played them.
        """
        stepgen = core.stepgen
        if not self._is_here(core) or self._at + plays > self._frames:
            left = core.queue.length[core.queue.head] - core.motion.played - 1
            self._make(core, max(plays, min(AHEAD_FRAMES, left)))
        first, last = self._at, self._at + plays
        state = _state(stepgen)
        for way in self._ways:
            way.tell(last, state)
        slot_words = core.layout.slot_words
        for slot, bits in self._slot_bits:
            slot_words[slot] ^= bits.item(first) ^ bits.item(last)
        self._at = last
        self._motion_frame = (core.motion.motion_frame + plays) & FRAME_MASK
        self._state = tuple(map(list, state))
        changed: Words = self._words[first : last + 1] ^ self._words[first]
        return changed

    def _is_here(self, core: Core) -> bool:
        """Whether the step generators stand where the frames made ahead lead; maybe the reference has made some."""
        passed = (core.motion.motion_frame - self._motion_frame) & FRAME_MASK
        if core is not self._core or passed > self._frames - self._at:
            return False
        expected = self._state
        if passed:
            expected = tuple(map(list, expected))
            for way in self._ways:
                way.tell(self._at + passed, expected)
        if expected != _state(core.stepgen):
            return False
        self._at += passed
        return True

    def _make(self, core: Core, frames: int) -> None:
        """Levels of the `frames` motion frames that follow."""
        stepgen = core.stepgen
        layout = core.layout
        self._core = core
        self._at, self._frames = 0, frames
        motors = [motor for motor in layout.moved if not _is_idle(stepgen, motor)]
        self._ways, self._slot_bits = [], []
        self._words = np.zeros((frames + 1, layout.periods), dtype=np.uint32)
        if not motors:
            return
        # step counts due before the first motion frame and after each, relative to those made: one row per motor
        rows = np.array(
            [
                (
                    stepgen.position[motor] + HALF_STEP - (stepgen.count[motor] << FRACTION_BITS),
                    stepgen.velocity[motor],
                    stepgen.acceleration[motor],
                    stepgen.jerk[motor],
                )
                for motor in motors
            ],
            dtype=np.int64,
        )
        due = rows[:, 1:2] * _FRAMES[: frames + 1]
        due += rows[:, :1]
        due += rows[:, 2:3] * _TRIANGLES[: frames + 1]
        due += rows[:, 3:] * _PYRAMIDS[: frames + 1]
        due >>= FRACTION_BITS
        rises = due[:, 1:] != due[:, :-1]
        bits_of_slot: dict[int, Words] = {}
        for row, motor in enumerate(motors):
            way = _Way(stepgen, motor, frames, due[row], rises[row])
            self._ways.append(way)
            bits = way.step * np.uint32(stepgen.step_mask[motor]) ^ way.direction * np.uint32(stepgen.dir_mask[motor])
            slot = layout.motor_slot[motor]
            if slot in bits_of_slot:
                bits_of_slot[slot] ^= bits
            else:
                bits_of_slot[slot] = bits
        self._slot_bits = list(bits_of_slot.items())
        for period, slot in enumerate(layout.entry_slots):
            if slot in bits_of_slot:
                self._words[:, period] = bits_of_slot[slot]


def _is_idle(stepgen: StepGenerator, motor: int) -> bool:
    """Whether a motor neither moves nor has anything left to do."""
    return not (
        stepgen.velocity[motor]
        or stepgen.acceleration[motor]
        or stepgen.jerk[motor]
        or stepgen.high_frames[motor]
        or stepgen.rise_wait[motor]
        or stepgen.dir_wait[motor]
        or (stepgen.position[motor] + HALF_STEP) >> FRACTION_BITS != stepgen.count[motor]
    )


class _Way:
    """One motor over the frames made ahead: `step` and `direction`, its levels before the first frame and after each.

    `due` (frames + 1): step counts relative to those made; `rises` (frames): where they change.
    """

    def __init__(self, stepgen: StepGenerator, motor: int, frames: int, due: Due, rises: Levels) -> None:
        self._stepgen = stepgen
        self._motor = motor
        self._start = tuple(values[motor] for values in _state(stepgen))
        self._due = due
        self._turned: list[tuple[int, int, int, int, int]] | None = None
        self._rise_frames: list[int] = []
        self.direction: Levels | np.bool_ = np.bool_(stepgen.dir_level[motor])
        if self._is_steady(frames, rises):
            self._rise_frames = (np.flatnonzero(rises) + 1).tolist()
            self.step = self._steady_levels(frames, rises)
        else:
            self._turned = self._frame_by_frame(due)
            _, high, _, _, level = zip(*self._turned, strict=True)
            self.step = np.array(high) > 0
            self.direction = np.array(level) != 0

    def tell(self, at: int, state: State) -> None:
        """Write the motor's state at an index into the lists of `_state`."""
        motor = self._motor
        p, v, a, j, count, high, rise_wait, dir_wait, level = self._start
        triangles = triangle(at)
        state[0][motor] = p + at * v + triangles * a + pyramid(at) * j
        state[1][motor] = v + at * a + triangles * j
        state[2][motor] = a + at * j
        state[3][motor] = j
        if self._turned is not None:
            made, high, rise_wait, dir_wait, level = self._turned[at]
        else:
            stepgen = self._stepgen
            made = self._due.item(at)
            elapsed = at
            rises_before = bisect_right(self._rise_frames, at)
            if rises_before:
                elapsed -= self._rise_frames[rises_before - 1]
                high, rise_wait, dir_wait = (
                    stepgen.step_length_frames,
                    stepgen.rise_wait_frames,
                    stepgen.dir_wait_frames,
                )
            high, rise_wait, dir_wait = max(0, high - elapsed), max(0, rise_wait - elapsed), max(0, dir_wait - elapsed)
        state[4][motor] = count + made
        state[5][motor] = high
        state[6][motor] = rise_wait
        state[7][motor] = dir_wait
        state[8][motor] = level

    def _is_steady(self, frames: int, rises: Levels) -> bool:
        """Whether the motor keeps its direction and is never late."""
        _, v, a, j, _, _, rise_wait, _, negative = self._start
        due = self._due
        for frame in (1, frames) if (a < 0) == (a + frames * j < 0) else (1, turning_frame(a, j, frames), frames):
            speed = speed_at(v, a, j, frame)
            if speed and (speed < 0) != negative:
                return False
        if due.item(0) != 0:
            return False
        # v(0), which brought p to frame 1, may have had the other sign; the distance between later rises needs no
        # check, because the rate limit lets p move by no more than one step in step length + step space
        if due.item(frames) or due.item(1):
            first = int(rises.argmax()) + 1
            if (due.item(first) < 0) != negative or first < rise_wait:
                return False
        return True

    def _steady_levels(self, frames: int, rises: Levels) -> Levels:
        step = np.zeros(frames + 1, dtype=np.bool_)
        step[1:] = rises
        for offset in range(1, self._stepgen.step_length_frames):
            step[1 + offset :] |= rises[:-offset]
        step[: self._start[5]] = True
        return step

    def _frame_by_frame(self, due: Due) -> list[tuple[int, int, int, int, int]]:
        """Steps made, the three waits and the level of DIR at every index, as the reference makes them."""
        stepgen = self._stepgen
        _, v, a, j, _, high, rise_wait, dir_wait, level = self._start
        made = 0
        found = [(made, high, rise_wait, dir_wait, level)]
        for wanted in due[1:].tolist():
            v += a
            a += j
            high -= high > 0
            rise_wait -= rise_wait > 0
            dir_wait -= dir_wait > 0
            turn = False
            if wanted != made:
                if (wanted < made) == level:
                    if rise_wait == 0:
                        made += -1 if level else 1
                        high = stepgen.step_length_frames
                        rise_wait = stepgen.rise_wait_frames
                        dir_wait = stepgen.dir_wait_frames
                else:
                    turn = dir_wait == 0
            else:
                turn = dir_wait == 0 and v != 0 and (v < 0) != level
            if turn:
                level ^= 1
                rise_wait = max(rise_wait, stepgen.setup_frames)
            found.append((made, high, rise_wait, dir_wait, level))
        return found

"""The fast path: the same board, many frames at a time, the same port words and bytes bit for bit.

Wherever nothing but motion at a constant rate can happen, the frames of a whole stretch are computed at once from the
closed form of the forward differences; every other frame is made by the reference. A stretch ends before the next
timer, the next event, the last frame of the segment, the frame in which low water might be reached, and the end of
the environment's promise that its inputs stay as they are. Ramps, strokes of the hand, debouncing and settling are
left to the reference.

Within a stretch a motor whose speed does not change its sign makes a step in every frame in which floor(p + 1/2)
changes, as long as two of them are far enough apart; that is an array operation. A motor that turns round, or whose
steps are late, is stepped frame by frame.

All arithmetic is in int64 relative to the step count at the start of the stretch: with at most 8192 frames at less
than half a step a frame it stays below 2^60. Products of the closed form may wrap, sums of them do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_protocol.enums import BoardState
from rm501_protocol.segment import FRACTION_BITS

from .board import Board
from .core import NEVER
from .limits import pyramid, speed_at, turning_frame
from .motion import RATE_ONE
from .segment_queue import FRAME_MASK, triangle
from .stepgen import HALF_STEP

__all__ = ["MAX_STRETCH_FRAMES", "MIN_STRETCH_FRAMES", "FastBoard"]

MAX_STRETCH_FRAMES = 8192
MIN_STRETCH_FRAMES = 12
"""Below it the reference is as fast."""

_FRAMES = np.arange(MAX_STRETCH_FRAMES + 1, dtype=np.int64)
_TRIANGLES = _FRAMES * (_FRAMES - 1) // 2
_PYRAMIDS = _TRIANGLES * (_FRAMES - 2) // 3

Levels = NDArray[np.bool_]
Words = NDArray[np.uint32]


class FastBoard(Board):
    """`Board`, many frames at a time; pins get `write_block` for a stretch and `write_frame` for a single frame."""

    def run_until(self, frame: int) -> None:
        """Make all frames up to `frame`, exclusive."""
        pins = self._pins
        while self._core.real_frame < frame:
            core = self._core
            number = core.real_frame
            inputs = pins.read_inputs(number)
            stretch = self._stretch(frame, inputs)
            if stretch >= MIN_STRETCH_FRAMES:
                pins.write_block(number, self._play_stretch(stretch))
                continue
            core.frame(inputs)
            pins.write_frame(number, core.words)
            if core.reports:
                self._report()

    def quiet_until(self) -> int:
        """First frame that may give the board something to say: a timer, an input, the end of a segment, the link."""
        core = self._core
        now = core.real_frame
        if core.reports or not core.sampled or not core.inputs.quiet(self._pins.read_inputs(now)):
            return now
        until = core.wake if core.wake > now else self._next_timer()
        if until <= now:
            return now
        due = self.next_transmit_frame()
        if due is not None and due <= until:
            until = due - 1
        until = min(until, self._pins.inputs_stable_until(now), now + MAX_STRETCH_FRAMES)
        return now + self._steady_frames(until - now) if core.motion.moving and until > now else max(now, until)

    def _next_timer(self) -> int:
        """First frame with a timer that is due, as `Core.timers` will find when it looks in the frame made next."""
        core = self._core
        layout = core.layout
        due = core.status_due if core.status_frames else NEVER
        for end in (core.master_reset_end, core.lease_end):
            if end:
                due = min(due, end)
        moving = core.motion.moving
        silence = layout.link_timeout_frames if moving else layout.idle_power_off_frames
        if silence and core.link_silent <= (0 if moving else 1):
            due = min(due, core.heard_frame + silence)
        return due

    # ------------------------------------------------------------------------------------------------- how far at once

    def _stretch(self, end: int, inputs: int) -> int:
        """Real frames that may be made at once, 0 for none."""
        core = self._core
        hand = core.hand
        now = core.real_frame
        frames = min(end, core.wake) - now
        if frames < MIN_STRETCH_FRAMES or not core.sampled or core.settling or not core.inputs.quiet(inputs):
            return 0
        if hand.pending or hand.high_frames or hand.rise_wait or hand.dir_wait:
            return 0
        frames = min(frames, MAX_STRETCH_FRAMES, self._pins.inputs_stable_until(now) - now)
        return self._steady_frames(frames) if core.motion.moving else frames

    def _steady_frames(self, frames: int) -> int:
        """Of so many real frames in motion, those in which only motion at a constant rate can happen."""
        core = self._core
        motion = core.motion
        now = core.real_frame
        if motion.gated:
            wait = (motion.start_frame - now) & FRAME_MASK
            return min(frames, wait) if not motion.braking and wait <= FRAME_MASK >> 1 else 0
        if motion.braking or motion.rate != motion.target or motion.played == 0:
            return 0
        plays = self._plays_allowed(frames)
        if motion.rate == RATE_ONE:
            return min(frames, plays)
        # the most real frames in which phase overflows no more than `plays` times
        return min(frames, (plays * RATE_ONE + RATE_ONE - 1 - motion.phase) // motion.rate)

    def _plays_allowed(self, most: int) -> int:
        """Motion frames that may be played before something else than motion can happen."""
        core = self._core
        motion = core.motion
        queue = core.queue
        plays = min(most, queue.length[queue.head] - motion.played - 1)
        if queue.event_count:
            plays = min(plays, (queue.event_frame[queue.event_head] - motion.motion_frame) & FRAME_MASK)
        if not queue.rest_points:
            slope = queue.hold_slope[queue.head]
            low, high = -1, plays
            while low < high:
                middle = (low + high + 1) // 2
                if motion.outruns(motion.rate, queue.room - middle * slope):
                    high = middle - 1
                else:
                    low = middle
            plays = low
        return max(plays, 0)

    # ------------------------------------------------------------------------------------------------------- one
    # stretch

    def _play_stretch(self, frames: int) -> Words:
        """Make `frames` real frames; shape (frames, periods)."""
        core = self._core
        layout = core.layout
        motion = core.motion
        slots: list[Words] = []
        if motion.moving and not motion.gated:
            total = motion.phase + frames * motion.rate
            plays = total >> 24
            if plays:
                slots = self._play_motors(plays)
            if motion.rate != RATE_ONE:
                index = (motion.phase + motion.rate * _FRAMES[1 : frames + 1]) >> 24
                slots = [slot[index] for slot in slots]
            else:
                slots = [slot[1:] for slot in slots]
            motion.phase = total & (RATE_ONE - 1)
            motion.played += plays
            motion.motion_frame = (motion.motion_frame + plays) & FRAME_MASK
            core.queue.room -= plays * core.queue.hold_slope[core.queue.head]
        words = np.empty((frames, layout.periods), dtype=np.uint32)
        for period in range(layout.periods):
            slot = layout.entry_slots[period]
            fixed = layout.entry_words[period] ^ core.line_word
            if slots:
                np.bitwise_xor(slots[slot], np.uint32(fixed), out=words[:, period])
            else:
                words[:, period] = fixed ^ layout.slot_words[slot]
        if core.state != BoardState.FAULT and layout.heartbeat_mask:
            words[0::2] ^= np.uint32(layout.heartbeat_mask)
            if frames & 1:
                core.line_word ^= layout.heartbeat_mask
        core.real_frame += frames
        for number, levels in enumerate(slots):
            layout.slot_words[number] = int(levels[-1])
        return words

    def _play_motors(self, plays: int) -> list[Words]:
        """Play motion frames; per slot its word before the first one and after each: shape (plays + 1)."""
        core = self._core
        stepgen = core.stepgen
        layout = core.layout
        slots = [np.full(plays + 1, word, dtype=np.uint32) for word in layout.slot_words]
        motors = [motor for motor in layout.moved if not self._idle_motor(motor)]
        if not motors:
            return slots
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
        due = rows[:, 1:2] * _FRAMES[: plays + 1]
        due += rows[:, :1]
        due += rows[:, 2:3] * _TRIANGLES[: plays + 1]
        due += rows[:, 3:] * _PYRAMIDS[: plays + 1]
        due >>= FRACTION_BITS
        rises = due[:, 1:] != due[:, :-1]
        for row, motor in enumerate(motors):
            slot = slots[layout.motor_slot[motor]]
            before_step = stepgen.step_mask[motor] if stepgen.high_frames[motor] else 0
            before_dir = stepgen.dir_mask[motor] if stepgen.dir_level[motor] else 0
            slot ^= np.uint32(before_step ^ before_dir)
            step, direction = self._play_motor(motor, plays, due[row], rises[row])
            slot ^= step * np.uint32(stepgen.step_mask[motor])
            slot ^= direction * np.uint32(stepgen.dir_mask[motor])
        return slots

    def _idle_motor(self, motor: int) -> bool:
        """Whether a motor neither moves nor has anything left to do."""
        stepgen = self._core.stepgen
        return not (
            stepgen.velocity[motor]
            or stepgen.acceleration[motor]
            or stepgen.jerk[motor]
            or stepgen.high_frames[motor]
            or stepgen.rise_wait[motor]
            or stepgen.dir_wait[motor]
            or (stepgen.position[motor] + HALF_STEP) >> FRACTION_BITS != stepgen.count[motor]
        )

    def _play_motor(
        self, motor: int, plays: int, due: NDArray[np.int64], rises: Levels
    ) -> tuple[Levels, Levels | np.bool_]:
        """STEP and DIR of one motor before the first motion frame and after each; its state moves on."""
        stepgen = self._core.stepgen
        v, a, j = stepgen.velocity[motor], stepgen.acceleration[motor], stepgen.jerk[motor]
        direction: Levels | np.bool_ = np.bool_(stepgen.dir_level[motor])
        step = self._steady_motor(motor, plays, v, a, j, due, rises)
        if step is None:
            levels = np.full(plays + 1, direction)
            step = self._turning_motor(motor, plays, v, a, j, due, levels)
            direction = levels
        triangles = triangle(plays)
        stepgen.position[motor] += plays * v + triangles * a + pyramid(plays) * j
        stepgen.velocity[motor] = v + plays * a + triangles * j
        stepgen.acceleration[motor] = a + plays * j
        return step, direction

    def _steady_motor(
        self, motor: int, plays: int, v: int, a: int, j: int, due: NDArray[np.int64], rises: Levels
    ) -> Levels | None:
        """STEP of a motor that keeps its direction and is never late; None when it does not, and then nothing has
        changed. `rises` (plays): where `due` changes.
        """
        stepgen = self._core.stepgen
        negative = stepgen.dir_level[motor]
        for frame in (1, plays) if (a < 0) == (a + plays * j < 0) else (1, turning_frame(a, j, plays), plays):
            speed = speed_at(v, a, j, frame)
            if speed and (speed < 0) != negative:
                return None
        if due.item(0) != 0:
            return None
        made = due.item(plays)
        elapsed = plays
        # v(0), which brought p to frame 1, may have had the other sign; the distance between later rises needs no
        # check, because the rate limit lets p move by no more than one step in step length + step space
        if made or due.item(1):
            first = int(rises.argmax()) + 1
            if (due.item(first) < 0) != negative or first < stepgen.rise_wait[motor]:
                return None
            elapsed = int(rises[::-1].argmax())
        step = np.zeros(plays + 1, dtype=np.bool_)
        step[1:] = rises
        for offset in range(1, stepgen.step_length_frames):
            step[1 + offset :] |= rises[:-offset]
        step[: stepgen.high_frames[motor]] = True
        if elapsed < plays:
            stepgen.high_frames[motor] = stepgen.step_length_frames
            stepgen.rise_wait[motor] = stepgen.rise_wait_frames
            stepgen.dir_wait[motor] = stepgen.dir_wait_frames
            stepgen.count[motor] += made
        for counter in (stepgen.high_frames, stepgen.rise_wait, stepgen.dir_wait):
            if counter[motor]:
                counter[motor] = max(0, counter[motor] - elapsed)
        return step

    def _turning_motor(
        self, motor: int, plays: int, v: int, a: int, j: int, due: NDArray[np.int64], direction: Levels
    ) -> Levels:
        """STEP of any motor, frame by frame as the reference does it; DIR is written into `direction`."""
        stepgen = self._core.stepgen
        step = np.zeros(plays + 1, dtype=np.bool_)
        high, rise_wait, dir_wait = stepgen.high_frames[motor], stepgen.rise_wait[motor], stepgen.dir_wait[motor]
        level = stepgen.dir_level[motor]
        step[0] = high > 0
        made = 0
        for frame, wanted in enumerate(due[1:].tolist(), 1):
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
            step[frame] = high > 0
            direction[frame] = bool(level)
        stepgen.high_frames[motor], stepgen.rise_wait[motor], stepgen.dir_wait[motor] = high, rise_wait, dir_wait
        stepgen.dir_level[motor] = level
        stepgen.count[motor] += made
        return step

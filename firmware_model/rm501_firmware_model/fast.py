"""The fast path: the same board, many frames at a time, the same port words and bytes bit for bit.

Wherever nothing but motion at a constant rate and a stroke of the hand can happen, the frames of a whole stretch are
computed at once, those of the motors from the closed form of the forward differences (`fast_motors`); every other
frame is made by the reference. A stretch ends before the next timer, the next event, the last frame of the segment,
the frame in which low water might be reached, and the end of the environment's promise that its inputs stay as they
are. Ramps, debouncing and settling are left to the reference.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from rm501_protocol.enums import BoardState

from .board import Board
from .core import NEVER
from .fast_motors import MAX_STRETCH_FRAMES, MotorsAhead, Words
from .motion import RATE_ONE
from .segment_queue import FRAME_MASK

__all__ = ["MAX_STRETCH_FRAMES", "MIN_STRETCH_FRAMES", "FastBoard"]

MIN_STRETCH_FRAMES = 12
"""Below it the reference is as fast."""

_FRAMES = np.arange(MAX_STRETCH_FRAMES + 1, dtype=np.int64)


class FastBoard(Board):
    """`Board`, many frames at a time; pins get `write_block` for a stretch and `write_frame` for a single frame."""

    @cached_property
    def _motors(self) -> MotorsAhead:
        return MotorsAhead()

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
        now = core.real_frame
        frames = min(end, core.wake) - now
        if frames < MIN_STRETCH_FRAMES or not core.sampled or core.settling or not core.inputs.quiet(inputs):
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

    # ------------------------------------------------------------------------------------------------ one stretch

    def _play_stretch(self, frames: int) -> Words:
        """Make `frames` real frames; shape (frames, periods)."""
        core = self._core
        layout = core.layout
        motion = core.motion
        slot_words = layout.slot_words
        fixed = [
            entry ^ core.line_word ^ slot_words[slot]
            for entry, slot in zip(layout.entry_words, layout.entry_slots, strict=True)
        ]
        words = np.empty((frames, layout.periods), dtype=np.uint32)
        words[:] = fixed
        if motion.moving and not motion.gated:
            total = motion.phase + frames * motion.rate
            plays = total >> 24
            if plays:
                changed = self._motors.play(core, plays)
                if motion.rate == RATE_ONE:
                    words ^= changed[1:]
                else:
                    words ^= changed[(motion.phase + motion.rate * _FRAMES[1 : frames + 1]) >> 24]
            motion.phase = total & (RATE_ONE - 1)
            motion.played += plays
            motion.motion_frame = (motion.motion_frame + plays) & FRAME_MASK
            core.queue.room -= plays * core.queue.hold_slope[core.queue.head]
        hand = core.hand
        if hand.pending or hand.high_frames or hand.rise_wait or hand.dir_wait:
            self._play_hand(words)
        if core.state != BoardState.FAULT and layout.heartbeat_mask:
            words[0::2] ^= np.uint32(layout.heartbeat_mask)
            if frames & 1:
                core.line_word ^= layout.heartbeat_mask
        core.real_frame += frames
        return words

    def _play_hand(self, words: Words) -> None:
        """The hand's own frames, one by one; its bits go into the words of its two slots."""
        hand = self._core.hand
        layout = self._core.layout
        slot_words = layout.slot_words
        used = sorted({layout.hand_dir_slot, layout.hand_pulse_slot})
        before = [slot_words[slot] for slot in used]
        levels = []
        for _ in range(len(words)):
            hand.frame()
            levels.append([slot_words[slot] for slot in used])
        changed = np.array(levels, dtype=np.uint32) ^ np.array(before, dtype=np.uint32)
        for period, slot in enumerate(layout.entry_slots):
            if slot in used:
                words[:, period] ^= changed[:, used.index(slot)]

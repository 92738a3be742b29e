"""What the bench remembers: every port word, what the registers counted, and a running fingerprint of both.

Words are kept as they came (one per base period) for the VCD export and for waveform checks; 25,000 words a second
make 100 kB a second, so a limit drops the oldest blocks and says how many were dropped. The fingerprint covers all
words since power-up, dropped or not.
"""

from __future__ import annotations

import hashlib
from collections import deque
from dataclasses import dataclass

import numpy as np

from rm501_sim_board.driver_boards import CHANNEL_COUNT, BusActivity, IntArray, Steps
from rm501_sim_board.errors import RecordingError
from rm501_sim_board.wiring import WordArray

# One hour at 25 kHz would be 360 MB; ten minutes are plenty to look at and fit anywhere.
DEFAULT_KEEP_WORDS = 15_000_000


@dataclass(frozen=True, slots=True)
class InputChange:
    """One change of the input word, at the start of a real frame."""

    frame: int
    word: int


class Recording:
    """Port words, counted steps and input words since power-up."""

    def __init__(self, periods_per_frame: int, keep_words: int = DEFAULT_KEEP_WORDS) -> None:
        self.periods_per_frame = periods_per_frame
        self.inputs: list[InputChange] = []
        self.dropped_words = 0
        self._keep_words = keep_words
        self._blocks: deque[WordArray] = deque()
        self._kept_words = 0
        self._words = 0
        self._digest = hashlib.sha256()
        self._start_counts = [0] * CHANNEL_COUNT
        self._steps: list[list[Steps]] = [[] for _ in range(CHANNEL_COUNT)]

    def restart(self, periods_per_frame: int, first_period: int) -> None:
        """Frames have another length: let go what was recorded and count periods from `first_period`."""
        for motor in range(CHANNEL_COUNT):
            self._start_counts[motor] += int(self.steps(motor).signs.sum())
            self._steps[motor] = []
        self.periods_per_frame = periods_per_frame
        self.inputs.clear()
        self._blocks.clear()
        self._kept_words = 0
        self._words = self.dropped_words = first_period

    @property
    def words_written(self) -> int:
        """Port words since power-up, that is base periods."""
        return self._words

    @property
    def pin_hash(self) -> str:
        """SHA-256 over every port word since power-up, little-endian 32 bit, in hexadecimal."""
        return self._digest.hexdigest()

    def add_words(self, words: WordArray) -> None:
        """Append a block of port words."""
        self._digest.update(words.tobytes())
        self._words += len(words)
        if self._keep_words <= 0:
            self.dropped_words += len(words)
            return
        self._blocks.append(words)
        self._kept_words += len(words)
        while self._kept_words > self._keep_words and len(self._blocks) > 1:
            gone = len(self._blocks.popleft())
            self._kept_words -= gone
            self.dropped_words += gone

    def add_activity(self, activity: BusActivity) -> None:
        """Append what the boards counted in a block."""
        for kept, steps in zip(self._steps, activity.steps, strict=True):
            if steps.periods.size:
                kept.append(steps)

    def add_input(self, frame: int, word: int) -> None:
        """Note the input word read at `frame`, when it differs from the last one."""
        if not self.inputs or self.inputs[-1].word != word:
            self.inputs.append(InputChange(frame, word))

    def words(self, first_period: int | None = None, end_period: int | None = None) -> tuple[int, WordArray]:
        """Kept port words and the base period of the first; the optional range must still be kept."""
        start = self.dropped_words
        first = start if first_period is None else first_period
        end = self._words if end_period is None else end_period
        if first < start or end > self._words or first > end:
            raise RecordingError(
                f"port words {first} to {end} asked for, {start} to {self._words} are kept; "
                "raise the limit with record=..."
            )
        parts: list[WordArray] = []
        at = start
        for block in self._blocks:
            low, high = max(first - at, 0), min(end - at, len(block))
            if low < high:
                parts.append(block[low:high])
            at += len(block)
        return first, np.concatenate(parts) if parts else np.zeros(0, dtype=np.uint32)

    def steps(self, motor: int) -> Steps:
        """Everything that one register counted since power-up (motor 5: the hand's power pulses)."""
        kept = self._steps[motor]
        if not kept:
            empty: IntArray = np.zeros(0, dtype=np.int64)
            return Steps(empty, empty)
        if len(kept) > 1:
            kept[:] = [Steps(np.concatenate([s.periods for s in kept]), np.concatenate([s.signs for s in kept]))]
        return kept[0]

    def step_frames(self, motor: int) -> tuple[IntArray, IntArray]:
        """Real frames in which `motor` was stepped, and the signed steps."""
        steps = self.steps(motor)
        return steps.periods // self.periods_per_frame, steps.signs

    def positions_steps(self, frames: IntArray) -> IntArray:
        """Commanded position of all six registers at the start of each real frame, shape (n, 6), from power-up."""
        periods = np.asarray(frames, dtype=np.int64) * self.periods_per_frame
        out = np.zeros((len(periods), CHANNEL_COUNT), dtype=np.int64)
        for motor in range(CHANNEL_COUNT):
            steps = self.steps(motor)
            sums = np.concatenate(([0], np.cumsum(steps.signs)))
            out[:, motor] = self._start_counts[motor] + sums[np.searchsorted(steps.periods, periods, side="left")]
        return out

    def step_sequence_hash(self) -> str:
        """SHA-256 over the signs of all steps per motor, times left out: equal for equal programs on any link."""
        digest = hashlib.sha256()
        for motor in range(CHANNEL_COUNT):
            signs = self.steps(motor).signs.astype(np.int8)
            digest.update(bytes([motor]) + len(signs).to_bytes(8, "little") + signs.tobytes())
        return digest.hexdigest()

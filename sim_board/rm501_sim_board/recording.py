"""What the bench remembers: every port word, what the registers counted, and a running fingerprint of both.

Words are kept as they came (one per base period) for the VCD export and for waveform checks; 25,000 words a second
make 100 kB a second, so a limit drops the oldest blocks and says how many were dropped. What the registers counted is
kept for ten minutes at least, and as long as the words. The fingerprints cover all words and steps since power-up,
dropped or not. So a bench that runs for weeks does not grow.
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
# Steps come in blocks of a few; so many are joined at a time.
_LOOSE_BLOCKS = 512
# A switch that chatters changes the word in every frame.
KEEP_INPUTS = 200_000


@dataclass(frozen=True, slots=True)
class InputChange:
    """One change of the input word, at the start of a real frame."""

    frame: int
    word: int


class Recording:
    """Port words, counted steps and input words since power-up, or as far back as they are kept."""

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
        self._steps_dropped_to = 0
        self._steps: list[deque[Steps]] = [deque() for _ in range(CHANNEL_COUNT)]
        self._loose_steps: list[list[Steps]] = [[] for _ in range(CHANNEL_COUNT)]
        self._sign_digests = [hashlib.sha256() for _ in range(CHANNEL_COUNT)]

    def restart(self, periods_per_frame: int, first_period: int) -> None:
        """Frames have another length: let go what was recorded and count periods from `first_period`."""
        for motor in range(CHANNEL_COUNT):
            self._start_counts[motor] += int(self.steps(motor).signs.sum())
            self._steps[motor].clear()
            self._loose_steps[motor].clear()
        self.periods_per_frame = periods_per_frame
        self.inputs.clear()
        self._blocks.clear()
        self._kept_words = 0
        self._words = self.dropped_words = self._steps_dropped_to = first_period

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
        for motor, steps in enumerate(activity.steps):
            if steps.periods.size:
                self._sign_digests[motor].update(steps.signs.astype(np.int8).tobytes())
                loose = self._loose_steps[motor]
                loose.append(steps)
                if len(loose) >= _LOOSE_BLOCKS:
                    self._steps[motor].append(_joined(loose))
                    loose.clear()
                    self._drop_old_steps(motor)

    def add_input(self, frame: int, word: int) -> None:
        """Note the input word read at `frame`, when it differs from the last one; the last one is always kept."""
        if not self.inputs or self.inputs[-1].word != word:
            self.inputs.append(InputChange(frame, word))
            if len(self.inputs) > KEEP_INPUTS:
                del self.inputs[: KEEP_INPUTS // 2]

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
        """What one register counted, as far back as it is kept (motor 5: the hand's power pulses)."""
        kept = [*self._steps[motor], *self._loose_steps[motor]]
        if not kept:
            empty: IntArray = np.zeros(0, dtype=np.int64)
            return Steps(empty, empty)
        return kept[0] if len(kept) == 1 else _joined(kept)

    def step_frames(self, motor: int) -> tuple[IntArray, IntArray]:
        """Real frames in which `motor` was stepped, and the signed steps."""
        steps = self.steps(motor)
        return steps.periods // self.periods_per_frame, steps.signs

    def positions_steps(self, frames: IntArray) -> IntArray:
        """Commanded position of all six registers at the start of each real frame, shape (n, 6).

        Raises RecordingError for frames from which on steps are kept no longer.
        """
        periods = np.asarray(frames, dtype=np.int64) * self.periods_per_frame
        if len(periods) and periods.min() < self._steps_dropped_to:
            raise RecordingError(
                f"steps are kept from base period {self._steps_dropped_to} on, {int(periods.min())} was asked for; "
                "raise the limit with record=..."
            )
        out = np.zeros((len(periods), CHANNEL_COUNT), dtype=np.int64)
        for motor in range(CHANNEL_COUNT):
            steps = self.steps(motor)
            sums = np.concatenate(([0], np.cumsum(steps.signs)))
            out[:, motor] = self._start_counts[motor] + sums[np.searchsorted(steps.periods, periods, side="left")]
        return out

    def step_sequence_hash(self) -> str:
        """SHA-256 over the signs of all steps per motor since power-up, times left out: equal for equal programs on
        any link.
        """
        return hashlib.sha256(b"".join(digest.digest() for digest in self._sign_digests)).hexdigest()

    def start_count(self, motor: int) -> int:
        """What a register had counted before the first of the kept `steps`."""
        return self._start_counts[motor]

    def _drop_old_steps(self, motor: int) -> None:
        """Let go steps whose port words are gone and that are older than ten minutes; the counts they led to stay."""
        oldest = min(self.dropped_words, self._words - DEFAULT_KEEP_WORDS)
        kept = self._steps[motor]
        while kept and kept[0].periods[-1] < oldest:
            gone = kept.popleft()
            self._start_counts[motor] += int(gone.signs.sum())
            self._steps_dropped_to = max(self._steps_dropped_to, int(gone.periods[-1]) + 1)


def _joined(blocks: list[Steps]) -> Steps:
    return Steps(np.concatenate([b.periods for b in blocks]), np.concatenate([b.signs for b in blocks]))

"""The ideal law of one run from rest to rest, sampled on frames: what the segmenter fits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.planner.pieces import Piece

from .backlash import Backlash
from .motors import MotorMap

Array = NDArray[np.float64]
Frames = NDArray[np.int64]

SAMPLE_FRAMES = 8
"""2.56 ms. Between samples two curves with 3 x the acceleration limit's difference part by 0.02 step at most."""


class Samples:
    """Motor positions (steps) and speeds (steps/frame) of a run at rising frames, counted from its start.

    Grows piece by piece (`extend`) and forgets what has been fitted (`drop_before`). `backlash` adds what takes up the
    play of the joints; where that is still on its way when the law comes to rest, the samples go on until it is there.
    `start_frame`: the motion frame at which the run starts, 64 bits.
    """

    def __init__(
        self, motors: MotorMap, frame_s: float, start_s: float, backlash: Backlash, start_frame: int = 0
    ) -> None:
        self._motors = motors
        self._frame_s = frame_s
        self._backlash = backlash
        self._start_frame = start_frame
        self.start_s = start_s
        self.tail_frames = 0
        self.frames: Frames = np.zeros(0, dtype=np.int64)
        self.steps: Array = np.zeros((0, 5))
        self.speeds: Array = np.zeros((0, 5))
        self.is_kink: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self.is_complete = False

    def extend(self, piece: Piece) -> None:
        """Add the piece that follows; it starts where the samples end."""
        assert piece.law is not None
        first = piece.start_s - self.start_s
        last = first + piece.duration_s
        begin = int(np.ceil(first / self._frame_s - 1e-6))
        end = round(last / self._frame_s) if piece.ends_at_rest else int(np.ceil(last / self._frame_s - 1e-6)) - 1
        known = int(self.frames[-1]) if len(self.frames) else -1
        grid = np.arange(-(-begin // SAMPLE_FRAMES) * SAMPLE_FRAMES, end + 1, SAMPLE_FRAMES, dtype=np.int64)
        times, _ = piece.law.kinks_s()
        places = (times + first) / self._frame_s
        # the frames before and after: within that frame the mean acceleration is played, on both sides the pure one
        kinks = np.unique(np.concatenate((np.floor(places + 1e-6), np.ceil(places - 1e-6)))).astype(np.int64)
        kinks = kinks[(kinks > max(begin, known)) & (kinks < end)]
        edges = [begin] if not len(self.frames) else []
        if piece.ends_at_rest:
            edges.append(end)
        fixed = np.unique(np.concatenate((kinks, np.array(edges, dtype=np.int64))))
        frames = np.unique(np.concatenate((_away_from(grid, fixed), fixed)))
        frames = frames[(frames > known) & (frames <= end)]
        if self._backlash.is_needed:
            self._backlash.follow(
                frames + self._start_frame, piece.q_deg(frames.astype(np.float64) * self._frame_s - first)
            )
            kinks, frames = self._with_take_up(kinks, frames, known, end, rests=piece.ends_at_rest)
        if len(frames):
            moving = frames[frames <= end]
            q_deg, rates, _ = piece.states(moving.astype(np.float64) * self._frame_s - first)
            speeds = self._motors.steps(rates) * self._frame_s
            if piece.ends_at_rest:
                speeds[-1] = 0.0
                q_deg[-1] = piece.rest_deg
            steps = self._motors.steps(q_deg)
            if self._backlash.is_needed:
                tail = len(frames) - len(moving)
                steps = np.concatenate((steps, np.repeat(steps[-1:], tail, axis=0)))
                speeds = np.concatenate((speeds, np.zeros((tail, 5))))
                offsets, offset_rates = self._backlash.law.at((frames + self._start_frame).astype(np.float64))
                steps += self._motors.steps(offsets)
                speeds += self._motors.steps(offset_rates)
            self.frames = np.concatenate((self.frames, frames))
            self.steps = np.concatenate((self.steps, steps))
            self.speeds = np.concatenate((self.speeds, speeds))
            self.is_kink = np.concatenate((self.is_kink, np.isin(frames, kinks)))
        self.is_complete = piece.ends_at_rest

    def _with_take_up(
        self, kinks: Frames, frames: Frames, known: int, end: int, *, rests: bool
    ) -> tuple[Frames, Frames]:
        """Kinks and frames with those of the take-up, and after a rest those until it is done."""
        law = self._backlash.law
        own = np.array(law.kinks(), dtype=np.int64) - self._start_frame
        own = own[own > known]
        settled = law.settled_frame
        last = end if settled is None or not rests else max(end, settled - self._start_frame)
        self.tail_frames = last - end
        if last > end:
            tail = np.arange(end + SAMPLE_FRAMES, last, SAMPLE_FRAMES, dtype=np.int64)
            own = np.concatenate((own, np.array([end, last], dtype=np.int64)))
            frames = np.concatenate((frames, tail))
        fixed = np.unique(np.concatenate((kinks, own[own <= last], frames[:1], frames[-1:])))
        fixed = fixed[(fixed > known) & (fixed <= last)]
        frames = np.unique(np.concatenate((_away_from(frames, fixed), fixed)))
        kinks = np.concatenate((kinks, own[own < last]))
        return kinks, frames

    def drop_before(self, index: int) -> None:
        """Forget everything before a sample."""
        self.frames = self.frames[index:]
        self.steps = self.steps[index:]
        self.speeds = self.speeds[index:]
        self.is_kink = self.is_kink[index:]

    def close(self, at: int, steps_now: Array, speed_now: Array) -> None:
        """Bend the samples from `at` to the rest at the end so that straight lines of speed between them lead there.

        For the last few frames before a rest, where kinks leave no room for corrections: the speeds are the ideal ones
        plus a bump (a triangle over the time left) that makes the travel exact; the positions are those that follow.
        """
        frames = self.frames[at:].astype(np.float64)
        lengths = np.diff(frames)[:, None]
        speeds = self.speeds[at:].copy()
        speeds[0] = speed_now
        bump = np.minimum(frames - frames[0], frames[-1] - frames)[:, None]
        missing = self.steps[-1] - steps_now - _travel(speeds, lengths).sum(axis=0)
        area = float(_travel(bump, lengths).sum())
        if area > 0.0:
            speeds += bump * (missing / area)
        self.speeds[at:] = speeds
        self.steps[at] = steps_now
        self.steps[at + 1 :] = steps_now + np.cumsum(_travel(speeds, lengths), axis=0)


def _travel(speeds: Array, lengths: Array) -> Array:
    """Travel over each interval (n - 1, k) when the speed (n, k) is linear between its ends."""
    travel: Array = 0.5 * (speeds[1:] + speeds[:-1]) * lengths
    return travel


def _away_from(frames: Frames, fixed: Frames) -> Frames:
    """Those frames that are at least half a sample away from every fixed one."""
    if not len(fixed) or not len(frames):
        return frames
    after = np.clip(np.searchsorted(fixed, frames), 0, len(fixed) - 1)
    before = np.clip(after - 1, 0, len(fixed) - 1)
    near = np.minimum(np.abs(fixed[after] - frames), np.abs(fixed[before] - frames))
    kept: Frames = frames[near >= SAMPLE_FRAMES // 2]
    return kept

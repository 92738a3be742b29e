"""The law by which play is taken up: how far each joint's motor side is ahead of its link.

Play sits behind a joint, or in the gear train of a wrist motor, which turns with pitch and roll together: seven places,
each followed by itself in its own angle; a wrist motor's offset becomes one of pitch and roll through the differential.

Theory of operation
-------------------
A joint with play b turns its link only after its motor has crossed the gap. So the motor side is driven to q + o, with
the offset o at +b/2 while the joint moves up and at -b/2 while it moves down (LinuxCNC's BACKLASH does the same: half
of it is added in the direction of motion). When the joint reverses, o crosses to the other side from rest to rest::

    rate of o       /\\                  n frames with +a, n frames with -a, a = |way| / n^2 <= the joint's share of
                   /  \\                 acceleration; whole frames, so its kinks never lie between two frames
              ____/    \\____

A second reversal before it has arrived brakes it with at most the same acceleration and then sends it back. From both
follows that o never leaves [-b/2, b/2], |acceleration| <= a and |rate| <= sqrt(a b): the planner holds just these two
back (`planner.limits`), so law and take-up together keep every limit. In jerk-limited plans o is averaged over a
window, which bounds its jerk in the same way as the plan's own (`planner.jerk`).

A reversal is seen once the joint has come back by `REVERSAL_STEPS` from where it was farthest: the law is causal, and a
joint that only trembles by rounding does not start it. What has been decided never changes for earlier frames, so the
offset at any frame that was played is known afterwards, also where a hold, a trigger or a stop ended motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from rm501_host.planner.limits import Limits

Array = NDArray[np.float64]

REVERSAL_STEPS = 0.1
"""A joint that moves by less than the segments' tolerance does not move."""
SHORTEST_FRAMES = 8
"""Fewest frames of one acceleration: kinks closer together would cost segments of their own."""
_SAME_DEG = 1e-12
_ALWAYS = -1
"""Before the first motion frame."""
_PLACES = 7
_ONLY_JOINTS = tuple(tuple(float(row == column) for column in range(_PLACES)) for row in range(5))


@dataclass(frozen=True, slots=True)
class TakeUpArc:
    """Constant acceleration of an offset over the motion frames [first_frame, last_frame].

    `offset_deg`, `rate_deg_frame` at its start; `acceleration_deg_frame2`.
    """

    first_frame: int
    last_frame: int
    offset_deg: float
    rate_deg_frame: float
    acceleration_deg_frame2: float


@dataclass(frozen=True, slots=True)
class PlaceOffset:
    """The offset at one place of play as a function of the motion frame: before its arcs, along them, after them.

    `window_frames`: length of the mean that smooths it (0: none).
    """

    before_deg: float
    arcs: tuple[TakeUpArc, ...] = ()
    after_deg: float = 0.0
    window_frames: int = 0

    @property
    def settled_frame(self) -> int | None:
        """The motion frame from which it stands still, None when it always does."""
        return self.arcs[-1].last_frame + self.window_frames if self.arcs else None

    def kinks(self) -> list[int]:
        """Motion frames at which its acceleration jumps."""
        return sorted({frame for arc in self.arcs for frame in (arc.first_frame, arc.last_frame)})

    def at(self, frames: Array) -> tuple[Array, Array]:
        """Offset in deg and rate in deg/frame, (n,) each, at motion frames (n,)."""
        if not self.arcs:
            return np.full(len(frames), self.after_deg), np.zeros(len(frames))
        if not self.window_frames:
            _, offset, rate = self._plain(frames)
            return offset, rate
        width = float(self.window_frames)
        area, offset, _ = self._plain(frames)
        area_before, offset_before, _ = self._plain(frames - width)
        return (area - area_before) / width, (offset - offset_before) / width

    def rate_at(self, frame: int) -> float:
        """Rate in deg/frame without the smoothing."""
        return float(self._plain(np.array([float(frame)]))[2][0]) if self.arcs else 0.0

    def offset_at(self, frame: int) -> float:
        """Offset in deg without the smoothing."""
        return float(self._plain(np.array([float(frame)]))[1][0]) if self.arcs else self.after_deg

    def since(self, frame: int) -> PlaceOffset:
        """The same from `frame` on, without the arcs that no longer matter."""
        kept = tuple(arc for arc in self.arcs if arc.last_frame + self.window_frames > frame)
        if len(kept) == len(self.arcs):
            return self
        before = kept[0].offset_deg if kept else self.after_deg
        return replace(self, before_deg=before, arcs=kept)

    def sent_to(self, target_deg: float, frame: int, acceleration_deg_frame2: float) -> PlaceOffset:
        """The same up to `frame`, from there on by the law to `target_deg`."""
        at, rate = self.offset_at(frame), self.rate_at(frame)
        arcs = [replace(arc, last_frame=min(arc.last_frame, frame)) for arc in self.arcs if arc.first_frame < frame]
        first = frame
        if rate != 0.0:
            n = ceil(abs(rate) / acceleration_deg_frame2 - 1e-9)
            arcs.append(TakeUpArc(first, first + n, at, rate, -rate / n))
            first += n
            at += 0.5 * rate * n
        way = target_deg - at
        if abs(way) > _SAME_DEG:
            n = max(SHORTEST_FRAMES, ceil(sqrt(abs(way) / acceleration_deg_frame2) - 1e-9))
            a = way / (n * n)
            arcs.append(TakeUpArc(first, first + n, at, 0.0, a))
            arcs.append(TakeUpArc(first + n, first + 2 * n, at + 0.5 * way, a * n, -a))
        return replace(self, arcs=tuple(arcs), after_deg=target_deg)

    def _plain(self, frames: Array) -> tuple[Array, Array, Array]:
        """Area under the offset since the first arc (deg frames), offset, rate, without the smoothing."""
        arcs = self.arcs
        firsts = np.array([float(arc.first_frame) for arc in arcs])
        lasts = np.array([float(arc.last_frame) for arc in arcs])
        offset = np.array([arc.offset_deg for arc in arcs])
        rate = np.array([arc.rate_deg_frame for arc in arcs])
        bend = np.array([arc.acceleration_deg_frame2 for arc in arcs])
        length = lasts - firsts
        ends = offset + length * (rate + 0.5 * length * bend)
        areas = length * (offset + length * (0.5 * rate + length * bend / 6.0))
        # between two arcs the offset rests where the first one ended
        gaps = np.concatenate((firsts[1:] - lasts[:-1], np.zeros(1)))
        starts = np.concatenate((np.zeros(1), np.cumsum(areas + gaps * ends)[:-1]))
        k = np.clip(np.searchsorted(firsts, frames, side="right") - 1, 0, len(arcs) - 1)
        since = frames - firsts[k]
        tau = np.clip(since, 0.0, length[k])
        rest = np.where(k == len(arcs) - 1, self.after_deg, ends[k])
        moving = (since >= 0.0) & (since < length[k])
        value = offset[k] + tau * (rate[k] + 0.5 * tau * bend[k])
        value = np.where(since < 0.0, self.before_deg, np.where(since >= length[k], rest, value))
        area = starts[k] + tau * (offset[k] + tau * (0.5 * rate[k] + tau * bend[k] / 6.0))
        area = area + np.where(
            since < 0.0, since * self.before_deg, np.where(since > length[k], (since - tau) * rest, 0.0)
        )
        return area, value, np.where(moving, rate[k] + tau * bend[k], 0.0)


@dataclass(frozen=True, slots=True)
class OffsetLaw:
    """The offsets as functions of the motion frame (64 bits), at the seven places of play (`planner.limits`).

    `columns`: what a deg at each place moves of each joint, five rows of seven.
    """

    places: tuple[PlaceOffset, ...]
    columns: tuple[tuple[float, ...], ...] = _ONLY_JOINTS

    @classmethod
    def still(cls, leads_deg: Sequence[float], columns: tuple[tuple[float, ...], ...] = _ONLY_JOINTS) -> OffsetLaw:
        """Offsets that stay as they are: of the joints (5,), or at all places (7,)."""
        leads = (*leads_deg, *(0.0,) * (_PLACES - len(leads_deg)))
        return cls(tuple(PlaceOffset(float(lead), (), float(lead)) for lead in leads), columns)

    @property
    def settled_frame(self) -> int | None:
        """The motion frame from which every offset stands still; None when none ever moves."""
        frames = [place.settled_frame for place in self.places if place.arcs]
        return max(frame for frame in frames if frame is not None) if frames else None

    def kinks(self) -> list[int]:
        """Motion frames at which an acceleration jumps."""
        return sorted({frame for place in self.places for frame in place.kinks()})

    def at(self, frames: Array) -> tuple[Array, Array]:
        """Offsets (n, 5) of the joints in deg and rates (n, 5) in deg/frame at motion frames (n,)."""
        found = [place.at(frames) for place in self.places]
        to_joints = np.array(self.columns).T
        offsets: Array = np.stack([offset for offset, _ in found], axis=1) @ to_joints
        rates: Array = np.stack([rate for _, rate in found], axis=1) @ to_joints
        return offsets, rates

    def leads_deg(self, frame: int) -> tuple[float, ...]:
        """Offsets (7,) at the places of play at one motion frame."""
        at = np.array([float(frame)])
        return tuple(float(place.at(at)[0][0]) for place in self.places)

    def offsets_deg(self, frame: int) -> tuple[float, ...]:
        """Offsets (5,) of the joints at one motion frame."""
        return tuple(float(value) for value in self.at(np.array([float(frame)]))[0][0])

    def since(self, frame: int) -> OffsetLaw:
        """The same from `frame` on, without what no longer matters."""
        return OffsetLaw(tuple(place.since(frame) for place in self.places), self.columns)

    def replaced(self, index: int, place: PlaceOffset) -> OffsetLaw:
        """The same with another law at one place."""
        return OffsetLaw((*self.places[:index], place, *self.places[index + 1 :]), self.columns)


NO_OFFSETS = OffsetLaw.still((0.0,) * _PLACES)
"""In the middle of every play, or without any."""


class Backlash:
    """Follows a law in joint space and decides where play has to be taken up."""

    def __init__(self, limits: Limits, frame_s: float, law: OffsetLaw = NO_OFFSETS) -> None:
        self._half_deg = 0.5 * limits.backlash_deg
        self._acceleration = limits.take_up_acceleration_deg_s2 * frame_s**2
        self._rows = limits.play_rows
        steps = np.abs(limits.steps_per_deg[:, None] * (limits.motor_matrix @ limits.play_columns))
        self._tremble_deg = REVERSAL_STEPS / steps.max(axis=0)
        self._places = [int(place) for place in np.flatnonzero(self._half_deg > 0.0)]
        windows = [ceil(float(window) / frame_s) for window in limits.take_up_window_s]
        self._law = OffsetLaw(
            tuple(replace(place, window_frames=window) for place, window in zip(law.places, windows, strict=True)),
            play_columns(limits),
        )
        # per place: its laws in the order in which they were decided, each with the frame of the decision
        self._decided: list[list[tuple[int, PlaceOffset]]] = [[(_ALWAYS, place)] for place in self._law.places]
        # which way each place turns as far as that is known, and how far it has come that way
        self._way = [_side(place.after_deg, half) for place, half in zip(law.places, self._half_deg, strict=True)]
        self._low: list[float] | None = None
        self._high: list[float] = []

    @property
    def is_needed(self) -> bool:
        """Whether there is any play."""
        return bool(self._places)

    @property
    def law(self) -> OffsetLaw:
        """The offsets as far as the law has been followed."""
        return self._law

    def law_until(self, frame: int) -> OffsetLaw:
        """The offsets as they were known at motion frame `frame`: without what was decided later."""
        return OffsetLaw(tuple(_known_at(frame, decided) for decided in self._decided), self._law.columns)

    def forget_before(self, frame: int) -> None:
        """Drop what only matters before a motion frame."""
        self._decided = [
            [
                (_ALWAYS, _known_at(frame, decided).since(frame)),
                *((when, place.since(frame)) for when, place in decided if when > frame),
            ]
            for decided in self._decided
        ]
        self._law = self._law.since(frame)

    def begin(self) -> None:
        """The law starts from rest: an offset is only sent over once its place has turned again."""
        self._way = [0] * _PLACES
        self._low = None

    def follow(self, frames: NDArray[np.int64], q_deg: Array) -> None:
        """Take joints (n, 5) in deg at rising motion frames (n,), from where the last call ended."""
        if not len(frames):
            return
        angles_deg = q_deg @ self._rows.T
        if self._low is None:
            self._low, self._high = angles_deg[0].tolist(), angles_deg[0].tolist()
        low, high, way = self._low, self._high, self._way
        for place in self._places:
            tremble = float(self._tremble_deg[place])
            for frame, angle in zip(frames.tolist(), angles_deg[:, place].tolist(), strict=True):
                low[place] = min(low[place], angle)
                high[place] = max(high[place], angle)
                if way[place] <= 0 and angle - low[place] >= tremble:
                    turned = 1
                elif way[place] >= 0 and high[place] - angle >= tremble:
                    turned = -1
                else:
                    continue
                way[place] = turned
                low[place] = high[place] = angle
                self._send(place, turned * float(self._half_deg[place]), frame)

    def _send(self, index: int, target_deg: float, frame: int) -> None:
        place = self._law.places[index]
        if place.after_deg == target_deg:
            return
        sent = place.sent_to(target_deg, frame, float(self._acceleration[index]))
        self._law = self._law.replaced(index, sent)
        self._decided[index].append((frame, sent))


def play_columns(limits: Limits) -> tuple[tuple[float, ...], ...]:
    """What a deg at each place of play moves of each joint, as an `OffsetLaw` has it."""
    return tuple(tuple(float(value) for value in row) for row in limits.play_columns)


def _known_at(frame: int, decided: Sequence[tuple[int, PlaceOffset]]) -> PlaceOffset:
    return next(place for when, place in reversed(decided) if when <= frame)


def _side(offset_deg: float, half_deg: float) -> int:
    if half_deg <= 0.0 or abs(offset_deg) < half_deg:
        return 0
    return 1 if offset_deg > 0.0 else -1

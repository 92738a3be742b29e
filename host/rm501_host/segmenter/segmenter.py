"""Pieces of the ideal law in, exact integer segments out.

Each segment starts at the exact position where the one before it ended (the mirror, in 2^-48 step), takes the ideal
speed there, and runs as far as cubics stay within the tolerance of the ideal law: lengths are doubled until the fit
fails, then halved in. Kinks of the law (jumps of acceleration) are tried as ends first, since a polynomial may lie on
either side of one but not across.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.moves import Source
from rm501_host.planner.errors import PlanError
from rm501_host.planner.pieces import Piece
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.segment import MAX_LENGTH_CUBIC_FRAMES, MAX_LENGTH_FRAMES, ONE_STEP, end_positions_q48
from rm501_protocol.segment_message import MAX_EVENTS, MotorTerm, Segment, SegmentEvent

from .backlash import NO_OFFSETS, Backlash, OffsetLaw
from .events import EventsAhead, wire_event
from .fit import Cubic, hermite, quadratic, to_wire
from .motors import MotorMap
from .samples import Samples
from .slopes import Slopes

Array = NDArray[np.float64]

ROUNDING_STEPS = 0.011
"""What the wire's rounding can add over a whole segment (design: the wire)."""
START_TOLERANCE_STEPS = 1.0
"""A plan that starts farther than this from where the board is belongs to another position."""
RATIO = 1.018
"""Largest acceleration of a segment's polynomial against the planning limits; the board refuses above 1.02."""
CLOSING_FRAMES = 256
"""From here to a rest the samples may be bent: a correction of 1e-4 step over so long takes 1e-8 step/frame^2."""
LONGEST_FALLBACK = 16
MOST_DRIFT_STEPS = 1e-4
"""What a longer parabola at the ideal speeds may drift from the ideal places."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSegment:
    """A segment and what belongs to it.

    `start_frame`, `end_frame`: motion frames, 64 bits; `start_q48`, `end_q48`: exact positions of the six motors
    there; `source`: the line that it belongs to at its start; `piece`: the piece of the ideal law, with
    `piece_start_frame`, the motion frame at which that piece's time 0 lies (float: pieces end between frames);
    `max_error_steps`: largest distance from the ideal law at the samples; `offsets`: how far the motors are ahead of
    the links to take up play, from `start_frame` to `end_frame` and, as far as decided by then, beyond;
    `tail_frames`: how much of it comes after the law's rest, to finish that.
    """

    segment: Segment
    start_frame: int
    end_frame: int
    start_q48: tuple[int, ...]
    end_q48: tuple[int, ...]
    source: Source
    piece: Piece
    piece_start_frame: float
    max_error_steps: float
    hold_slope_local: float
    stop_slope_local: float
    offsets: OffsetLaw = NO_OFFSETS
    tail_frames: int = 0


class Segmenter:
    """Turns pieces into segments, from any exact state of the mirror.

    `start_steps48`: positions of the six motors (or the five of the arm) in 2^-48 step where motion stands now;
    `start_frame`: the motion frame (64 bits) from which segments go on. Both follow the segments that are yielded.
    `offsets`: how much of the positions is play taken up; those of the segment before where motion goes on in mid-run.
    `start_speed`: (5,) in steps/frame, that of the segment before where motion goes on; else it is the ideal one.
    `most_frames`: how long segments of motion may be, for motion that may be replanned at their boundaries.
    """

    def __init__(
        self,
        config: Config,
        start_steps48: Sequence[int],
        start_frame: int,
        offsets: OffsetLaw = NO_OFFSETS,
        start_speed: Array | None = None,
        *,
        most_frames: int = MAX_LENGTH_FRAMES,
    ) -> None:
        self._config = config
        self._motors = MotorMap(config)
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self._tolerance = config.planner.tolerance_steps - ROUNDING_STEPS
        self._positions = tuple(start_steps48)
        self._frame = start_frame
        self._guess = 64
        self._speed = np.zeros(5)
        self._start_speed = start_speed
        self._most_frames = most_frames
        self._slopes = Slopes(config, self._motors)
        self._events_ahead = EventsAhead()
        self._backlash = Backlash(self._motors.limits, self._frame_s, offsets)

    @property
    def positions_q48(self) -> tuple[int, ...]:
        """Where the segments made so far end, in 2^-48 step."""
        return self._positions

    @property
    def frame(self) -> int:
        """The motion frame at which the segments made so far end."""
        return self._frame

    def segments(self, pieces: Iterable[Piece]) -> Iterator[PlannedSegment]:
        """Yield the segments of the pieces in order.

        A segment is held back until what follows within the stop horizon is known, because its slopes depend on it.
        Raises PlanError when the pieces do not start where the mirror is.
        """
        for planned in self._raw(pieces):
            yield from self._slopes.add(planned)
        yield from self._slopes.finish()

    def _raw(self, pieces: Iterable[Piece]) -> Iterator[PlannedSegment]:
        samples: Samples | None = None
        run: list[Piece] = []
        run_frame = self._frame
        for piece in pieces:
            if piece.law is None:
                if piece.duration_s > 0.0:
                    yield from self._still(piece)
                continue
            if samples is None:
                samples = Samples(self._motors, self._frame_s, piece.start_s, self._backlash, self._frame)
                run_frame = self._frame
                run = []
                _, rates, _ = piece.states(np.zeros(1))
                self._speed = self._motors.steps(rates)[0] * self._frame_s * (not piece.starts_at_rest)
                if piece.starts_at_rest:
                    self._backlash.begin()
                elif self._backlash.is_needed:
                    _, offset_rates = self._backlash.law.at(np.array([float(run_frame)]))
                    self._speed += self._motors.steps(offset_rates)[0]
                if self._start_speed is not None and not piece.starts_at_rest:
                    self._speed = self._start_speed
                self._start_speed = None
            samples.extend(piece)
            run.append(piece)
            self._events_ahead.add(piece, self._origin(piece, samples, run_frame), self._frame_s)
            yield from self._fit(samples, run, run_frame)
            if piece.ends_at_rest:
                samples = None

    def _still(self, piece: Piece) -> Iterator[PlannedSegment]:
        """A wait: segments without motors; events at their frames."""
        frames = round(piece.duration_s / self._frame_s)
        first = float(self._frame)
        done = 0
        while done < frames:
            length = min(frames - done, MAX_LENGTH_FRAMES)
            events = self._events(piece, done, length)
            segment = Segment(self._frame & 0xFFFFFFFF, length, (), SegmentFlag.ENDS_AT_REST, events=events)
            yield self._made(segment, piece, first, piece.source, 0.0, (np.inf, np.inf))
            done += length

    def _events(self, piece: Piece, first: int, length: int) -> tuple[SegmentEvent, ...]:
        """Events of a wait whose frame lies in [first, first + length)."""
        found = []
        for event in piece.events:
            frame = int(np.ceil(event.offset_s / self._frame_s - 1e-6))
            if first <= frame < first + length:
                found.append(wire_event(frame - first, event))
        if len(found) > MAX_EVENTS:
            raise PlanError(
                f"more than {MAX_EVENTS} output changes at one place", source=piece.source, remedy="spread them"
            )
        return tuple(found)

    def _fit(self, samples: Samples, run: list[Piece], run_frame: int) -> Iterator[PlannedSegment]:
        """Fit what the samples hold; the last stretch waits for more unless the run is complete."""
        if len(samples.frames) and self._frame == run_frame:
            apart = np.abs(self._steps_now() - samples.steps[0])
            if float(apart.max()) > START_TOLERANCE_STEPS:
                motor = int(np.argmax(apart))
                raise PlanError(
                    f"motor {motor} is {float(apart[motor]):.2f} steps away from where the plan starts",
                    source=run[0].source,
                    remedy="plan again from the position that the board reports",
                )
        at = 0
        while at < len(samples.frames) - 1:
            chosen = self._longest(samples, at)
            if chosen is None:
                break
            end, cubic, terms, error = chosen
            yield self._emit(samples, run, run_frame, at, end, cubic, terms, error)
            self._speed = cubic.end_speed(int(samples.frames[end] - samples.frames[at]))
            at = end
        samples.drop_before(at)

    def _steps_now(self) -> Array:
        return np.array([position / ONE_STEP for position in self._positions[:5]])

    def _longest(self, samples: Samples, at: int) -> tuple[int, Cubic, tuple[MotorTerm, ...], float] | None:
        """The farthest end that fits, with its polynomial; None when more samples have to come first."""
        last = self._last_end(samples, at)
        low, best = at, None
        step = max(1, self._guess)
        high = None
        while high is None:
            end = min(at + step, last)
            fitted = self._try(samples, at, end)
            if fitted is None:
                high = end
            else:
                low, best = end, fitted
                if end == last:
                    break
                step *= 2
        if high is None:
            if last == len(samples.frames) - 1 and not samples.is_complete:
                return None
        else:
            while high - low > 1:
                inside = np.flatnonzero(samples.is_kink[low + 1 : high])
                middle = low + 1 + int(inside[-1]) if len(inside) else (low + high) // 2
                fitted = self._try(samples, at, middle)
                if fitted is None:
                    high = middle
                else:
                    low, best = middle, fitted
        if best is None:
            low, best = self._shortest(samples, at)
        self._guess = max(1, low - at)
        return low, *best

    def _last_end(self, samples: Samples, at: int) -> int:
        """The last sample at which a segment from sample `at` may end: it may be so long, and carry so many events."""
        most = int(np.searchsorted(samples.frames, samples.frames[at] + self._most_frames, side="right")) - 1
        last = min(len(samples.frames) - 1, max(at + 1, most))
        frame = self._events_ahead.last_end
        if frame is None:
            return last
        here = int(samples.frames[at]) - self._frame
        return min(last, max(at + 1, int(np.searchsorted(samples.frames, frame + here, side="right")) - 1))

    def _shortest(self, samples: Samples, at: int) -> tuple[int, tuple[Cubic, tuple[MotorTerm, ...], float]]:
        """Where the longest lengths tried do not fit.

        A short cubic, whose j fits 32 bits (a small difference of speeds over few frames takes a large j). Or, close
        before a rest, the samples bent so that parabolas between them lead exactly there. Or a parabola at the ideal
        speeds: a kink between two frames leaves a mean acceleration and no room for more; what it is off by, some
        1e-5 step, is made good where there is room again.
        """
        last = len(samples.frames) - 1
        for length in (12, 24, 8, 48, 16, 32, 96, 6, 64, 4, 128, 3, 2, 1):
            fitted = self._try(samples, at, at + length) if at + length <= last else None
            if fitted is not None:
                return at + length, fitted
        if samples.is_complete and samples.frames[last] - samples.frames[at] <= CLOSING_FRAMES:
            samples.close(at, self._steps_now(), self._speed)
        found: tuple[int, tuple[Cubic, tuple[MotorTerm, ...], float]] | None = None
        for length in range(1, min(LONGEST_FALLBACK, last - at) + 1):
            matched = self._speed_matched(samples, at, at + length)
            if matched is None or (found is not None and matched[2] > MOST_DRIFT_STEPS):
                break
            found = at + length, (*matched[:2], matched[3])
        if found is None:
            raise PlanError("a motor would have to accelerate faster than a segment can say")
        return found

    def _speed_matched(
        self, samples: Samples, at: int, end: int
    ) -> tuple[Cubic, tuple[MotorTerm, ...], float, float] | None:
        """The parabola that ends at the samples' speed: with how far it drifts from them, and its largest error."""
        frames = int(samples.frames[end] - samples.frames[at])
        bend = (samples.speeds[end] - self._speed) / (2.0 * frames)
        cubic = Cubic(self._speed, bend, np.zeros_like(bend))
        if self._motors.acceleration_ratio((2.0 * bend)[None, :]) > RATIO:
            return None
        start = self._steps_now()
        inner = (samples.frames[at + 1 : end + 1] - samples.frames[at]).astype(np.float64)
        offsets = cubic.offsets(inner)
        apart = offsets + start - samples.steps[at + 1 : end + 1]
        drift = float(np.abs(apart[-1] - (start - samples.steps[at])).max())
        error = float(np.abs(apart).max())
        if error > max(self._tolerance, float(np.abs(start - samples.steps[at]).max())):
            return None
        terms = to_wire(cubic, self._positions, start + offsets[-1], frames)
        return None if terms is None else (cubic, terms, drift, error)

    def _try(self, samples: Samples, at: int, end: int) -> tuple[Cubic, tuple[MotorTerm, ...], float] | None:
        frames = int(samples.frames[end] - samples.frames[at])
        if frames > MAX_LENGTH_CUBIC_FRAMES:
            return None
        start = self._steps_now()
        target = samples.steps[end]
        inner = (samples.frames[at + 1 : end] - samples.frames[at]).astype(np.float64)
        ideal = samples.steps[at + 1 : end]
        last_speed = samples.speeds[end]
        # a run that starts beside the ideal (a residue of the last stop) closes in on it
        tolerance = max(self._tolerance, float(np.abs(start - samples.steps[at]).max()))
        best: tuple[Cubic, float] | None = None
        for cubic in (
            quadratic(target - start, self._speed, frames),
            hermite(target - start, self._speed, last_speed, frames),
        ):
            if float(np.abs(cubic.end_speed(frames) - last_speed).max()) > 2e-7:
                continue
            error = float(np.abs(cubic.offsets(inner) + start - ideal).max(initial=0.0))
            if error > tolerance:
                continue
            accelerations = np.stack((2.0 * cubic.c, 2.0 * cubic.c + 6.0 * frames * cubic.d))
            if self._motors.acceleration_ratio(accelerations) > RATIO:
                continue
            best = (cubic, error)
            break
        if best is None:
            return None
        terms = to_wire(best[0], self._positions, target, frames)
        return None if terms is None else (best[0], terms, best[1])

    def _emit(
        self,
        samples: Samples,
        run: list[Piece],
        run_frame: int,
        at: int,
        end: int,
        cubic: Cubic,
        terms: tuple[MotorTerm, ...],
        error: float,
    ) -> PlannedSegment:
        frames = int(samples.frames[end] - samples.frames[at])
        flags = SegmentFlag.NONE
        if any(term.j for term in terms):
            flags |= SegmentFlag.CUBIC
        if samples.is_complete and end == len(samples.frames) - 1:
            flags |= SegmentFlag.ENDS_AT_REST
        first_s = int(samples.frames[at]) * self._frame_s + samples.start_s
        while len(run) > 1 and first_s >= run[0].end_s - 1e-9:
            del run[0]
        piece = run[0]
        origin = self._origin(piece, samples, run_frame)
        at_rest = bool(flags & SegmentFlag.ENDS_AT_REST)
        events = self._events_ahead.take(self._frame, frames, ends_at_rest=at_rest)
        segment = Segment(self._frame & 0xFFFFFFFF, frames, terms, flags, events=events)
        within = np.array([(self._frame - origin) * self._frame_s])
        line = int(piece.lines(np.clip(within, 0.0, None))[0])
        source = replace(piece.source, line=line) if line != piece.source.line else piece.source
        slopes = self._slopes.local(cubic, frames)
        tail = int(samples.frames[end] - samples.frames[-1]) + samples.tail_frames if samples.is_complete else 0
        return self._made(segment, piece, origin, source, error, slopes, min(max(tail, 0), frames))

    def _origin(self, piece: Piece, samples: Samples, run_frame: int) -> float:
        return run_frame + (piece.start_s - samples.start_s) / self._frame_s

    def _made(
        self,
        segment: Segment,
        piece: Piece,
        origin: float,
        source: Source,
        error: float,
        slopes: tuple[float, float],
        tail_frames: int = 0,
    ) -> PlannedSegment:
        start, first = self._positions, self._frame
        self._positions = end_positions_q48(start, segment)
        self._frame = first + segment.length_frames
        offsets = NO_OFFSETS
        if self._backlash.is_needed:
            self._backlash.forget_before(first)
            offsets = self._backlash.law_until(self._frame)
        return PlannedSegment(
            segment,
            first,
            self._frame,
            start,
            self._positions,
            source,
            piece,
            origin,
            error,
            slopes[0],
            slopes[1],
            offsets,
            tail_frames,
        )

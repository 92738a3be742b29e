"""A program's path while it is played: which law is on its way now, and what of the past is remembered.

The pieces of the plan are the source; what is played are generations of it. The first one is the plan itself, piece by
piece. Another one begins where the override went above what the generation before was planned for
(`planner.respeed`), or where the arm was run back along its path and goes forward again. Every piece that is played
knows its place on the source, so progress, running back and the next generation are found from any of them.

The source is remembered `REMEMBERED_S` back from where the arm is, in time at 100 %, and the pieces that are played
only as long as they are queued: memory does not grow with the program.

Planning (`__iter__`, `respeeded`, `back`) may block and belongs in an executor, one call at a time; everything else
only looks at what is there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from rm501_host.config import Config
from rm501_host.errors import RefusedError
from rm501_host.planner import EventKind, Piece, PieceEvent, plan_run_back
from rm501_host.planner.respeed import Place, Respeed, Respeeded, lead_of, place_at, plan_time
from rm501_host.planner.run_back import KEPT_S
from rm501_host.planner.ways import along, way_at
from rm501_host.segmenter import PlannedSegment

HIGHEST_SCALE = 2.0
REMEMBERED_S = HIGHEST_SCALE * KEPT_S
"""Time at 100 %: as much as the arm can pass in `KEPT_S` at the highest override."""
_ALMOST_ONE = 1.0 - 1e-6
_SAME_S = 1e-6


@dataclass(frozen=True, slots=True)
class Missed:
    """A faster law that did not take over: the scale it was for, why, and whether it is tried again."""

    scale: float
    why: str
    for_good: bool


class _Source:
    """The plan's pieces by number, pulled from the runs of the program as they are wanted."""

    def __init__(self) -> None:
        self._pieces: dict[int, Piece] = {}
        self._count = 0
        self._feed: Iterator[Piece] = iter(())

    @property
    def count(self) -> int:
        return self._count

    def follow_with(self, pieces: Iterable[Piece]) -> None:
        self._feed = iter(pieces)

    def get(self, number: int) -> Piece | None:
        while number >= self._count:
            piece = next(self._feed, None)
            if piece is None:
                return None
            self._pieces[self._count] = piece
            self._count += 1
        return self._pieces.get(number)

    def forget_before(self, time_s: float) -> None:
        for number in list(self._pieces):
            if self._pieces[number].end_s >= time_s:
                break
            del self._pieces[number]

    def known(self) -> list[tuple[int, Piece]]:
        return list(self._pieces.items())


class _Known:
    """The source as far as it has been planned: looking at it plans nothing."""

    def __init__(self, source: _Source) -> None:
        self._source = source

    def get(self, number: int) -> Piece | None:
        return self._source.get(number) if number < self._source.count else None


class _Generation:
    """Respeeded pieces, kept from the one that is played on to the last one that was asked for."""

    def __init__(self, pieces: Iterator[Respeeded]) -> None:
        self._pieces = pieces
        self._made: dict[int, Respeeded] = {}
        self._numbers: dict[int, int] = {}
        self._count = 0

    def get(self, number: int) -> Respeeded | None:
        while number >= self._count:
            played = next(self._pieces, None)
            if played is None:
                return None
            self._made[self._count] = played
            self._numbers[id(played.piece)] = self._count
            self._count += 1
        return self._made.get(number)

    def played(self) -> Iterator[Respeeded]:
        number = 0
        while (played := self.get(number)) is not None:
            yield played
            number += 1

    def since(self, number: int) -> Iterator[Respeeded]:
        while (played := self.get(number)) is not None:
            yield played
            number += 1

    def number_of(self, piece: Piece) -> int | None:
        return self._numbers.get(id(piece))

    def forget_before(self, number: int) -> None:
        for old in list(self._made):
            if old >= number:
                break
            del self._numbers[id(self._made.pop(old).piece)]


class LivePath:
    """The path of one job. `begin` each run of it, then play the object itself; `scale` of the feeds, 1..2, at will."""

    def __init__(self, config: Config, on_missed: Callable[[Missed], None] = lambda missed: None) -> None:
        self._config = config
        self._on_missed = on_missed
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self._source = _Source()
        self._known = _Known(self._source)
        self._now = _Generation(iter(()))
        self._past: list[_Generation] = []
        self._next: _Generation | None = None
        self._wish = self._goal = self._next_goal = 1.0
        self._goal_before: float | None = None

    # --------------------------------------------------------------------------------------------- what is played

    def begin(self, pieces: Iterable[Piece]) -> None:
        """The next run of the program, from rest to a mark or the end. Plans nothing; the pieces may raise PlanError as
        they are taken.
        """
        self._source.follow_with(pieces)
        self._now = self._generation(Place(self._source.count))
        self._goal, self._goal_before = self._wish, None

    def go_on_from(self, place: Place) -> None:
        """Play again from a place at which the arm stands, to the end of the run."""
        self._now = self._generation(place)
        self._goal, self._goal_before = self._wish, None

    def __iter__(self) -> Iterator[Piece]:
        """The pieces of the newest generation, planned as they are taken; raises PlanError."""
        for played in self._now.played():
            yield played.piece

    def _generation(self, place: Place) -> _Generation:
        return _Generation(Respeed(self._config, self._source, lambda: self._wish).pieces(place))

    # -------------------------------------------------------------------------------------------------- the scale

    @property
    def scale(self) -> float:
        """What programmed feeds are to be multiplied by: at once where the plan has to be made faster, from the next
        rest on where it may be slower.
        """
        return self._wish

    @scale.setter
    def scale(self, scale: float) -> None:
        if scale != self._wish and self._goal_before is not None:
            self._goal, self._goal_before = self._goal_before, None
        self._wish = scale
        self._goal = min(self._goal, scale)

    @property
    def is_respeed_wanted(self) -> bool:
        """Whether feeds are to be higher than what is being played was planned for."""
        return self._wish > self._goal

    def scale_of(self, planned: PlannedSegment) -> float:
        """What the feeds of a segment are multiplied by; 1 where it is not known (any more)."""
        played = self._played(planned)
        return 1.0 if played is None else played.scale

    def may_respeed(self, planned: PlannedSegment) -> bool:
        """Whether a faster law may take over at the start of this segment."""
        number = self._now.number_of(planned.piece)
        played = None if number is None else self._now.get(number)
        if played is None or played.scale >= self._wish or planned.start_frame < planned.piece_start_frame - 1e-6:
            return False
        if planned.piece.starts_at_rest and planned.start_frame == round(planned.piece_start_frame):
            return True
        law = along(planned.piece.law)
        return law is not None and self._time_in(planned) < law.duration_s

    def respeeded(self, planned: PlannedSegment) -> Iterator[Piece]:
        """The pieces of a faster law from the start of this segment (a motion frame); plans, raises PlanError."""
        number = self._now.number_of(planned.piece)
        assert number is not None
        played = self._now.get(number)
        assert played is not None
        at_s = self._time_in(planned)
        lead = None
        if planned.piece.law is not None and not (planned.piece.starts_at_rest and at_s <= 0.0):
            lead = lead_of(self._now.since(number), at_s)
        respeed = Respeed(self._config, self._source, lambda: self._wish)
        place = place_at(self._source, played, at_s)
        pieces = respeed.pieces(place, lead, event_slack_s=_ALMOST_ONE * self._frame_s)
        self._next_goal = self._wish
        self._next = following = _Generation(pieces)
        return (item.piece for item in following.played())

    def adopt(self) -> None:
        """The faster law has taken over."""
        assert self._next is not None
        self._past.append(self._now)
        self._now, self._next = self._next, None
        self._goal, self._goal_before = min(self._next_goal, self._wish), None

    def discard(self, why: str, *, for_good: bool) -> None:
        """It has not; `for_good`: the path keeps what it was planned for, up to its next rest or the next change."""
        self._next = None
        if for_good:
            self._goal_before, self._goal = self._goal, self._wish
        self._on_missed(Missed(self._wish, why, for_good))

    # ------------------------------------------------------------------------------------------- places on the path

    def place(self, planned: PlannedSegment, frame: int) -> Place | None:
        """The place on the source at a motion frame (absolute, never wrapping) of a segment; None for segments that are
        not of this path.
        """
        played = self._played(planned)
        if played is None:
            return None
        time_s = (frame - planned.piece_start_frame) * self._frame_s
        return place_at(self._known, played, min(max(0.0, time_s), played.piece.duration_s))

    def time_s(self, place: Place) -> float:
        """Plan time of a place at 100 %, s."""
        return plan_time(self._known, place)

    def end(self) -> Place:
        """The place at the end of what has been planned so far."""
        number = self._source.count - 1
        return Place(number, *self._whole(number))

    def passed(self, place: Place) -> None:
        """The arm has come here: what lies too far behind is forgotten."""
        self._source.forget_before(self.time_s(place) - REMEMBERED_S)

    def playing(self, planned: PlannedSegment) -> None:
        """This segment is under way: pieces before its own are not played any more."""
        number = self._now.number_of(planned.piece)
        if number is not None:
            self._now.forget_before(number)
            self._past.clear()

    def back(self, place: Place, seconds: float) -> tuple[tuple[Piece, ...], Place]:
        """Pieces that lead back from a place as far as the path came in `seconds` at 100 %, and the place there.

        Raises RefusedError where there is nothing to go back along, PlanError where the law is timed from outside.
        """
        known = self._source.known()
        stopped_s = self.time_s(place)
        pieces = plan_run_back(self._config, [piece for _, piece in known], stopped_s, seconds)
        if not pieces:
            raise RefusedError("the arm has not moved in that time; give more seconds, or resume")
        goal_s = max(stopped_s - seconds, known[0][1].start_s)
        for number, piece in known:
            if goal_s < piece.end_s:
                law = along(piece.law)
                if law is None:
                    return pieces, Place(number, 0.0, goal_s - piece.start_s)
                return pieces, Place(number, way_at(law, min(goal_s - piece.start_s, law.duration_s)))
        raise AssertionError("the past ends before now")

    def actions(self, first: Place, last_s: float) -> tuple[str, ...]:
        """What the hand and the outputs do from a place to a plan time, in words with their lines; waits, the hand's
        too, are begun anew.
        """
        first_s = self.time_s(replace(first, waited_s=0.0))
        found = []
        for _, piece in self._source.known():
            for event in piece.events:
                if first_s - _SAME_S <= piece.start_s + event.offset_s < last_s - _SAME_S:
                    what = _in_words(event)
                    found.append(what if event.source is None else f"{what} (line {event.source.line})")
        return tuple(found)

    # --------------------------------------------------------------------------------------------------- inside

    def _whole(self, number: int) -> tuple[float, float]:
        piece = self._known.get(number)
        assert piece is not None
        law = along(piece.law)
        return (0.0, piece.duration_s) if law is None else (way_at(law, law.duration_s), 0.0)

    def _played(self, planned: PlannedSegment) -> Respeeded | None:
        for generation in (self._now, *self._past):
            number = generation.number_of(planned.piece)
            if number is not None:
                return generation.get(number)
        return None

    def _time_in(self, planned: PlannedSegment) -> float:
        return (planned.start_frame - planned.piece_start_frame) * self._frame_s


def _in_words(event: PieceEvent) -> str:
    if event.kind is EventKind.HAND:
        return "hand opens" if event.value > 0 else "hand closes"
    numbers = (number for number in range(event.mask.bit_length()) if event.mask >> number & 1)
    return ", ".join(f"output {number} {'on' if event.levels >> number & 1 else 'off'}" for number in numbers)

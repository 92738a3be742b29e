"""The same path at another feed, from any place on it: what the live override and running back are made of.

A plan is a row of pieces, the *source*. `Respeed` yields it again from a `Place`, its programmed feeds multiplied by a
scale. At scale 1, from a rest, those are the source's own pieces, untouched. Otherwise the elements of each chain (from
one rest to the next) get a new time law. Rapids and everything else that is bounded by the arm alone stay what they
are: only feeds are scaled, limits never.

From a place in mid-motion the new law cannot simply take over: where the law before is braking for a corner as hard as
it may, no other law is legal but that one, and a new grid would find its speed too high by a hair. So the law before is
followed, exactly, to the first grid point of the new one from which the new one can still stop; there it is left. In
other words: nothing ever has to be slowed down beyond what was planned, speeds only rise.

Laws that average over time (jerk) are left in the same way, with their base laws (`jerk_lead`): those of the law before
that the average still needs are the past of the new one. Averages are made in windows, too, so a chain without an end
is no burden. Laws timed from outside are not scaled at all.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from math import ceil
from typing import Protocol

import numpy as np

from rm501_host.config import Config

from .elements import Array, Element
from .grid import GridBuilder
from .jerk import JerkLaw
from .jerk_lead import SmoothLead
from .jerk_window import JerkWindow
from .law import PathLaw
from .limits import Limits
from .pieces import Piece, PieceEvent, PieceKind
from .ways import Along, along, elements_between, grid_ways, length_of, sliced, time_at, way_at
from .window import Window

_CHUNK = 64
"""Elements that enter the window at once: the first segments of a new law are wanted soon."""
_SMOOTH_CHUNK = 256
"""The same for averages, whose windows need more ahead of them."""
_MOST_FOLLOWED = 4_000
"""Grid intervals over which a chance to leave the law before is looked for at a time."""
_LEAST_LEFT = 33
"""Grid points from where the law before is left to the end: closer to the rest it is followed to it."""
_SAME_WAY = 1e-7


@dataclass(frozen=True, slots=True)
class Place:
    """A place on a plan: the number of the piece, and how far along its path (its way, see `ways`).

    `waited_s`: how much of a piece without a path has passed there.
    """

    piece: int
    way: float = 0.0
    waited_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Respeeded:
    """A piece to play: where on the source it begins, and what the programmed feeds were multiplied by."""

    piece: Piece
    begin: Place
    scale: float


class Pieces(Protocol):
    """Pieces by number; None behind the last one."""

    def get(self, number: int) -> Piece | None:
        """The piece of this number, planned now if need be."""
        ...


def place_at(source: Pieces, played: Respeeded, time_s: float) -> Place:
    """Where on the source a respeeded piece is at one of its times."""
    law = along(played.piece.law)
    if law is None:
        return replace(played.begin, waited_s=played.begin.waited_s + time_s)
    return moved(source, played.begin, way_at(law, min(time_s, law.duration_s)))


def moved(source: Pieces, place: Place, way: float) -> Place:
    """The place that lies `way` farther along the path, within the same chain."""
    number, at = place.piece, place.way + way
    while (piece := source.get(number)) is not None and not piece.ends_at_rest:
        law = along(piece.law)
        if law is None or at < (length := length_of(law)) - _SAME_WAY:
            break
        number, at = number + 1, max(0.0, at - length)
    return Place(number, at)


def plan_time(source: Pieces, place: Place) -> float:
    """The plan time of a place on the source."""
    piece = source.get(place.piece)
    assert piece is not None
    law = along(piece.law)
    if law is None:
        return piece.start_s + min(place.waited_s, piece.duration_s)
    return piece.start_s + time_at(law, place.way)


class Lead:
    """The law that is being played, from the place where another one shall take over: it is followed until that can."""

    def __init__(self, played: Iterable[Respeeded], time_s: float) -> None:
        """`played`: the pieces from the one under way on; `time_s`: the time in the first of them."""
        self._played = iter(played)
        self._time_s = time_s
        self._parts: list[_Part] = []
        self._ways = np.zeros(0)
        self._squared = np.zeros(0)
        self._is_complete = False

    def squared(self, ways: Array) -> Array:
        """Squared speeds (n,) at ways (n,) from the place."""
        while not self._is_complete and (not len(self._ways) or self._ways[-1] < ways[-1]):
            self._extend()
        return np.interp(ways, self._ways, self._squared)

    def _extend(self) -> None:
        played = next(self._played, None)
        law = None if played is None else played.piece.law
        if played is None or not isinstance(law, PathLaw):
            self._is_complete = True
            return
        self._is_complete = played.piece.ends_at_rest
        if not len(self._ways):
            law = sliced(law, way_at(law, self._time_s), length_of(law))
        begin = float(self._ways[-1]) if len(self._ways) else 0.0
        self._parts.append(_Part(law, begin, played.scale))
        self._index()

    def until(self, way: float) -> list[_Part]:
        """What lies before `way`, cut there; it is forgotten, and ways count on from there."""
        taken = []
        while self._parts:
            part = self._parts[0]
            length = float(grid_ways(part.law)[-1])
            cut = way - part.begin
            if cut >= length - _SAME_WAY:
                taken.append(self._parts.pop(0))
                continue
            if cut > _SAME_WAY:
                taken.append(replace(part, law=sliced(part.law, 0.0, cut)))
                self._parts[0] = replace(part, law=sliced(part.law, cut, length), begin=way)
            break
        if np.isfinite(way):
            self._parts = [replace(part, begin=part.begin - way) for part in self._parts]
        self._index()
        return taken

    def _index(self) -> None:
        if self._parts:
            self._ways = np.concatenate([part.begin + grid_ways(part.law) for part in self._parts])
            self._squared = np.concatenate([part.law.speed**2 for part in self._parts])


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A law, the way at which it begins, the scale of its feeds."""

    law: PathLaw
    begin: float
    scale: float


def lead_of(played: Iterable[Respeeded], time_s: float) -> Lead | SmoothLead | None:
    """The law that is being played as one to be followed; None where it is none along a path.

    `played`: the pieces from the one under way on; `time_s`: the time in the first of them.
    """
    pieces = iter(played)
    first = next(pieces, None)
    if first is None or along(first.piece.law) is None:
        return None
    everything = chain([first], pieces)
    if isinstance(first.piece.law, JerkLaw):
        return SmoothLead(((item.piece, item.scale) for item in everything), time_s)
    return Lead(everything, time_s)


class Respeed:
    """Yields a source again from a place, at a scale of its programmed feeds."""

    def __init__(self, config: Config, source: Pieces, scale: Callable[[], float]) -> None:
        """`scale` is asked at the start of each chain."""
        self._source = source
        self._scale = scale
        self._limits = Limits.from_config(config)
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6

    def pieces(
        self, begin: Place, lead: Lead | SmoothLead | None = None, *, event_slack_s: float = 0.0
    ) -> Iterator[Respeeded]:
        """From `begin` to the source's end.

        With a `lead` motion goes on there as that law has it, else from rest. Events up to `event_slack_s` before
        `begin` have not been played yet: segments place them on the next frame.
        """
        number = begin.piece
        while (piece := self._source.get(number)) is not None:
            start = begin if begin.piece == number else Place(number)
            scale = self._scale()
            if along(piece.law) is None:
                yield Respeeded(piece, Place(number), scale)
                number += 1
            elif lead is None and scale == 1.0 and piece.starts_at_rest and start.way == 0.0:
                number = yield from self._as_it_is(number)
            else:
                number = yield from self._chain(start, scale, lead, event_slack_s)
            lead = None

    def _as_it_is(self, number: int) -> Generator[Respeeded, None, int]:
        """The chain that begins with this piece, untouched; gives the number behind it."""
        while (piece := self._source.get(number)) is not None:
            yield Respeeded(piece, Place(number), 1.0)
            number += 1
            if piece.ends_at_rest:
                break
        return number

    def _chain(
        self, begin: Place, scale: float, lead: Lead | SmoothLead | None, event_slack_s: float
    ) -> Generator[Respeeded, None, int]:
        """The chain that holds `begin`, with a new law from there; gives the number behind it."""
        first = self._path(begin.piece)
        made = _Chain(self._source, begin, self._frame_s, is_moving=lead is not None)
        if isinstance(first, JerkLaw):
            assert not isinstance(lead, Lead), "an average is gone on from as an average"
            return (yield from self._smooth_chain(made, begin, scale, lead, event_slack_s))
        assert not isinstance(lead, SmoothLead), "only an average is gone on from as an average"
        window = Window(first.arm, self._builder(first), self._frame_s)
        for elements in self._elements(made, begin, event_slack_s):
            for chunk in _chunks(elements, scale, _CHUNK):
                window.extend(chunk)
                if lead is not None:
                    followed, lead = _follow(window, lead)
                    for part in followed:
                        yield made.made(part.law, part.scale)
                if lead is None:
                    while (stretch := window.commit()) is not None:
                        yield made.made(stretch.law, scale)
        if lead is not None:
            # nowhere could it be left: it is followed to the rest
            rest = lead.until(np.inf)
            for part in rest[:-1]:
                yield made.made(part.law, part.scale)
            yield made.made(rest[-1].law, rest[-1].scale, rests=True, ends=True)
        else:
            last = window.finish()
            assert last is not None
            yield made.made(last.law, scale, rests=True, ends=True)
        return made.number

    def _smooth_chain(
        self, made: _Chain, begin: Place, scale: float, lead: SmoothLead | None, event_slack_s: float
    ) -> Generator[Respeeded, None, int]:
        """The same where laws are averages."""
        first = self._path(begin.piece)
        window_s = None if lead is None else lead.window_s
        window = JerkWindow(first.arm, self._builder(first), self._limits, self._frame_s, window_s=window_s)
        skipped = 0.0 if lead is None else lead.ahead
        for elements in self._elements(made, begin, event_slack_s):
            ahead, skipped = _without_first(elements, skipped)
            for chunk in _chunks(ahead, scale, _SMOOTH_CHUNK):
                window.extend(chunk)
                if lead is not None:
                    followed, has_taken_over = window.follow(lead)
                    for law, its_scale in followed:
                        yield made.made(law, its_scale)
                    if has_taken_over:
                        lead = None
                if lead is None:
                    while (settled := window.commit()) is not None:
                        yield made.made(settled.law, scale, rests=settled.ends_at_rest)
        if lead is not None:
            rest = lead.until(np.inf)
            for law, its_scale in rest[:-1]:
                yield made.made(law, its_scale)
            yield made.made(rest[-1][0], rest[-1][1], rests=True, ends=True)
            return made.number
        left = window.finish()
        while left is not None:
            # there is more where no legal law was found in the middle
            settled, left = left, window.finish()
            yield made.made(settled.law, scale, rests=True, ends=left is None)
        return made.number

    def _builder(self, law: Along) -> GridBuilder:
        return GridBuilder(law.arm, self._limits, check_limits=False)

    def _elements(self, made: _Chain, begin: Place, event_slack_s: float) -> Iterator[list[Element]]:
        """The elements of the chain from `begin` on, piece by piece."""
        first = self._path(begin.piece)
        way = begin.way
        slack_way = way
        if event_slack_s > 0.0 and way > 0.0:
            slack_way = way_at(first, max(0.0, time_at(first, way) - event_slack_s))
        ends = False
        while not ends:
            piece, law = self._source.get(made.number), self._path(made.number)
            assert piece is not None
            made.take_events(piece.events, law, slack_way - way, way)
            elements = elements_between(law, way, length_of(law))
            way, slack_way, ends = 0.0, 0.0, piece.ends_at_rest
            made.number += 1
            yield elements

    def _path(self, number: int) -> Along:
        piece = self._source.get(number)
        law = None if piece is None else along(piece.law)
        assert law is not None, "a chain of motion ends at rest"
        return law


def _follow(window: Window, lead: Lead) -> tuple[list[_Part], Lead | None]:
    """Parts of the law before to go along because the window's cannot take over yet; None instead of that law once it
    can, in motion at the window's first point then.
    """
    ways = window.ways
    squared = lead.squared(ways)
    join = window.joins(squared)
    left: Lead | None = None
    if join is None or len(squared) - join < _LEAST_LEFT:
        if window.intervals < _MOST_FOLLOWED:
            return [], lead
        join, left = window.intervals // 2, lead
    parts = lead.until(float(ways[join]))
    window.pass_on(join, float(squared[join]), sum(part.law.duration_s for part in parts))
    return parts, left


class _Chain:
    """Makes pieces of the laws of one chain, one after another."""

    def __init__(self, source: Pieces, begin: Place, frame_s: float, *, is_moving: bool) -> None:
        self._source = source
        self._place = begin
        self.number = begin.piece
        """Of the next piece of the source that enters the chain."""
        self._frame_s = frame_s
        self._is_moving = is_moving
        self._time_s = 0.0
        self._way = 0.0
        self._known = 0.0
        self._events: list[tuple[float, PieceEvent]] = []

    def take_events(self, events: tuple[PieceEvent, ...], law: Along, earliest: float, way: float) -> None:
        """Events of the next piece of the source, which enters the chain at `way`, from `earliest` beyond that on."""
        for event in events:
            beyond = way_at(law, event.offset_s) - way
            if beyond >= earliest:
                self._events.append((self._known + beyond, event))
        self._known += length_of(law) - way

    def made(self, law: Along, scale: float, *, rests: bool = False, ends: bool = False) -> Respeeded:
        """The piece that plays `law`, the next part of the chain; whether it ends at rest, and is the last one."""
        length = length_of(law)
        start_s, duration_s = self._time_s, law.duration_s
        rest = tuple(law.q_deg(np.array([duration_s]))[0].tolist())
        events = []
        while self._events and (ends or self._events[0][0] < self._way + length):
            way, event = self._events.pop(0)
            offset_s = time_at(law, min(max(0.0, way - self._way), length))
            events.append(replace(event, offset_s=offset_s))
        self._time_s += duration_s
        if rests:
            self._time_s = ceil(self._time_s / self._frame_s - 1e-6) * self._frame_s
        piece = Piece(
            PieceKind.MOTION,
            law.table.elements[int(law.places(np.zeros(1))[0][0])].source,
            start_s,
            self._time_s - start_s,
            rest,
            law=law,
            starts_at_rest=not self._is_moving,
            ends_at_rest=rests,
            events=tuple(events),
            motion_s=duration_s,
            arm=law.arm,
        )
        played = Respeeded(piece, self._place, scale)
        self._is_moving = not rests
        self._place = moved(self._source, self._place, length)
        self._way += length
        return played


def _chunks(elements: list[Element], scale: float, size: int) -> Iterator[list[Element]]:
    scaled = [_scaled(element, scale) for element in elements]
    for at in range(0, len(scaled), size):
        yield scaled[at : at + size]


def _without_first(elements: list[Element], way: float) -> tuple[list[Element], float]:
    """The elements behind `way`, the one it lies on cut there, and how much of it is left behind all of them."""
    for number, element in enumerate(elements):
        if way < element.length - _SAME_WAY:
            if way > 0.0:
                return [element.trimmed(way, element.length), *elements[number + 1 :]], 0.0
            return elements[number:], 0.0
        way = max(0.0, way - element.length)
    return [], way


def _scaled(element: Element, scale: float) -> Element:
    return replace(element, feed_mm_s=element.feed_mm_s * scale, rate=element.rate * scale)

"""The same path at another feed, from any place on it: what the live override and running back are made of.

A plan is a row of pieces, the *source*. `Respeed` yields it again from a `Place`, its programmed feeds multiplied by a
scale. At scale 1, from a rest, those are the source's own pieces, untouched. Otherwise the elements of each chain (from
one rest to the next) get a new time law. Rapids and everything else that is bounded by the arm alone stay what they
are: only feeds are scaled, limits never.

From a place in mid-motion the new law cannot simply take over: where the law before is braking for a corner as hard as
it may, no other law is legal but that one, and a new grid would find its speed too high by a hair. So the law before is
followed, exactly, to the first grid point of the new one from which the new one can still stop; there it is left. In
other words: nothing ever has to be slowed down beyond what was planned, speeds only rise.

Laws that average over time (jerk) or come from outside cannot be left in motion: they are scaled from their next rest
on, or, timed from outside, not at all. Averages are made in windows, too, so a chain without an end is no burden.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from math import ceil
from typing import Protocol

import numpy as np

from rm501_host.config import Config

from .elements import Array, Element
from .grid import GridBuilder
from .jerk import JerkLaw
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


class Respeed:
    """Yields a source again from a place, at a scale of its programmed feeds."""

    def __init__(self, config: Config, source: Pieces, scale: Callable[[], float]) -> None:
        """`scale` is asked at the start of each chain."""
        self._source = source
        self._scale = scale
        self._limits = Limits.from_config(config)
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6

    def pieces(self, begin: Place, lead: Lead | None = None, *, event_slack_s: float = 0.0) -> Iterator[Respeeded]:
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
        self, begin: Place, scale: float, lead: Lead | None, event_slack_s: float
    ) -> Generator[Respeeded, None, int]:
        """The chain that holds `begin`, with a new law from there; gives the number behind it."""
        first = self._path(begin.piece)
        if isinstance(first, JerkLaw):
            assert lead is None, "an average is not left in motion"
        chain = _Chain(self._source, begin, self._frame_s, is_moving=lead is not None)
        builder = GridBuilder(first.arm, self._limits, check_limits=False)
        smooth = JerkWindow(first.arm, builder, self._limits, self._frame_s) if isinstance(first, JerkLaw) else None
        window = Window(first.arm, builder, self._frame_s)
        slack_way = begin.way
        if event_slack_s > 0.0 and begin.way > 0.0:
            slack_way = way_at(first, max(0.0, time_at(first, begin.way) - event_slack_s))
        number, way = begin.piece, begin.way
        ends = False
        while not ends:
            piece, law = self._source.get(number), self._path(number)
            assert piece is not None
            chain.take_events(piece.events, law, slack_way - way, way)
            elements = [_scaled(element, scale) for element in elements_between(law, way, length_of(law))]
            number, way, slack_way, ends = number + 1, 0.0, 0.0, piece.ends_at_rest
            size = _CHUNK if smooth is None else _SMOOTH_CHUNK
            for at in range(0, len(elements), size):
                chunk = elements[at : at + size]
                if smooth is not None:
                    smooth.extend(chunk)
                    while (settled := smooth.commit()) is not None:
                        yield chain.made(settled.law, scale, rests=settled.ends_at_rest)
                    continue
                window.extend(chunk)
                if lead is not None:
                    followed, lead = _follow(window, lead)
                    for part in followed:
                        yield chain.made(part.law, part.scale)
                if lead is None:
                    while (stretch := window.commit()) is not None:
                        yield chain.made(stretch.law, scale)
        if smooth is not None:
            left = smooth.finish()
            while left is not None:
                # there is more where no legal law was found in the middle
                settled, left = left, smooth.finish()
                yield chain.made(settled.law, scale, rests=True, ends=left is None)
        elif lead is not None:
            # nowhere could it be left: it is followed to the rest
            rest = lead.until(np.inf)
            for part in rest[:-1]:
                yield chain.made(part.law, part.scale)
            yield chain.made(rest[-1].law, rest[-1].scale, rests=True, ends=True)
        else:
            last = window.finish()
            assert last is not None
            yield chain.made(last.law, scale, rests=True, ends=True)
        return number

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


def _scaled(element: Element, scale: float) -> Element:
    return replace(element, feed_mm_s=element.feed_mm_s * scale, rate=element.rate * scale)

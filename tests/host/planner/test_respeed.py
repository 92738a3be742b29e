"""A path timed anew from any place on it: limits, continuity, the same geometry, the feeds that are asked for."""

from __future__ import annotations

import random
from dataclasses import replace
from math import sin

import msgspec
import numpy as np
import pytest

from rm501_host.config import Config, load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Dwell, Feed, LinearMove, Move, OutputChange, RapidMove
from rm501_host.planner import Piece, PieceKind, Plan, Planner
from rm501_host.planner.jerk import JerkLaw
from rm501_host.planner.law import PathLaw
from rm501_host.planner.pieces import EventKind, PieceEvent
from rm501_host.planner.respeed import Lead, Place, Respeed, Respeeded, lead_of, moved, place_at, plan_time
from rm501_host.planner.ways import elements_between, length_of, sliced, time_at, way_at
from rm501_host.segmenter import PlannedSegment, Segmenter
from rm501_host.segmenter.fit import to_q48
from tests.host.planner.programs import (
    PICK_START_DEG,
    POLYLINE_MM,
    POLYLINE_START_DEG,
    at,
    lines,
    mode,
    pick_and_place,
    target,
)
from tests.support.plan_checker import judge_samples, play_segments

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
FRAME_S = CONFIG.board.base_period_us * len(CONFIG.board.table) * 1e-6


class Row:
    """A plan as a source."""

    def __init__(self, pieces: list[Piece]) -> None:
        self.pieces = pieces

    def get(self, number: int) -> Piece | None:
        return self.pieces[number] if number < len(self.pieces) else None


def planned(moves: list[Move], start_deg: tuple[float, ...], config: Config = CONFIG) -> Row:
    return Row(list(Planner(ARM, config, start_deg).plan(moves)))


def segments_of(pieces: list[Piece], start_q48: tuple[int, ...], frame: int) -> list[PlannedSegment]:
    return list(Segmenter(CONFIG, start_q48, frame).segments(pieces))


def q48(q_deg: tuple[float, ...]) -> tuple[int, ...]:
    return (*map(to_q48, ARM.motors_from_joints(np.array(q_deg)).tolist()), 0)


PROGRAMS = {
    "pick and place, stopping": (pick_and_place(2800.0, None), PICK_START_DEG),
    "pick and place, blended": (pick_and_place(1500.0, 2.0), PICK_START_DEG),
    "polyline": ([mode(5.0), *lines([(x, y, 100) for x, y in POLYLINE_MM], 2000.0)], POLYLINE_START_DEG),
}


def taken_over(
    source: Row, start_deg: tuple[float, ...], scale: float, rng: random.Random
) -> tuple[list[PlannedSegment], list[Piece], list[Respeeded], float]:
    """Segments up to a random boundary and from there on by a law of another scale; the pieces in their order, at the
    times at which they are played; the new ones; the duration without all that.
    """
    old = segments_of(source.pieces, q48(start_deg), 0)
    number = rng.choice([i for i in range(1, len(old)) if isinstance(old[i].piece.law, PathLaw)])
    place_segment = old[number]
    piece = place_segment.piece
    at_s = (place_segment.start_frame - place_segment.piece_start_frame) * FRAME_S
    played = [Respeeded(item, Place(i), 1.0) for i, item in enumerate(source.pieces)]
    index = source.pieces.index(piece)
    lead = Lead(iter(played[index:]), at_s) if at_s > 0.0 or not piece.starts_at_rest else None
    new = list(Respeed(CONFIG, source, lambda: scale).pieces(place_at(source, played[index], at_s), lead))
    segments = old[:number] + segments_of([x.piece for x in new], old[number - 1].end_q48, place_segment.start_frame)
    starts = {id(item.piece): item.piece_start_frame * FRAME_S for item in reversed(segments)}
    at_times: list[Piece] = []
    offset = 0.0
    for item in source.pieces[: index + (at_s > 0.0)]:
        offset = starts[id(item)] - item.start_s if item.starts_at_rest else offset
        until_s = place_segment.start_frame * FRAME_S - item.start_s - offset
        at_times.append(replace(item, start_s=item.start_s + offset, duration_s=min(item.duration_s, until_s)))
    offset = place_segment.start_frame * FRAME_S - new[0].piece.start_s
    for item in (x.piece for x in new):
        offset = starts[id(item)] - item.start_s if item.starts_at_rest else offset
        at_times.append(replace(item, start_s=item.start_s + offset))
    return segments, at_times, new, old[-1].end_frame * FRAME_S


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_faster_law_takes_over_in_motion_within_every_limit(name: str) -> None:
    moves, start_deg = PROGRAMS[name]
    source = planned(list(moves), start_deg)
    rng = random.Random(name)
    gained = 0
    for _ in range(3):
        segments, pieces, _, before_s = taken_over(source, start_deg, rng.choice([1.2, 2.0]), rng)
        samples = Plan(ARM, CONFIG, pieces).sample()
        judged = judge_samples(CONFIG, samples.t_s, samples.q_deg)
        assert judged.worst <= 1.0 + 1e-6
        assert judged.lowest_margin_deg >= -1e-6
        stepped = play_segments(CONFIG, segments, pieces)
        assert stepped.worst <= 1.02
        assert stepped.largest_error_steps <= 0.1
        assert stepped.largest_speed_jump_steps_s < 0.1
        assert stepped.largest_rest_error_steps < 1e-4
        end = np.array(source.pieces[-1].rest_deg)
        assert np.abs(pieces[-1].q_deg(np.array([pieces[-1].duration_s]))[0] - end).max() < 1e-9
        after_s = segments[-1].end_frame * FRAME_S
        assert after_s <= before_s + 0.05
        gained += after_s < before_s - 0.05
    assert gained >= 1


def test_a_slower_scale_waits_for_the_law_before_to_become_slow() -> None:
    """Nothing is slowed down beyond what was planned: the law before is followed to where the new one is not slower."""
    moves: list[Move] = [mode(1.0), *lines([(x, y, 100) for x, y in POLYLINE_MM], 2000.0)]
    fast = planned(
        [replace(m, feed=Feed(4000.0)) if isinstance(m, LinearMove) else m for m in moves], POLYLINE_START_DEG
    )
    _, pieces, new, _ = taken_over(fast, POLYLINE_START_DEG, 0.5, random.Random(3))
    samples = Plan(ARM, CONFIG, pieces).sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    assert {x.scale for x in new} <= {1.0, 0.5}


def test_feeds_are_scaled_and_rapids_are_not_above_their_limits() -> None:
    moves = [mode(None), RapidMove(target(300, 40, 250), at(2)), LinearMove(target(300, -40, 250), Feed(1200.0), at(3))]
    source = planned(moves, CONFIG.home_deg)
    plan = [x.piece for x in Respeed(CONFIG, source, lambda: 1.5).pieces(Place(0))]
    slow = sum(piece.motion_s for piece in source.pieces if piece.source.line == 2)
    assert sum(piece.motion_s for piece in plan if piece.source.line == 2) == pytest.approx(slow, abs=2 * FRAME_S)
    line = max((piece for piece in plan if piece.source.line == 3), key=lambda piece: piece.motion_s)
    assert isinstance(line.law, PathLaw)
    assert line.law.tool_speeds_mm_s(np.linspace(0, line.duration_s, 400)).max() == pytest.approx(30.0, rel=1e-4)


def test_at_scale_1_the_pieces_of_the_plan_are_played_themselves() -> None:
    source = planned(pick_and_place(2800.0, 2.0), PICK_START_DEG)
    again = [x.piece for x in Respeed(CONFIG, source, lambda: 1.0).pieces(Place(0))]
    assert len(again) == len(source.pieces)
    assert all(a is b for a, b in zip(again, source.pieces, strict=True))


def test_places_and_times_are_each_others_inverse_also_across_pieces_and_laws() -> None:
    source = planned([mode(2.0), *lines([(x, y, 100) for x, y in POLYLINE_MM], 2000.0)], POLYLINE_START_DEG)
    faster = list(Respeed(CONFIG, source, lambda: 2.0).pieces(Place(0)))
    for played in faster:
        for share in (0.0, 0.3, 0.999):
            time_s = share * played.piece.motion_s
            place = place_at(source, played, time_s)
            piece = source.pieces[place.piece]
            here = piece.q_deg(np.array([plan_time(source, place) - piece.start_s]))
            assert np.abs(here - played.piece.q_deg(np.array([time_s]))).max() < 1e-6
    law = source.pieces[0].law
    assert isinstance(law, PathLaw)
    for way in np.linspace(0.0, length_of(law), 23):
        assert way_at(law, time_at(law, float(way))) == pytest.approx(way, abs=1e-9)
    assert moved(source, Place(0), 1e9).piece == len(source.pieces) - 1


def test_an_averaged_chain_is_scaled_in_windows_from_any_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole chains of it cannot be planned at once: they may be without an end."""
    soft = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
    monkeypatch.setattr("rm501_host.planner.respeed._SMOOTH_CHUNK", 64)
    points = [(300 + 0.4 * i, 8.0 * sin(0.05 * i), 150.0) for i in range(160)]
    moves = [mode(0.5), *lines(points, 240.0)]
    moves.insert(90, OutputChange(0, True, True, at(90)))
    best = ARM.ik((300.0, 0.0, 150.0), 0.0, 0.0).best
    assert best is not None
    source = planned(moves, best.q_deg, soft)
    for share, scale in ((0.0, 2.0), (0.3, 1.0)):
        begin = moved(source, Place(0), share * sum(length_of(as_jerk(piece)) for piece in source.pieces))
        made = list(Respeed(soft, source, lambda scale=scale: scale).pieces(begin))
        assert len(made) > 2
        assert made[-1].piece.ends_at_rest and sum(item.piece.ends_at_rest for item in made) <= 2
        assert sum(len(item.piece.events) for item in made) == 1
        pieces = []
        for item in made:
            start_s = pieces[-1].end_s if pieces else 0.0
            pieces.append(replace(item.piece, start_s=start_s))
            place = place_at(source, item, item.piece.motion_s)
            here = source.pieces[place.piece].q_deg(
                np.array([plan_time(source, place) - source.pieces[place.piece].start_s])
            )
            assert np.abs(here - item.piece.q_deg(np.array([item.piece.motion_s]))).max() < 1e-5
        samples = Plan(ARM, soft, pieces).sample()
        assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
        jerks = np.abs(np.diff(samples.q_deg, 3, axis=0))[:-1] / 1e-9
        assert (jerks / [joint.max_jerk_deg_s3 for joint in CONFIG.joints.ordered]).max() <= 1.0 + 1e-3
        if scale > 1.0:
            assert pieces[-1].end_s < source.pieces[-1].end_s - 0.5


SOFT = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
JERK = np.array([joint.max_jerk_deg_s3 for joint in CONFIG.joints.ordered])
AVERAGED = {
    "wave": ([mode(0.5), *lines([(300 + 0.4 * i, 8.0 * sin(0.05 * i), 150.0) for i in range(100)], 240.0)], None),
    "polyline": ([mode(2.0), *lines([(x, y, 100) for x, y in POLYLINE_MM], 1500.0)], POLYLINE_START_DEG),
    "stopping": ([mode(None), *lines([(x, y, 100) for x, y in POLYLINE_MM], 1500.0)], POLYLINE_START_DEG),
}


@pytest.mark.parametrize("name", AVERAGED)
def test_an_average_is_left_in_motion_twice_within_its_jerk(name: str) -> None:
    moves, start_deg = AVERAGED[name]
    if start_deg is None:
        best = ARM.ik((300.0, 0.0, 150.0), 0.0, 0.0).best
        assert best is not None
        start_deg = best.q_deg
    source = planned(moves, start_deg, SOFT)
    rng = random.Random(501)
    played = [Respeeded(piece, Place(k), 1.0) for k, piece in enumerate(source.pieces)]
    is_faster = False
    for scale in (1.3, 2.0):
        until_s = sum(item.piece.duration_s for item in played)
        at_s = rng.uniform(0.05, 0.7) * until_s
        first = 0
        while at_s >= played[first].piece.duration_s:
            at_s -= played[first].piece.duration_s
            first += 1
        left = played[first]
        at_s = min(at_s, left.piece.motion_s - 1e-3)
        place = place_at(source, left, at_s)
        lead = lead_of(played[first:], at_s)
        made = list(Respeed(SOFT, source, lambda scale=scale: scale).pieces(place, lead))
        check_continued(source, [item.piece for item in played[: first + 1]], at_s, [item.piece for item in made])
        before_s = sum(item.piece.duration_s for item in played[first:]) - at_s
        after_s = sum(item.piece.duration_s for item in made)
        assert after_s <= before_s + 1e-3
        is_faster |= scale in [item.scale for item in made] and after_s < 0.97 * before_s
        played = made
    assert is_faster


def check_continued(source: Row, before: list[Piece], at_s: float, after: list[Piece]) -> None:
    """The last piece of `before` up to a time and then the others: the path's end, every limit, and the jerk."""
    parts = [(piece, piece.duration_s) for piece in before[:-1]] + [(before[-1], at_s)]
    parts += [(piece, piece.duration_s) for piece in after]
    ends = np.cumsum([duration_s for _, duration_s in parts])
    times = np.arange(0.0, float(ends[-1]), 1e-3)
    which = np.searchsorted(ends, times, side="right")
    q_deg = np.zeros((len(times), 5))
    for k in np.unique(which).tolist():
        rows = which == k
        q_deg[rows] = parts[k][0].q_deg(times[rows] - ends[k] + parts[k][1])
    assert judge_samples(CONFIG, times, q_deg).worst <= 1.0 + 1e-6
    assert (np.abs(np.diff(q_deg, 3, axis=0)) / 1e-9 / JERK).max() <= 1.0 + 1e-5
    np.testing.assert_allclose(after[-1].rest_deg, source.pieces[-1].rest_deg, atol=1e-6)


def as_jerk(piece: Piece) -> JerkLaw:
    assert isinstance(piece.law, JerkLaw)
    return piece.law


def test_a_slice_of_a_law_is_the_law_itself() -> None:
    source = planned([mode(2.0), *lines([(x, y, 100) for x, y in POLYLINE_MM], 2000.0)], POLYLINE_START_DEG)
    law = source.pieces[0].law
    assert isinstance(law, PathLaw)
    first, last = 0.21 * length_of(law), 0.77 * length_of(law)
    part = sliced(law, first, last)
    begin_s = time_at(law, first)
    times = np.linspace(0.0, part.duration_s, 50)
    assert part.duration_s == pytest.approx(time_at(law, last) - begin_s, abs=1e-9)
    assert np.abs(part.q_deg(times) - law.q_deg(times + begin_s)).max() < 1e-8
    assert sum(e.length for e in elements_between(law, first, last)) == pytest.approx(last - first, abs=1e-9)


def test_events_on_the_way_happen_at_their_place_whatever_the_scale() -> None:
    moves: list[Move] = [
        mode(None),
        RapidMove(target(300, 0, 250), at(1)),
        LinearMove(target(300, 40, 250), Feed(1500.0), at(2)),
        LinearMove(target(300, -40, 250), Feed(1500.0), at(3)),
        Dwell(0.1, at(4)),
        OutputChange(0, True, False, at(5)),
        LinearMove(target(280, -40, 250), Feed(1500.0), at(6)),
    ]
    source = planned(moves, CONFIG.home_deg)
    motion = [i for i, p in enumerate(source.pieces) if p.kind is PieceKind.MOTION and p.source.line == 2]
    piece = source.pieces[motion[0]]
    times = (0.1 * piece.duration_s, 0.5 * piece.duration_s, piece.duration_s)
    events = tuple(PieceEvent(t, EventKind.OUTPUT, mask=1 << i, levels=1 << i) for i, t in enumerate(times))
    source.pieces[motion[0]] = replace(piece, events=events)
    at_s = 0.3 * piece.duration_s
    assert isinstance(piece.law, PathLaw)
    played = Respeeded(piece, Place(motion[0]), 1.0)
    lead = Lead(iter([played]), at_s)
    place = place_at(source, played, at_s)
    found = []
    for new in Respeed(CONFIG, source, lambda: 2.0).pieces(place, lead, event_slack_s=FRAME_S):
        found += [(new, event) for event in new.piece.events]
    assert [event.mask for _, event in found] == [2, 4, 1]  # the first one lies before; the last is the dwelling output
    for (new, event), time_s in zip(found[:2], times[1:], strict=True):
        here = new.piece.q_deg(np.array([event.offset_s]))
        assert np.abs(here - piece.q_deg(np.array([time_s]))).max() < 1e-6

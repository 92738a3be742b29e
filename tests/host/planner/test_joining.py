"""Many elements at a time: what is decided and planned at once is what one by one gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import JointMove, PathMode, PathModeChange
from rm501_host.planner import JointLimitError, Piece, Planner, UnreachableError
from rm501_host.planner.corners import CornerMaker, Passage
from rm501_host.planner.elements import Element, ElementTable, Space, line
from rm501_host.planner.grid import GridBuilder
from rm501_host.planner.joining import Arrival, Joiner, Run
from rm501_host.planner.limits import Limits
from tests.host.planner.programs import at, lines, mode

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
LIMITS = Limits.from_config(CONFIG)
MAKER = CornerMaker(ARM, LIMITS)
PLACE = (300.0, 0.0, 150.0)


def scribble(count: int, seed: int) -> list[tuple[float, float, float]]:
    """Points of 0.05 to 1 mm lines in any direction."""
    draw = np.random.default_rng(seed)
    steps = draw.normal(size=(count, 2))
    steps *= (draw.uniform(0.05, 1.0, count) / np.linalg.norm(steps, axis=1))[:, None]
    return [(PLACE[0] + float(x), PLACE[1] + float(y), PLACE[2]) for x, y in np.cumsum(steps, axis=0)]


def elements_of(points: list[tuple[float, float, float]]) -> list[Element]:
    found, before = [], np.array((*PLACE, 0.0, 0.0))
    for number, point in enumerate(points):
        after = np.array((*point, 0.0, 0.0))
        length = float(np.linalg.norm(after - before))
        found.append(line(Space.TASK, before, after, length, at(number), feed_mm_s=100.0))
        before = after
    return found


def start_deg() -> tuple[float, ...]:
    best = ARM.ik(PLACE, 0.0, 0.0).best
    assert best is not None
    return best.q_deg


def one_by_one(elements: list[Element], tolerance_mm: float) -> list[bool]:
    """Whether each corner is passed, judged in order by what is left of the element before it."""
    used, passed = 0.0, []
    for first, second in pairwise(elements):
        corner = MAKER.between(first, used, second, PathMode.BLEND, tolerance_mm)
        passed.append(corner is not None)
        used = 0.0 if corner is None else corner.after
    return passed


def passed_in(runs: list[Run], count: int) -> list[bool]:
    """The same, from where the runs end."""
    stops = {run.elements[-1].source.line for run in runs if run.ends_at_rest}
    return [number not in stops for number in range(count - 1)]


@pytest.mark.parametrize("seed", (1, 2))
@pytest.mark.parametrize("batch", [7, 100])
def test_corners_decided_together_are_those_decided_one_by_one(seed: int, batch: int) -> None:
    elements = elements_of(scribble(24, seed))
    joiner, runs = Joiner(MAKER), []
    for number, element in enumerate(elements, 1):
        joiner.add(Arrival(element, PathMode.BLEND, 0.001))
        if number % batch == 0:
            runs += joiner.join(to_rest=False)
    runs += joiner.join(to_rest=True)
    expected = one_by_one(elements, 0.001)
    assert passed_in(runs, len(elements)) == expected
    assert True in expected and False in expected
    whole = [element for run in runs for element in run.elements]
    for before, after in pairwise(whole):
        np.testing.assert_allclose(before.at(before.length)[0], after.at(0.0)[0], atol=1e-9)


class OnlyFromWhole(CornerMaker):
    """Finds a corner faster only where all of the element before it is left: every second one."""

    def __init__(self) -> None:
        super().__init__(ARM, LIMITS)
        self.asked: list[tuple[int, float]] = []

    def are_faster(self, passages: Sequence[Passage]) -> list[bool]:
        self.asked += [(passage.first.source.line, passage.used) for passage in passages]
        return [passage.used == 0.0 for passage in passages]


@pytest.mark.parametrize("batch", [2, 5, 100])
def test_a_corner_is_judged_by_what_the_one_before_has_left(batch: int) -> None:
    points = [(300.0 + 0.2 * (i % 2), 0.1 * i, 150.0) for i in range(1, 21)]
    elements, maker = elements_of(points), OnlyFromWhole()
    joiner, runs = Joiner(maker), []
    for number, element in enumerate(elements, 1):
        joiner.add(Arrival(element, PathMode.BLEND, 0.05))
        if number % batch == 0:
            runs += joiner.join(to_rest=False)
    runs += joiner.join(to_rest=True)
    assert passed_in(runs, len(elements)) == [number % 2 == 0 for number in range(len(elements) - 1)]
    assert len(set(maker.asked)) == len(maker.asked)


def test_grids_built_together_are_those_built_one_by_one() -> None:
    runs = [elements_of(scribble(count, count)) for count in (1, 3, 12)]
    builder = GridBuilder(ARM, LIMITS)
    for run, grid in zip(runs, builder.build_each(runs), strict=True):
        alone = builder.build(ElementTable(run))
        np.testing.assert_array_equal(grid.element, alone.element)
        np.testing.assert_array_equal(grid.stop, alone.stop)
        np.testing.assert_allclose(grid.lines.peak_x, alone.lines.peak_x, rtol=1e-9)


def test_the_limits_without_roll_are_those_that_bind_when_it_stands_still() -> None:
    rows, velocity, acceleration = LIMITS.without_roll()
    draw = np.random.default_rng(4)
    for _ in range(200):
        rates = draw.normal(size=5)
        rates[4] = 0.0
        few, many = np.abs(rows @ rates), np.abs(LIMITS.rows @ rates)
        assert (few / velocity).max() == pytest.approx((many / LIMITS.velocity).max(), rel=1e-12)
        assert (few / acceleration).max() == pytest.approx((many / LIMITS.acceleration).max(), rel=1e-12)


def test_an_end_out_of_reach_is_refused_after_all_that_came_before_it() -> None:
    """In the middle of stops that are planned many at a time, with moves behind it."""
    points = scribble(20, 1)
    points[12] = (900.0, 0.0, 150.0)
    exact = PathModeChange(PathMode.EXACT_STOP, None, None, at(1))
    planner = Planner(ARM, CONFIG, start_deg())
    pieces: list[Piece] = []
    with pytest.raises(UnreachableError) as caught:
        for piece in planner.plan([exact, *lines(points, 6000.0, 0)]):
            pieces.append(piece)
    assert caught.value.source == at(12)
    assert caught.value.amount is not None and caught.value.amount > 400.0
    assert [piece.source.line for piece in pieces] == list(range(11))
    assert not list(planner.come_to_rest())
    assert ARM.fk(planner.q_deg).xyz_mm == pytest.approx(points[11], abs=1e-6)


def test_an_end_out_of_range_is_refused_where_the_joints_are_asked_for() -> None:
    planner = Planner(ARM, CONFIG, start_deg())
    moves = [mode(0.1), *lines([(220.0, 0.0, 150.0)], 6000.0, 5), JointMove(0, 10.0, True, at(6))]
    with pytest.raises(JointLimitError) as caught:
        list(planner.plan(moves))
    assert caught.value.source == at(5)


def test_an_error_in_reading_comes_after_the_pieces_before_it() -> None:
    def moves():  # type: ignore[no-untyped-def]
        yield PathModeChange(PathMode.EXACT_PATH, None, None, at(1))
        yield from lines(scribble(5, 2), 6000.0, 2)
        raise RuntimeError("no more to read")

    pieces: list[Piece] = []
    with pytest.raises(RuntimeError, match="no more"):
        for piece in Planner(ARM, CONFIG, start_deg()).plan(moves()):
            pieces.append(piece)
    assert [piece.source.line for piece in pieces] == [2, 3, 4, 5]


def test_straight_elements_know_it_however_they_are_made() -> None:
    (element,) = elements_of(scribble(1, 3))
    other = Element(Space.TASK, element.length, element.coefficients, element.source)
    assert element.is_straight and other.is_straight
    assert not replace(other, is_blend=True).is_straight
    part, same = element.trimmed(0.01, 0.04), other.trimmed(0.01, 0.04)
    np.testing.assert_allclose(part.coefficients, same.coefficients, atol=1e-15)

"""Elements, corners, splines, orientations, joint derivatives, the look-ahead window."""

from __future__ import annotations

from math import cos, pi, radians, sin, tan

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import ArcMove, Feed, LinearMove, Move, PathMode, RapidMove, SplineMove
from rm501_host.planner import Plan, Planner
from rm501_host.planner.corners import Corner, CornerMaker
from rm501_host.planner.elements import Element, Space, arc, line
from rm501_host.planner.jointspace import joint_derivatives, tool_derivatives
from rm501_host.planner.limits import Limits
from rm501_host.planner.path import PathBuilder
from rm501_host.planner.rounding import round_curves
from rm501_host.planner.run_back import reversed_element
from rm501_host.planner.splines import SplineCurve
from tests.host.planner.programs import at, lines, mode, target
from tests.support.plan_checker import judge_samples, path_deviation_mm, programmed_points

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
MAKER = CornerMaker(ARM, Limits.from_config(CONFIG))
FEED = Feed(6000.0)


def straight(start: tuple[float, float, float], end: tuple[float, float, float]) -> Element:
    a, b = np.array((*start, 0.0, 0.0)), np.array((*end, 3.0, -4.0))
    return line(Space.TASK, a, b, float(np.linalg.norm(b[:3] - a[:3])), at(1))


def round_arc(centre: tuple[float, float], radius: float, first_deg: float, turn_deg: float) -> Element:
    def point(angle_deg: float) -> np.ndarray:
        angle = radians(angle_deg)
        return np.array((centre[0] + radius * cos(angle), centre[1] + radius * sin(angle), 100.0, 0.0, 0.0))

    middle = np.array((*centre, 100.0))
    return arc(point(first_deg), point(first_deg + turn_deg), middle, np.array((0, 0, 1.0)), radians(turn_deg), at(1))


def check_corner(first: Element, second: Element, tolerance_mm: float, corner: Corner | None = None) -> None:
    corner = corner or MAKER.between(first, 0.0, second, PathMode.BLEND, tolerance_mm)
    assert corner is not None
    (blend,) = corner.elements
    assert 0.0 < corner.before <= 0.5 * first.length + 1e-9
    assert 0.0 < corner.after <= 0.5 * second.length + 1e-9
    for element, s, other, t in (
        (first, first.length - corner.before, blend, 0.0),
        (second, corner.after, blend, blend.length),
    ):
        value, slope = element.at(s)
        joined, joined_slope = other.at(t)
        np.testing.assert_allclose(joined, value, atol=1e-7)
        np.testing.assert_allclose(joined_slope, slope, atol=1e-6)
    places = blend.evaluate(np.linspace(0.0, blend.length, 4001))[0][:, :3]
    at_corner = first.at(first.length)[0][:3]
    distance = np.linalg.norm(places - at_corner, axis=1).min()
    # the nearest of samples is a little farther than the nearest of all
    spacing = blend.length / 4000
    assert np.sqrt(max(0.0, distance**2 - spacing**2)) <= tolerance_mm + 1e-9
    before = first.evaluate(np.linspace(0, first.length, 4000))[0][:, :3]
    after = second.evaluate(np.linspace(0, second.length, 4000))[0][:, :3]
    assert path_deviation_mm(places, np.concatenate((before, after))) <= tolerance_mm + 1e-4
    # as large as it may be: the tolerance or half of a neighbour is used up
    used = max(distance / tolerance_mm, 2 * corner.before / first.length, 2 * corner.after / second.length)
    assert used > 0.9


@pytest.mark.parametrize("tolerance_mm", [0.01, 0.5, 4.0])
@pytest.mark.parametrize("turn_deg", [3.0, 30.0, 90.0, -60.0])
def test_line_to_line(tolerance_mm: float, turn_deg: float) -> None:
    turn = radians(turn_deg)
    corner = (300.0, 0.0, 200.0)
    first = straight((300.0, -40.0, 200.0), corner)
    second = straight(corner, (300.0 - 30 * sin(turn), 30 * cos(turn), 200.0))
    second = Element(Space.TASK, second.length, second.coefficients + _offset(first, second), second.source)
    check_corner(first, second, tolerance_mm)


def _offset(first: Element, second: Element) -> np.ndarray:
    shift = np.zeros((4, 5))
    shift[0] = first.at(first.length)[0] - second.coefficients[0]
    return shift


def test_a_right_angle_of_5_mm_passes_the_corner_at_2_0711_mm() -> None:
    corner = MAKER.between(
        straight((300, -40, 200), (300, 0, 200)),
        0.0,
        line(Space.TASK, np.array((300, 0, 200, 3, -4.0)), np.array((340, 0, 200, 3, -4.0)), 40.0, at(1)),
        PathMode.BLEND,
        5.0 * tan(pi / 8),
    )
    assert corner is not None
    assert corner.before == pytest.approx(5.0, rel=1e-9)
    assert corner.elements[0].omega == pytest.approx(1 / 5.0, rel=1e-9)


@pytest.mark.parametrize("tolerance_mm", [0.05, 1.0])
@pytest.mark.parametrize("turn_deg", [70.0, -70.0])
def test_line_to_arc_convex_and_concave(tolerance_mm: float, turn_deg: float) -> None:
    second = round_arc((320.0, 0.0), 40.0, 90.0, turn_deg)
    corner = second.at(0.0)[0][:3]
    first = line(
        Space.TASK,
        np.array((corner[0] + 3.0, corner[1] + 30.0, corner[2], 0.0, 0.0)),
        np.array((*corner, 0.0, 0.0)),
        float(np.hypot(3.0, 30.0)),
        at(1),
    )
    check_corner(first, second, tolerance_mm)


@pytest.mark.parametrize(
    ("turn_deg", "next_deg", "next_turn_deg"),
    [(60.0, 210.0, 60.0), (60.0, 30.0, -60.0), (-60.0, 270.0, 60.0), (-60.0, 90.0, -60.0)],
)
def test_arc_to_arc(turn_deg: float, next_deg: float, next_turn_deg: float) -> None:
    """Convex and concave, turning by 50 deg at the corner."""
    first = round_arc((315.0, 0.0), 40.0, 100.0, turn_deg)
    corner = first.at(first.length)[0][:3]
    angle = radians(next_deg)
    centre = (corner[0] - 25.0 * cos(angle), corner[1] - 25.0 * sin(angle))
    second = round_arc(centre, 25.0, next_deg, next_turn_deg)
    found = round_curves(first, second, 0.4, 3.1)
    assert found is not None
    check_corner(first, second, 0.4, Corner(found[0], found[1], (found[2],)))


def test_a_reversal_stops() -> None:
    first = straight((300, -40, 200), (300, 0, 200))
    back = line(Space.TASK, first.at(first.length)[0], first.at(0.0)[0], first.length, at(2))
    assert MAKER.between(first, 0.0, back, PathMode.BLEND, 1.0) is None


def test_reversed_elements_are_the_same_places_backwards() -> None:
    spiral = arc(
        np.array((320.0, 0, 200, 0, 0)), np.array((300.0, 25, 215, 9, -9)), np.array((300.0, 0, 200)),
        np.array((0, 0, 1.0)), pi / 2, at(1),
    )  # fmt: skip
    s = np.linspace(0, spiral.length, 50)
    values, slopes, bends = spiral.evaluate(s)
    back = reversed_element(spiral).evaluate(spiral.length - s)
    np.testing.assert_allclose(back[0], values, atol=1e-9)
    np.testing.assert_allclose(back[1], -slopes, atol=1e-9)
    np.testing.assert_allclose(back[2], bends, atol=1e-9)


@pytest.mark.parametrize("tool", [(0.0, (0.0, 0.0)), (30.0, (12.0, -7.0))])
def test_joint_derivatives_are_the_differences_of_the_inverse(tool: tuple[float, tuple[float, float]]) -> None:
    arm = ARM.with_tool(*tool)
    element = arc(
        np.array((300.0, 20, 220, 30, 10)), np.array((260.0, 90, 250, 50, -20)), np.array((250.0, 20, 220)),
        np.array((0, 0, 1.0)), 1.2, at(1),
    )  # fmt: skip
    s = np.linspace(1.0, element.length - 1.0, 40)
    values, y1, y2 = element.evaluate(s)

    def joints(shift: float) -> np.ndarray:
        y = element.evaluate(s + shift)[0]
        q, ok = arm.ik_batch(y[:, :3], y[:, 3], y[:, 4])
        assert ok.shape == (len(q),)
        assert np.isfinite(q).all()
        return q

    h = 0.02
    q1, q2 = joint_derivatives(arm, joints(0.0), y1, y2, values[:, :3])
    np.testing.assert_allclose(q1, (joints(h) - joints(-h)) / (2 * h), atol=2e-7)
    np.testing.assert_allclose(q2, (joints(h) - 2 * joints(0.0) + joints(-h)) / h**2, atol=2e-7)
    p1, p2 = tool_derivatives(arm, joints(0.0), q1, q2)
    np.testing.assert_allclose(p1, y1[:, :3], atol=1e-9)
    np.testing.assert_allclose(p2, y2[:, :3], atol=1e-9)


def test_a_spline_runs_by_its_arc_length() -> None:
    points = np.array(((0, 0, 0), (10, 30, 5), (40, -10, 0), (60, 20, -5), (80, 0, 0)), dtype=float)
    weights = (1.0, 2.0, 0.5, 1.5, 1.0)
    curve = SplineCurve(points, weights, (0, 0, 0, 0, 1.5, 2, 2, 2, 2), 3, (10.0, 20.0))
    s = np.linspace(0.0, curve.length_mm, 20_001)
    values, slopes, _ = curve.evaluate(s)
    np.testing.assert_allclose(np.linalg.norm(slopes[:, :3], axis=1), 1.0, atol=1e-12)
    chords = np.linalg.norm(np.diff(values[:, :3], axis=0), axis=1)
    assert chords.sum() == pytest.approx(curve.length_mm, rel=1e-7)
    np.testing.assert_allclose(values[[0, -1], :3], points[[0, -1]], atol=1e-9)


def test_a_quarter_circle_as_a_spline_moves_as_the_arc() -> None:
    """Rational quadratic: weights 1, cos 45, 1 make an exact circle."""
    start = ARM.ik((300.0, 0.0, 200.0), 0.0, 0.0).best
    assert start is not None
    radius = 30.0
    points = ((300.0, 0.0, 200.0), (300.0, radius, 200.0), (300.0 - radius, radius, 200.0))
    spline = SplineMove(
        target(300 - radius, radius, 200), points, (1.0, cos(pi / 4), 1.0), (0, 0, 0, 1, 1, 1), 2, FEED, at(1)
    )
    round_move = ArcMove(target(300 - radius, radius, 200), (300.0 - radius, 0.0, 200.0), (0, 0, 1), 90.0, FEED, at(1))
    one = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan([spline])).sample()
    two = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan([round_move])).sample()
    assert one.t_s[-1] == pytest.approx(two.t_s[-1], rel=3e-3)
    assert path_deviation_mm(one.tcp_mm, two.tcp_mm) < 2e-3


def test_the_thesis_orientation_keeps_its_yaw_while_the_waist_turns() -> None:
    config = load_config("configs/thesis.toml")
    arm = Arm.from_config(config)

    def goal(x: float, y: float, z: float) -> tuple[float, ...]:
        return (x, y, z, 0.0, 0.0, 0.0)

    moves: list[Move] = [
        RapidMove(goal(210, 0, -150), at(1)),  # type: ignore[arg-type]  # six numbers
        mode(None),
        ArcMove(goal(0, 210, -150), (0, 0, -150), (0, 0, 1), 90.0, FEED, at(2)),  # type: ignore[arg-type]
        LinearMove(goal(-80, 260, -120), FEED, at(3)),  # type: ignore[arg-type]
    ]
    samples = Plan(arm, config, Planner(arm, config, arm.home_deg).plan(moves)).sample()
    cartesian = samples.line >= 2
    rpy = np.array([arm.program_from_joints(q)[3:] for q in samples.q_deg[cartesian][::20]])
    assert np.abs(rpy).max() < 1e-6
    assert judge_samples(config, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6


@pytest.mark.parametrize("size_mm", [10.0, 0.2])
def test_an_oriented_spline_has_the_derivatives_of_its_values_up_to_its_ends(size_mm: float) -> None:
    """It has nothing beyond its ends to take differences from; a kink there once asked for impossible accelerations."""
    config = load_config("configs/thesis.toml")
    arm = Arm.from_config(config)
    start = arm.joints_from_program((313, 0, 10, 0, 0, 0)).best
    assert start is not None
    builder = PathBuilder(arm, np.array(start.q_deg), linear_rapids=False)
    d = size_mm
    points = ((313.0, 0.0, 10.0), (313.0, 0.5 * d, 10.0), (313 - 0.5 * d, d, 10.0), (313 - d, d, 10.0))
    move = SplineMove((313 - d, d, 10, 0, 0, 5), points, (1.0,) * 4, (0.0,) * 4 + (1.0,) * 4, 3, FEED, at(2))
    element = builder.spline(move)
    assert element is not None
    s = np.linspace(0.0, element.length, 2001)
    values, slopes, bends = element.evaluate(s)
    inside = slice(10, -10)
    np.testing.assert_allclose(slopes[inside, 4], np.gradient(values[:, 4], s)[inside], atol=2e-5)
    # the ends belong to the same smooth function as what is next to them
    for rates, tolerance in ((slopes[:, 4], 1e-3), (bends[:, 4], 2e-3)):
        steps = np.abs(np.diff(rates))
        assert steps.max() < tolerance
    samples = Plan(arm, config, Planner(arm, config, start.q_deg).plan([move])).sample()
    assert judge_samples(config, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6


def test_the_window_does_not_slow_a_long_path_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """Streamed in small chunks or planned at once: the same law."""
    import rm501_host.planner.planner as planner_module

    angle = np.linspace(0.0, 6.0, 900)
    points = [(300 + 25 * cos(a), 25 * sin(a), 200 + 3 * a) for a in angle]
    start = ARM.ik(points[0], 0.0, 0.0).best
    assert start is not None
    moves = [mode(0.3), *lines(points[1:], 12000.0)]

    def planned(chunk: int) -> Plan:
        monkeypatch.setattr(planner_module, "CHUNK_ELEMENTS", chunk)
        return Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan(moves))

    whole, streamed = planned(100_000), planned(16)
    assert len(whole.pieces) == 1
    assert len(streamed.pieces) > 10
    assert streamed.motion_s <= whole.motion_s * 1.0005
    samples = streamed.sample()
    assert judge_samples(CONFIG, samples.t_s, samples.q_deg).worst <= 1.0 + 1e-6
    path = programmed_points(np.array(points[0]), moves)
    assert path_deviation_mm(samples.tcp_mm, path) <= 0.3

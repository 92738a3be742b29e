"""Canonical calls to moves: units, offsets, rotation, planes, turns, splines, and what is not motion."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_host import moves as mv
from rm501_host.gcode import GcodeUnsupportedError, ResolveOptions, Settings, interpret, resolve
from rm501_host.gcode.canon import Signal


def _moves(text: str, options: ResolveOptions | None = None, settings: Settings | None = None) -> list[object]:
    return list(resolve(interpret(text, settings), options))


def _targets(text: str) -> list[tuple[float, ...]]:
    motions = (mv.RapidMove, mv.LinearMove, mv.ArcMove, mv.SplineMove, mv.ProbeMove)
    return [move.target for move in _moves(text) if isinstance(move, motions)]


def _arcs(text: str) -> list[mv.ArcMove]:
    return [move for move in _moves(text) if isinstance(move, mv.ArcMove)]


def test_inches_become_millimetres_and_angles_do_not() -> None:
    assert _targets("G20 G0 X1 Y2 Z3 A4 B5 C6\nM2") == [pytest.approx((25.4, 50.8, 76.2, 4, 5, 6))]


def test_feeds() -> None:
    text = "G20 F10\nG1 X1\nG1 A90\nG93 G1 X2 F3\nG94 G21 F100\nG1 X0\nM2"
    feeds = [move.feed for move in _moves(text) if isinstance(move, mv.LinearMove)]
    assert feeds == [
        mv.Feed(254.0),
        mv.Feed(10.0),  # degrees know no inch
        mv.Feed(3.0, mv.FeedMode.INVERSE_TIME),
        mv.Feed(100.0),
    ]


def test_work_offset_rotation_and_g92_together() -> None:
    """Against the composition written out by hand: Rot(30) (p + g92) + g5x."""
    text = "G21\nG10 L2 P2 X10 Y5 Z1 A2 R30\nG55\nG52 X3 Y-4 A1\nG0 X7 Y8 Z9 A10\nM2"
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    px, py = 7 + 3, 8 - 4
    expected = (c * px - s * py + 10, s * px + c * py + 5, 9 + 1, 10 + 1 + 2, 0, 0)
    assert _targets(text)[-1] == pytest.approx(expected)


def test_g53_is_the_program_frame_itself() -> None:
    text = "G21 G10 L2 P1 X10 Y20 R45\nG92 X1\nG53 G0 X100 Y50 Z5\nM2"
    assert _targets(text)[-1] == pytest.approx((100, 50, 5, 0, 0, 0))


_LENGTH = st.floats(-50, 50).map(lambda v: round(v, 3))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.builds(lambda n, x, y, r: f"G10 L2 P{n} X{x} Y{y} R{r}", st.integers(1, 3), _LENGTH, _LENGTH, _LENGTH),
            st.sampled_from(["G54", "G55", "G56", "G20", "G21", "G92.1", "G92.2", "G92.3"]),
            st.builds(lambda x, y: f"G92 X{x} Y{y}", _LENGTH, _LENGTH),
            st.builds(lambda x: f"G52 X{x} Z1", _LENGTH),
        ),
        max_size=8,
    )
)
def test_changing_offsets_never_moves_the_tool(changes: list[str]) -> None:
    """A move by nothing after any change of numbers goes to where the tool already is."""
    text = "\n".join(["G21 G0 X11 Y-7 Z3 B4", *changes, "G91 G0 X0 Y0 Z0 A0 B0", "M2"])
    assert _targets(text)[-1] == pytest.approx((11, -7, 3, 0, 4, 0), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "centre", "axis", "angle"),
    [
        ("G17 G3 X0 Y10 I-10 J0", (0, 0, 0), (0, 0, 1), 90),
        ("G17 G2 X0 Y10 I-10 J0", (0, 0, 0), (0, 0, 1), -270),
        ("G17 G2 X10 Y0 I-10 J0", (0, 0, 0), (0, 0, 1), -360),
        ("G17 G3 X10 Y0 I-10 J0 P3", (0, 0, 0), (0, 0, 1), 1080),
        ("G17 G3 X0 Y10 I-10 J0 P2", (0, 0, 0), (0, 0, 1), 450),
        ("G18 G3 X0 Z-10 I-10 K0", (0, 0, 0), (0, 1, 0), 90),
        ("G18 G2 X0 Z10 I-10 K0", (0, 0, 0), (0, 1, 0), -90),
        ("G19 G3 Y-5 Z5 J-5 K0", (10, -5, 0), (1, 0, 0), 90),
    ],
)
def test_arcs(text: str, centre: tuple[float, ...], axis: tuple[float, ...], angle: float) -> None:
    arc = _arcs(f"G21 F100\nG0 X10 Y0 Z0\n{text}\nM2")[0]
    assert arc.centre_mm == pytest.approx(centre, abs=1e-12)
    assert arc.axis == pytest.approx(axis)
    assert arc.angle_deg == pytest.approx(angle)


def _rotate_about(point: list[float], centre: mv.Vector, axis: mv.Vector, angle_deg: float) -> list[float]:
    """Rodrigues' rotation, independent of the code under test."""
    a = math.radians(angle_deg)
    v = [p - q for p, q in zip(point, centre, strict=True)]
    cross = [
        axis[1] * v[2] - axis[2] * v[1],
        axis[2] * v[0] - axis[0] * v[2],
        axis[0] * v[1] - axis[1] * v[0],
    ]
    dot = sum(p * q for p, q in zip(axis, v, strict=True))
    return [
        c + v[i] * math.cos(a) + cross[i] * math.sin(a) + axis[i] * dot * (1 - math.cos(a))
        for i, c in enumerate(centre)
    ]


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(["G17", "G18", "G19"]),
    st.sampled_from(["G2", "G3"]),
    st.floats(0, 359),
    st.floats(1, 359),
    st.floats(1, 40),
    st.floats(-180, 180),
    st.integers(1, 3),
    st.floats(-9, 9),
)
def test_turning_the_start_about_the_axis_gives_the_end(
    plane: str, code: str, a0: float, sweep: float, r: float, rotation: float, turns: int, rise: float
) -> None:
    first, second, i, j, normal = {"G17": "XYIJZ", "G18": "ZXKIY", "G19": "YZJKX"}[plane]
    t0, t1 = math.radians(a0), math.radians(a0 + sweep)
    start = (r * math.cos(t0), r * math.sin(t0))
    end = (r * math.cos(t1), r * math.sin(t1))
    text = (
        f"G21 F100 {plane}\nG10 L2 P1 X5 Y-3 Z2 R{rotation:.6f}\n"
        f"G0 {first}{start[0]:.9f} {second}{start[1]:.9f} {normal}0\n"
        f"{code} {first}{end[0]:.9f} {second}{end[1]:.9f} {normal}{rise:.6f} "
        f"{i}{-start[0]:.9f} {j}{-start[1]:.9f} P{turns}\nM2"
    )
    begun = list(_targets(text)[0][:3])
    arc = _arcs(text)[0]
    turned = _rotate_about(begun, arc.centre_mm, arc.axis, arc.angle_deg)
    risen = [p + rise * q for p, q in zip(turned, arc.axis, strict=True)]
    assert risen == pytest.approx(arc.target[:3], abs=1e-4)
    expected = sweep if code == "G3" else sweep - 360.0
    assert arc.angle_deg == pytest.approx(expected + (1 if code == "G3" else -1) * 360.0 * (turns - 1), abs=1e-4)


def test_splines_carry_all_their_control_data() -> None:
    text = (
        "G21 F100\nG10 L2 P1 X100 Z5 R90\nG0 X0 Y0 Z1\nG5 I0 J3 P0 Q-3 X1 Y1\nG5.1 X2 I2 J-8\n"
        "G5.2 P1 L3\nX0 Y1 P1\nX2 Y2 P2\nG5.3\nM2"
    )
    cubic, quadratic, nurbs = (m for m in _moves(text) if isinstance(m, mv.SplineMove))
    assert cubic.control_points_mm == (
        pytest.approx((100, 0, 6)),
        pytest.approx((97, 0, 6)),
        pytest.approx((102, 1, 6)),
        pytest.approx((99, 1, 6)),
    )
    assert (cubic.degree, cubic.knots, cubic.weights) == (3, (0.0,) * 4 + (1.0,) * 4, (1.0,) * 4)
    assert (quadratic.degree, len(quadratic.knots)) == (2, 6)
    assert quadratic.control_points_mm[0] == pytest.approx(cubic.target[:3])
    assert nurbs.weights == (1.0, 1.0, 2.0)
    assert len(nurbs.knots) == len(nurbs.control_points_mm) + nurbs.degree + 1


def test_the_rest() -> None:
    text = (
        "G21 G61\nG61.1\nG64 P0.5 Q0.1\nG64\nG4 P2\nM101\nM102\nM62 P1\nM65 P2\nM0\nM1\nM60\n(MSG,hello)\n"
        "M66 P3 L3 Q5\nM110 P2 Q30\nM111 P5 Q-10\nG43.1 Z50 X1 Y2\nM2"
    )
    moves = _moves(text)
    kinds = [type(m).__name__ for m in moves]
    assert kinds == (
        ["PathModeChange"] * 4 + ["Dwell", "HandMove", "HandMove", "OutputChange", "OutputChange"] + ["Pause"] * 3
        + ["Message", "InputWait", "JointMove", "JointMove", "ToolChange", "ProgramEnd"]
    )  # fmt: skip
    assert [(m.mode, m.tolerance_mm) for m in moves if isinstance(m, mv.PathModeChange)] == [
        (mv.PathMode.EXACT_PATH, None),
        (mv.PathMode.EXACT_STOP, None),
        (mv.PathMode.BLEND, 0.5),
        (mv.PathMode.BLEND, None),
    ]
    assert [m.open for m in moves if isinstance(m, mv.HandMove)] == [True, False]
    assert [m.kind for m in moves if isinstance(m, mv.Pause)] == [
        mv.PauseKind.PROGRAM,
        mv.PauseKind.OPTIONAL,
        mv.PauseKind.EXCHANGE,
    ]
    joints = [m for m in moves if isinstance(m, mv.JointMove)]
    assert [(m.joint, m.angle_deg, m.relative) for m in joints] == [(1, 30.0, False), (4, -10.0, True)]
    assert next((m.length_mm, m.offset_mm) for m in moves if isinstance(m, mv.ToolChange)) == (50.0, (1.0, 2.0))
    assert all(m.source.line > 0 and m.source.block for m in moves)


def test_tool_length_is_not_added_to_the_target() -> None:
    text = "G21\nG43.1 Z50\nG0 X1 Y2 Z3\nM2"
    assert _targets(text) == [pytest.approx((1, 2, 3, 0, 0, 0))]


def test_spindle_and_coolant_need_an_output() -> None:
    with pytest.raises(GcodeUnsupportedError, match="M3 has no output") as caught:
        _moves("G0 X1\nM3 S100\nM2")
    assert caught.value.line == 2
    options = ResolveOptions(
        outputs={Signal.START_SPINDLE_CLOCKWISE: (3, True), Signal.STOP_SPINDLE_TURNING: (3, False)}
    )
    changes = [m for m in _moves("M3 S100\nM5\nM2", options) if isinstance(m, mv.OutputChange)]
    assert [(m.output, m.on) for m in changes] == [(3, True), (3, False), (3, False)]


@pytest.mark.parametrize("text", ["M68 E1 Q2\nM2", "G43.1 A5\nM2", "M64 P-1\nM2"])
def test_what_the_arm_cannot_do_is_refused_with_its_line(text: str) -> None:
    with pytest.raises(GcodeUnsupportedError) as caught:
        _moves(text)
    assert caught.value.line == 1


def test_moves_come_one_by_one() -> None:
    moves = resolve(interpret("G0 X1\nG0 X2\nG0 X[1/0]\nM2"))
    assert isinstance(next(moves), mv.RapidMove)
    assert isinstance(next(moves), mv.RapidMove)

"""Plain blocks have a fast path; a leading slash sends the same block the long way. Both must agree."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_host.gcode import GcodeError, Interpreter, Settings, TextLines, to_json

_number = st.one_of(
    st.integers(-30, 30).map(str),
    st.floats(-30, 30).map(lambda v: f"{v:.3f}"),
    st.sampled_from([".5", "-.25", "+1.", "0", "-0", "007", "1.0000000001"]),
)
_space = st.sampled_from(["", " ", "  ", "\t"])
_letter = st.sampled_from("XYZABCIJRFxyzabcijrfNPK")


@st.composite
def _block(draw: st.DrawFn) -> str:
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.sampled_from(["G90", "G91", "G18", "G17", "G90.1", "G91.1", "G20", "G21", "G93", "G94", "G80"]))
    if kind == 1:
        r = draw(st.integers(1, 9))
        sign = draw(st.sampled_from([1, -1]))
        across = draw(
            st.sampled_from([f"X{2 * r} Y0 I{sign * r} J0", f"X0 Y{2 * r} I0 J{sign * r}", f"Y{r} J{sign * r}"])
        )
        return f"G{draw(st.sampled_from('23'))} {across} F{draw(_number)}"
    words = []
    if draw(st.booleans()):
        words.append(draw(st.sampled_from(["G0", "G1", "G01", "g1", "G2", "G3", "G00"])))
    letters = draw(st.lists(_letter, min_size=1, max_size=5))
    if draw(st.booleans()):
        letters = sorted(set(letters), key="XYZABCIJRFxyzabcijrfNPK".index)
    words += [f"{letter}{draw(_space)}{draw(_number)}" for letter in letters]
    return draw(_space).join(words)


def _outcome(lines: list[str]) -> tuple[list[dict[str, object]], str | None]:
    out: list[dict[str, object]] = []
    try:
        for call in Interpreter(TextLines("\n".join(lines)), Settings()).calls():
            out.append(to_json(call))
    except GcodeError as error:
        return out, f"{type(error).__name__} {error.line} {error.message}"
    return out, None


@settings(max_examples=300, deadline=None)
@given(st.lists(_block(), min_size=1, max_size=12))
def test_both_ways_give_the_same_calls_and_errors(blocks: list[str]) -> None:
    lines = ["G21 F100", *blocks, "M2"]
    slow = [line if line == "M2" else f"/{line}" for line in lines]
    assert _outcome(lines) == _outcome(slow)


def test_plain_arcs_in_every_direction() -> None:
    """Full and part circles about centres all round, absolute: the fast path's centre must be the long way's."""
    blocks = ["G0 X0 Y0"]
    for i, j in [(3, 0), (0, 4), (-5, 0), (0, -6), (3, 4), (-4, 3), (1.5, -2)]:
        for code in "G2", "G3":
            blocks += [f"{code} X{2 * i} Y{2 * j} I{i} J{j} Z1", "G0 X0 Y0", f"{code} X0 Y0 I{i} J{j}"]
    lines = ["G21 F100", *blocks, "M2"]
    calls, error = _outcome(lines)
    assert error is None
    assert sum(call["op"] == "ArcFeed" for call in calls) == 28
    assert (calls, error) == _outcome([line if line == "M2" else f"/{line}" for line in lines])

"""Segment arithmetic: closed form against stepping, an oracle of fractions, extremes against brute force."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_protocol.messages import MotorTerm, Segment
from rm501_protocol.segment import (
    MAX_LENGTH_CUBIC_FRAMES,
    MAX_LENGTH_FRAMES,
    ONE_STEP,
    POSITION_MAX_STEPS,
    POSITION_MIN_STEPS,
    end_positions_q48,
    motor_end,
    motor_extremes,
    motor_state_at,
    motor_states,
    position_q48,
    steps_of,
    velocity_q48,
)

s32 = st.integers(-(1 << 31), (1 << 31) - 1)
terms = st.builds(MotorTerm, st.just(0), s32, s32, st.one_of(st.just(0), s32))
positions = st.integers(POSITION_MIN_STEPS * ONE_STEP, POSITION_MAX_STEPS * ONE_STEP)


@given(positions, terms, st.integers(0, 400))
def test_closed_form_and_stepping_are_identical_at_every_frame(start: int, term: MotorTerm, frames: int) -> None:
    for frame, state in enumerate(motor_states(start, term, frames)):
        assert state == motor_state_at(start, term, frame)
    assert state == motor_end(start, term, frames)


@settings(max_examples=5)
@given(positions, terms)
def test_and_at_the_end_of_the_longest_segments(start: int, term: MotorTerm) -> None:
    length = MAX_LENGTH_CUBIC_FRAMES if term.j else MAX_LENGTH_FRAMES
    *_, last = motor_states(start, term, length)
    assert last == motor_state_at(start, term, length)


@given(positions, terms, st.integers(0, MAX_LENGTH_FRAMES))
def test_the_units_are_those_of_the_wire(start: int, term: MotorTerm, n: int) -> None:
    """p(n) = p + n v + C(n,2) a + C(n,3) j in steps, as exact fractions."""
    v, a, j = Fraction(term.v, 2**32), Fraction(term.a, 2**40), Fraction(term.j, 2**48)
    steps = Fraction(start, ONE_STEP) + n * v + Fraction(n * (n - 1), 2) * a + Fraction(n * (n - 1) * (n - 2), 6) * j
    assert Fraction(position_q48(start, term, n), ONE_STEP) == steps
    assert Fraction(velocity_q48(term, n), ONE_STEP) == v + n * a + Fraction(n * (n - 1), 2) * j


@given(terms, st.integers(1, 300))
def test_extremes_are_those_that_stepping_meets(term: MotorTerm, length: int) -> None:
    states = list(motor_states(0, term, length))
    speeds = [state.v_q48 for state in states]
    accelerations = [state.a_q48 for state in states[:-1]]
    assert motor_extremes(term, length) == (min(speeds), max(speeds), min(accelerations), max(accelerations))


@given(st.integers(1, 1 << 31), st.integers(1, (1 << 31) - 1), st.integers(2, MAX_LENGTH_CUBIC_FRAMES), st.booleans())
def test_the_vertex_of_a_long_cubic_is_not_missed(a: int, j: int, length: int, mirrored: bool) -> None:
    sign = -1 if mirrored else 1
    low, high, *_ = motor_extremes(MotorTerm(0, 0, -sign * a, sign * j), length)
    around = min(length, max(0, (a << 8) // j))
    for n in range(max(0, around - 3), min(length, around + 4) + 1):
        assert low <= velocity_q48(MotorTerm(0, 0, -sign * a, sign * j), n) <= high


def test_a_chain_of_segments_returns_to_its_start_without_drift() -> None:
    there, back = MotorTerm(1, 12345, -678, 9), MotorTerm(1, -12345, 678, -9)
    where = (0, 7, 0)
    for number in range(2000):
        where = end_positions_q48(where, Segment(number, 777, (there,)))
        where = end_positions_q48(where, Segment(number, 777, (back,)))
    assert where == (0, 7, 0)
    with pytest.raises(IndexError):
        end_positions_q48(where, Segment(0, 1, (MotorTerm(5, 1),)))


@pytest.mark.parametrize(
    ("position", "steps"),
    [
        (0, 0),
        (ONE_STEP // 2, 1),
        (ONE_STEP // 2 - 1, 0),
        (-ONE_STEP // 2, 0),
        (-ONE_STEP // 2 - 1, -1),
        (-ONE_STEP, -1),
    ],
)
def test_a_count_is_the_floor_of_position_plus_a_half(position: int, steps: int) -> None:
    assert steps_of(position) == steps

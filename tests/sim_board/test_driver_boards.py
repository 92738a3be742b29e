"""Boards 724, 732 and 727 from the pins alone, against an independent decoder and against broken cables."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_sim_board.bench import standard_wiring
from rm501_sim_board.driver_boards import DriverBoards
from rm501_sim_board.wiring import Terminal
from tests.support.pin_decoder import MOTORS, decode
from tests.support.port_words import IDLE_WORD, run_words, step_words

NAMES = (*MOTORS, "hand")
levels = st.dictionaries(st.sampled_from(NAMES), st.booleans())


def _decoded(boards: DriverBoards, words: np.ndarray, first: int = 0) -> list[list[tuple[int, int]]]:
    activity = boards.decode(words, first)
    return [list(zip(s.periods.tolist(), s.signs.tolist(), strict=True)) for s in activity.steps]


@given(st.lists(st.tuples(levels, levels), min_size=1, max_size=40), st.lists(st.integers(0, 320), max_size=4))
@settings(max_examples=150, deadline=None)
def test_block_decoding_equals_the_independent_decoder_wherever_it_is_cut(frames, cuts) -> None:
    words = run_words(frames)
    judge = decode(words)
    boards = DriverBoards(standard_wiring())
    edges = sorted({0, len(words), *(c for c in cuts if c < len(words))})
    found: list[list[tuple[int, int]]] = [[] for _ in NAMES]
    for low, high in itertools.pairwise(edges):
        for kept, new in zip(found, _decoded(boards, words[low:high], low), strict=True):
            kept += new
    assert found[:5] == [judge.steps[m] for m in MOTORS]
    assert found[5] == judge.hand_pulses


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=200))
@settings(max_examples=150, deadline=None)
def test_arbitrary_words_are_read_as_the_independent_decoder_reads_them(words) -> None:
    judge = decode(words)
    found = _decoded(DriverBoards(standard_wiring()), np.array(words, dtype=np.uint32))
    assert found[:5] == [judge.steps[m] for m in MOTORS]
    assert found[5] == judge.hand_pulses


def test_plain_lines_report_their_changes() -> None:
    words = np.concatenate(
        [
            run_words([({}, {})] * 2),
            run_words([({}, {})] * 3, {"MOTOR_POWER": True, "MASTER RESET": True}),
            run_words([({}, {})], {"HEARTBEAT": True}),
        ]
    )
    activity = DriverBoards(standard_wiring()).decode(words, 0)
    assert activity.motor_power.periods.tolist() == [16, 40]
    assert activity.motor_power.levels.tolist() == [True, False]
    assert activity.master_reset.periods.tolist() == [16, 40]
    assert activity.heartbeat_edges == 1


@pytest.mark.parametrize("motor", MOTORS)
def test_each_motor_is_stepped_alone(motor) -> None:
    counts = [sum(s for _, s in steps) for steps in _decoded(DriverBoards(standard_wiring()), step_words(motor, -7))]
    assert counts == [-7 if name == motor else 0 for name in NAMES]


def test_swapped_selects_move_the_other_motor() -> None:
    wiring = standard_wiring().swapped(Terminal.ELBOW_SELECT, Terminal.WAIST_SELECT)
    counts = [sum(s for _, s in steps) for steps in _decoded(DriverBoards(wiring), step_words("waist", 5))]
    assert counts == [0, 0, 5, 0, 0, 0]


def test_a_stuck_strobe_moves_nothing() -> None:
    for level in (False, True):
        wiring = standard_wiring().stuck(Terminal.STROBE_724, level)
        found = _decoded(DriverBoards(wiring), np.concatenate([step_words("waist", 5), step_words("shoulder", 4)]))
        assert [sum(s for _, s in steps) for steps in found] == [0, 4, 0, 0, 0, 0]


def test_a_select_stuck_active_follows_every_motor_of_its_bus() -> None:
    wiring = standard_wiring().stuck(Terminal.ELBOW_SELECT, True)
    found = _decoded(DriverBoards(wiring), step_words("waist", 5))
    assert len(found[2]) == 5  # the elbow goes along with the waist


def test_a_missing_inverter_on_the_direction_line_reverses_both_motors_of_the_board() -> None:
    wiring = standard_wiring().without_inverter(Terminal.DIR_1)
    found = _decoded(DriverBoards(wiring), np.concatenate([step_words("waist", 3), step_words("elbow", -4)]))
    assert [sum(s for _, s in steps) for steps in found] == [-3, 0, 4, 0, 0, 0]


def test_a_missing_inverter_on_a_select_latches_in_all_the_wrong_slots() -> None:
    wiring = standard_wiring().without_inverter(Terminal.WAIST_SELECT)
    found = _decoded(DriverBoards(wiring), step_words("elbow", 6))
    assert sum(s for _, s in found[0]) == 6  # the waist hears the elbow's slot
    assert sum(s for _, s in found[2]) == 6


def test_pins_that_idle_do_nothing() -> None:
    found = _decoded(DriverBoards(standard_wiring()), np.full(4000, IDLE_WORD, dtype=np.uint32))
    assert found == [[]] * 6

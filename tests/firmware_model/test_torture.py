"""The tortures of `torture` and `holding` at a size for every day; `python -m benchmarks.stepgen` runs them in full."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from rm501_firmware_model import BoardLayout
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState, HoldCause
from rm501_protocol.segment import ONE_STEP
from tests.firmware_model.holding import MOTORS, Ideal, Player, hold_often, stall, trace, worst_acceleration
from tests.firmware_model.programs import swinging_program
from tests.firmware_model.torture import Torture, torture


def test_random_segments_legal_and_malicious() -> None:
    found = torture(3000, seed=1)
    assert not found.first_problem
    assert (found.timing_violations, found.wrong_counts, found.disagreements) == (0, 0, 0)
    assert found.worst_lag <= 0.54
    assert found.steps > 10_000 and found.refused > 300 and len(found.refused_for) >= 8


@pytest.mark.parametrize("frames", [(2, 1, 1, 1), (1, 3, 1, 1), (1, 1, 4, 1), (2, 2, 3, 5)])
def test_other_step_timings_hold_at_the_pins_too(frames: tuple[int, int, int, int]) -> None:
    length, space, setup, hold = frames
    timing = replace(
        RM501_BOARD.timing,
        step_length_frames=length,
        step_space_frames=space,
        dir_setup_frames=setup,
        dir_hold_frames=hold,
    )
    config = replace(RM501_BOARD, timing=timing)
    rate = config.max_step_rate
    motors = tuple(
        replace(limits, max_rate_steps_s=min(rate, limits.max_rate_steps_s)) for limits in config.motors.motors
    )
    hand = replace(config.hand, pulse_rate_hz=min(rate, 500))
    config = replace(config, motors=replace(config.motors, motors=motors), hand=hand)
    run = Torture(seed=sum(frames), config=config)
    run.batch(300)
    assert run.found.timing_violations == 0, run.found.first_problem
    assert run.found.wrong_counts == 0 and run.found.disagreements == 0
    assert run.found.worst_lag < 1.0  # later than with timings of one frame, yet never a step lost


@pytest.fixture(scope="module")
def program() -> tuple[list, Player]:  # type: ignore[type-arg]  # segments and the undisturbed run
    segments = swinging_program(random.Random(3), 5)
    player = Player(segments)
    player.play()
    player.settle()
    return segments, player


def test_holds_change_nothing_but_time(program: tuple[list, Player]) -> None:  # type: ignore[type-arg]
    segments, undisturbed = program
    before, held = trace(undisturbed), hold_often(segments, 40, seed=5)
    after = trace(held)
    assert len(after.motion_time) > len(before.motion_time) + 20_000
    assert np.array_equal(after.levels, before.levels)
    assert np.array_equal(after.by_motion_frame, before.by_motion_frame)
    assert not (before.by_motion_frame == -1).any()
    assert after.counts == before.counts
    assert after.hand == before.hand and len(after.hand) > 10
    assert np.abs(np.array(after.hand_starts) - np.array(before.hand_starts)).max() <= 1


def test_ramps_keep_the_acceleration_that_the_slopes_allow(program: tuple[list, Player]) -> None:  # type: ignore[type-arg]
    segments, _ = program
    held = trace(hold_often(segments, 40, seed=6))
    ideal = Ideal(segments)
    layout = BoardLayout(RM501_BOARD)
    worst = [
        worst_acceleration(ideal, held.motion_time, motor) * ONE_STEP / layout.max_acceleration[motor]
        for motor in MOTORS
    ]
    assert max(worst) <= 2.001, worst  # slopes were declared for twice the planning limit
    assert max(worst) > 1.5  # and the ramps do use it: without slopes it would be far more


@pytest.mark.parametrize(
    ("stall_s", "state", "cause"),
    [
        (0.1, BoardState.RUNNING, HoldCause.NONE),
        (0.9, BoardState.HELD, HoldCause.LOW_WATER),
        (3.0, BoardState.HELD, HoldCause.LINK_LOST),
    ],
)
def test_fault_8_host_stall_holds_on_the_path_and_goes_on(
    program: tuple[list, Player],  # type: ignore[type-arg]
    stall_s: float,
    state: BoardState,
    cause: HoldCause,
) -> None:
    segments, undisturbed = program
    lead = 9000 if cause is not HoldCause.LOW_WATER else 1500
    at = 12000 if cause is HoldCause.LOW_WATER else 9000
    found = stall(segments, at, stall_s, lead, trace(undisturbed))
    assert (found.state, found.cause) == (state, cause)
    assert found.steps_lost == 0 and found.same_levels and found.trusted

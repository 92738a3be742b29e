"""The bench's promises: inputs read lazily are the inputs read at every frame; the hand; the missing strobes."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_protocol.board_config import InputId
from rm501_sim_board.bench import Bench
from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.presets import at_pose, preset
from rm501_sim_board.wiring import Terminal
from tests.support.port_words import run_words, step_words

POWER = {"MOTOR_POWER": True}


def _words(seed: int, motors: tuple[str, ...], frames: int) -> np.ndarray:
    """A wild ride: every motor turns and pauses at random, at the fastest rate that the bus can carry."""
    rng = np.random.default_rng(seed)
    steps = dict.fromkeys(motors, False)
    negative = {m: bool(rng.integers(2)) for m in motors}
    pausing = dict.fromkeys(motors, 0)
    rows = []
    for _ in range(frames):
        for m in motors:
            if pausing[m] > 0:
                pausing[m] -= 1
                steps[m] = False
            elif rng.random() < 0.004:
                negative[m] = not negative[m]
                pausing[m] = int(rng.integers(1, 200))
                steps[m] = False
            else:
                steps[m] = not steps[m]
        rows.append((dict(steps), dict(negative)))
    return run_words(rows, POWER)


@pytest.mark.parametrize("name", ["ideal", "real", "harsh"])
@pytest.mark.parametrize("seed", [1, 2])
def test_inputs_read_when_a_promise_ends_are_those_read_every_frame(name, seed) -> None:
    parameters = at_pose(preset(name), "-149.6,101.8,-89.9,0.9,-66")
    words = _words(seed, ("waist", "shoulder", "elbow", "right wrist", "left wrist"), 2500)
    every, lazy = Bench(parameters, seed=seed), Bench(parameters, seed=seed)
    settled = 0
    for frame in range(2500):
        every.world_changed()
        promise = lazy.inputs_stable_until(frame)
        settled += promise == frame + 1
        assert every.read_inputs(frame) == lazy.read_inputs(frame), frame
        for bench in (every, lazy):
            bench.write_frame(frame, words[8 * frame : 8 * frame + 8].tolist())
    assert every.truth(2500) == lazy.truth(2500)
    changes = every.recording.inputs
    assert len(changes) > 3  # something did change on the way
    assert [(c.frame, c.word) for c in changes] == [(c.frame, c.word) for c in lazy.recording.inputs]
    assert settled < 2000  # and the promises were worth something


def _read_lazily_and_every_frame(words: np.ndarray, at_frame: int = -1, change=lambda bench: None) -> list[int]:
    """Both readings of the same words agree; the lengths of the promises that the lazy one relied on."""
    every, lazy = Bench(preset("ideal")), Bench(preset("ideal"))
    promises, until = [], 0
    frames = len(words) // 8
    for frame in range(frames):
        if frame == at_frame:
            change(every)
            change(lazy)
        every.world_changed()
        word = lazy.read_inputs(frame)
        assert every.read_inputs(frame) == word, frame
        until = lazy.inputs_stable_until(frame)
        promises.append(until - frame)
        for bench in (every, lazy):
            bench.write_frame(frame, words[8 * frame : 8 * frame + 8].tolist())
    assert every.truth(frames) == lazy.truth(frames)
    return promises


def test_counters_of_motors_that_turn_freely_promise_more_until_the_words_switch_power_off() -> None:
    running = [({"waist": bool(frame % 2)}, {}) for frame in range(600)]
    words = np.concatenate([run_words([({}, {})], POWER), run_words(running, POWER), run_words(running)])
    promises = _read_lazily_and_every_frame(words)
    assert max(promises[:600]) > 600  # a counter without power is full after 255
    assert 200 < max(promises[602:640]) < 256
    blocks = Bench(preset("ideal"))
    blocks.write_block(0, words[:8])
    assert blocks.inputs_stable_until(1) > 700
    blocks.write_block(1, words[8 : 8 * 602])
    assert blocks.inputs_stable_until(602) <= 601 + 255


def test_a_cable_that_changes_voids_promises_and_may_carry_more_steps() -> None:
    running = [({"waist": bool(frame % 2)}, {}) for frame in range(500)]
    words = np.concatenate([run_words([({}, {})], POWER), run_words(running, POWER)])
    promises = _read_lazily_and_every_frame(
        words, 400, lambda bench: bench.rewire(bench.boards.wiring.stuck(Terminal.SHOULDER_SELECT, True))
    )
    assert promises[400] < 0.3 * promises[399]


def test_a_stroke_moves_the_fingers_an_object_stops_them_and_hangs_on_the_arm() -> None:
    bench = Bench(preset("ideal"))
    bench.hand.offer_object(30.0, 0.4)
    words = np.concatenate([run_words([({}, {})], POWER), step_words("hand", -800, POWER)])
    bench.write_block(0, words)
    truth = bench.truth(len(words) // 8)
    assert truth.hand_opening_mm == pytest.approx(30.0)
    assert truth.gripping
    assert truth.payload_kg == 0.4
    assert truth.commanded_steps[5] == -800
    opening = step_words("hand", 200, POWER)
    bench.write_block(len(words) // 8, opening)
    truth = bench.truth((len(words) + len(opening)) // 8)
    assert not truth.gripping
    assert truth.payload_kg == 0.0
    assert truth.hand_opening_mm == pytest.approx(45.0)


def test_without_power_the_hand_does_not_move() -> None:
    bench = Bench(preset("ideal"))
    words = step_words("hand", -800)
    bench.write_block(0, words)
    assert bench.truth(len(words) // 8).hand_opening_mm == 60.0


def test_missed_strobes_lose_steps_at_their_rate_and_the_same_ones_every_time() -> None:
    words = np.concatenate([run_words([({}, {})], POWER), step_words("waist", 2000, POWER)])

    def counted(cut: int) -> int:
        bench = Bench(preset("ideal"), seed=4)
        bench.miss_strobes(0.02)
        bench.write_block(0, words[: 8 * cut])
        bench.truth(cut)
        bench.write_block(cut, words[8 * cut :])
        return bench.truth(len(words) // 8).commanded_steps[0]

    lost = 2000 - counted(1000)
    assert 50 < lost < 110  # an unseen level loses the step, whether high or low
    assert counted(1000) == counted(37)


def test_frames_must_follow_each_other_and_time_does_not_go_back() -> None:
    bench = Bench(preset("ideal"))
    bench.write_block(0, run_words([({}, {})] * 10))
    with pytest.raises(BenchConfigError, match="follow each"):
        bench.write_block(11, run_words([({}, {})]))
    bench.truth(10)
    with pytest.raises(BenchConfigError, match="go back"):
        bench.truth(9)
    with pytest.raises(BenchConfigError, match="no button"):
        bench.press(InputId.SWITCH_ROLL)

"""A bench that runs for hours remembers the last ten minutes and goes on counting from power-up."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_sim_board import ideal_plant, recording, servo_plant
from rm501_sim_board.driver_boards import CHANNEL_COUNT, BusActivity, LevelChanges, Steps
from rm501_sim_board.errors import RecordingError
from rm501_sim_board.geometry import DriveTrain
from rm501_sim_board.ideal_plant import IdealPlant
from rm501_sim_board.plant import FrameClock
from rm501_sim_board.recording import Recording

PER_FRAME = 8
CLOCK = FrameClock(40, PER_FRAME)
PER_SECOND = 25_000


def activity(first_period: int, periods: list[int], sign: int = 1) -> BusActivity:
    """A second in which motor 0 made steps at `periods` after its start."""
    none = Steps(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    made = Steps(np.array(periods, dtype=np.int64) + first_period, np.full(len(periods), sign, dtype=np.int64))
    quiet = LevelChanges(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_))
    return BusActivity(first_period, first_period + PER_SECOND, (made, *[none] * (CHANNEL_COUNT - 1)), quiet, quiet, 0)


def ideal() -> IdealPlant:
    start = (0.0, 45.0, -45.0, 90.0, 0.0)
    return IdealPlant(DriveTrain(), CLOCK, start, power_fitted=False, max_steps_per_frame=0.5)


SECONDS = [
    activity(second * PER_SECOND, list(range(0, 16_000, 400)), 1 if second % 7 < 4 else -1) for second in range(60)
]


def test_the_recording_of_steps_stays_within_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    every = Recording(PER_FRAME)
    monkeypatch.setattr(recording, "DEFAULT_KEEP_WORDS", 5 * PER_SECOND)
    monkeypatch.setattr(recording, "_LOOSE_BLOCKS", 3)
    short = Recording(PER_FRAME, 0)
    for second in SECONDS:
        for kept in (every, short):
            kept.add_words(np.zeros(PER_SECOND, dtype=np.uint32))
            kept.add_activity(second)
    assert len(every.steps(0).signs) == 60 * 40
    assert 5 * 40 <= len(short.steps(0).signs) <= 11 * 40
    assert short.step_sequence_hash() == every.step_sequence_hash()
    frames = np.arange(55 * PER_SECOND // PER_FRAME, 60 * PER_SECOND // PER_FRAME, 11)
    assert np.array_equal(short.positions_steps(frames), every.positions_steps(frames))
    assert short.start_count(0) + int(short.steps(0).signs.sum()) == int(every.steps(0).signs.sum())
    with pytest.raises(RecordingError, match="kept from base period"):
        short.positions_steps(np.array([3]))


def test_the_fingerprint_of_steps_tells_another_order() -> None:
    one, other = Recording(PER_FRAME), Recording(PER_FRAME)
    for kept, signs in ((one, (1, 1, -1)), (other, (1, -1, 1))):
        for number, sign in enumerate(signs):
            kept.add_activity(activity(number * PER_SECOND, [8], sign))
    assert one.step_sequence_hash() != other.step_sequence_hash()


def test_the_trace_of_an_ideal_plant_is_the_same_but_shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    every, short = ideal(), ideal()
    for second in SECONDS:
        every.feed(second)
        every.advance(second.end_period // PER_FRAME)
    monkeypatch.setattr(ideal_plant, "TRACE_SECONDS", 4)
    for second in SECONDS:
        short.feed(second)
        short.advance(second.end_period // PER_FRAME)
    whole, part = every.trace(), short.trace()
    count = len(part.frames)
    assert 4 * 1041 <= count <= 4 * 1043
    assert np.array_equal(part.frames, whole.frames[-count:])
    assert np.array_equal(part.commanded_steps, whole.commanded_steps[-count:])
    assert np.array_equal(part.actual_steps, whole.actual_steps[-count:])
    assert np.ptp(part.actual_steps[:, 0]) > 40


def test_the_trace_of_a_plant_with_dynamics_is_the_same_but_shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    from rm501_sim_board.bench import Bench
    from rm501_sim_board.presets import preset

    every = Bench(preset("real"), seed=3).plant
    short = Bench(preset("real"), seed=3).plant
    for plant, kept_s in ((every, 600), (short, 4)):
        monkeypatch.setattr(servo_plant, "TRACE_SECONDS", kept_s)
        for second in SECONDS[:20]:
            plant.feed(second)
            plant.advance(second.end_period // PER_FRAME)
    part = short.trace()
    monkeypatch.setattr(servo_plant, "TRACE_SECONDS", 600)
    whole = every.trace()
    count = len(part.frames)
    assert 4 * 1041 <= count <= 4 * 1043
    assert np.array_equal(part.frames, whole.frames[-count:])
    assert np.array_equal(part.commanded_steps, whole.commanded_steps[-count:])
    assert np.array_equal(part.actual_steps, whole.actual_steps[-count:])

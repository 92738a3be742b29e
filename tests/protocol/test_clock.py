"""Clock estimates, jumps, wraps, and the map between motion and real frames."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.clock_sync import main as clock_sync
from rm501_protocol.clock import ClockEstimator
from rm501_protocol.messages import BoardState, FaultCode, HandState, HoldCause, Status
from rm501_protocol.motion_map import MotionMap, extend_u32

WRAP = 1 << 32


def feed(clock: ClockEstimator, offset_us: float, drift: float, first: int, count: int, seed: int = 1) -> None:
    rng = random.Random(seed)
    for number in range(first, first + count):
        t0 = number * 100_000
        arrives = t0 + 500 + rng.expovariate(1 / 200)
        leaves = arrives + 100
        back = leaves + 500 + rng.expovariate(1 / 200)
        t1, t2 = (int(offset_us + t * (1 + drift)) for t in (arrives, leaves))
        clock.add(t0, t1 % WRAP, t2 % WRAP, int(back))


@pytest.mark.parametrize("drift_ppm", [-100, 0, 60])
@pytest.mark.parametrize("offset_us", [0, 12345, WRAP - 20_000_000])
def test_offset_and_drift_are_found_also_across_the_wrap_of_the_ticks(offset_us: int, drift_ppm: float) -> None:
    clock = ClockEstimator()
    feed(clock, offset_us, drift_ppm * 1e-6, 0, 400)
    at = 400 * 100_000
    truth = offset_us + at * (1 + drift_ppm * 1e-6)
    assert abs(clock.board_us(at) - truth) < 40
    assert abs(clock.host_us(truth) - at) < 40
    quality = clock.quality
    assert quality.samples == 400 and abs(quality.drift_ppm - drift_ppm) < 3
    assert 900 < quality.min_round_trip_us < 1100 and quality.bound_us == quality.min_round_trip_us / 2
    assert quality.jumps == 0


def test_before_the_first_sample_it_says_so() -> None:
    clock = ClockEstimator()
    assert not clock.ready and clock.quality.bound_us == float("inf") and clock.quality.samples == 0
    with pytest.raises(ValueError, match="no clock samples"):
        clock.board_us(0)
    assert clock.extend_ticks(WRAP + 5) == 5
    clock.add(100, 5, 6, 99)  # arrives before it left: nonsense is not taken
    assert not clock.ready
    clock.add(100, 5, 6, 200)
    assert clock.ready and clock.extend_ticks(WRAP - 1) == -1


@pytest.mark.parametrize("jump_us", [1000, -1000, 50_000, -3_000_000])
def test_a_jump_is_counted_and_followed(jump_us: int) -> None:
    clock = ClockEstimator()
    feed(clock, 7e6, 20e-6, 0, 300)
    clock.board_us(0)
    feed(clock, 7e6 + jump_us, 20e-6, 300, 40, seed=2)
    assert clock.quality.jumps == 1 and abs(clock.quality.last_jump_us - jump_us) < 600
    at = 340 * 100_000
    assert abs(clock.board_us(at) - (7e6 + jump_us + at * (1 + 20e-6))) < 100
    clock.restart()
    assert not clock.ready and clock.quality.jumps == 1


def test_a_few_strange_samples_are_no_jump() -> None:
    clock = ClockEstimator()
    feed(clock, 0, 0, 0, 200)
    for number, size in ((200, 800), (203, -900), (206, 800)):
        t0 = number * 100_000
        clock.add(t0, t0 + 550 + size, t0 + 650 + size, t0 + 1200)
        feed(clock, 0, 0, number + 1, 2, seed=number)
    feed(clock, 0, 0, 210, 60, seed=9)
    assert clock.quality.jumps == 0


def test_known_line_time_is_taken_off() -> None:
    clock = ClockEstimator()
    for number in range(100):
        t0 = number * 100_000
        clock.add(t0, t0 + 3000, t0 + 3000, t0 + 4000, line_out_us=2500, line_in_us=500)
    assert abs(clock.board_us(10_000_000) - 10_000_000) < 5


def test_the_benchmark_meets_its_target(capsys: pytest.CaptureFixture[str]) -> None:
    assert clock_sync(["--n", "1500"]) == 0
    assert "clock_sync: ok" in capsys.readouterr().out


def status(real: int, motion: int, phase: int, rate: int) -> Status:
    return Status(
        real % WRAP,
        0,
        motion % WRAP,
        phase,
        rate,
        rate,
        BoardState.RUNNING,
        HoldCause.NONE,
        FaultCode.NONE,
        1,
        31,
        0,
        (),
        0,
        True,
        HandState.OPEN,
        0,
        0,
    )


@given(st.integers(0, 3 * WRAP), st.integers(-(WRAP // 2), WRAP // 2 - 1))
def test_counters_are_extended_to_the_nearest(near: int, distance: int) -> None:
    assert extend_u32((near + distance) % WRAP, near) == near + distance


@given(st.integers(0, 1 << 24), st.integers(0, (1 << 24) - 1), st.integers(WRAP - 5000, WRAP), st.integers(1, 10_000))
def test_the_map_agrees_with_the_accumulator(rate: int, phase: int, real: int, later: int) -> None:
    motion = real - 1000
    motion_map = MotionMap()
    with pytest.raises(ValueError, match="no status"):
        motion_map.motion_frame_at(0)
    motion_map.update(status(real - later, 0, 0, rate))
    motion_map = MotionMap()
    motion_map.update(status(real, motion, phase, rate))
    base = real % WRAP
    m, p = motion % WRAP, phase
    for _ in range(min(later, 300)):
        p += rate
        m, p = m + (p >> 24), p & 0xFFFFFF
        base += 1
        assert motion_map.motion_frame_at(base) == m
    motion_map.update(status(base, m, p, rate))
    assert motion_map.steady and motion_map.rate == rate / (1 << 24)
    assert motion_map.motion_frame_at(base) == m, "counters go on beyond 32 bits"
    ahead = motion_map.real_frame_at(m + 3)
    if rate == 0:
        assert ahead is None
    else:
        assert ahead is not None
        assert motion_map.motion_frame_at(ahead) >= m + 3 > motion_map.motion_frame_at(ahead - 1)
    assert motion_map.real_frame_at(m) == base
    motion_map.update(status(base - 1, 0, 0, 0))
    assert motion_map.rate == rate / (1 << 24), "an older status is ignored"
    motion_map.update(status(base + 10, m + 100, 0, rate))
    assert not motion_map.steady

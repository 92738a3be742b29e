"""Rows 1 to 4 of the fault list on whole streams: errors up to one byte in a hundred, bursts, late answers."""

import random

import pytest

from benchmarks.soak import Line, Simulation
from rm501_protocol.link_core import LINE_AHEAD_US

TWO_MINUTES_US = 120_000_000


class BurstLine(Line):
    """Everything is lost for 1 to 200 ms, about twice a second."""

    def __init__(self, rng: random.Random, bytes_per_second: int) -> None:
        super().__init__(rng, bytes_per_second, 0.0)
        self._draw = rng
        self._begins_us = 0.0
        self._ends_us = 0.0

    def send(self, data: bytes, now_us: int) -> tuple[int, bytes]:
        arrival_us, data = super().send(data, now_us)
        while arrival_us > self._ends_us:
            self._begins_us = self._ends_us + self._draw.expovariate(1 / 400_000)
            self._ends_us = self._begins_us + self._draw.uniform(1_000, 200_000)
        return arrival_us, b"" if arrival_us >= self._begins_us else data


class LateLine(Line):
    """Every packet is up to 500 ms late, and so they overtake each other."""

    def __init__(self, rng: random.Random, bytes_per_second: int, most_us: int) -> None:
        super().__init__(rng, bytes_per_second, 0.0)
        self._draw = rng
        self._most_us = most_us

    def send(self, data: bytes, now_us: int) -> tuple[int, bytes]:
        arrival_us, data = super().send(data, now_us)
        return arrival_us + self._draw.randrange(self._most_us), data


def check(simulation: Simulation, least_lead_s: float) -> None:
    simulation.run_until(TWO_MINUTES_US)
    result = simulation.finish()
    assert result.segments > 300
    assert (result.lost, result.doubled, result.altered) == (0, 0, 0)
    assert (result.queue_overflows, result.underruns) == (0, 0)
    assert result.least_lead_s > least_lead_s


@pytest.mark.parametrize("byte_error", [0.0, 1e-6, 1e-4, 1e-3, 3e-3])
def test_byte_errors(byte_error: float) -> None:
    check(Simulation(3, 250_000, byte_error), 1.5)


def test_one_byte_in_a_hundred_broken_is_slow_but_never_wrong() -> None:
    simulation = Simulation(4, 250_000, 1e-2)
    simulation.run_until(TWO_MINUTES_US)
    result = simulation.finish()
    assert result.segments > 300 and result.retransmits > 100
    assert (result.lost, result.doubled, result.altered, result.queue_overflows) == (0, 0, 0, 0)


def test_bursts() -> None:
    simulation = Simulation(5, 250_000, 0.0)
    simulation.to_board = BurstLine(random.Random(6), 25_000)
    simulation.to_host = BurstLine(random.Random(7), 25_000)
    check(simulation, 1.0)


@pytest.mark.parametrize("way", ["answers late", "segments late", "both late"])
def test_late_and_overtaking_packets(way: str) -> None:
    simulation = Simulation(8, 250_000, 0.0)
    if way != "answers late":
        simulation.to_board = LateLine(random.Random(9), 25_000, 300_000)
    if way != "segments late":
        simulation.to_host = LateLine(random.Random(10), 25_000, 500_000)
    simulation.run_until(TWO_MINUTES_US)
    result = simulation.finish()
    assert result.segments > 200
    assert (result.lost, result.doubled, result.altered, result.queue_overflows) == (0, 0, 0, 0)


def test_never_more_than_5_ms_of_line_time_is_handed_out() -> None:
    simulation = Simulation(11, 250_000, 1e-3)
    worst_us = 0.0
    for packet_line in (simulation.to_board, simulation.to_host):
        original = packet_line.send

        def send(data: bytes, now_us: int, line: Line = packet_line, send=original) -> tuple[int, bytes]:
            nonlocal worst_us
            arrived = send(data, now_us)
            worst_us = max(worst_us, line._free_us - now_us)
            return arrived

        packet_line.send = send  # type: ignore[method-assign]
    simulation.run_until(20_000_000)
    longest_frame_us = 256 * 40
    assert 0 < worst_us <= max(LINE_AHEAD_US, longest_frame_us)

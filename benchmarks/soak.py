"""Both link ends over a bad line on virtual time: nothing lost, doubled or altered, no underrun, quick stops.

python -m benchmarks.soak [--hours 1] [--byte-error 1e-4] [--baud 250000] [--stops 2000] [--jobs 2] [--seed 1]

A host streams segments of a seeded motion (lengths 40 ms to 0.6 s, mean 0.25 s) into a board with 32 slots that plays
them; clock queries and status at 10 Hz run beside. Bytes are flipped, lost, doubled and inserted at the given rate in
both directions. The board compares each segment with what the host made. Then, on the same line at a byte error of
1e-3, stops are issued at random instants while segments stream.
"""

from __future__ import annotations

import argparse
import heapq
import math
import os
import random
import sys
import time
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

from rm501_protocol.link import (
    BoardLink,
    GenerationAdvanced,
    HostLink,
    LinkSilent,
    Received,
    SessionLost,
    SessionOpened,
    StopAcknowledged,
    StopKind,
    StopReceived,
)
from rm501_protocol.messages import (
    BoardState,
    FaultCode,
    HandState,
    HoldCause,
    Identify,
    MotorTerm,
    Segment,
    SegmentFlag,
    Status,
)

QUEUE_DEPTH = 32
FRAME_US = 320
STATUS_US = 100_000
LATENCY_US = 1_000  # a USB adapter hands over once a millisecond
STOP_P99_US, STOP_MAX_US = 15_000, 50_000
LIMIT_S = 900.0


class Line:
    """One direction of a serial line with errors."""

    def __init__(self, rng: random.Random, bytes_per_second: int, byte_error: float) -> None:
        self._rng = rng
        self._us_per_byte = 1e6 / bytes_per_second
        self._log = math.log1p(-byte_error) if byte_error else 0.0
        self._free_us = 0.0
        self._good_bytes = self._next_gap()
        self.bytes = 0

    def _next_gap(self) -> int:
        if not self._log:
            return 1 << 62
        return int(math.log(1.0 - self._rng.random()) / self._log)

    def send(self, data: bytes, now_us: int) -> tuple[int, bytes]:
        """When the data arrives, and what arrives."""
        size = len(data)
        self.bytes += size
        self._free_us = max(self._free_us, now_us) + size * self._us_per_byte
        arrival_us = int(self._free_us) + int(self._rng.random() * LATENCY_US)
        if self._good_bytes >= size:
            self._good_bytes -= size
            return arrival_us, data
        return arrival_us, self._damaged(data)

    def _damaged(self, data: bytes) -> bytes:
        out = bytearray()
        for value in data:
            if self._good_bytes > 0:
                self._good_bytes -= 1
                out.append(value)
                continue
            self._good_bytes = self._next_gap()
            kind = self._rng.random()
            if kind < 0.7:
                out.append(value ^ 1 << int(self._rng.random() * 8))
            elif kind < 0.8:
                pass
            elif kind < 0.9:
                out += bytes((value, value))
            else:
                out += bytes((value, int(self._rng.random() * 256)))
        return bytes(out)


class Motion:
    """The segments of a seeded motion; host and board each make their own copy and compare."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._start = 0
        self.made = 0

    def next(self) -> Segment:
        """The next segment."""
        draw = self._rng.random
        length = 125 + int(-650 * math.log(1.0 - draw()))
        length = min(length, 1900)
        rest = draw() < 0.05
        motors = tuple(
            MotorTerm(motor, int(draw() * 0x7FFFFFFF) - 0x3FFFFFFF, int(draw() * 0xFFFFFF) - 0x7FFFFF)
            for motor in range(5)
            if draw() < 0.8
        )
        flags = SegmentFlag.ENDS_AT_REST if rest else SegmentFlag.NONE
        segment = Segment(self._start, length, motors, flags, 700, 1200)
        self._start = segment.end_frames
        self.made += 1
        return segment


@dataclass
class Result:
    """What one simulation found."""

    hours: float = 0.0
    segments: int = 0
    lost: int = 0
    altered: int = 0
    doubled: int = 0
    underruns: int = 0
    queue_overflows: int = 0
    least_lead_s: float = math.inf
    retransmits: int = 0
    bad_frames: int = 0
    bytes_out: int = 0
    bytes_in: int = 0
    sessions_lost: int = 0
    cpu_s: float = 0.0


class Simulation:
    """Host and board, their line, and virtual time."""

    def __init__(self, seed: int, baud: int, byte_error: float) -> None:
        rate = baud // 10
        self.rng = random.Random(seed)
        self.now_us = 0
        self.host = HostLink(bytes_per_second=rate)
        self.board = BoardLink(self.rng.getrandbits(32), Identify(), bytes_per_second=rate)
        self.to_board = Line(random.Random(seed + 1), rate, byte_error)
        self.to_host = Line(random.Random(seed + 2), rate, byte_error)
        self.made = Motion(seed + 3)
        self.expected = Motion(seed + 3)
        self.result = Result()
        self._arrivals: list[tuple[int, int, bool, bytes]] = []
        self._order = 0
        self._queue: deque[tuple[int, bool]] = deque()
        self._queued_frames = 0
        self._playing_until_us = 0
        self._status_due_us = 0
        self._primed = False
        self.stop_seen_us: int | None = None
        self.stop_acknowledged = False
        self.streaming = False
        self.busy_stops = 0
        self.host.connect(self.rng.getrandbits(32), 0)
        self.board.free_slots = QUEUE_DEPTH

    def run_until(self, end_us: int) -> None:
        """Let virtual time pass; stops early when a stop has been acknowledged."""
        while True:
            self._exchange()
            times = [self.host.next_deadline_us(), self.board.next_deadline_us(), self._status_due_us]
            if self._queue:
                times.append(self._playing_until_us)
            if self._arrivals:
                times.append(self._arrivals[0][0])
            upcoming = max(self.now_us, min(value for value in times if value is not None))
            if upcoming >= end_us or self.stop_acknowledged:
                self.now_us = max(self.now_us, min(upcoming, end_us))
                return
            self.now_us = upcoming
            self._arrive()
            self._play()
            if self.now_us >= self._status_due_us:
                self._status_due_us += STATUS_US
                self.board.send(self._status())

    def _exchange(self) -> None:
        now_us = self.now_us
        for packet in self.host.packets_to_send(now_us):
            self._put(self.to_board, packet, False)
        for packet in self.board.packets_to_send(now_us):
            self._put(self.to_host, packet, True)

    def _put(self, line: Line, packet: bytes, to_host: bool) -> None:
        arrival_us, data = line.send(packet, self.now_us)
        if data:
            self._order += 1
            heapq.heappush(self._arrivals, (arrival_us, self._order, to_host, data))

    def _arrive(self) -> None:
        while self._arrivals and self._arrivals[0][0] <= self.now_us:
            _, _, to_host, data = heapq.heappop(self._arrivals)
            if to_host:
                self.host.receive_data(data, self.now_us)
                self._host_events()
            else:
                self.board.receive_data(data, self.now_us)
                self._board_events()

    def _host_events(self) -> None:
        while (event := self.host.next_event()) is not None:
            if isinstance(event, SessionOpened):
                self.streaming = True
            elif isinstance(event, StopAcknowledged):
                self.stop_acknowledged = True
            elif isinstance(event, SessionLost | GenerationAdvanced | LinkSilent):
                self.result.sessions_lost += 1
        self.feed()

    def feed(self) -> None:
        """Keep two segments waiting in the host's link."""
        while self.streaming and self.host.pending < 2 and self.host.is_open:
            self.host.send(self.made.next())

    def _board_events(self) -> None:
        while (event := self.board.next_event()) is not None:
            if isinstance(event, StopReceived):
                self.stop_seen_us = self.now_us
                self._queue.clear()
                self._queued_frames = 0
                self._primed = False
                self.board.free_slots = QUEUE_DEPTH
            elif isinstance(event, Received) and isinstance(event.message, Segment):
                self._take(event.message)

    def _take(self, segment: Segment) -> None:
        result = self.result
        expected = self.expected.next()
        if segment != expected:
            if segment.start_frames == expected.start_frames:
                result.altered += 1
            elif (segment.start_frames - expected.start_frames) & 0xFFFFFFFF < 1 << 31:
                while expected.start_frames != segment.start_frames and result.lost < 1000:
                    result.lost += 1
                    expected = self.expected.next()
            else:
                result.doubled += 1
        result.segments += 1
        if len(self._queue) >= QUEUE_DEPTH:
            result.queue_overflows += 1
            return
        if not self._queue:
            self._playing_until_us = self.now_us + segment.length_frames * FRAME_US
        self._queue.append((segment.length_frames, bool(segment.flags & SegmentFlag.ENDS_AT_REST)))
        self._queued_frames += segment.length_frames
        self.board.free_slots = QUEUE_DEPTH - len(self._queue)
        self._primed = self._primed or len(self._queue) >= 8

    def _play(self) -> None:
        result = self.result
        while self._queue and self._playing_until_us <= self.now_us:
            length, rest = self._queue.popleft()
            self._queued_frames -= length
            if self._primed:
                result.least_lead_s = min(result.least_lead_s, self._queued_frames * FRAME_US / 1e6)
            if self._queue:
                self._playing_until_us += self._queue[0][0] * FRAME_US
            elif self._primed:
                result.underruns += not rest
                self._primed = False
            self.board.free_slots = QUEUE_DEPTH - len(self._queue)

    def _status(self) -> Status:
        used = len(self._queue)
        return Status(
            self.now_us // FRAME_US & 0xFFFFFFFF,
            self.now_us & 0xFFFFFFFF,
            0,
            0,
            1 << 24,
            1 << 24,
            BoardState.RUNNING,
            HoldCause.NONE,
            FaultCode.NONE,
            used,
            QUEUE_DEPTH - used,
            0,
            (1, -2, 3, -4, 5, -6),
            63,
            True,
            HandState.OPEN,
            0,
            0,
        )

    def finish(self) -> Result:
        """The result with its totals."""
        result = self.result
        result.hours = self.now_us / 3.6e9
        for end in (self.host, self.board):
            result.retransmits += end.stats.retransmits
            result.bad_frames += end.stats.bad_frames
        result.bytes_out, result.bytes_in = self.to_board.bytes, self.to_host.bytes
        return result


def stream(job: tuple[int, int, float, float]) -> Result:
    """One long run."""
    seed, baud, byte_error, hours = job
    began = time.process_time()
    simulation = Simulation(seed, baud, byte_error)
    simulation.run_until(int(hours * 3.6e9))
    result = simulation.finish()
    result.cpu_s = time.process_time() - began
    return result


def stops(seed: int, baud: int, byte_error: float, count: int) -> tuple[list[int], int]:
    """Latencies in us from `stop` to the board's StopReceived, sorted, and how many met segments in flight."""
    simulation = Simulation(seed, baud, byte_error)
    latencies = []
    for _ in range(count):
        simulation.run_until(simulation.now_us + 2_000 + simulation.rng.randrange(90_000))  # while the queue fills
        while not simulation.streaming:
            simulation.run_until(simulation.now_us + 100_000)
        simulation.stop_seen_us = None
        asked_us = simulation.now_us
        simulation.busy_stops += simulation.host.unacknowledged > 0
        simulation.streaming = False
        simulation.host.stop(StopKind.STOP, asked_us)
        while not simulation.stop_acknowledged:
            simulation.run_until(simulation.now_us + 1_000_000)
        assert simulation.stop_seen_us is not None
        latencies.append(simulation.stop_seen_us - asked_us)
        simulation.stop_acknowledged = False
        # a new motion: whatever the board takes of the old one from here on is a wrong segment
        motion_seed = simulation.rng.getrandbits(32)
        simulation.made, simulation.expected = Motion(motion_seed), Motion(motion_seed)
        simulation.streaming = True
        simulation.feed()
    wrong = simulation.result.lost + simulation.result.altered + simulation.result.doubled
    if wrong:
        raise AssertionError(f"{wrong} segments of before a stop were executed after it")
    return sorted(latencies), simulation.busy_stops


def _sum(results: list[Result]) -> Result:
    total = Result()
    for result in results:
        for name in Result.__dataclass_fields__:
            if name == "least_lead_s":
                total.least_lead_s = min(total.least_lead_s, result.least_lead_s)
            else:
                setattr(total, name, getattr(total, name) + getattr(result, name))
    return total


def main(arguments: list[str] | None = None) -> int:
    """Run it; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--byte-error", type=float, default=1e-4)
    parser.add_argument("--baud", type=int, default=250_000)
    parser.add_argument("--stops", type=int, default=2000, help="stops in the latency part, 0 to leave it out")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)

    started = time.perf_counter()
    jobs = max(1, min(options.jobs, int(options.hours * 2)))
    work = [(options.seed + 1000 * n, options.baud, options.byte_error, options.hours / jobs) for n in range(jobs)]
    if jobs == 1:
        results = [stream(work[0])]
    else:
        with ProcessPoolExecutor(jobs) as pool:
            results = list(pool.map(stream, work))
    total = _sum(results)
    seconds = time.perf_counter() - started
    print(f"{'simulated':<26}{total.hours:.2f} h at {options.baud} baud, byte error {options.byte_error:g}")
    print(f"{'segments':<26}{total.segments}")
    print(f"{'lost, doubled, altered':<26}{total.lost}, {total.doubled}, {total.altered}")
    print(f"{'underruns, overflows':<26}{total.underruns}, {total.queue_overflows}")
    print(f"{'least queued motion':<26}{total.least_lead_s:.2f} s")
    print(f"{'bad frames, sent again':<26}{total.bad_frames}, {total.retransmits}")
    print(f"{'bytes out, in':<26}{total.bytes_out}, {total.bytes_in}")
    print(f"{'sessions lost':<26}{total.sessions_lost}")
    wrong = total.lost + total.doubled + total.altered + total.underruns + total.queue_overflows + total.sessions_lost
    print(f"{'time taken':<26}{seconds:.0f} s, {total.cpu_s:.0f} s of CPU in {jobs} processes")
    # the limit is for a machine that does nothing else: CPU of the slowest process
    failed = bool(wrong) or max(result.cpu_s for result in results) > LIMIT_S or total.segments == 0
    text = ""
    if options.stops:
        latencies, busy = stops(options.seed, 250_000, 1e-3, options.stops)
        p99_us, worst_us = latencies[int(len(latencies) * 0.99)], latencies[-1]
        middle_ms = latencies[len(latencies) // 2] / 1e3
        print(
            f"{'stops at byte error 1e-3':<26}{len(latencies)}, {busy} with segments in flight, p50 {middle_ms:.2f} ms"
        )
        text = f", stop p99 {p99_us / 1e3:.2f} ms, max {worst_us / 1e3:.2f} ms"
        failed = failed or p99_us > STOP_P99_US or worst_us > STOP_MAX_US
    ratio = total.hours * 3600 / seconds
    verdict = "FAILED" if failed else "ok"
    print(f"soak: {verdict}, {wrong} wrong in {total.segments} segments{text}, {ratio:.0f} x real time")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

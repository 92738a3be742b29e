"""The daemon's machine for a day of virtual time: no step lost, no event missed, no memory kept.

Every cycle runs the pick-and-place from its file through the daemon's own program runner, over a line that flips bytes
at 1e-5 both ways. After each cycle, and exactly:

steps     what the emulated driver boards have counted since the first cycle against what the host commanded (5 motors)
events    power pulses of the hand that the emulated hand got, against one full stroke closed and open for each cycle
memory    blocks that Python has allocated in the whole process, emulator included (`sys.getallocatedblocks`), and the
          resident set; `tracemalloc` says how much of it the host's own files hold, in windows

`tracemalloc` makes Python about three times slower. Windows of it are spread over the whole run, `--traced-cycles` of
every hundred cycles; a hundred traces all of it. The mean growth is judged. Line numbers of long
functions would make it much slower still: Python looks them up from the function's start, unless the function was once
traced by `sys.settrace`, which the first cycle therefore is.
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
import tempfile
import time
import tracemalloc
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from rm501_host.machine import operations
from rm501_host.virtual_time import run_virtual
from rm501_sim_board import ideal_plant, recording
from tests.operator.processes import REPOSITORY
from tests.support.virtual_machine import ME, homed, running_service

SETTLED_CYCLES = 420
"""By then every bounded ring is full: 2000 log records (the slowest), 64 jobs, 60 s of wire and status."""
GROWTH_BLOCKS = 2.0
"""A cycle, over the settled part. One object kept by every cycle would be seen as 1 to 3 blocks."""
FILLING_BLOCKS = 600.0
"""A cycle, while the rings still fill: a run too short to settle."""
JUDGED_CYCLES = 100
"""Shorter runs still import modules and fill caches: their growth is printed, not judged."""
GROWTH_BYTES = 20_000
"""A cycle, traced, mean of all windows: what a cycle leaves in rings counts, what it pushes out was made before the
window. The last 60 s of wire alone, some 200 kB, make single windows differ by 10 kB a cycle; a leak adds to all.
"""
_BENCH_MEMORY_S = 10
_LOOK_CYCLES = 5
_WINDOW_CYCLES = 100
_HAND = 5
_PULSES = 800
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


@dataclass(slots=True)
class Found:
    """What a soak has seen; sums and maxima, so that it does not grow itself."""

    hours: float = 0.0
    blocks: list[tuple[int, int, int]] = field(default_factory=list)
    """(cycle, allocated blocks, resident bytes), every few cycles."""
    traced: list[list[tuple[int, int]]] = field(default_factory=list)
    """Windows of (cycle, bytes that files of the host and the protocol hold)."""
    cycles: int = 0
    lost_steps: int = 0
    """The most that any motor's count was off after a cycle."""
    apart_steps: float = 0.0
    last_apart_steps: float = 0.0
    missed_pulses: int = 0
    seen_hand: int = 0
    belief_deg: float = 0.0
    bad_frames: int = 0
    board_bad_frames: int = 0
    retransmits: int = 0


def _trace_lines(frame: FrameType, event: str, argument: object) -> Any:
    return _trace_lines


def _traced_bytes() -> int:
    kept = [tracemalloc.Filter(True, f"*/{package}/*") for package in ("rm501_host", "rm501_protocol")]
    snapshot = tracemalloc.take_snapshot().filter_traces(kept)
    return sum(statistic.size for statistic in snapshot.statistics("filename"))


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_BYTES


class _Soak:
    """One run: `hours` of virtual time, `tracemalloc` over `traced_cycles` of every hundred."""

    def __init__(self, hours: float, seed: int, traced_cycles: int) -> None:
        self._hours = hours
        self._seed = seed
        self._traced_cycles = traced_cycles
        self.found = Found()
        self._lines: list[Any] = []

    async def run(self, folder: Path) -> None:
        """Cycle after cycle; fills `found`."""
        url = f"emu://?preset=ideal&seed={self._seed}&record=0&fault=flip:p=1e-5"
        found = self.found
        async with running_service(folder, url, on_transport=self._keep) as service:
            machine, programs = service.machine, service.programs
            text = (REPOSITORY / "examples" / "pick_and_place.ngc").read_text()
            (folder / "programs" / "p.ngc").write_text(text)
            loop = asyncio.get_running_loop()
            await homed(service)
            began_s = time.perf_counter()
            first_counts: tuple[int, ...] = ()
            first_place: tuple[int, ...] = ()
            hand = self._hand
            while loop.time() < 3600 * self._hours or found.cycles < 3:
                self._choose_tracing(found.cycles)
                self._transport.truth()  # the emulator runs on to this instant; left alone it may lag by a status
                opened, closed = hand.pulses_open, hand.pulses_closed
                job = await programs.run(ME, "p.ngc")
                shown = set()
                while not job.done.is_set():
                    await asyncio.sleep(0.3)
                    shown.add(machine.arm_state.hand)
                await job.wait()
                found.seen_hand += {"CLOSED", "OPEN"} <= shown
                counted = self._transport.truth().commanded_steps[:_HAND]
                found.missed_pulses += abs(hand.pulses_open - opened - _PULSES)
                found.missed_pulses += abs(hand.pulses_closed - closed - _PULSES)
                assert machine.stream is not None
                # what was counted by the driver boards, relative to what the host believes: never changes
                counts = tuple(a - b for a, b in zip(counted, machine.stream.positions_steps, strict=False))
                place = machine.stream.positions_q48[:_HAND]
                first_counts, first_place = first_counts or counts, first_place or place
                found.lost_steps = max(
                    found.lost_steps, *(abs(a - b) for a, b in zip(counts, first_counts, strict=True))
                )
                apart = max(abs(a - b) for a, b in zip(place, first_place, strict=True)) / 2**48
                found.apart_steps, found.last_apart_steps = max(found.apart_steps, apart), apart
                found.cycles += 1
                cycles = found.cycles
                if cycles % _LOOK_CYCLES == 0 or cycles < 3 or tracemalloc.is_tracing():
                    gc.collect()
                    found.blocks.append((cycles, sys.getallocatedblocks(), _resident_bytes()))
                    if tracemalloc.is_tracing():
                        found.traced[-1].append((cycles, _traced_bytes()))
                if cycles % 100 == 0:
                    self._tell(loop.time(), time.perf_counter() - began_s)
            stats = machine.session.link.stats
            found.hours = loop.time() / 3600
            found.retransmits, found.bad_frames = stats.retransmits, stats.bad_frames
            status = machine.board_status
            found.board_bad_frames = 0 if status is None else status.bad_frames
            # where the arm stands after homing again must be where the counts said
            before = machine.arm_state.joints_deg
            await operations.home(machine, ME).wait()
            await operations.move_joints(machine, ME, before).wait()
            truth = self._transport.truth().joint_deg[:5]
            found.belief_deg = max(abs(a - b) for a, b in zip(truth, before, strict=True))

    def _keep(self, transport: Any) -> Any:
        self._transport = transport
        self._hand = transport.emulator.bench.hand
        return transport

    def _choose_tracing(self, cycles: int) -> None:
        """Trace the first cycles of every hundred; the very first under `settrace`."""
        if cycles == 1:
            sys.settrace(None)
        wanted = cycles % _WINDOW_CYCLES < self._traced_cycles
        if wanted and not tracemalloc.is_tracing():
            tracemalloc.start()
            self.found.traced.append([])
        elif not wanted and tracemalloc.is_tracing():
            tracemalloc.stop()

    def _tell(self, now_s: float, took_s: float) -> None:
        found = self.found
        print(
            f"  {now_s / 3600:6.2f} h, {found.cycles} cycles, {now_s / took_s:.1f} x real time, "
            f"{found.blocks[-1][1]} blocks, {found.blocks[-1][2] / 1e6:.1f} MB, lost steps {found.lost_steps}, "
            f"missed pulses {found.missed_pulses}",
            file=sys.stderr,
            flush=True,
        )


def slope(points: list[tuple[int, int]]) -> float:
    """Least-squares growth for each cycle, of points (cycle, value)."""
    middle = sum(cycle for cycle, _ in points) / len(points)
    spread = sum((cycle - middle) ** 2 for cycle, _ in points)
    return sum((cycle - middle) * value for cycle, value in points) / spread if spread else 0.0


def soak(hours: float, seed: int, traced_cycles: int) -> bool:
    """Run it and print what was found; False when a target is missed."""
    run = _Soak(hours, seed, traced_cycles)
    # what the emulated bench remembers of its motion goes up and down by tens of MB in twenty minutes; make it seconds
    ideal_plant.TRACE_SECONDS = _BENCH_MEMORY_S
    recording.DEFAULT_KEEP_WORDS = _BENCH_MEMORY_S * 25_000
    recording.KEEP_INPUTS = 20
    with tempfile.TemporaryDirectory() as name:
        sys.settrace(_trace_lines)
        began_s = time.perf_counter()
        run_virtual(run.run(Path(name)))
        took_s = time.perf_counter() - began_s
        sys.settrace(None)
        tracemalloc.stop()
    found = run.found
    cycles = found.cycles
    settled = cycles > 2 * SETTLED_CYCLES
    first = SETTLED_CYCLES if settled else cycles // 3
    looked = [look for look in found.blocks if look[0] >= first]
    kept = slope([(cycle, count) for cycle, count, _ in looked])
    resident = slope([(cycle, count) for cycle, _, count in looked])
    print(
        f"{found.hours:.2f} h of virtual time in {took_s / 60:.1f} min ({3600 * found.hours / took_s:.1f} x), "
        f"{cycles} cycles, byte errors 1e-5 both ways: {found.bad_frames} bad frames at the host, "
        f"{found.board_bad_frames} at the board, {found.retransmits} retransmits"
    )
    print(
        f"  steps counted by the driver boards against those commanded: {found.lost_steps} apart at most; "
        f"exact end positions apart from the first cycle's: at most {found.apart_steps:.4f} step, "
        f"the last {found.last_apart_steps:.4f}; after homing again the arm is {found.belief_deg:.4f} deg off"
    )
    print(
        f"  hand: strokes shown in status {found.seen_hand}/{cycles} cycles, power pulses missed or made too many: "
        f"{found.missed_pulses} of {2 * _PULSES * cycles}"
    )
    rings = "rings full" if settled else "rings still fill" if cycles >= JUDGED_CYCLES else "too few to judge"
    print(
        f"  memory of the process from cycle {first} on ({rings}): "
        f"{looked[0][1]} -> {looked[-1][1]} blocks, {kept:+.3f} a cycle; "
        f"resident {looked[0][2] / 1e6:.1f} -> {looked[-1][2] / 1e6:.1f} MB, "
        f"{resident:+.0f} bytes a cycle"
    )
    good = found.lost_steps == 0 and found.apart_steps < 0.05 and found.belief_deg < 0.1
    good = good and found.missed_pulses == 0 and found.seen_hand == cycles
    if cycles >= JUDGED_CYCLES:
        good = good and kept < (GROWTH_BLOCKS if settled else FILLING_BLOCKS)
    growths = []
    for window in found.traced:
        if len(window) < 3:
            continue
        middle = window[len(window) // 2]
        growths.append((window[-1][1] - middle[1]) / max(1, window[-1][0] - middle[0]))
    if growths:
        mean = sum(growths) / len(growths)
        good = good and mean < GROWTH_BYTES
        print(
            f"  tracemalloc, {len(growths)} windows from cycle {found.traced[0][0][0]} to {found.traced[-1][-1][0]}, "
            f"files of the host and the protocol, kB a cycle over the second half of each, mean {mean / 1e3:+.2f}: "
            + " ".join(f"{growth / 1e3:+.2f}" for growth in growths)
        )
    return good

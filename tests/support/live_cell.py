"""A machine with a program under way on virtual time, and what came out at the pins: for override and running back."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config, load_config
from rm501_host.daemon.service import Service
from rm501_host.errors import RefusedError
from rm501_host.machine import Machine, MachineState
from rm501_host.motion.mirror import Mirror
from rm501_host.segmenter import PlannedSegment
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.transport import Transport
from rm501_sim_board.emu_transport import running_board, shut_down
from rm501_sim_board.emulator import Emulator
from tests.support.plan_checker import motor_matrix, path_deviation_mm, tool_positions
from tests.support.virtual_machine import ME, homed, running_service

Array = NDArray[np.float64]

PROGRAM = """G21 G90 G94 G17
G64 P1
G0 X270 Y0 Z250 A0 B0
G1 X300 F1500
G1 Y50
G1 Z225
M102
G1 Z250
G4 P0.3
G3 X300 Y-50 R120
G1 X280 Y-40 F3000
G1 X275 Y-20 Z230
M101
G1 X270 Y0 Z250
M2
"""


@dataclass
class Played:
    """Segments as the board has them in the end: what was cut off or broken off is not in it."""

    segments: list[PlannedSegment] = field(default_factory=list)
    cuts: int = 0


@contextmanager
def played() -> Iterator[Played]:
    """Follow every mirror for a while."""
    log = Played()
    add, back_to, end_at = Mirror.add, Mirror.back_to, Mirror.end_at

    def added(self: Mirror, planned: PlannedSegment) -> None:
        log.segments.append(planned)
        add(self, planned)

    def back(self: Mirror, frame: int) -> list[PlannedSegment]:
        dropped = back_to(self, frame)
        if dropped:
            log.cuts += 1
            del log.segments[-len(dropped) :]
        return dropped

    def ended(self: Mirror, positions_q48: Sequence[int], end_frame: int) -> None:
        while log.segments and log.segments[-1].start_frame >= end_frame:
            log.segments.pop()
        end_at(self, positions_q48, end_frame)

    Mirror.add, Mirror.back_to, Mirror.end_at = added, back, ended  # type: ignore[method-assign]
    try:
        yield log
    finally:
        Mirror.add, Mirror.back_to, Mirror.end_at = add, back_to, end_at  # type: ignore[method-assign]


@dataclass
class LiveCell:
    """A homed machine, its board, and where the pins have been."""

    service: Service
    emulator: Emulator
    config: Config

    def frames(self) -> int:
        """Real frames so far."""
        return self.emulator.recording.words_written // len(self.config.board.table)

    def places_mm(self, first_frame: int, every: int = 5) -> Array:
        """Tool positions (n, 3) that the steps at the pins stand for, from a real frame on."""
        steps = self.emulator.recording.positions_steps(np.arange(first_frame, self.frames(), every))
        q_deg = np.linalg.solve(motor_matrix(self.config), steps[:, :5].T.astype(np.float64)).T
        keep = np.concatenate(([True], np.any(np.diff(q_deg, axis=0) != 0.0, axis=1)))
        return tool_positions(self.config, q_deg[keep])


@asynccontextmanager
async def live_cell(
    folder: Path,
    program: str = PROGRAM,
    *,
    config: Config | None = None,
    on_transport: Callable[[Transport], Transport] = lambda transport: transport,
) -> AsyncIterator[LiveCell]:
    """A homed machine with `program` stored as live.ngc."""
    config = config or load_config()
    (folder / "programs").mkdir(exist_ok=True, parents=True)
    (folder / "programs" / "live.ngc").write_text(program)
    async with running_service(folder, "emu://live?preset=ideal&seed=1", config, on_transport) as service:
        await homed(service)
        yield LiveCell(service, running_board("live").emulator, config)
    shut_down("live")


@dataclass(frozen=True)
class Ratios:
    """Largest ratios of the segments' polynomials to the limits, and the largest jump of a motor's speed, steps/s."""

    velocity: float
    acceleration: float
    jump_steps_s: float


def judge(config: Config, segments: Sequence[PlannedSegment]) -> Ratios:
    """Limits and continuity over segments that follow each other, at the ends of each."""
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    matrix = motor_matrix(config)
    back = np.linalg.inv(matrix)
    joints, motors = config.joints.ordered, config.motors.ordered
    velocity = np.array([j.max_velocity_deg_s for j in joints])
    acceleration = np.array([j.max_acceleration_deg_s2 for j in joints])
    rate = np.array([m.max_rate_steps_s for m in motors])
    motor_acceleration = np.array([m.max_acceleration_deg_s2 * m.steps_per_deg for m in motors])
    worst = [0.0, 0.0]
    jump = 0.0
    before = np.zeros(5)
    frame: int | None = None
    positions: tuple[int, ...] = ()
    for item in segments:
        if frame is not None and item.start_frame == frame:
            assert item.start_q48 == positions, "the mirror tears"
        else:
            before = np.zeros(5)
        frame, positions = item.end_frame, item.end_q48
        n = item.segment.length_frames
        speeds, accelerations = np.zeros((2, 5)), np.zeros((2, 5))
        for term in item.segment.motors:
            v, a, j = term.v << 16, term.a << 8, term.j
            for at, k in enumerate((0, n)):
                vk, ak = v + k * a + k * (k - 1) // 2 * j, a + k * j
                speeds[at, term.motor] = (vk - ak / 2 + j / 3) / 2.0**48 / frame_s
                accelerations[at, term.motor] = (ak - j) / 2.0**48 / frame_s**2
        jump = max(jump, float(np.abs(speeds[0] - before).max()))
        before = speeds[1]
        if item.segment.flags & SegmentFlag.ENDS_AT_REST:
            jump, before = max(jump, float(np.abs(before).max())), np.zeros(5)
        worst[0] = max(worst[0], _ratio(speeds @ back.T, velocity), _ratio(speeds, rate))
        worst[1] = max(worst[1], _ratio(accelerations @ back.T, acceleration))
        worst[1] = max(worst[1], _ratio(accelerations, motor_acceleration))
    return Ratios(worst[0], worst[1], jump)


def _ratio(values: Array, limits: Array) -> float:
    return float((np.abs(values) / limits).max(initial=0.0))


@dataclass(frozen=True)
class Reference:
    """An undisturbed run: where the pins have been, and how it ended."""

    places_mm: Array
    steps: tuple[int, ...]
    duration_s: float


@dataclass(frozen=True)
class Trial:
    """A disturbed run against the undisturbed one."""

    acts: tuple[str, ...]
    duration_s: float
    deviation_mm: float
    steps_off: int
    ratios: Ratios
    cuts: int

    @property
    def wrong(self) -> str:
        """What is not as it must be, empty when all is."""
        found = []
        if self.deviation_mm > MOST_DEVIATION_MM:
            found.append(f"{self.deviation_mm:.3f} mm off the path")
        if self.steps_off:
            found.append(f"{self.steps_off} steps off at the end")
        if max(self.ratios.velocity, self.ratios.acceleration) > 1.02:
            found.append(f"a limit exceeded: {self.ratios}")
        if self.ratios.jump_steps_s > MOST_JUMP_STEPS_S:
            found.append(f"a speed jumps by {self.ratios.jump_steps_s:.2f} steps/s")
        return "; ".join(found)


MOST_DEVIATION_MM = 0.3
"""Both runs round to whole steps of up to 0.25 mm at the tip."""
MOST_JUMP_STEPS_S = 0.5
_HELD_S = 20.0


async def undisturbed(cell: LiveCell, runs: int = 2) -> Reference:
    """Run the program twice as it is: the first run may begin elsewhere. Once is enough where only the end counts."""
    loop = asyncio.get_running_loop()
    for _ in range(runs):
        first_frame, began_s = cell.frames(), loop.time()
        job = await cell.service.programs.run(ME, "live.ngc")
        await job.wait()
    stream = cell.service.machine.stream
    assert stream is not None
    return Reference(cell.places_mm(first_frame), stream.positions_steps, loop.time() - began_s)


async def trial(cell: LiveCell, reference: Reference, rng: random.Random, *, backs: bool, most_acts: int = 6) -> Trial:
    """Run the program and change the override at random instants, hold, and, with `backs`, run back."""
    machine, programs = cell.service.machine, cell.service.programs
    loop = asyncio.get_running_loop()
    await machine.set_override(rng.choice((1.0, 1.0, 1.6)), ME)
    acts: list[str] = []
    with played() as log:
        first_frame, began_s = cell.frames(), loop.time()
        job = await programs.run(ME, "live.ngc")
        for _ in range(rng.randint(1, most_acts)):
            await asyncio.sleep(rng.uniform(0.05, 4.0) if most_acts <= 8 else rng.uniform(0.05, 1.5))
            if job.done.is_set():
                break
            if rng.random() < (0.6 if backs else 0.15):
                acts.append(await _hold_and_go_on(cell, rng, backs=backs))
            else:
                ratio = rng.choice((0.0, 0.3, 0.8, 1.0, 1.2, 1.5, 2.0, 2.0))
                acts.append(f"{loop.time() - began_s:.2f} s: override {ratio}")
                await machine.set_override(ratio, ME)
        if machine.override < 0.5:
            await machine.set_override(1.0, ME)
        await job.wait()
        duration_s = loop.time() - began_s
    stream = machine.stream
    assert stream is not None
    places = cell.places_mm(first_frame)
    off = max(abs(a - b) for a, b in zip(stream.positions_steps[:5], reference.steps[:5], strict=True))
    deviation = path_deviation_mm(places, reference.places_mm)
    return Trial(tuple(acts), duration_s, deviation, off, judge(cell.config, log.segments), log.cuts)


async def _hold_and_go_on(cell: LiveCell, rng: random.Random, *, backs: bool) -> str:
    """Hold, perhaps run back once or twice, resume; what was done, in words."""
    machine, programs = cell.service.machine, cell.service.programs
    if machine.override == 0.0:
        await machine.set_override(1.0, ME)
        await asyncio.sleep(0.3)
    if not await machine.hold(ME) or not await _until_held(machine):
        return "hold at the end"
    text = f"hold in line {programs.line}"
    for _ in range(rng.randint(1, 2) if backs else 0):
        seconds = rng.choice((0.05, 0.5, 2.0, 5.0, 30.0)) * rng.uniform(0.5, 1.0)
        try:
            text += f", back by {(await programs.run_back(ME, seconds)).seconds:.2f} s"
        except RefusedError as refused:
            assert "has not moved" in str(refused) or "not held any more" in str(refused), refused
            continue
        if rng.random() < 0.3:
            await asyncio.sleep(rng.uniform(0.1, 0.6))
            if machine.waiting_for == "" and await machine.hold(ME) and await _until_held(machine):
                text += " (held on the way)"
                if not machine.waiting_for:
                    await machine.resume(ME)
        await until(lambda: machine.waiting_for == "run back")
    await machine.resume(ME)
    return text


async def until(condition: Callable[[], bool]) -> None:
    """Look at it every 20 ms for at most some minutes."""
    async with asyncio.timeout(_HELD_S * 10):
        while not condition():  # noqa: ASYNC110  # polled from outside
            await asyncio.sleep(0.02)


async def _until_held(machine: Machine) -> bool:
    """Wait for rest after a hold; False when the motion ended instead."""
    async with asyncio.timeout(_HELD_S):
        while machine.state is not MachineState.HELD:
            if machine.job is None:
                return False
            await asyncio.sleep(0.02)
    return True

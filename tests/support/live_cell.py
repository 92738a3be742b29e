"""A machine with a program under way on virtual time, and what came out at the pins: for override and running back."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config, load_config
from rm501_host.daemon.service import Service
from rm501_host.motion.mirror import Mirror
from rm501_host.segmenter import PlannedSegment
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.transport import Transport
from rm501_sim_board.emu_transport import running_board, shut_down
from rm501_sim_board.emulator import Emulator
from tests.support.plan_checker import motor_matrix, tool_positions
from tests.support.virtual_machine import homed, running_service

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

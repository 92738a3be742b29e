"""From a command to the first step at the pins, on virtual time: the line and the waits, not the computing.

Beside it the CPU of what runs away from the event loop (planning, the position file, the first segments) up to the
moment at which the start is handed to the link. `python -m benchmarks.jogs` prints the table.
"""

from __future__ import annotations

import asyncio
import inspect
import tempfile
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np

from rm501_host.config import load_config
from rm501_host.daemon.service import Service
from rm501_host.machine import Job, operations
from rm501_host.virtual_time import VirtualLoop
from rm501_protocol.declaration import Message
from rm501_protocol.messages import Start
from rm501_protocol.segment_message import Segment
from rm501_sim_board.emu_transport import running_board, shut_down
from tests.support.virtual_machine import ME, homed, running_service

REPOSITORY = Path(__file__).resolve().parents[1]
LATEST_MS = 100.0
"""From a call to the first step; a person takes 0.1 s for at once."""
_POSE = (0.0, 60.0, -60.0, 60.0, 0.0)
_WAVES = "G21 G90 G64 P1\nG0 X270 Y0 Z250 A0 B0\n" + "".join(
    f"G1 X{270 + 30 * sin(i * 0.3):.3f} Y{40 * cos(i * 0.3) - 40:.3f} F3000\n" for i in range(60)
)
Begin = Callable[[Service], Job | Awaitable[Job]]


@dataclass(frozen=True)
class Begun:
    """How one motion began: virtual ms to the first step, segments handed over before the start, CPU ms."""

    what: str
    first_step_ms: float
    segments: int
    cpu_ms: float


class _CountingLoop(VirtualLoop):
    """Counts the CPU of what runs in its executor."""

    cpu_s = 0.0

    def run_in_executor(self, executor: object, func: Callable[..., Any], *args: Any) -> asyncio.Future[Any]:
        began_s = time.process_time()
        try:
            return super().run_in_executor(executor, func, *args)
        finally:
            self.cpu_s += time.process_time() - began_s


def _commands(service: Service) -> list[tuple[str, Begin]]:
    machine, jogger = service.machine, service.jogger
    x, y, z, a, b, c = machine.arm.program_from_joints(_POSE)
    return [
        ("jog joint waist", lambda s: jogger.start(ME, "joint", "waist", 20.0)),
        ("jog world y", lambda s: jogger.start(ME, "world", "y", 50.0)),
        ("jog world x, 1 mm", lambda s: jogger.start(ME, "world", "x", -50.0, distance=1.0)),
        ("jog tool z", lambda s: jogger.start(ME, "tool", "z", 50.0)),
        ("move.joints", lambda s: operations.move_joints(machine, ME, (40.0, 70.0, -50.0, 40.0, 20.0))),
        ("move.linear", lambda s: operations.move_linear(machine, ME, (x - 50.0, y + 80.0, z, a, b, c))),
        ("mdi", lambda s: s.programs.mdi(ME, f"G1 X{x - 40.0:.3f} Y100 F3000")),
        ("program.run, 60 lines", lambda s: s.programs.run(ME, "waves.ngc")),
    ]


async def _measured() -> list[Begun]:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, _CountingLoop)
    found = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = load_config(REPOSITORY / "configs" / "rm501.toml")
        async with running_service(folder, "emu://starts?preset=ideal&seed=1", config) as service:
            (folder / "programs" / "waves.ngc").write_text(_WAVES + "M2\n")
            await homed(service)
            for what, begin in _commands(service):
                await operations.move_joints(service.machine, ME, _POSE).wait()
                await asyncio.sleep(1.0)
                found.append(await _begun(service, loop, what, begin))
                await service.machine.abort(ME)
        shut_down("starts")
    return found


async def _begun(service: Service, loop: _CountingLoop, what: str, begin: Begin) -> Begun:
    machine, emulator = service.machine, running_board("starts").emulator
    session, periods = machine.session, len(machine.config.board.table)
    handed, cpu_ms = 0, float("nan")
    post = session.post

    def counted(message: Message) -> None:
        nonlocal handed, cpu_ms
        handed += isinstance(message, Segment) and cpu_ms != cpu_ms
        if isinstance(message, Start):
            cpu_ms = loop.cpu_s * 1e3
        post(message)

    session.post = counted  # type: ignore[method-assign]
    try:
        loop.cpu_s = 0.0
        first_frame = emulator.recording.words_written // periods
        before = emulator.recording.positions_steps(np.array([first_frame - 1]))[0, :5]
        started = begin(service)
        job: Job = await started if inspect.isawaitable(started) else started
        while True:
            service.jogger.keep(ME, job.id)
            await asyncio.sleep(0.002)
            frames = np.arange(first_frame, emulator.recording.words_written // periods)
            stepped = np.flatnonzero((emulator.recording.positions_steps(frames)[:, :5] != before).any(axis=1))
            if len(stepped):
                return Begun(what, float(stepped[0]) * machine.frame_s * 1e3, handed, cpu_ms)
    finally:
        session.post = post  # type: ignore[method-assign]


def print_starts() -> bool:
    """Measure and print; whether all of them began in time."""
    with asyncio.Runner(loop_factory=_CountingLoop) as runner:
        found = runner.run(_measured())
    print("from a command to the first step    ms on the line   segments before the start   CPU ms")
    for item in found:
        print(f"  {item.what:33s} {item.first_step_ms:14.1f} {item.segments:27d} {item.cpu_ms:8.1f}")
    return all(item.first_step_ms <= LATEST_MS for item in found)

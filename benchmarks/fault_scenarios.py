"""Faults that need a host doing something particular: one that floods the board, stops in a bad moment, or verifies.

Every scenario is a coroutine for a virtual loop; it returns a complaint, empty when all went as demanded.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from rm501_host.config import load_config
from rm501_host.config.board import board_config_from
from rm501_host.errors import Rm501Error
from rm501_host.kinematics import Arm
from rm501_host.machine import operations
from rm501_host.machine.jogging import Jogger
from rm501_host.machine.verify import verify
from rm501_host.motion import Homing, MotionStream
from rm501_host.session import BoardSession, open_session
from rm501_host.session.board_session import Notice
from rm501_protocol.enums import BoardState, SegmentFlag
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.messages import (
    Hold,
    MotorTerm,
    Refused,
    Reset,
    Resume,
    ResumeCause,
    Segment,
    SetPower,
    Start,
    Status,
)
from rm501_sim_board.emu_transport import open_transport, running_board, shut_down
from rm501_sim_board.running import RunningBoard

Scenario = Callable[[int], Coroutine[Any, Any, str]]

CONFIG = Path(__file__).parents[1] / "configs" / "thesis.toml"
_NAME = "scenario"
_POSE = "-140,95,-82,8,-60"
_SEGMENTS = 60
_SLOTS = 32
_RAMP_FRAMES, _CRUISE_FRAMES = 2000, 100
_STOP_RAMP_FRAMES = 6000
"""Longer than any ramp of a stop: 1.7 s, and some for the way of the message."""


@asynccontextmanager
async def _board(seed: int, *faults: str) -> AsyncIterator[tuple[BoardSession, RunningBoard]]:
    """A board of its own with a session; switched off at the end."""
    given = "".join(f"&fault={fault}" for fault in faults)
    session = await _session(seed, f"emu://{_NAME}?pose={_POSE}&seed={seed}{given}")
    running = running_board(_NAME)
    try:
        yield session, running
    finally:
        await session.aclose()
        shut_down(_NAME)


async def _session(seed: int, url: str) -> BoardSession:
    return await open_session(
        open_transport(url), board_config_from(load_config(CONFIG)), lambda: random.Random(seed).getrandbits(32)
    )


async def _power_on(session: BoardSession) -> None:
    await session.command(SetPower(True), lambda status: status.power and status.state is BoardState.READY)


def _waist_segments(start_frame: int) -> list[Segment]:
    """A long move of the waist in many segments: faster to 0.064 steps a frame, on, slower to rest."""
    acceleration = (round(0.064 * 2**40 / _RAMP_FRAMES) >> 8) << 8
    speed = (acceleration * _RAMP_FRAMES) >> 8
    segments = []
    for number in range(_SEGMENTS):
        first, last = number == 0, number == _SEGMENTS - 1
        length = _RAMP_FRAMES if first or last else _CRUISE_FRAMES
        term = MotorTerm(0, 0 if first else speed, acceleration * (first - last), 0)
        flags = SegmentFlag.ENDS_AT_REST if last else SegmentFlag.NONE
        segments.append(Segment(start_frame & 0xFFFFFFFF, length, (term,), flags, 600, 900))
        start_frame += length
    return segments


def _post_all(session: BoardSession, segments: list[Segment]) -> None:
    """As many as there are slots, the start, and the others behind it: they wait for the slots."""
    for segment in segments[:_SLOTS]:
        session.post(segment)
    session.post(Start())
    for segment in segments[_SLOTS:]:
        session.post(segment)


# ------------------------------------------------------------ row 17


async def flooded_queue(seed: int) -> str:
    """A host that ignores the window: what finds no slot is refused, and nothing of the rest suffers."""
    async with _board(seed) as (session, running):
        honest = await _flood(session, running, flooding=False)
    async with _board(seed) as (session, running):
        complaint = await _flood(session, running, flooding=True)
    return complaint if complaint.startswith("!") else "" if complaint == honest else "other steps than with the window"


async def _flood(session: BoardSession, running: RunningBoard, *, flooding: bool) -> str:
    """Play the waist's segments; the hash of the steps, or a complaint that begins with an exclamation mark."""
    heard: list[Notice] = []
    session.add_listener(heard.append)
    await _power_on(session)
    segments = _waist_segments(session.motion_frames.value)
    accepted = _SEGMENTS
    if flooding:
        # The host's own link keeps to the window; it takes a false report to make it flood the board.
        running.faults.inject("queue-lie:slots=255")
        await session.refresh_status()
        for segment in segments[:40]:
            session.post(segment)
        await asyncio.sleep(0.4)
        session.post(Start())
        await asyncio.sleep(0.1)
        for segment in segments[40:]:
            session.post(segment)
        await asyncio.sleep(0.3)
        status = await session.refresh_status()
        refused = [notice for notice in heard if isinstance(notice, Refused)]
        accepted = _SLOTS
        end_frame = segments[accepted].start_frames
        if len(refused) != _SEGMENTS - accepted:
            return f"!{len(refused)} segments refused, {_SEGMENTS - accepted} expected"
        if any(r.reason is not RefusalReason.QUEUE_FULL or r.limit & 0xFFFFFFFF != end_frame for r in refused):
            return f"!refused for another reason, or without the queue's end: {refused[0]}"
        if (status.state, status.queue_free, status.queue_end_frame) != (BoardState.RUNNING, 0, end_frame):
            return f"!the status does not tell how things stand: {status}"
        running.faults.clear("queue-lie")
        await session.refresh_status()
        for segment in segments[accepted:]:
            session.post(segment)
    else:
        _post_all(session, segments)
    await asyncio.sleep(6.0)
    states = {notice.state for notice in heard if isinstance(notice, Status)}
    if states & {BoardState.HOLDING, BoardState.HELD, BoardState.FAULT}:
        return f"!the board did not keep playing: {states}"
    if session.motion_frames.value != segments[-1].end_frames:
        return f"!motion ended at frame {session.motion_frames.value}"
    running.board.run_to_now()
    return running.emulator.recording.step_sequence_hash()


# ------------------------------------------------------------ row 28


async def _stop_wins(session: BoardSession, running: RunningBoard, *, moving: bool = True) -> str:
    """STOP now; then look whether anything sent before it still moves the arm, also after a reset with power."""
    frame = running.emulator.frame
    before = running.truth().commanded_steps
    await session.stop()
    return await _stopped_for_good(session, running, frame, before, moving=moving)


async def _stopped_for_good(
    session: BoardSession, running: RunningBoard, frame: int, before: tuple[int, ...], *, moving: bool
) -> str:
    await asyncio.sleep(3.0)
    stopped = running.truth().commanded_steps
    status = await session.refresh_status()
    if status.state is not BoardState.IDLE or status.power or status.queue_used:
        return f"after the stop the board is {status.state.name}, power {status.power}, {status.queue_used} queued"
    if moving and stopped == before:
        return "the arm did not ramp down: it was not moving when the stop came"
    recording = running.emulator.recording
    last = max((int(f[-1]) for f, _ in map(recording.step_frames, range(5)) if len(f)), default=0)
    if last - frame > _STOP_RAMP_FRAMES:
        return f"the last step came {last - frame} frames after the stop"
    session.post(Reset(FaultCode.NONE))
    await _power_on(session)
    with contextlib.suppress(Rm501Error):
        session.post(Resume(ResumeCause.USER))
        session.post(Start())
    await asyncio.sleep(3.0)
    if running.truth().commanded_steps != stopped:
        return "what was queued before the stop ran after it"
    _post_all(session, _waist_segments((await session.refresh_status()).motion_frame))
    await asyncio.sleep(6.0)
    made = running.truth().commanded_steps[0] - stopped[0]
    wanted = round(0.064 * (_RAMP_FRAMES + (_SEGMENTS - 2) * _CRUISE_FRAMES))
    return "" if abs(made - wanted) <= 1 else f"a new move made {made} steps instead of {wanted}"


async def _flow(session: BoardSession, running: RunningBoard) -> None:
    """The waist on its long way, more segments waiting than the board has slots."""
    await _power_on(session)
    _post_all(session, _waist_segments(session.motion_frames.value))
    await asyncio.sleep(0.9)


async def stop_while_homing(seed: int) -> str:
    """STOP at 6 s of homing."""
    config = load_config(CONFIG)
    async with _board(seed) as (session, running):
        stream = MotionStream(session, config, someone_resumes=False)
        await stream.prepare()
        homing = asyncio.create_task(Homing(stream, Arm.from_config(config), config).home_all())
        loop = asyncio.get_running_loop()
        await _until(lambda: loop.time() >= 6.0 and _moves(session))
        frame, before = running.emulator.frame, running.truth().commanded_steps
        await session.stop()
        with contextlib.suppress(Rm501Error):
            await homing
            return "homing ended as if nothing had happened"
        stream.detach()
        return await _stopped_for_good(session, running, frame, before, moving=True)


async def stop_while_held(seed: int) -> str:
    """STOP while the arm is held on its path with segments queued."""
    async with _board(seed) as (session, running):
        await _flow(session, running)
        session.post(Hold())  # `command` would wait for the segments that wait for slots
        await _until(lambda: session.status is not None and session.status.state is BoardState.HELD)
        return await _stop_wins(session, running, moving=False)


async def stop_while_retransmitting(seed: int) -> str:
    """STOP while lost segments are being sent again."""
    async with _board(seed, "drop:p=0.02,to=board@0.1s/1.9s") as (session, running):
        await _flow(session, running)
        sent = session.link.stats.retransmits
        await _until(lambda: session.link.stats.retransmits > sent and bool(session.link.unacknowledged))
        return await _stop_wins(session, running)


async def stop_while_shaking_hands(seed: int) -> str:
    """Another host connects to a moving arm and stops it before its handshake is through."""
    async with _board(seed) as (session, running):
        await _flow(session, running)
        await session.aclose()
        nonces = random.Random(seed + 1)
        second = BoardSession(await open_transport(f"emu://{_NAME}"), lambda: nonces.getrandbits(32))
        try:
            handshake = asyncio.create_task(second.handshake(board_config_from(load_config(CONFIG))))
            await asyncio.sleep(0)
            if second.link.is_open:
                return "the handshake was through before the stop"
            frame, before = running.emulator.frame, running.truth().commanded_steps
            await second.stop()
            await handshake
            return await _stopped_for_good(second, running, frame, before, moving=True)
        finally:
            await second.aclose()


async def stop_while_jogging(seed: int) -> str:
    """STOP during a continuous jog whose key stays down."""
    from tests.support.virtual_machine import ME, running_service

    name = "jogged"
    with tempfile.TemporaryDirectory() as folder:
        async with running_service(Path(folder), f"emu://{name}?pose={_POSE}&seed={seed}") as service:
            machine = service.machine
            await machine.reset(ME)
            jogger = Jogger(machine)
            job = jogger.start(ME, "joint", "waist", 10.0)
            for _ in range(15):
                await asyncio.sleep(0.1)
                jogger.keep(ME, job.id)
            running = running_board(name)
            frame, before = running.emulator.frame, running.truth().commanded_steps
            await machine.stop(ME)
            for _ in range(10):
                await asyncio.sleep(0.1)
                jogger.keep(ME, job.id)
            with contextlib.suppress(Rm501Error):
                await job.wait()
                return "the jog ended as if nothing had happened"
            complaint = await _stopped_for_good(machine.session, running, frame, before, moving=True)
        shut_down(name)
    return complaint


async def _until(condition: Callable[[], bool]) -> None:
    """Look every 2 ms of virtual time; TimeoutError after 20 s."""
    async with asyncio.timeout(20.0):
        while not condition():  # noqa: ASYNC110  # a plain poll, virtual time costs nothing
            await asyncio.sleep(0.002)


def _moves(session: BoardSession) -> bool:
    return session.status is not None and session.status.state is BoardState.RUNNING


# ------------------------------------------------------------ row 14


async def lost_steps_verified(seed: int) -> str:
    """Steps lost after homing: `verify` finds them, on that joint and on no other."""
    from tests.support.virtual_machine import ME, homed, running_service

    name = "verified"
    with tempfile.TemporaryDirectory() as folder:
        async with running_service(Path(folder), f"emu://{name}?pose={_POSE}&seed={seed}") as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, (0.0, 60.0, -60.0, 60.0, 0.0)).wait()
            running_board(name).faults.inject("lost-steps:motor=waist,n=40")
            found = await verify(machine, ME).wait()
        shut_down(name)
    joints = found["joints"]
    assert isinstance(joints, list)
    lost = {joint["joint"]: joint["lost_steps"] for joint in joints}
    suspects = [joint["joint"] for joint in joints if joint["suspicious"]]
    if suspects != ["waist"] or abs(abs(lost["waist"]) - 40) > 4:
        return f"verify found {lost}"
    return ""

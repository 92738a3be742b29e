"""Jogs on the emulated board: how they end by themselves, where they stop, how straight they go, before homing too."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import pytest

from rm501_host.errors import RefusedError
from rm501_host.machine import MachineState, operations
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, homed, running_service

START = (0.0, 60.0, -60.0, 60.0, 0.0)
STRAIGHT_DOWN = (0.0, 58.8, -83.7, 24.9, 0.0)
"""The one orientation that five joints can keep in every horizontal direction."""


def virtual(test: Coroutine[Any, Any, None]) -> None:
    run_virtual(test)


def test_a_jog_ends_by_itself_when_nobody_keeps_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, jogger = service.machine, service.jogger
            loop = asyncio.get_running_loop()
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            job = jogger.start(ME, "joint", "waist", 20)
            for _ in range(10):
                await asyncio.sleep(0.1)
                assert jogger.keep(ME, job.id)
            last_s = loop.time()
            await job.wait()
            # the lease of 200 ms, then the ramp from 20 deg/s
            assert 0.15 < loop.time() - last_s < 0.9
            assert machine.state is MachineState.IDLE and machine.arm_state.homed == (True,) * 5
            assert not jogger.keep(ME, job.id)
            at = machine.arm_state.joints_deg
            await asyncio.sleep(3)
            assert machine.arm_state.joints_deg == at

    virtual(scenario())


@pytest.mark.parametrize(
    ("frame", "axis", "speed", "moved"),
    [
        ("world", "x", 40.0, (1, 0, 0)),
        ("world", "y", -40.0, (0, -1, 0)),
        ("world", "z", 40.0, (0, 0, 1)),
        ("tool", "z", 40.0, None),
        ("tool", "x", -40.0, None),
    ],
)
def test_cartesian_jogs_go_straight_and_keep_the_orientation(
    tmp_path: Path, frame: str, axis: str, speed: float, moved: tuple[int, ...] | None
) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            pose = START if frame == "tool" else STRAIGHT_DOWN
            await operations.move_joints(machine, ME, pose).wait()
            before = operations.position(machine)
            tool = machine.arm.fk(pose).rotation[:, "xyz".index(axis)]
            await service.jogger.start(ME, frame, axis, speed, distance=20.0).wait()
            after = operations.position(machine)
            step = [b - a for a, b in zip(before[:3], after[:3], strict=True)]
            direction = moved if moved is not None else (machine.arm.frame.rotation.T @ tool * (1 if speed > 0 else -1))
            assert step == pytest.approx([20.0 * part for part in direction], abs=0.25)
            assert after[3:] == pytest.approx(before[3:], abs=0.1)

    virtual(scenario())


def test_jogs_stop_at_the_limits_and_refuse_to_start_beyond(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, jogger = service.machine, service.jogger
            await homed(service)
            await operations.move_joints(machine, ME, (140.0, 60.0, -60.0, 60.0, 0.0)).wait()
            job = jogger.start(ME, "joint", "waist", 1000)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            assert job.error is None and machine.arm_state.joints_deg[0] == pytest.approx(150.0, abs=0.03)
            with pytest.raises(RefusedError, match="at its limit 150"):
                await jogger.start(ME, "joint", "waist", 5).wait()
            with pytest.raises(RefusedError, match="no joint"):
                jogger.start(ME, "joint", "knee", 5)
            with pytest.raises(RefusedError, match="no axis"):
                jogger.start(ME, "tool", "a", 5)
            # straight out until the arm is stretched: ends before, without a fault
            job = jogger.start(ME, "tool", "z", 200)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            assert job.error is None and machine.state is MachineState.IDLE
            limits = machine.config.joints.ordered
            for angle, joint in zip(machine.arm_state.joints_deg, limits, strict=True):
                assert joint.min_deg - 0.03 <= angle <= joint.max_deg + 0.03

    virtual(scenario())


def test_unhomed_joints_jog_slowly_and_not_far(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine, jogger = service.machine, service.jogger
            await machine.reset(ME)
            loop = asyncio.get_running_loop()
            began_s = loop.time()
            job = jogger.start(ME, "joint", "waist", 30)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            assert machine.arm_state.joints_deg[0] == pytest.approx(30.0, abs=0.03)
            # a fifth of 30 deg/s
            assert loop.time() - began_s > 30.0 / 6.0
            assert machine.arm_state.homed == (False,) * 5

    virtual(scenario())

"""Limits that are lowered at run time: bounded by the file, used from the next motion on, forgotten by reset."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest

from rm501_host.errors import RefusedError
from rm501_host.machine import operations
from rm501_host.machine.limits import RuntimeLimits
from rm501_host.machine.trajectories import TimedPoints, follow
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, homed, running_service, thesis_config

START = (0.0, 60.0, -60.0, 60.0, 0.0)
TURNED = (60.0, *START[1:])


def test_lower_limits_hold_from_the_next_motion_on(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            loop = asyncio.get_running_loop()
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            fastest = {"waist": 0.0, "tool": 0.0}

            async def turn(target: tuple[float, ...]) -> float:
                began_s = loop.time()
                job = operations.move_joints(machine, ME, target)
                before, before_s = machine.arm_state.joints_deg, loop.time()
                fastest.update(waist=0.0, tool=0.0)
                while not job.done.is_set():
                    await asyncio.sleep(0.2)
                    now, now_s = machine.arm_state.joints_deg, loop.time()
                    moved = machine.arm.fk(now).xyz_mm - machine.arm.fk(before).xyz_mm
                    fastest["waist"] = max(fastest["waist"], abs(now[0] - before[0]) / (now_s - before_s))
                    fastest["tool"] = max(fastest["tool"], float(moved @ moved) ** 0.5 / (now_s - before_s))
                    before, before_s = now, now_s
                await job.wait()
                return loop.time() - began_s

            full_s = await turn(TURNED)
            assert fastest["waist"] > 25.0
            status = service.status()
            assert not status.limits_reduced and status.velocity_limits_deg_s[0] == 30.0

            machine.limits.set(velocity_deg_s={"waist": 10.0})
            assert service.status().limits_reduced and service.status().velocity_limits_deg_s[0] == 10.0
            slow_s = await turn(START)
            assert 8.0 < fastest["waist"] < 12.0 and slow_s > 2.2 * full_s

            machine.limits.reset()
            assert not service.status().limits_reduced
            machine.limits.set(tcp_speed_mm_s=40.0)
            await turn(TURNED)
            assert 30.0 < fastest["tool"] < 44.0
            with pytest.raises(RefusedError, match=r"x the speed that is allowed for the tool"):
                await follow(machine, ME, TimedPoints((START,), (4.0,)))
            job = await follow(machine, ME, TimedPoints((START,), (4.0,)), stretch=True)
            assert (await job.wait())["slowed_by"] > 1.5

            machine.limits.reset()
            machine.limits.set(acceleration_deg_s2={"waist": 5.0})
            assert await turn(TURNED) > 6.0  # 2 sqrt(60 / 5) s and more

    run_virtual(scenario())


def test_the_file_is_the_most_and_a_change_is_all_or_nothing() -> None:
    limits = RuntimeLimits(thesis_config())
    assert limits.in_force == limits.hard and not limits.are_reduced
    for wrong, why in (
        ({"velocity_deg_s": {"waist": 31.0}}, r"joints.waist.max_velocity_deg_s 31 is not within 0.3 to 30"),
        ({"velocity_deg_s": {"waist": 0.1}}, r"0.1 is not within 0.3 to 30"),
        ({"velocity_deg_s": {"waist": float("nan")}}, "nan is not within"),
        ({"acceleration_deg_s2": {"elbow": 21.0}}, r"joints.elbow.max_acceleration_deg_s2 21 .* edit it and restart"),
        ({"velocity_deg_s": {"knee": 1.0}}, "no joint 'knee'"),
        ({"tcp_speed_mm_s": 0.5}, "planner.tcp_max_speed_mm_s 0.5 is not within 1:"),
        ({"velocity_deg_s": {"waist": 10.0}, "acceleration_deg_s2": {"waist": -1.0}}, "-1 is not within"),
    ):
        with pytest.raises(RefusedError, match=why):
            limits.set(**wrong)  # type: ignore[arg-type]  # several kinds of values in one table
        assert not limits.are_reduced
    limits.set({"waist": 10.0}, {"waist": 50.0}, 100.0)
    limits.set({"elbow": 5.0})
    joints = limits.config.joints
    assert (joints.waist.max_velocity_deg_s, joints.waist.max_acceleration_deg_s2) == (10.0, 50.0)
    assert joints.elbow.max_velocity_deg_s == 5.0 and limits.in_force.tcp_speed_mm_s == 100.0
    limits.set({"waist": 30.0})  # up again, to the file's
    assert limits.config.joints.waist.max_velocity_deg_s == 30.0
    assert limits.config.board == limits.file.board and limits.config.motors == limits.file.motors
    limits.reset()
    assert limits.config is limits.file


def test_a_limit_of_the_file_on_the_tool_is_the_most_too() -> None:
    config = thesis_config()
    config = msgspec.structs.replace(config, planner=msgspec.structs.replace(config.planner, tcp_max_speed_mm_s=80.0))
    limits = RuntimeLimits(config)
    with pytest.raises(RefusedError, match="90 is not within 1 to 80"):
        limits.set(tcp_speed_mm_s=90.0)
    limits.set(tcp_speed_mm_s=20.0)
    limits.reset()
    assert limits.in_force.tcp_speed_mm_s == 80.0

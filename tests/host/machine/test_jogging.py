"""Jogs on the emulated board: through singularities, lost on the way, before zones, and unhomed beside a switch."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.config.schema import BoxSection
from rm501_host.errors import RefusedError
from rm501_host.machine import MachineState, operations
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, REPOSITORY, homed, running_service

PLAIN = load_config(REPOSITORY / "configs" / "rm501.toml")
BOX = BoxSection(name="vice", min_mm=(150.0, 200.0, 0.0), max_mm=(400.0, 400.0, 900.0))
ZONED = msgspec.structs.replace(PLAIN, keep_out=msgspec.structs.replace(PLAIN.keep_out, boxes=(BOX,)))
START = (0.0, 60.0, -60.0, 60.0, 0.0)
BACK = (0.0, 85.0, -30.0, 172.0, 0.0)
"""The tool leans back; 17 mm before the waist axis, 2 mm beside it once it has been jogged there."""


def test_jogs_pass_the_waist_axis_end_on_their_path_and_heed_zones(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path, config=ZONED) as service:
            machine, jogger = service.machine, service.jogger
            await homed(service)
            await operations.move_joints(machine, ME, BACK).wait()

            # 2 mm beside the waist axis, x decreasing: through, damped, and on to a joint's limit
            await jogger.start(ME, "world", "y", 20.0, distance=2.0).wait()
            arm = machine.arm
            start = arm.fk(machine.planning_start_deg).xyz_mm
            job = jogger.start(ME, "world", "x", -40.0)
            seen = []
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                seen.append((service.status().jog_damped, *arm.fk(machine.arm_state.joints_deg).xyz_mm))
                await asyncio.sleep(0.05)
            result = await job.wait()
            assert result["damped"] and "limit" in str(result["ended"]) and result["deviation_mm"] < 6.0
            assert {damped for damped, *_ in seen} == {False, True} and not service.status().jog_damped
            places = np.array([place for _, *place in seen])
            damped = np.array([flag for flag, *_ in seen])
            assert places[-1, 0] < -15.0 < 15.0 < start[0] + 20.0
            assert np.hypot(places[damped][:, 0], places[damped][:, 1]).max() < 20.0, "damped near the axis alone"
            assert (np.diff(places[:, 0]) < 0.2).all(), "never back"

            # nobody keeps it any more, at several moments of a way of many short segments: each time it ends well
            for kept_s in (0.3, 0.6, 1.1):
                job = jogger.start(ME, "world", "x", 20.0)
                for _ in range(round(kept_s / 0.05)):
                    jogger.keep(ME, job.id)
                    await asyncio.sleep(0.05)
                result = await job.wait()
                assert result["damped"] and "ended" not in result, "it did not come to the end of its way"
                assert machine.state is MachineState.IDLE and machine.arm_state.homed == (True,) * 5
                rest = machine.arm_state.joints_deg
                await asyncio.sleep(1.0)
                assert machine.arm_state.joints_deg == rest == pytest.approx(machine.planning_start_deg, abs=0.02)

            # a joint's jog ends before a zone, and the next is refused
            await operations.move_joints(machine, ME, (0.0, 60.0, -60.0, 60.0, 0.0)).wait()
            job = jogger.start(ME, "joint", "waist", 30.0)
            while not job.done.is_set():
                jogger.keep(ME, job.id)
                await asyncio.sleep(0.05)
            result = await job.wait()
            assert "vice" in str(result["ended"]) and 20.0 < machine.arm_state.joints_deg[0] < 90.0
            with pytest.raises(RefusedError, match="vice"):
                await jogger.start(ME, "joint", "waist", 30.0).wait()
            with pytest.raises(RefusedError, match="no axis C"):
                await jogger.start(ME, "world", "c", 30.0).wait()
            assert machine.state is MachineState.IDLE

    run_virtual(scenario())


def test_an_unhomed_joint_leaves_its_active_switch_only(tmp_path: Path) -> None:
    async def scenario() -> None:
        url = "emu://?preset=ideal&seed=1&pose=-150.3,60,-60,0.1,0"
        async with running_service(tmp_path, url=url, config=PLAIN) as service:
            machine, jogger = service.machine, service.jogger
            await machine.reset(ME)
            with pytest.raises(RefusedError, match="SWITCH_WAIST is active; jog the other way or home"):
                await jogger.start(ME, "joint", "waist", -5.0, distance=1.0).wait()
            assert machine.arm_state.steps[0] == 0
            await jogger.start(ME, "joint", "waist", 5.0, distance=1.0).wait()
            assert machine.arm_state.joints_deg[0] == pytest.approx(1.0, abs=0.03)
            # off the switch both ways are free again; the pitch works past its own
            await jogger.start(ME, "joint", "waist", -5.0, distance=0.1).wait()
            await jogger.start(ME, "joint", "pitch", -5.0, distance=1.0).wait()

    run_virtual(scenario())


def test_what_an_aborted_jog_leaves_on_the_line_does_not_end_the_next_motion(tmp_path: Path) -> None:
    """Its lease runs out while the arm comes to rest; the report of that may come after the status that shows it."""

    async def scenario() -> None:
        async with running_service(tmp_path, config=PLAIN) as service:
            machine, jogger = service.machine, service.jogger
            await homed(service)
            for kept in (3, 5, 11, 13, 16, 20):
                await operations.move_joints(machine, ME, START).wait()
                assert machine.arm_state.joints_deg == pytest.approx(START, abs=0.03)
                job = jogger.start(ME, "world", "x", -50.0)
                for _ in range(kept):
                    jogger.keep(ME, job.id)
                    await asyncio.sleep(0.01)
                await asyncio.sleep(0.004)
                assert await machine.hold(ME), "a jog that is held ends"
                await operations.move_joints(machine, ME, (10.0, *START[1:])).wait()

    run_virtual(scenario())

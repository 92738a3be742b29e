"""An arm with play on the emulated board: where its link really stands, and what is known of it after any stop.

The bench is the preset `real` with play in the waist's gear, where no gravity presses the link against one flank, and a
drive there that follows within a step: what is left between command and link is the play.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rm501_host.config import Config
from rm501_host.config.board import board_config_from
from rm501_host.errors import StoppedError
from rm501_host.kinematics import Arm
from rm501_host.machine import operations
from rm501_host.machine.verify import verify
from rm501_host.motion import Homing, MotionStream
from rm501_host.planner import plan_joint_move
from rm501_host.session import open_session
from rm501_host.transports import open_transport
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.emu_transport import running_board
from rm501_sim_board.presets import PRESETS, tuned_servo
from tests.support.play import with_backlash
from tests.support.virtual_machine import ME, homed, running_service, thesis_config

PLAY_DEG = 0.6
STIFF = thesis_config()
LOOSE = with_backlash(STIFF, (PLAY_DEG, 0.0, 0.0, 0.0, 0.0))
POSE = (0.0, 60.0, -60.0, 60.0, 0.0)
ONE_STEP_DEG = 0.025
SWITCH_ERROR_DEG = 0.36
"""Where the waist's switch of the preset really releases, beside its nominal place."""


@pytest.fixture(autouse=True)
def loose_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    real = PRESETS["real"]
    assert real.servos is not None
    waist = tuned_servo(
        40.0,
        1.2,
        25.0,
        1.0,
        0.0,
        viscous_nm_s_rad=12.0,
        coulomb_nm=0.3,
        stiction_ratio=1.0,
        torque_limit_nm=300.0,
        stall_torque_nm=600.0,
        no_load_deg_s=110.0,
        backlash_deg=PLAY_DEG,
    )
    switch = replace(real.switches[0], repeatability_deg=0.0)
    bench = replace(real, servos=(waist, *real.servos[1:]), switches=(switch, *real.switches[1:]))
    monkeypatch.setitem(PRESETS, "loose", bench)


def link_deg() -> float:
    """Where the link of the waist truly is."""
    return running_board("loose").emulator.truth().joint_deg[0]


async def waist_errors(config: Config, pose: float) -> list[float]:
    """Truth less command of the waist at home, then after moves up, up, down, down, up a little, down a little."""
    arm = Arm.from_config(config)
    url = f"emu://loose?preset=loose&seed=3&pose={pose},60,-60,60,0"
    session = await open_session(open_transport(url), board_config_from(config), lambda: 7)
    try:
        stream = MotionStream(session, config, someone_resumes=False)
        await stream.prepare()
        await Homing(stream, arm, config).home_joint(0)
        await asyncio.sleep(0.5)
        found = [link_deg()]
        for angle in (10.0, 20.0, 5.0, -5.0, -4.6, -4.9):
            motors = np.array(stream.positions_q48[:5]) / 2.0**48
            start = arm.joints_from_motors(motors) - np.array(stream.offsets.deg)
            await stream.play(plan_joint_move(arm, config, start, (angle, *start[1:]), ignore_limits=True))
            await asyncio.sleep(0.5)
            found.append(link_deg() - angle)
        return found
    finally:
        await session.aclose()


def test_the_link_comes_to_the_same_place_from_both_sides() -> None:
    stiff = run_virtual(waist_errors(STIFF, -120.0))
    loose = run_virtual(waist_errors(LOOSE, -120.0))
    assert np.ptp(stiff) == pytest.approx(PLAY_DEG, abs=1.5 * ONE_STEP_DEG)
    assert np.ptp(loose) <= 1.5 * ONE_STEP_DEG


def test_homing_leaves_the_link_where_the_switch_says() -> None:
    """Whichever way the first search went: from above the switch, and from on it."""
    for pose in (-150.3, -100.0):
        errors = run_virtual(waist_errors(LOOSE, pose))
        assert np.array(errors) == pytest.approx(SWITCH_ERROR_DEG, abs=0.09)


def test_the_play_is_known_after_an_abort_in_another_daemon_and_for_verify(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path, "emu://loose?preset=loose&seed=3", LOOSE) as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, (10.0, *POSE[1:])).wait()
            assert machine.stream is not None
            assert machine.stream.offsets.deg[0] == PLAY_DEG / 2

            # ended in the middle of a take-up
            job = operations.move_joints(machine, ME, (-20.0, *POSE[1:]))
            async with asyncio.timeout(5):
                while not -0.25 < machine.arm_state.offsets_deg[0] < 0.2:  # noqa: ASYNC110  # polled from outside
                    await asyncio.sleep(0.001)
            await machine.abort(ME)
            with pytest.raises(StoppedError):
                await job.wait()
            await asyncio.sleep(0.3)
            assert -PLAY_DEG / 2 < machine.stream.offsets.deg[0] < PLAY_DEG / 2
            assert machine.stream.offsets.deg == machine.arm_state.offsets_deg
            assert machine.arm_state.joints_deg[0] == pytest.approx(machine.planning_start_deg[0], abs=0.03)

            # back the way it came, and from the other side
            for angle, side in ((12.0, 1), (-12.0, -1)):
                await operations.move_joints(machine, ME, (angle, *POSE[1:])).wait()
                await asyncio.sleep(0.5)
                assert link_deg() - angle == pytest.approx(SWITCH_ERROR_DEG, abs=0.09)
                assert machine.arm_state.offsets_deg == (side * PLAY_DEG / 2, 0.0, 0.0, 0.0, 0.0)
                assert machine.arm_state.joints_deg[0] == pytest.approx(angle, abs=ONE_STEP_DEG)

            # another daemon finds it in the position file, and says so where it does not
            joints = machine.arm_state.joints_deg
            identify, status = machine.session.link.identify, machine.board_status
            assert identify is not None and status is not None
            fresh = type(machine.arm_state)(machine.arm, LOOSE, machine.arm_state._file, lambda: "")
            assert "not known" not in fresh.connected(identify, status)
            assert fresh.joints_deg == joints
            assert machine.arm_state.save(dirty=True)
            text = fresh.connected(identify, status)
            assert "on which side of its play each joint stands is not known (waist)" in text
            assert fresh.joints_deg[0] == pytest.approx(joints[0] - PLAY_DEG / 2)

            await operations.move_joints(machine, ME, (-140.0, *POSE[1:])).wait()
            verified = verify(machine, ME, ["waist"])
            await verified.wait()
            (result,) = verified.result["joints"]
            assert abs(result["lost_deg"]) <= 2 * ONE_STEP_DEG

    run_virtual(scenario())

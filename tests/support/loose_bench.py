"""The emulated arm with play in the waist's gear, and a run on it that turns the waist round several times.

It is the preset `real` with play there, where no gravity presses the link against one flank, and with a drive that
follows within a step: what is left between command and link is the play. Nothing is random.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np

from rm501_host.config import Config
from rm501_host.config.board import board_config_from
from rm501_host.kinematics import Arm
from rm501_host.motion import Homing, MotionStream
from rm501_host.planner import plan_joint_move
from rm501_host.session import open_session
from rm501_host.transports import open_transport
from rm501_sim_board.emu_transport import running_board
from rm501_sim_board.presets import PRESETS, BenchParameters, tuned_servo

LOOSE = "loose"
"""Name of the preset, once it is put into PRESETS, and of the board."""
SWITCH_ERROR_DEG = 0.36
"""Where the waist's switch of the preset really releases, beside its nominal place."""


def loose_bench(play_deg: float) -> BenchParameters:
    """The bench; `play_deg` is the whole play of the waist."""
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
        backlash_deg=play_deg,
    )
    others = (replace(servo, drift_nm=0.0, friction_scatter=0.0, backlash_deg=0.0) for servo in real.servos[1:])
    switches = tuple(replace(switch, repeatability_deg=0.0) for switch in real.switches)
    return replace(real, servos=(waist, *others), switches=switches)


def link_deg() -> float:
    """Where the link of the waist truly is."""
    return running_board(LOOSE).emulator.truth().joint_deg[0]


async def waist_errors_deg(config: Config, pose_deg: float) -> list[float]:
    """Truth less command of the waist after homing it, then after moves up, up, down, down, up and down a little.

    `pose_deg`: where the waist stands at power-up. The preset must be in PRESETS.
    """
    arm = Arm.from_config(config)
    url = f"emu://{LOOSE}?preset={LOOSE}&seed=3&pose={pose_deg},60,-60,60,0"
    session = await open_session(open_transport(url), board_config_from(config), lambda: 7)
    try:
        stream = MotionStream(session, config, someone_resumes=False)
        await stream.prepare()
        await Homing(stream, arm, config).home_joint(0)
        await asyncio.sleep(0.5)
        found = [link_deg() - config.home_deg[0]]
        for angle in (10.0, 20.0, 5.0, -5.0, -4.6, -4.9):
            motors = np.array(stream.positions_q48[:5]) / 2.0**48
            start = arm.joints_from_motors(motors) - np.array(stream.offsets.deg)
            await stream.play(plan_joint_move(arm, config, start, (angle, *start[1:]), ignore_limits=True))
            await asyncio.sleep(0.5)
            found.append(link_deg() - angle)
        return found
    finally:
        await session.aclose()

"""Touching the switches again: how many steps were lost since homing.

The board has no encoders, so a motor that slipped shows only where something fixed is touched. Each joint goes to its
switch, closes it, leaves it slowly, and the count latched at the release edge is compared with the one at which homing
put the switch. Nothing is set; the arm then goes back to where it was.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from rm501_host.config import JOINT_NAMES
from rm501_host.errors import StoppedError
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.operations import joint_indices
from rm501_host.motion import MotionStream
from rm501_host.motion.offsets import flank_deg
from rm501_host.planner import Limits, plan_joint_move
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import Edge
from rm501_protocol.messages import TriggerReport

APPROACH_DEG = 3.0
"""From so far away the switch is approached at the latch speed."""
PAST_DEG = 8.0
"""A switch farther from its place than this has moved, or the arm has lost more than `verify` can measure."""
SUSPICIOUS_STEPS = 8.0
"""0.2 deg: more than the repeatability of switches (0.05 to 0.1 deg) explains."""


def verify(machine: Machine, who: Owner, joints: Sequence[str] = ()) -> Job:
    """Measure the lost steps of homed joints (all without names); the result has them per joint."""
    wanted = joint_indices(joints) or list(range(len(JOINT_NAMES)))

    async def body(job: Job) -> None:
        assert machine.stream is not None
        start = machine.planning_start_deg
        found = []
        for index in wanted:
            lost_deg = await _measure(machine, machine.stream, index)
            steps_per_deg = machine.config.motors.ordered[index].steps_per_deg
            lost_steps = lost_deg * steps_per_deg
            found.append(
                {
                    "joint": JOINT_NAMES[index],
                    "lost_deg": round(lost_deg, 4),
                    "lost_steps": round(lost_steps, 1),
                    "suspicious": abs(lost_steps) > SUSPICIOUS_STEPS,
                }
            )
            await _go(machine, machine.stream, start)
        machine.write_log("verify", joints=found)
        job.result["joints"] = found

    return machine.start_job(JobKind.HOME, who, body)


async def _measure(machine: Machine, stream: MotionStream, index: int) -> float:
    """Angle at which the switch releases, less the angle at which homing saw it release."""
    home = machine.config.joints.ordered[index].home
    away = -1.0 if home.active == "above" else 1.0
    target = list(machine.planning_start_deg)
    target[index] = home.switch_deg + away * APPROACH_DEG
    await _go(machine, stream, target)
    speed = abs(home.latch_deg_s)
    if await _seek(machine, stream, index, -away * (APPROACH_DEG + PAST_DEG), speed, Edge.RISING) is None:
        raise _missing(index, "did not close")
    report = await _seek(machine, stream, index, away * 2 * PAST_DEG, speed, Edge.FALLING)
    if report is None:
        raise _missing(index, "did not release")
    # leaving the switch, the link hangs on the flank of that direction
    flank = flank_deg(Limits.from_config(machine.config), stream.offsets, index, away)
    latched = float(machine.arm.joints_from_motors(report.positions_steps[:5])[index])
    return latched - flank - home.switch_deg


async def _seek(
    machine: Machine, stream: MotionStream, index: int, travel_deg: float, speed_deg_s: float, edge: Edge
) -> TriggerReport | None:
    start = machine.planning_start_deg
    target = list(start)
    target[index] += travel_deg
    pieces = plan_joint_move(
        machine.arm, machine.config, start, target, max_velocity_deg_s=speed_deg_s, ignore_limits=True
    )
    switch = InputId[machine.config.joints.ordered[index].home.input]
    return await stream.play_until(pieces, switch, edge)


async def _go(machine: Machine, stream: MotionStream, target: Sequence[float]) -> None:
    start = machine.planning_start_deg
    loop = asyncio.get_running_loop()
    pieces = await loop.run_in_executor(
        None, lambda: plan_joint_move(machine.arm, machine.config, start, target, speed_scale=0.5, ignore_limits=True)
    )
    if pieces:
        await stream.play(pieces)


def _missing(index: int, what: str) -> StoppedError:
    return StoppedError(
        f"verify {JOINT_NAMES[index]}: the switch {what} within {PAST_DEG} deg of its place; "
        "the joint has lost many steps, or its switch has moved: home it, then look at the switch"
    )

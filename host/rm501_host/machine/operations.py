"""The motions that people and programs ask for outside G-code: home, go to joints, go straight, hand.

Every function checks everything it can before the job starts, so that a refusal comes at once and nothing moves; the
job itself then plans away from the event loop and plays.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

import numpy as np

from rm501_host.config import JOINT_NAMES
from rm501_host.errors import RefusedError
from rm501_host.kinematics.results import Target6
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.states import MachineState
from rm501_host.machine.zones import refuse_zones
from rm501_host.motion import Homing
from rm501_host.moves import Feed, HandMove, LinearMove, Move, Source
from rm501_host.planner import Piece, Planner, plan_joint_move

TEACH_SPEED_MM_S = 250.0
"""Limit of the tool's speed for motion that a person commands by hand (ISO 10218's reduced speed)."""
_WRIST = (3, 4)


def home(machine: Machine, who: Owner, joints: Sequence[str] = ()) -> Job:
    """Home joints (all without names) in the configured sequence; the wrist's two joints home together."""
    wanted = set(joint_indices(joints)) or set(range(len(JOINT_NAMES)))
    if wanted & set(_WRIST):
        wanted |= set(_WRIST)
    order = sorted(wanted, key=lambda index: machine.config.joints.ordered[index].home.sequence)

    async def body(job: Job) -> None:
        assert machine.stream is not None
        homing = Homing(machine.stream, machine.arm, machine.config)
        results = []
        for index in order:
            machine.write_log("homing", joint=JOINT_NAMES[index])
            homed = await homing.home_joint(index)
            machine.arm_state.joint_homed(index)
            results.append({"joint": homed.joint, "spread_deg": homed.spread_deg})
        job.result["joints"] = results

    return machine.start_job(JobKind.HOME, who, body, homed=False)


def move_joints(machine: Machine, who: Owner, target_deg: Sequence[float], speed: float = 1.0) -> Job:
    """Go to joint angles (5,), deg, on a straight line in joint space, at `speed` (0..1] of the limits. Raises
    RefusedError outside the joint ranges, and what `Machine.start_job` raises.
    """
    target = _finite("joint angles", target_deg, len(JOINT_NAMES))
    if not 0.0 < speed <= 1.0:
        raise RefusedError(f"speed {speed} is not above 0 and at most 1")
    for name, joint, angle_deg in zip(JOINT_NAMES, machine.config.joints.ordered, target, strict=True):
        if not joint.min_deg <= angle_deg <= joint.max_deg:
            raise RefusedError(
                f"{name} {angle_deg:.3f} deg is outside {joint.min_deg} to {joint.max_deg} deg; choose an angle inside"
            )

    async def body(job: Job) -> None:
        start = machine.planning_start_deg
        await _play(machine, lambda: plan_joint_move(machine.arm, machine.config, start, target, speed_scale=speed))

    return machine.start_job(JobKind.MOVE, who, body)


def move_linear(machine: Machine, who: Owner, target: Sequence[float], feed_mm_s: float = 50.0) -> Job:
    """Go straight to X Y Z (mm) A B C (deg) of the program frame; at most the teach speed. Raises PlanError where no
    straight way leads there, RefusedError for a feed that is too high, and what `Machine.start_job` raises.
    """
    goal = _target(target)
    _check_feed(feed_mm_s)

    machine.lease.require(who)
    move = LinearMove(goal, Feed(feed_mm_s * 60.0), Source("(move_linear)", 0))
    # planned before the job starts: what cannot be planned at all is refused at once
    pieces = _planned(machine, [move]) if machine.state is MachineState.IDLE and not machine.arm_state.unhomed() else ()

    async def body(job: Job) -> None:
        await _play(machine, lambda: pieces)

    return machine.start_job(JobKind.MOVE, who, body)


def hand(machine: Machine, who: Owner, *, opened: bool) -> Job:
    """Open or close the hand and wait for its stroke; raises what `Machine.start_job` raises."""

    async def body(job: Job) -> None:
        await _play(machine, lambda: _planned(machine, [HandMove(opened, Source("(hand)", 0))]))

    return machine.start_job(JobKind.HAND, who, body, homed=False)


def _planned(machine: Machine, moves: Sequence[Move]) -> tuple[Piece, ...]:
    planner = Planner(machine.arm, machine.config, machine.planning_start_deg)
    return tuple(planner.plan(moves))


async def _play(machine: Machine, plan: Callable[[], Sequence[Piece]]) -> None:
    assert machine.stream is not None
    pieces = tuple(await asyncio.get_running_loop().run_in_executor(None, plan))
    if pieces:
        await asyncio.get_running_loop().run_in_executor(None, lambda: refuse_zones(machine, pieces))
        await machine.stream.play(pieces)


def joint_indices(joints: Sequence[str]) -> list[int]:
    """Numbers 0..4 of joints by name; raises RefusedError for others."""
    found = []
    for name in joints:
        if name not in JOINT_NAMES:
            raise RefusedError(f"there is no joint {name!r}; the joints are {', '.join(JOINT_NAMES)}")
        found.append(JOINT_NAMES.index(name))
    return found


def _finite(what: str, values: Sequence[float], count: int) -> tuple[float, ...]:
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise RefusedError(f"{what}: give {count} finite numbers, not {list(values)}")
    return tuple(float(value) for value in values)


def _target(values: Sequence[float]) -> Target6:
    x, y, z, a, b, c = _finite("target", values, 6)
    return (x, y, z, a, b, c)


def _check_feed(feed_mm_s: float) -> None:
    if not 0.0 < feed_mm_s <= TEACH_SPEED_MM_S:
        raise RefusedError(f"feed {feed_mm_s} mm/s is not above 0 and at most {TEACH_SPEED_MM_S} mm/s")


def position(machine: Machine) -> Target6:
    """X Y Z A B C of the tool in the program frame."""
    return machine.arm.program_from_joints(np.array(machine.arm_state.joints_deg))

"""Joint trajectories timed from outside: positions, velocities and times, as motion planners such as MoveIt send them.

Checked as a whole before anything moves: start, joint ranges, every limit in force, the tool's speed, keep-out zones.
Then it is a motion like any other: hold, resume, override and stop act along its path.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.errors import RefusedError
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.states import MachineState
from rm501_host.machine.zones import refuse_zones, sample_times
from rm501_host.planner import Limits, Piece, plan_timed

Array = NDArray[np.float64]

MAX_POINTS = 100_000
_SAME_DEG = 1e-3
_ROUNDING = 1.000001


@dataclass(frozen=True, slots=True)
class TimedPoints:
    """Joint angles (n, 5) in deg at times (n,) in s, rising from 0 or later; velocities (n, 5) in deg/s or none."""

    points_deg: tuple[tuple[float, ...], ...]
    times_s: tuple[float, ...]
    velocities_deg_s: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        count = len(self.times_s)
        shapes = [self.points_deg] if self.velocities_deg_s is None else [self.points_deg, self.velocities_deg_s]
        if not 1 <= count <= MAX_POINTS:
            raise RefusedError(f"a trajectory has 1 to {MAX_POINTS} points, not {count}")
        for rows in shapes:
            if len(rows) != count or any(len(row) != 5 for row in rows):
                raise RefusedError(f"give as many rows of five joints as times ({count}), not {len(rows)}")

    def extended(self, more: TimedPoints) -> TimedPoints:
        """These points with more behind them; raises RefusedError when only one of both has velocities."""
        if (self.velocities_deg_s is None) is not (more.velocities_deg_s is None):
            raise RefusedError("give velocities with all points of a trajectory, or with none")
        velocities = None
        if self.velocities_deg_s is not None and more.velocities_deg_s is not None:
            velocities = self.velocities_deg_s + more.velocities_deg_s
        return TimedPoints(self.points_deg + more.points_deg, self.times_s + more.times_s, velocities)


async def follow(machine: Machine, who: Owner, timed: TimedPoints, *, stretch: bool = False) -> Job:
    """Check a trajectory and start it; with `stretch` one that is too fast is slowed down by the least that makes it
    legal.

    Raises RefusedError, PlanError, JointLimitError with the time and the joint: nothing moved then.
    """
    machine.lease.require(who)
    if machine.state is MachineState.IDLE and not machine.arm_state.unhomed():
        await _start_from_counts(machine, timed)
    start = machine.planning_start_deg
    loop = asyncio.get_running_loop()
    pieces: tuple[Piece, ...] = ()
    if not machine.arm_state.unhomed():
        pieces = await loop.run_in_executor(None, lambda: plan_trajectory(machine, start, timed, stretch=stretch))

    async def body(job: Job) -> None:
        if tuple(machine.planning_start_deg) != tuple(start):
            raise RefusedError("the arm moved while the trajectory was checked; start it again")
        assert machine.stream is not None
        await machine.stream.play(pieces)
        duration_s = sum(piece.duration_s for piece in pieces)
        job.result.update(duration_s=round(duration_s, 6), slowed_by=round(duration_s / timed.times_s[-1], 6))

    return machine.start_job(JobKind.TRAJECTORY, who, body)


async def _start_from_counts(machine: Machine, timed: TimedPoints) -> None:
    """Let the next motion start at the step counts where the trajectory does.

    The ideal end of the last motion is up to half a step off the count; what clients see, and begin at, is the count.
    """
    if timed.times_s[0] != 0.0:
        return
    first = np.array(timed.points_deg[0])
    if (
        np.abs(first - machine.planning_start_deg).max() > _SAME_DEG
        and np.abs(first - machine.arm_state.joints_deg).max() <= _SAME_DEG
    ):
        await machine.resync()


def plan_trajectory(
    machine: Machine, start_deg: Sequence[float], timed: TimedPoints, *, stretch: bool
) -> tuple[Piece, ...]:
    """The checked piece of a trajectory; raises what `follow` raises."""
    times = np.array(timed.times_s, dtype=np.float64)
    velocities = None if timed.velocities_deg_s is None else np.array(timed.velocities_deg_s, dtype=np.float64)

    def plan(slower: float) -> tuple[Piece, ...]:
        return plan_timed(
            machine.arm,
            machine.config,
            start_deg,
            np.array(timed.points_deg, dtype=np.float64),
            times * slower,
            None if velocities is None else velocities / slower,
            stretch=stretch,
        )

    pieces = plan(1.0)
    ratio = _tool_ratio(machine, pieces)
    if ratio > 1.0:
        if not stretch:
            raise RefusedError(
                f"the trajectory asks {ratio:.4g} x the speed that is allowed for the tool; stretch its times by that"
            )
        slowed = pieces[0].duration_s / float(times[-1])
        pieces = plan(slowed * ratio * _ROUNDING)
    refuse_zones(machine, pieces)
    return pieces


def _tool_ratio(machine: Machine, pieces: tuple[Piece, ...]) -> float:
    """The tool's largest speed over the one in force."""
    allowed_mm_s = Limits.from_config(machine.config).tcp_speed_mm_s
    if not np.isfinite(allowed_mm_s):
        return 0.0
    fastest = 0.0
    for piece in pieces:
        q_deg, rates, _ = piece.states(sample_times(piece))
        tool = np.einsum("nij,nj->ni", machine.arm.jacobian_batch(q_deg)[:, :3], np.radians(rates))
        fastest = max(fastest, float(np.linalg.norm(tool, axis=1).max()))
    return fastest / allowed_mm_s

"""Jogging: a motion that goes on while somebody keeps asking for it, and stops by itself when nobody does.

A continuous jog is one planned move from here to as far as it may go that way (the soft limit, the edge of the
workspace, a singularity), played under the board's lease of 200 ms. Each `keep` of the client renews the lease;
when the key, the client, the daemon or the link goes away, the board ramps down on the path and drops the rest. So
the limits are respected on the way by construction, and nothing has to be sent to stop.

An incremental jog is the same move with a known length.

Frames: `joint` (axes: the joints), `world` (X Y Z of the program frame, A B C), `tool` (X Y Z along the tool's own
axes). Cartesian jogs keep the orientation and end before the place that cannot be planned.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from rm501_host.config import JOINT_NAMES
from rm501_host.errors import RefusedError, Rm501Error, StoppedError
from rm501_host.kinematics.results import Target6
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.operations import TEACH_SPEED_MM_S
from rm501_host.moves import Feed, LinearMove, Source
from rm501_host.planner import Piece, PlanError, Planner, plan_joint_move
from rm501_host.session import BoardRefusedError, BoardSession
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.faults import RefusalReason
from rm501_protocol.messages import Lease

UNHOMED_SPEED = 0.2
"""Share of a joint's speed while it is not homed: nobody knows where its limits are."""
UNHOMED_REACH_DEG = 30.0
"""How far one jog of an unhomed joint may go: an end stop may be near."""
_LINEAR_REACH_MM = 800.0
"""The workspace's diameter is below this."""
_ANGULAR_REACH_DEG = 360.0
_SAMPLE = 2.0
"""Spacing of the samples along a Cartesian jog, mm or deg."""
_LARGEST_STEP_DEG = 20.0
"""A joint that turns farther between two samples 2 mm apart passes a singularity or changes the branch."""
_SHORTENINGS = 6
_SHORTEST = 0.5
_SOURCE = Source("(jog)", 0)
WORLD_AXES = ("x", "y", "z", "a", "b", "c")
TOOL_AXES = ("x", "y", "z")


class Jogger:
    """Starts, keeps and ends jogs on a machine; at most one at a time, as with every motion."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._lease_ms = machine.config.board.jog_lease_ms
        self._wanted: Job | None = None

    def start(self, who: Owner, frame: str, axis: str, speed: float, *, distance: float | None = None) -> Job:
        """Start a jog; `speed` in deg/s or mm/s, its sign is the direction; `distance` (deg or mm, above 0): just so
        far. Continuous without `distance`: call `keep` at least every 200 ms.

        Raises RefusedError when the axis does not exist, when it cannot go that way at all, or when not homed (only
        joints may be jogged then).
        """
        machine = self._machine
        if not np.isfinite(speed) or speed == 0:
            raise RefusedError(f"speed {speed} is no speed; give deg/s or mm/s, the sign is the direction")
        if distance is not None and not 0 < distance < 1000:
            raise RefusedError(f"distance {distance} is not between 0 and 1000; the direction is the sign of speed")
        if frame == "joint":
            if axis not in JOINT_NAMES:
                raise RefusedError(f"there is no joint {axis!r}; the joints are {', '.join(JOINT_NAMES)}")
        elif axis not in (WORLD_AXES if frame == "world" else TOOL_AXES if frame == "tool" else ()):
            raise RefusedError(
                f"there is no axis {axis!r} in frame {frame!r}; use joint, world ({' '.join(WORLD_AXES)}) "
                f"or tool ({' '.join(TOOL_AXES)})"
            )
        continuous = distance is None

        async def body(job: Job) -> None:
            await self._jog(frame, axis, speed, distance, job, continuous=continuous)

        job = machine.start_job(JobKind.JOG, who, body, homed=frame != "joint")
        self._wanted = job
        return job

    def keep(self, who: Owner, number: int) -> bool:
        """Renew the lease of jog `number`; False when it is over."""
        job = self._machine.job
        if job is None or job.id != number or job is not self._wanted:
            return False
        self._machine.lease.require(who)
        with contextlib.suppress(Rm501Error):
            self._machine.session.post(Lease(self._lease_ms))
        return True

    def end(self, who: Owner) -> None:
        """The key was released: ramp down now."""
        job = self._machine.job
        if job is not None and job is self._wanted:
            self._machine.lease.require(who)
            self._wanted = None
            self._machine.session.post(Lease(0))

    async def _jog(
        self, frame: str, axis: str, speed: float, distance: float | None, job: Job, *, continuous: bool
    ) -> None:
        machine = self._machine
        assert machine.stream is not None
        loop = asyncio.get_running_loop()
        start = machine.planning_start_deg
        pieces = await loop.run_in_executor(None, lambda: self._plan(start, frame, axis, speed, distance))
        if self._wanted is not job and continuous:
            return
        session = machine.session
        session.post(Lease(self._lease_ms))
        stream = machine.stream
        ended_without_motion = False
        try:
            if not continuous:
                self._keep_alive(session, loop, job)
            await stream.play(pieces, flags=SegmentFlag.JOG)
        except StoppedError:
            if not machine.stopped_by_lease():
                raise
        except BoardRefusedError as error:
            # the lease ran out before a segment arrived: nobody asks for the jog any more
            if error.refused.reason is not RefusalReason.NO_LEASE:
                raise
            ended_without_motion = True
        finally:
            if machine.last_end is None and session.failure is None:
                with contextlib.suppress(Rm501Error):
                    session.post(Lease(0))
        if ended_without_motion:
            await machine.resync()
        job.result["joints_deg"] = list(machine.planning_start_deg)

    def _keep_alive(self, session: BoardSession, loop: asyncio.AbstractEventLoop, job: Job) -> None:
        """An incremental jog has a known end, so the daemon itself keeps the lease until then."""
        if self._wanted is job and self._machine.job is job and session.failure is None:
            session.post(Lease(self._lease_ms))
            loop.call_later(self._lease_ms / 4000, self._keep_alive, session, loop, job)

    # ------------------------------------------------------------------------------------------------ planning

    def _plan(
        self, start: Sequence[float], frame: str, axis: str, speed: float, distance: float | None
    ) -> tuple[Piece, ...]:
        if frame == "joint":
            return self._plan_joint(start, JOINT_NAMES.index(axis), speed, distance)
        return self._plan_line(start, frame, axis, speed, distance)

    def _plan_joint(
        self, start: Sequence[float], joint: int, speed: float, distance: float | None
    ) -> tuple[Piece, ...]:
        machine = self._machine
        section = machine.config.joints.ordered[joint]
        homed = machine.arm_state.homed[joint]
        sign = 1.0 if speed > 0 else -1.0
        target = list(start)
        cap = min(abs(speed), section.max_velocity_deg_s)
        if homed:
            room = (section.max_deg - start[joint]) if sign > 0 else (start[joint] - section.min_deg)
            if room <= 1e-6:
                limit = section.max_deg if sign > 0 else section.min_deg
                raise RefusedError(f"{JOINT_NAMES[joint]} is at its limit {limit} deg; jog the other way")
            if distance is not None and distance > room + 1e-9:
                raise RefusedError(
                    f"{JOINT_NAMES[joint]} has {room:.3f} deg left that way, not {distance}; choose a shorter step"
                )
            reach = room if distance is None else distance
            cap = min(cap, self._teach_cap(start, joint))
        else:
            reach = min(UNHOMED_REACH_DEG, UNHOMED_REACH_DEG if distance is None else distance)
            cap = min(cap, UNHOMED_SPEED * section.max_velocity_deg_s)
        target[joint] += sign * reach
        return plan_joint_move(
            machine.arm, machine.config, start, target, max_velocity_deg_s=cap, ignore_limits=not homed, source=_SOURCE
        )

    def _teach_cap(self, start: Sequence[float], joint: int) -> float:
        """Largest rate of a joint, deg/s, at which the tool stays within the teach speed wherever the others stand."""
        section = self._machine.config.joints.ordered[joint]
        sweep = np.tile(np.array(start), (31, 1))
        sweep[:, joint] = np.linspace(section.min_deg, section.max_deg, 31)
        per_rad = np.linalg.norm(self._machine.arm.jacobian_batch(sweep)[:, :3, joint], axis=1).max()
        if per_rad < 1e-9:
            return float("inf")
        return float(np.rad2deg(TEACH_SPEED_MM_S / per_rad))

    def _plan_line(
        self, start: Sequence[float], frame: str, axis: str, speed: float, distance: float | None
    ) -> tuple[Piece, ...]:
        machine = self._machine
        here = machine.arm.program_from_joints(np.array(start))
        sign = 1.0 if speed > 0 else -1.0
        direction = np.zeros(6)
        direction[WORLD_AXES.index(axis)] = sign
        angular = axis in "abc"
        if frame == "tool":
            direction[:3] = self._tool_axis(start, TOOL_AXES.index(axis)) * sign
        feed = min(abs(speed), TEACH_SPEED_MM_S) * 60.0
        if distance is not None:
            return self._line(start, here, direction * distance, feed)
        reach = self._reach(start, here, direction, _ANGULAR_REACH_DEG if angular else _LINEAR_REACH_MM)
        reason: Rm501Error | None = None
        for _ in range(_SHORTENINGS):
            if reach < _SHORTEST:
                break
            try:
                return self._line(start, here, direction * reach, feed)
            except PlanError as error:
                reason = error
                reach *= 0.7
        because = "the arm's reach or a joint limit is there" if reason is None else str(reason)
        raise RefusedError(f"cannot jog {frame} {axis} that way from here: {because}")

    def _reach(
        self, start: Sequence[float], here: Target6, direction: np.ndarray[Any, np.dtype[np.float64]], farthest: float
    ) -> float:
        """How far the arm can follow, mm or deg: to the last of dense samples within limits, near its neighbour."""
        arm = self._machine.arm
        distances = np.arange(_SAMPLE, farthest, _SAMPLE)
        seed = tuple(start)
        reached = 0.0
        for distance in distances:
            x, y, z, a, b, c = (float(value) for value in np.array(here) + direction * distance)
            try:
                best = arm.joints_from_program((x, y, z, a, b, c), seed).best
            except Rm501Error:
                break
            if best is None or max(abs(p - q) for p, q in zip(best.q_deg, seed, strict=True)) > _LARGEST_STEP_DEG:
                break
            seed = best.q_deg
            reached = float(distance)
        return reached

    def _line(
        self, start: Sequence[float], here: Target6, step: np.ndarray[Any, np.dtype[np.float64]], feed: float
    ) -> tuple[Piece, ...]:
        goal = np.array(here) + step
        x, y, z, a, b, c = (float(value) for value in goal)
        move = LinearMove((x, y, z, a, b, c), Feed(feed), _SOURCE)
        return tuple(Planner(self._machine.arm, self._machine.config, start).plan([move]))

    def _tool_axis(self, start: Sequence[float], column: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        """A column of the tool's rotation, turned into the program frame."""
        machine = self._machine
        tool = machine.arm.fk(np.array(start)).rotation[:, column]
        axis: np.ndarray[Any, np.dtype[np.float64]] = machine.arm.frame.rotation.T @ tool
        return axis

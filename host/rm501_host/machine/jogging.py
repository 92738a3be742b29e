"""Jogging: a motion that goes on while somebody keeps asking for it, and stops by itself when nobody does.

A continuous jog is one planned move from here to as far as it may go that way (a joint limit, a keep-out zone, a
singularity that leaves no way on), played under the board's lease of 200 ms. Each `keep` of the client renews the
lease; when the key, the client, the daemon or the link goes away, the board ramps down on the path and drops the rest.
So the limits are respected on the way by construction, and nothing has to be sent to stop.

An incremental jog is the same move with a known length.

Frames: `joint` (axes: the joints), `world` (X Y Z of the program frame, A B C), `tool` (X Y Z along the tool's own
axes). Cartesian jogs pass singularities by damped least squares: `jog_path` has the theory. The job's result says why
the way ends and how far damping takes the tool off its line.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence

import numpy as np

from rm501_host.config import JOINT_NAMES
from rm501_host.errors import RefusedError, Rm501Error, StoppedError
from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.jog_elements import DAMPED_SOURCE, JOG_SOURCE
from rm501_host.machine.jog_path import JogPath
from rm501_host.machine.jog_plan import TOOL_AXES, WORLD_AXES, PlannedJog, plan_cartesian_jog
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine
from rm501_host.machine.operations import TEACH_SPEED_MM_S
from rm501_host.motion import Progress
from rm501_host.planner import plan_joint_move
from rm501_host.preflight.keep_out import KeepOut
from rm501_host.session import BoardRefusedError, BoardSession
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.faults import RefusalReason
from rm501_protocol.messages import Lease

UNHOMED_SPEED = 0.2
"""Share of a joint's speed while it is not homed: nobody knows where its limits are."""
UNHOMED_REACH_DEG = 30.0
"""How far one jog of an unhomed joint may go: an end stop may be near."""
_SHORTEST_DEG = 0.05
_RAMP_TIMEOUT_S = 5.0
"""The ramp at the end of a lease takes two seconds at most."""
_POLL_S = 0.02
_SWEEP_DEG = 0.5
"""Spacing at which a joint's jog is checked against keep-out zones."""


class Jogger:
    """Starts, keeps and ends jogs on a machine; at most one at a time, as with every motion."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._lease_ms = machine.config.board.jog_lease_ms
        self._wanted: Job | None = None
        self.is_damped = False
        """Whether the tool is in a part of its way where damping may take it off its line."""

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
        planned = await loop.run_in_executor(None, lambda: self._plan(start, frame, axis, speed, distance))
        if self._wanted is not job:  # the key was released before anything moved
            return
        session = machine.session
        session.post(Lease(self._lease_ms))
        stream = machine.stream
        ended_without_motion = False
        try:
            if not continuous:
                self._keep_alive(session, loop, job)
            await stream.play(planned.pieces, self._on_progress, flags=SegmentFlag.JOG)
            job.result["ended"] = planned.path.reason
        except StoppedError:
            if not machine.stopped_by_lease():
                raise
        except BoardRefusedError as error:
            # the lease ran out before a segment arrived, or while some were on their way to a board that was already
            # ramping down or had dropped its queue: nobody asks for the jog any more
            if error.refused.reason is not RefusalReason.NO_LEASE and not await self._lease_ran_out():
                raise
            ended_without_motion = True
        finally:
            self.is_damped = False
            if machine.last_end is None and session.failure is None:
                with contextlib.suppress(Rm501Error):
                    session.post(Lease(0))
        if ended_without_motion:
            await machine.resync()
        job.result["joints_deg"] = list(machine.planning_start_deg)
        job.result["damped"] = planned.path.is_damped
        job.result["deviation_mm"] = round(planned.path.deviation_mm, 3)

    async def _lease_ran_out(self) -> bool:
        """Once the board has told that motion ended: whether the lease's end did it."""
        machine = self._machine
        with contextlib.suppress(Rm501Error, TimeoutError):
            async with asyncio.timeout(_RAMP_TIMEOUT_S):
                while machine.last_end is None and machine.session.failure is None:  # noqa: ASYNC110  # a plain poll
                    await asyncio.sleep(_POLL_S)
        return machine.stopped_by_lease()

    def _on_progress(self, progress: Progress) -> None:
        self.is_damped = progress.source is not None and progress.source.line == DAMPED_SOURCE.line

    def _keep_alive(self, session: BoardSession, loop: asyncio.AbstractEventLoop, job: Job) -> None:
        """An incremental jog has a known end, so the daemon itself keeps the lease until then."""
        if self._wanted is job and self._machine.job is job and session.failure is None:
            session.post(Lease(self._lease_ms))
            loop.call_later(self._lease_ms / 4000, self._keep_alive, session, loop, job)

    # ------------------------------------------------------------------------------------------------ planning

    def _plan(self, start: Sequence[float], frame: str, axis: str, speed: float, distance: float | None) -> PlannedJog:
        if frame == "joint":
            return self._plan_joint(start, JOINT_NAMES.index(axis), speed, distance)
        machine = self._machine
        return plan_cartesian_jog(
            machine.arm, machine.config, np.array(start), frame, axis, speed, distance, TEACH_SPEED_MM_S
        )

    def _plan_joint(self, start: Sequence[float], joint: int, speed: float, distance: float | None) -> PlannedJog:
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
            reason = f"{JOINT_NAMES[joint]} is at its limit" if distance is None else ""
            free, zone = self._free_deg(start, joint, sign, reach)
            if free < reach:
                if distance is not None or free < _SHORTEST_DEG:
                    raise RefusedError(
                        f"{JOINT_NAMES[joint]} has {free:.2f} deg left that way: {zone}; jog another way"
                    )
                reach, reason = free, zone
            cap = min(cap, self._teach_cap(start, joint))
        else:
            self._refuse_into_switch(joint, sign)
            reason = "an unhomed joint goes no farther in one jog"
            reach = min(UNHOMED_REACH_DEG, UNHOMED_REACH_DEG if distance is None else distance)
            cap = min(cap, UNHOMED_SPEED * section.max_velocity_deg_s)
        target[joint] += sign * reach
        pieces = plan_joint_move(
            machine.arm,
            machine.config,
            start,
            target,
            max_velocity_deg_s=cap,
            ignore_limits=not homed,
            source=JOG_SOURCE,
        )
        return PlannedJog(pieces, JogPath(reach=reach, reason=reason))

    def _refuse_into_switch(self, joint: int, sign: float) -> None:
        """An unhomed joint leaves its active switch, it does not go farther into it."""
        home = self._machine.config.joints.ordered[joint].home
        status = self._machine.board_status
        into = -1.0 if home.active == "below" else 1.0
        if status is None or home.ignore_limits or sign != into or not status.inputs >> InputId[home.input] & 1:
            return
        raise RefusedError(
            f"{JOINT_NAMES[joint]} is not homed and {home.input} is active; jog the other way or home the joint"
        )

    def _free_deg(self, start: Sequence[float], joint: int, sign: float, reach: float) -> tuple[float, str]:
        """How far a joint may turn before the arm enters a keep-out zone, deg, and which.

        A zone that the arm already stands in does not keep it from getting out. While another joint is not homed nobody
        knows where the arm is.
        """
        machine = self._machine
        zones = KeepOut(machine.config)
        if zones.is_empty or machine.arm_state.unhomed():
            return reach, ""
        turns = np.append(np.arange(0.0, reach, _SWEEP_DEG), reach)
        sweep = np.tile(np.array(start), (len(turns), 1))
        sweep[:, joint] += sign * turns
        found = zones.first_entry(machine.arm, sweep, 0.0)
        if found is None or found[0] == 0:
            return reach, ""
        return float(turns[found[0] - 1]), found[1]

    def _teach_cap(self, start: Sequence[float], joint: int) -> float:
        """Largest rate of a joint, deg/s, at which the tool stays within the teach speed wherever the others stand."""
        section = self._machine.config.joints.ordered[joint]
        sweep = np.tile(np.array(start), (31, 1))
        sweep[:, joint] = np.linspace(section.min_deg, section.max_deg, 31)
        per_rad = np.linalg.norm(self._machine.arm.jacobian_batch(sweep)[:, :3, joint], axis=1).max()
        if per_rad < 1e-9:
            return float("inf")
        return float(np.rad2deg(TEACH_SPEED_MM_S / per_rad))

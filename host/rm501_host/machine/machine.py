"""The machine: one arm, its state, who moves it, and what happens when something goes wrong.

`run` supervises for as long as the daemon lives: it keeps the connection (`BoardPort`), follows the board's state, and
runs at most one motion at a time (`JobRunner`). Requests come in through the methods; those that move the arm return a
job at once. STOP, KILL and HOLD wait for nothing.

The state changes through `Condition.apply` only. Whatever the board does by itself (a hold button, a low queue, a
fault, a restart) arrives as a notice and is turned into events (`following`). Each part has its file: `job_runner` one
motion from its beginning to its end, `resetting` the way back from ESTOP, `drive` the motors' power and their stream.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import numpy as np

from rm501_host.blackbox import BlackBox
from rm501_host.config import Config
from rm501_host.config.board import board_config_from
from rm501_host.errors import NoBoardError, RefusedError, Rm501Error
from rm501_host.kinematics import Arm
from rm501_host.machine import causes
from rm501_host.machine.arm_state import ArmState
from rm501_host.machine.board_port import BoardPort
from rm501_host.machine.condition import Condition
from rm501_host.machine.drive import Drive
from rm501_host.machine.feed_override import HIGHEST_OVERRIDE, FeedOverride
from rm501_host.machine.following import events_of
from rm501_host.machine.job_runner import JobRunner
from rm501_host.machine.jobs import Job, JobBook, JobKind
from rm501_host.machine.lease import MotionLease, Owner
from rm501_host.machine.limits import RuntimeLimits
from rm501_host.machine.resetting import Resetting
from rm501_host.machine.settling import REST_TIMEOUT_S
from rm501_host.machine.states import Event, MachineState, Mode, TaskState, describe
from rm501_host.motion import MotionStream
from rm501_host.session import BoardSession, ContradictionError, LinkLostError
from rm501_host.session.board_session import Notice
from rm501_host.storage import JsonLog, PositionFile
from rm501_protocol.enums import BoardState, EndCause, HoldCause, ResumeCause
from rm501_protocol.faults import FaultCode
from rm501_protocol.link_events import LinkHeard, LinkNoisy, LinkSilent, StopKind
from rm501_protocol.messages import FaultReport, Hold, MotionEnded, Resume, Status
from rm501_protocol.segment import ONE_STEP
from rm501_protocol.transport import Transport

_SYSTEM = Owner(0, "the machine")
_BY_ITSELF = "a board that hears nobody holds a moving arm on its path, motors on; use the emergency stop that is wired"


@dataclass(frozen=True, slots=True)
class MachineParts:
    """What a machine is given: its connection, its memory, its clocks."""

    open_transport: Callable[[], Coroutine[Any, Any, Transport]]
    nonce: Callable[[], int]
    log: JsonLog
    black_box: BlackBox
    position_file: PositionFile
    utc: Callable[[], str]


class Machine:
    """See the module's text. Make it inside the running loop, then run `run` in a task group."""

    def __init__(self, config: Config, parts: MachineParts) -> None:
        self.limits = RuntimeLimits(config)
        self.arm = Arm.from_config(config)
        self.lease = MotionLease()
        self.log = parts.log
        self.black_box = parts.black_box
        self.arm_state = ArmState(self.arm, config, parts.position_file, parts.utc)
        self.frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self.messages: deque[str] = deque(maxlen=8)
        self._port = BoardPort(
            parts.open_transport,
            board_config_from(config),
            parts.nonce,
            self._tap,
            self._link_up,
            self._link_down,
            self._notice,
        )
        self._condition = Condition(parts.log, parts.black_box, lambda: self.board_status)
        self._causes = self._condition.causes
        self._override = FeedOverride()
        self._drive = Drive(lambda: self.session, self._condition, self.arm_state, self.limits, self._override)
        self._resetting = Resetting(lambda: self.session, self._condition, self._drive)
        self._runner = JobRunner(self._port, self._condition, self.lease, self._drive, self.arm_state, self.stop)

    # -------------------------------------------------------------------------------------------- life

    async def run(self, started: Callable[[], None] = lambda: None) -> None:
        """Supervise until cancelled; a moving arm is then stopped on its path before this returns."""
        try:
            async with asyncio.TaskGroup() as tasks:
                self._runner.tasks = tasks
                tasks.create_task(self._port.run(), name="board port")
                started()
        finally:
            self._runner.tasks = None

    async def shut_down(self) -> None:
        """Bring a moving arm to rest on its path and leave it held; called before `run` is cancelled."""
        session = self._port.session
        if session is None or self.job is None:
            return
        with contextlib.suppress(Rm501Error, TimeoutError):
            self._runner.abort_now(session)
            async with asyncio.timeout(REST_TIMEOUT_S):
                await self.job.done.wait()

    @property
    def config(self) -> Config:
        """The configuration with the limits in force, for planning; `limits.file` is the file's."""
        return self.limits.config

    @property
    def session(self) -> BoardSession:
        """The open session; raises NoBoardError with what to do when there is none."""
        session = self._port.session
        if session is None or session.failure is not None:
            raise NoBoardError(self._no_board())
        return session

    def _no_board(self) -> str:
        cause = self._causes.connection
        return f"{cause.text}; {cause.remedy}"

    @property
    def state(self) -> MachineState:
        """What the machine is in."""
        return self._condition.state

    @property
    def mode(self) -> Mode:
        """The mode that belongs to the newest motion."""
        return self._runner.mode

    @property
    def jobs(self) -> JobBook:
        """The last motions, by number."""
        return self._runner.book

    @property
    def job(self) -> Job | None:
        """The motion under way."""
        return self._runner.job

    @property
    def last_job_id(self) -> int:
        """The number of the newest motion, 0 before the first."""
        return self._runner.last_id

    @property
    def waiting_for(self) -> str:
        """What the operator's resume ends ("M0", "step"), empty while nothing waits for it."""
        return self._runner.waiting_for

    @property
    def stream(self) -> MotionStream | None:
        """The stream of motion to the board, None before the motors are on and after the link was lost."""
        return self._drive.stream

    @property
    def last_end(self) -> MotionEnded | None:
        """How the board says that the newest motion ended, None when it has not."""
        return self._drive.last_end

    @property
    def override(self) -> float:
        """The feed override that was asked for; 1: as programmed."""
        return self._override.ratio

    @property
    def plan_scale(self) -> float:
        """By how much the feeds of what is played were multiplied when it was planned."""
        return self._override.plan_scale

    @property
    def cause(self) -> causes.Cause | None:
        """Why the machine is in ESTOP or OFF, None when nothing is wrong."""
        return self._causes.shown

    @property
    def connected(self) -> bool:
        """Whether a session is open."""
        return self._port.session is not None

    @property
    def board_status(self) -> Status | None:
        """The newest status of the board."""
        session = self._port.session
        return None if session is None else session.status

    @property
    def link_silent(self) -> bool:
        """Whether an open session has not been heard for a second."""
        session = self._port.session
        return session is not None and session.link_silent

    @property
    def warnings(self) -> tuple[str, ...]:
        """What does not work but does not stop motion either."""
        found = []
        if self.log.last_error is not None:
            found.append(f"the log cannot be written ({self.log.last_error}); records stay in memory")
        session = self._port.session
        noise = None if session is None else session.noise_warning
        found += [text for text in (self.arm_state.warning, self.black_box.warning, noise) if text is not None]
        return tuple(found)

    def set_status_period(self, wanted_ms: int) -> None:
        """How often the board is to tell its status while somebody watches; within 20 to 40 ms."""
        self._port.set_status_period(wanted_ms)

    def write_log(self, kind: str, **data: object) -> None:
        """One record for the log and the black box."""
        self._condition.write_log(kind, **data)

    @property
    def planning_start_deg(self) -> tuple[float, ...]:
        """Joint angles (5,) where the next motion starts: those of the exact mirror, fractions of steps included."""
        if self.stream is None:
            return self.arm_state.joints_deg
        motors = np.array(self.stream.positions_q48[:5], dtype=float) / ONE_STEP
        angles = self.arm.joints_from_motors(motors) - np.array(self.stream.offsets.deg)
        return tuple(float(angle) for angle in angles)

    # ------------------------------------------------------------------------- what everybody may do

    async def stop(self, who: Owner = _SYSTEM, kind: StopKind = StopKind.STOP) -> None:
        """STOP (category 1) or KILL (category 0): ahead of everything, from anybody, in every state.

        Raises NoBoardError when there is nobody to tell, LinkLostError when nobody has acknowledged it.
        """
        self._resetting.stopped()
        self.write_log("stop", who=who.name, category=kind.name, state=describe(self.state))
        self._runner.wake()
        if self.state.task is TaskState.ON:
            self._runner.stop_instead()
            self._condition.apply(Event.STOP)
            self._causes.add(causes.OPERATOR_STOP)
        try:
            await self.session.stop(kind)
        except NoBoardError as error:
            self.write_log("stop_not_delivered", category=kind.name, error=str(error))
            raise NoBoardError(f"{kind.name} was not delivered: {error}; {_BY_ITSELF}") from error
        except LinkLostError as error:
            self.write_log("stop_not_acknowledged", category=kind.name, error=str(error))
            raise LinkLostError(f"{kind.name} has not been acknowledged: {error}; {_BY_ITSELF}") from error

    async def hold(self, who: Owner = _SYSTEM) -> bool:
        """Feed hold on the path; False when nothing moves. Anybody may, whoever has the lease; a jog ends.

        An arm that stands held for another reason (override 0, a late host) is held by a user from then on. Raises
        NoBoardError when there is no board to tell it to, LinkLostError when it is silent.
        """
        self.write_log("hold", who=who.name)
        session = self._port.session
        if session is None or session.failure is not None:
            raise NoBoardError(f"nobody can be told to hold: {self._no_board()}; {_BY_ITSELF}")
        job = self.job
        if job is None or self.state not in (MachineState.RUNNING, MachineState.HOLDING, MachineState.HELD):
            return False
        if job.kind is JobKind.JOG:
            await self._runner.end_on_the_path(self.session, job)
        elif not self.waiting_for:
            session.post(Hold())
            if session.link_silent:
                raise LinkLostError(f"the hold is on its way, but the board has been silent for a second; {_BY_ITSELF}")
        return True

    # --------------------------------------------------------------------- what the owner may do

    async def resume(self, who: Owner) -> None:
        """Go on after a hold, a pause of the program, or a single block.

        Raises LeaseHeldError while somebody else keeps the lease, RefusedError where nothing is held, NoBoardError.
        """
        self.lease.require_control(who)
        if self.waiting_for:
            self.write_log("continue", who=who.name, after=self.waiting_for)
            self._runner.wake()
            return
        if self.state not in (MachineState.HOLDING, MachineState.HELD):
            raise RefusedError(f"nothing is held, the machine is {describe(self.state)}; start something first")
        self.write_log("resume", who=who.name)
        await self.session.command(
            Resume(ResumeCause.USER),
            lambda status: (
                status.state not in (BoardState.HOLDING, BoardState.HELD) or status.hold_cause is not HoldCause.USER
            ),
        )

    async def abort(self, who: Owner) -> bool:
        """End the motion on its path, motors held, position trusted; False when there is none.

        Raises LeaseHeldError while somebody else keeps the lease, NoBoardError, StoppedError when the motion has not
        ended in time.
        """
        self.lease.require_control(who)
        job = self.job
        if job is None:
            return False
        self.write_log("abort", who=who.name, motion=job.id)
        await self._runner.end_on_the_path(self.session, job)
        return True

    async def set_override(self, ratio: float, who: Owner) -> None:
        """Feed override `ratio`, 0 to 2 (1: as programmed), along the path. Up to 1 at once; above it a program is
        planned anew for higher feeds, and every other motion stays at 1.

        Raises LeaseHeldError while somebody else keeps the lease, RefusedError outside 0 to 2, NoBoardError.
        """
        self.lease.require_control(who)
        if not 0.0 <= ratio <= HIGHEST_OVERRIDE:
            raise RefusedError(f"override {ratio} is not between 0 and {HIGHEST_OVERRIDE:g}")
        session = self.session
        self.write_log("override", who=who.name, old=self.override, new=ratio)
        self._override.ratio = ratio
        session.post(self._override.message)

    def follow_plan_scale(self, scale: float) -> None:
        """Feeds of what is played now were multiplied by this: the board's rate does the rest of the override."""
        if scale == self.plan_scale:
            return
        self.write_log("plan_scale", old=self.plan_scale, new=scale)
        self._override.plan_scale = scale
        session = self._port.session
        if session is not None and session.failure is None:
            session.post(self._override.message)

    async def reset(self, who: Owner, fault: str | None = None, *, power: bool = True) -> None:
        """Leave ESTOP or OFF: clear the fault that is named, drop what is queued, switch the motors on.

        Raises RefusedError for a fault that was not named or does not exist, NoBoardError, BoardRefusedError when its
        cause is still there, StoppedError when somebody stops meanwhile: the stop wins. Nothing moves.
        """
        self.lease.require_control(who)
        await self._resetting.reset(who.name, fault, power=power)

    async def power_off(self, who: Owner) -> None:
        """Motor power off at rest. Where the line is fitted the arm sinks and the position is trusted no longer.

        Raises LeaseHeldError while somebody else keeps the lease, RefusedError unless the machine is OFF or IDLE,
        NoBoardError, BoardRefusedError.
        """
        self.lease.require_control(who)
        await self._drive.power_off(who.name)

    def start_job(
        self, kind: JobKind, who: Owner, body: Callable[[Job], Awaitable[None]], *, homed: bool = True
    ) -> Job:
        """Start a motion; raises RefusedError when it may not start now, LeaseHeldError when somebody else moves."""
        return self._runner.start(kind, who, body, homed=homed)

    def go_on(self) -> None:
        """End `wait_for_operator` without an operator's resume: somebody has something else for the arm to do."""
        self._runner.waiting_for = ""
        self._runner.wake()

    async def wait_for_operator(self, what: str) -> None:
        """A program waits for `resume` (M0, M1, a single block); the state is HELD meanwhile.

        Raises StoppedError when it was stopped or aborted instead.
        """
        await self._runner.wait_for_operator(what)

    async def resync(self) -> None:
        """After a motion that broke off in an unknown place: come to rest, take over the board's positions."""
        await self._drive.resync()

    def stopped_by_lease(self) -> bool:
        """Whether the newest end of motion was the end of a jog's lease."""
        return self.last_end is not None and self.last_end.cause is EndCause.LEASE

    # ---------------------------------------------------------------------------------- what the board tells

    def _tap(self, now_us: int, direction: str, data: bytes) -> None:
        self.black_box.add("sent" if direction == "out" else "received", data)

    def _link_up(self, session: BoardSession) -> None:
        identify, status = session.link.identify, session.status
        assert identify is not None and status is not None
        restarted = self.arm_state.boot_id not in (0, identify.boot_id)
        trust = self.arm_state.connected(identify, status)
        self.write_log("link_up", boot_id=identify.boot_id, build=identify.build, board=status.state.name, trust=trust)
        fault = causes.board_fault(FaultCode(status.fault)) if status.state is BoardState.FAULT else None
        self._causes.connected(restarted=restarted, fault=fault)

    def _link_down(self, error: Rm501Error) -> None:
        if isinstance(error, ContradictionError):
            self.arm_state.contradicted()
            if self._runner.tasks is not None:
                self._runner.tasks.create_task(self._runner.save(dirty=True))
        was_up = self._port.session is not None
        if was_up or self.state is not MachineState.ESTOP:
            self._drive.stream = None
            self.arm_state.disconnected()
            self._runner.fault(causes.link_lost(error), "link lost")
        else:
            nobody_answered = isinstance(error, NoBoardError | LinkLostError)
            self._causes.not_connected(None if nobody_answered else str(error))
        self.log.write("link_down", error=str(error))

    def _notice(self, notice: Notice) -> None:
        match notice:
            case Status():
                if self.stream is not None:
                    self.arm_state.leads_deg = self.stream.offsets.leads_at(self.session.motion_frames.value)
                self.arm_state.update(notice)
                self._follow(notice)
            case FaultReport(fault=fault):
                self.write_log("fault", fault=fault.name, source=notice.source, value=notice.value, limit=notice.limit)
                self._runner.fault(causes.board_fault(fault), fault.name)
            case MotionEnded():
                self._drive.motion_ended(notice)
                self.write_log("motion_ended", cause=notice.cause.name, motion_frame=notice.motion_frame)
            case LinkSilent(silent_us=silent_us):
                self.write_log("link_silent", silent_us=silent_us)
            case LinkHeard(silent_us=silent_us):
                self.write_log("link_heard", silent_us=silent_us)
            case LinkNoisy(bad_frames=bad_frames, frames=frames):
                self.write_log("link_noisy", bad_frames=bad_frames, frames=frames)
            case _:
                pass

    def _follow(self, status: Status) -> None:
        """Take the board's state over into the machine's."""
        if self.state.task is not TaskState.ON:
            return
        if status.state is BoardState.FAULT:
            self._runner.fault(causes.board_fault(FaultCode(status.fault)), FaultCode(status.fault).name)
            return
        events = events_of(status.state, self.state, has_job=self.job is not None, is_waiting=bool(self.waiting_for))
        for event in events:
            self._condition.apply(event)
        if self.state is MachineState.OFF:
            self._causes.add(causes.POWERED_OFF)

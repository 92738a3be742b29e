"""The machine: one arm, its state, who moves it, and what happens when something goes wrong.

`run` supervises for as long as the daemon lives: it keeps the connection (`BoardPort`), follows the board's state, and
runs at most one motion (`Job`) at a time. Requests come in through the methods; those that move the arm return a
job at once. STOP, KILL and HOLD wait for nothing.

The state changes through `Condition.apply` only. Whatever the board does by itself (a hold button, a low queue, a
fault, a restart) arrives as a notice and is turned into events (`following`).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import numpy as np

from rm501_host.blackbox import BlackBox
from rm501_host.config import Config
from rm501_host.config.board import board_config_from
from rm501_host.errors import NoBoardError, RefusedError, Rm501Error, StoppedError
from rm501_host.kinematics import Arm
from rm501_host.machine import causes
from rm501_host.machine.arm_state import ArmState
from rm501_host.machine.board_port import BoardPort
from rm501_host.machine.condition import Condition
from rm501_host.machine.following import events_of
from rm501_host.machine.jobs import Job, JobBook, JobKind
from rm501_host.machine.lease import MotionLease, Owner
from rm501_host.machine.limits import RuntimeLimits
from rm501_host.machine.settling import REST_TIMEOUT_S, settle
from rm501_host.machine.states import Event, MachineState, Mode, TaskState, describe
from rm501_host.motion import MotionStream
from rm501_host.session import BoardSession, ContradictionError, LinkLostError
from rm501_host.session.board_session import Notice
from rm501_host.session.refusals import BoardRefusedError
from rm501_host.storage import JsonLog, PositionFile
from rm501_protocol.enums import BoardState, EndCause, HoldCause, ResumeCause
from rm501_protocol.faults import FaultCode
from rm501_protocol.link_events import LinkHeard, LinkNoisy, LinkSilent, StopKind
from rm501_protocol.messages import (
    OVERRIDE_ONE,
    FaultReport,
    Hold,
    MotionEnded,
    Reset,
    Resume,
    SetOverride,
    SetPower,
    Status,
)
from rm501_protocol.segment import ONE_STEP
from rm501_protocol.transport import Transport

_LOGGER = logging.getLogger(__name__)
_NOTICE_S = 0.5
"""A job whose motion the board has ended notices within a status period; if not, it is ended."""
HIGHEST_OVERRIDE = 2.0
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
        self.jobs = JobBook()
        self.log = parts.log
        self.black_box = parts.black_box
        self.arm_state = ArmState(self.arm, config, parts.position_file, parts.utc)
        self._condition = Condition(parts.log, parts.black_box, lambda: self.board_status)
        self._causes = self._condition.causes
        self.mode = Mode.MANUAL
        self.override = 1.0
        self.plan_scale = 1.0
        self.job: Job | None = None
        self._job_task: asyncio.Task[None] | None = None
        self.last_job_id = 0
        self.frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self.stream: MotionStream | None = None
        self.waiting_for = ""
        self.messages: deque[str] = deque(maxlen=8)
        self.last_end: MotionEnded | None = None
        self._loop = asyncio.get_running_loop()
        self._tasks: asyncio.TaskGroup | None = None
        self._continue = asyncio.Event()
        self._port = BoardPort(
            parts.open_transport,
            board_config_from(config),
            parts.nonce,
            self._tap,
            self._link_up,
            self._link_down,
            self._notice,
        )
        self._aborting = False
        self._resets = asyncio.Lock()
        self._saves = asyncio.Lock()
        self._stops = 0

    # -------------------------------------------------------------------------------------------- life

    async def run(self, started: Callable[[], None] = lambda: None) -> None:
        """Supervise until cancelled; a moving arm is then stopped on its path before this returns."""
        try:
            async with asyncio.TaskGroup() as tasks:
                self._tasks = tasks
                tasks.create_task(self._port.run(), name="board port")
                started()
        finally:
            self._tasks = None

    async def shut_down(self) -> None:
        """Bring a moving arm to rest on its path and leave it held; called before `run` is cancelled."""
        session = self._port.session
        if session is None or self.job is None:
            return
        with contextlib.suppress(Rm501Error):
            self._abort_now(session)
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
        self._stops += 1
        self.write_log("stop", who=who.name, category=kind.name, state=describe(self.state))
        self._continue.set()
        if self.state.task is TaskState.ON:
            self._aborting = False
            self._apply(Event.STOP)
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
            await self._end_on_the_path(job)
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
            self._continue.set()
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
        await self._end_on_the_path(job)
        return True

    async def _end_on_the_path(self, job: Job) -> None:
        self._abort_now(self.session)
        try:
            async with asyncio.timeout(REST_TIMEOUT_S):
                await job.done.wait()
        except TimeoutError:
            raise StoppedError(
                f"motion {job.id} has not ended within {REST_TIMEOUT_S:.0f} s; look at the arm and the status, or stop"
            ) from None

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
        self.override = ratio
        session.post(self._rate())

    def follow_plan_scale(self, scale: float) -> None:
        """Feeds of what is played now were multiplied by this: the board's rate does the rest of the override."""
        if scale == self.plan_scale:
            return
        self.write_log("plan_scale", old=self.plan_scale, new=scale)
        self.plan_scale = scale
        session = self._port.session
        if session is not None and session.failure is None:
            session.post(self._rate())

    def _rate(self) -> SetOverride:
        return SetOverride(round(min(1.0, self.override / self.plan_scale) * OVERRIDE_ONE))

    async def reset(self, who: Owner, fault: str | None = None, *, power: bool = True) -> None:
        """Leave ESTOP or OFF: clear the fault that is named, drop what is queued, switch the motors on.

        Raises RefusedError naming a fault that was not named, NoBoardError, BoardRefusedError when its cause is still
        there, StoppedError when somebody stops meanwhile: the stop wins. Nothing moves.
        """
        self.lease.require_control(who)
        async with self._resets:
            stops = self._stops
            refused: Rm501Error | None = None
            try:
                await self._reset(who, fault, power=power, stops=stops)
            except (BoardRefusedError, StoppedError) as error:
                if self._stops == stops:
                    raise
                refused = error
            if self._stops != stops:
                self._causes.add(causes.OPERATOR_STOP)
                raise StoppedError(
                    "somebody stopped the machine during the reset; look at the arm, then reset again"
                ) from refused

    async def _reset(self, who: Owner, fault: str | None, *, power: bool, stops: int) -> None:
        session = self.session
        if self.state.task is TaskState.ON and self.state is not MachineState.IDLE:
            raise RefusedError(f"the machine is {describe(self.state)}; stop or abort first")
        if self.state is MachineState.IDLE and session.status is not None and session.status.power:
            return
        self.write_log("reset", who=who.name, fault=fault)
        status = await session.refresh_status()
        if status.state is BoardState.FAULT:
            status = await self._clear_fault(session, status, fault)
        await settle(session, self._newest_end)
        if self._stops != stops:
            return
        if session.status is not None and session.status.state is BoardState.IDLE:
            session.post(Reset(FaultCode.NONE))
        if self.state is MachineState.ESTOP:
            self._apply(Event.RESET)
        self._causes.clear()
        self._causes.add(causes.AFTER_RESET)
        if power:
            await self._power_on(session)

    async def power_off(self, who: Owner) -> None:
        """Motor power off at rest. Where the line is fitted the arm sinks and the position is trusted no longer.

        Raises LeaseHeldError while somebody else keeps the lease, RefusedError unless the machine is OFF or IDLE,
        NoBoardError, BoardRefusedError.
        """
        self.lease.require_control(who)
        if self.state is MachineState.OFF:
            return
        if self.state is not MachineState.IDLE:
            raise RefusedError(f"the machine is {describe(self.state)}; stop it first")
        self.write_log("power_off", who=who.name)
        self._apply(Event.POWER_OFF)
        self._causes.add(causes.POWERED_OFF)
        await self.session.command(SetPower(False), lambda status: not status.power)

    def start_job(
        self, kind: JobKind, who: Owner, body: Callable[[Job], Awaitable[None]], *, homed: bool = True
    ) -> Job:
        """Start a motion; raises RefusedError when it may not start now, LeaseHeldError when somebody else moves."""
        self.lease.require(who)
        if self.state is not MachineState.IDLE:
            after = f" ({self.cause.text}; {self.cause.remedy})" if self.cause is not None else ""
            raise RefusedError(f"{kind.value} is not possible in {describe(self.state)}{after}; nothing moved")
        if homed and (missing := self.arm_state.unhomed()):
            raise RefusedError(f"not homed: {', '.join(missing)}; home first, until then joints can be jogged slowly")
        if self._tasks is None or self.stream is None:
            raise NoBoardError("the machine does not run; start rm501-host serve")
        job = self.jobs.new(kind, who)
        self.lease.begin_motion(who)
        self.job = job
        self.last_job_id = job.id
        self.mode = kind.mode
        self.last_end = None
        self._aborting = False
        self._apply(Event.START)
        self.write_log("motion", motion=job.id, what=kind.value, who=who.name)
        self._job_task = self._tasks.create_task(self._run_job(job, body), name=f"motion {job.id}")
        return job

    def go_on(self) -> None:
        """End `wait_for_operator` without an operator's resume: somebody has something else for the arm to do."""
        self.waiting_for = ""
        self._continue.set()

    async def wait_for_operator(self, what: str) -> None:
        """A program waits for `resume` (M0, M1, a single block); the state is HELD meanwhile.

        Raises StoppedError when it was stopped or aborted instead.
        """
        self._continue.clear()
        self.waiting_for = what
        self._apply(Event.HOLD)
        self._apply(Event.AT_REST)
        try:
            await self._continue.wait()
        finally:
            self.waiting_for = ""
        if self._aborting or self.state is not MachineState.HELD:
            raise StoppedError(f"stopped while waiting for {what}")
        self._apply(Event.RESUME)

    # -------------------------------------------------------------------------------------- one motion

    async def _run_job(self, job: Job, body: Callable[[Job], Awaitable[None]]) -> None:
        try:
            await self._save(dirty=True)
            await body(job)
        except Rm501Error as error:
            job.error = error
            if isinstance(error, RefusedError) and self.state not in (MachineState.RUNNING, MachineState.IDLE):
                # the board refused what was on its way when the machine was taken away
                job.error = StoppedError(f"{job.kind.value} ended: the machine went to {describe(self.state)}")
        except asyncio.CancelledError:
            why = "aborted" if self._aborting else f"the machine went to {describe(self.state)}"
            job.error = StoppedError(f"{job.kind.value} ended: {why}; the arm stands on its path")
            if self._tasks is None:
                raise
        except Exception as error:
            _LOGGER.exception("motion %d failed", job.id)
            job.error = StoppedError(f"an error of the daemon ended the motion: {error!r}; its log has the details")
            with contextlib.suppress(Rm501Error):
                await self.stop()
        finally:
            self.job = None
            self.lease.end_motion()
            self.waiting_for = ""
            await self._after_motion(job)
            job.done.set()

    async def _after_motion(self, job: Job) -> None:
        """Bring the state to where a motion leaves it, and the position file up to date."""
        session = self._port.session
        is_settled = True
        if session is not None and session.failure is None and self.state.task is TaskState.ON:
            if (self.state is not MachineState.STOPPING or self._aborting) and job.error is not None:
                # motion may be queued that nobody will complete, and only the board knows where it ended
                is_settled = await self._settled(session)
            if self.state in (MachineState.HOLDING, MachineState.HELD):
                self._apply(Event.ABORT)
            if self.state is MachineState.RUNNING or (self.state is MachineState.STOPPING and self._aborting):
                self._apply(Event.FINISHED)
        self._aborting = False
        text = None if job.error is None else str(job.error)
        self.write_log("motion_end", motion=job.id, what=job.kind.value, error=text)
        if is_settled and self._is_open(session):
            await self._save(dirty=False)

    async def _save(self, *, dirty: bool) -> None:
        """Write the position file; in the order of the calls: the end of one motion and the beginning of the next may
        meet here.
        """
        async with self._saves:
            await self._loop.run_in_executor(None, lambda: self.arm_state.save(dirty=dirty))

    async def _settled(self, session: BoardSession) -> bool:
        """Bring the board of `session` to rest after a motion that broke off; False, and ESTOP, when it does not tell
        where that is: planning the next motion from a guess would lead the arm along another path than was checked.
        """
        try:
            try:
                await self.resync()
            except (Rm501Error, TimeoutError) as first:
                # what was under way to the board may have met it in between
                self.write_log("resync_again", error=str(first))
                await asyncio.sleep(_NOTICE_S)
                if self._is_open(session):
                    await self.resync()
        except (Rm501Error, TimeoutError) as error:
            if self._is_open(session):
                silence_s = session.silence_s
                reason = str(error) or f"it did not come to rest within {REST_TIMEOUT_S:.0f} s"
                self._fault(causes.silent(silence_s) if silence_s else causes.unsettled(reason), "rest unknown")
                return False
        return self._is_open(session)

    def _is_open(self, session: BoardSession | None) -> bool:
        """Whether this is the session still; what is wrong with one that is over, its end has told."""
        return session is not None and session is self._port.session and session.failure is None

    def _abort_now(self, session: BoardSession) -> None:
        self._aborting = True
        self._continue.set()
        if self.state in (MachineState.RUNNING, MachineState.HOLDING, MachineState.HELD):
            self._apply(Event.ABORT)
        session.post(Hold())
        assert self._tasks is not None
        if self.job is not None:
            self._tasks.create_task(self._truncate_when_held(session, self.job))

    async def _truncate_when_held(self, session: BoardSession, job: Job) -> None:
        """After the hold of an abort: at rest on the path drop the rest of the queue, then end the job."""
        with contextlib.suppress(Rm501Error, TimeoutError):
            await settle(session, self._newest_end, lambda: self.job is job)
        self._end_job(job)

    def _newest_end(self) -> MotionEnded | None:
        return self.last_end

    def _end_job(self, job: Job) -> None:
        """Cancel a job that has not noticed by itself that its motion is over."""
        if self.job is job and self._job_task is not None:
            self._job_task.cancel()

    # ---------------------------------------------------------------------------------- reset, power

    async def _clear_fault(self, session: BoardSession, status: Status, named: str | None) -> Status:
        latched = FaultCode(status.fault)
        if named is None or named.upper() != latched.name:
            cause = causes.board_fault(latched)
            raise RefusedError(f"{cause.text}; {cause.remedy}; a reset has to name the fault: {latched.name}")
        return await session.command(
            Reset(latched, master_reset=latched is FaultCode.OVERFLOW),
            lambda now: now.state is not BoardState.FAULT,
        )

    async def _power_on(self, session: BoardSession) -> None:
        stream = MotionStream(session, self.limits.file)
        old, self.stream = self.stream, None
        if old is not None:
            with contextlib.suppress(ValueError):
                old.detach()
        await stream.prepare()
        stream.offsets.set(self.arm_state.leads_deg)
        if self.override != 1.0:
            session.post(self._rate())
        self.stream = stream
        self._apply(Event.POWER_ON)
        self._causes.clear()

    async def resync(self) -> None:
        """After a motion that broke off in an unknown place: come to rest, take over the board's positions."""
        stream, session = self.stream, self.session
        await settle(session, self._newest_end)
        if stream is not None and session.status is not None and session.status.state is BoardState.READY:
            await stream.prepare()

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
            if self._tasks is not None:
                self._tasks.create_task(self._save(dirty=True))
        was_up = self._port.session is not None
        if was_up or self.state is not MachineState.ESTOP:
            self.stream = None
            self.arm_state.disconnected()
            self._fault(causes.link_lost(error), "link lost")
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
                self._fault(causes.board_fault(fault), fault.name)
            case MotionEnded():
                if self.stream is None or self.stream.motion_ended(notice):
                    self.last_end = notice
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
            self._fault(causes.board_fault(FaultCode(status.fault)), FaultCode(status.fault).name)
            return
        events = events_of(status.state, self.state, has_job=self.job is not None, is_waiting=bool(self.waiting_for))
        for event in events:
            self._apply(event)
        if self.state is MachineState.OFF:
            self._causes.add(causes.POWERED_OFF)

    def _fault(self, cause: causes.Cause, reason: str) -> None:
        self._continue.set()
        if self.state is not MachineState.ESTOP:
            self._apply(Event.FAULT)
        self._condition.tell(cause, reason)

    def _apply(self, event: Event) -> None:
        self._condition.apply(event)
        if self.state.task is not TaskState.ON and self.job is not None:
            self._loop.call_later(_NOTICE_S, self._end_job, self.job)

    def stopped_by_lease(self) -> bool:
        """Whether the newest end of motion was the end of a jog's lease."""
        return self.last_end is not None and self.last_end.cause is EndCause.LEASE

"""Runs one motion at a time as a job: begins it, waits for the operator within it, ends it, brings the state after it.

A job ends by itself, on its path when it is aborted, or because the machine was taken away (a stop, a fault, a lost
link). Whatever ended it, afterwards the board is at rest, the machine in the state that belongs to it, and the position
file up to date.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable

from rm501_host.errors import NoBoardError, RefusedError, Rm501Error, StoppedError
from rm501_host.machine import causes
from rm501_host.machine.arm_state import ArmState
from rm501_host.machine.board_port import BoardPort
from rm501_host.machine.condition import Condition
from rm501_host.machine.drive import Drive
from rm501_host.machine.jobs import Job, JobBook, JobKind
from rm501_host.machine.lease import MotionLease, Owner
from rm501_host.machine.settling import REST_TIMEOUT_S, settle
from rm501_host.machine.states import Event, MachineState, Mode, TaskState, describe
from rm501_host.session import BoardSession
from rm501_protocol.messages import Hold

_LOGGER = logging.getLogger(__name__)
_NOTICE_S = 0.5
"""A job whose motion the board has ended notices within a status period; if not, it is ended."""


class JobRunner:
    """The motion under way, and the ones before. `tasks` is the group that motions run in, None while the machine does
    not run; `stop` stops the arm when a motion fails by an error of ours.
    """

    def __init__(
        self,
        port: BoardPort,
        condition: Condition,
        lease: MotionLease,
        drive: Drive,
        arm_state: ArmState,
        stop: Callable[[], Awaitable[None]],
    ) -> None:
        self.tasks: asyncio.TaskGroup | None = None
        self.book = JobBook()
        self.job: Job | None = None
        self.last_id = 0
        self.mode = Mode.MANUAL
        self.waiting_for = ""
        self._port = port
        self._condition = condition
        self._lease = lease
        self._drive = drive
        self._arm_state = arm_state
        self._stop = stop
        self._loop = asyncio.get_running_loop()
        self._task: asyncio.Task[None] | None = None
        self._continue = asyncio.Event()
        self._aborting = False
        self._saves = asyncio.Lock()
        condition.watch(self._end_when_taken_away)

    @property
    def _state(self) -> MachineState:
        return self._condition.state

    # ------------------------------------------------------------------------------------- beginning

    def start(self, kind: JobKind, who: Owner, body: Callable[[Job], Awaitable[None]], *, homed: bool) -> Job:
        """Start a motion; raises RefusedError when it may not start now, LeaseHeldError when somebody else moves."""
        self._lease.require(who)
        if self._state is not MachineState.IDLE:
            cause = self._condition.causes.shown
            after = f" ({cause.text}; {cause.remedy})" if cause is not None else ""
            raise RefusedError(f"{kind.value} is not possible in {describe(self._state)}{after}; nothing moved")
        if homed and (missing := self._arm_state.unhomed()):
            raise RefusedError(f"not homed: {', '.join(missing)}; home first, until then joints can be jogged slowly")
        if self.tasks is None or self._drive.stream is None:
            raise NoBoardError("the machine does not run; start rm501-host serve")
        job = self.book.new(kind, who)
        self._lease.begin_motion(who)
        self.job = job
        self.last_id = job.id
        self.mode = kind.mode
        self._drive.last_end = None
        self._aborting = False
        self._condition.apply(Event.START)
        self._condition.write_log("motion", motion=job.id, what=kind.value, who=who.name)
        self._task = self.tasks.create_task(self._run(job, body), name=f"motion {job.id}")
        return job

    # ------------------------------------------------------------------------------- waiting within it

    async def wait_for_operator(self, what: str) -> None:
        """A program waits for `wake`; the state is HELD meanwhile. Raises StoppedError when it was stopped instead."""
        self._continue.clear()
        self.waiting_for = what
        self._condition.apply(Event.HOLD)
        self._condition.apply(Event.AT_REST)
        try:
            await self._continue.wait()
        finally:
            self.waiting_for = ""
        if self._aborting or self._state is not MachineState.HELD:
            raise StoppedError(f"stopped while waiting for {what}")
        self._condition.apply(Event.RESUME)

    def wake(self) -> None:
        """End `wait_for_operator`; what it finds then says whether the program goes on."""
        self._continue.set()

    # ------------------------------------------------------------------------------- ending it early

    def abort_now(self, session: BoardSession) -> None:
        """End the motion on its path: hold it, drop the rest when it is at rest."""
        self._aborting = True
        self._continue.set()
        if self._state in (MachineState.RUNNING, MachineState.HOLDING, MachineState.HELD):
            self._condition.apply(Event.ABORT)
        session.post(Hold())
        assert self.tasks is not None
        if self.job is not None:
            self.tasks.create_task(self._truncate_when_held(session, self.job))

    async def end_on_the_path(self, session: BoardSession, job: Job) -> None:
        """`abort_now`, and wait for the end; raises StoppedError when it does not come in time."""
        self.abort_now(session)
        try:
            async with asyncio.timeout(REST_TIMEOUT_S):
                await job.done.wait()
        except TimeoutError:
            raise StoppedError(
                f"motion {job.id} has not ended within {REST_TIMEOUT_S:.0f} s; look at the arm and the status, or stop"
            ) from None

    def stop_instead(self) -> None:
        """A stop takes over from an abort that may be under way."""
        self._aborting = False

    def fault(self, cause: causes.Cause, reason: str) -> None:
        """Something took the machine away: ESTOP, and whoever waits for an operator need not."""
        self._continue.set()
        if self._state is not MachineState.ESTOP:
            self._condition.apply(Event.FAULT)
        self._condition.tell(cause, reason)

    async def _truncate_when_held(self, session: BoardSession, job: Job) -> None:
        """After the hold of an abort: at rest on the path drop the rest of the queue, then end the job."""
        with contextlib.suppress(Rm501Error, TimeoutError):
            await settle(session, self._drive.newest_end, lambda: self.job is job)
        self._end(job)

    def _end(self, job: Job) -> None:
        """Cancel a job that has not noticed by itself that its motion is over."""
        if self.job is job and self._task is not None:
            self._task.cancel()

    def _end_when_taken_away(self) -> None:
        if self._state.task is not TaskState.ON and self.job is not None:
            self._loop.call_later(_NOTICE_S, self._end, self.job)

    # ---------------------------------------------------------------------------------- from end to end

    async def _run(self, job: Job, body: Callable[[Job], Awaitable[None]]) -> None:
        try:
            await self.save(dirty=True)
            await body(job)
        except Rm501Error as error:
            job.error = error
            if isinstance(error, RefusedError) and self._state not in (MachineState.RUNNING, MachineState.IDLE):
                # the board refused what was on its way when the machine was taken away
                job.error = StoppedError(f"{job.kind.value} ended: the machine went to {describe(self._state)}")
        except asyncio.CancelledError:
            why = "aborted" if self._aborting else f"the machine went to {describe(self._state)}"
            job.error = StoppedError(f"{job.kind.value} ended: {why}; the arm stands on its path")
            if self.tasks is None:
                raise
        except Exception as error:
            _LOGGER.exception("motion %d failed", job.id)
            job.error = StoppedError(f"an error of the daemon ended the motion: {error!r}; its log has the details")
            with contextlib.suppress(Rm501Error):
                await self._stop()
        finally:
            self.job = None
            self._lease.end_motion()
            self.waiting_for = ""
            await self._after_motion(job)
            job.done.set()

    async def _after_motion(self, job: Job) -> None:
        """Bring the state to where a motion leaves it, and the position file up to date."""
        session = self._port.session
        is_settled = True
        if session is not None and session.failure is None and self._state.task is TaskState.ON:
            if (self._state is not MachineState.STOPPING or self._aborting) and job.error is not None:
                # motion may be queued that nobody will complete, and only the board knows where it ended
                is_settled = await self._settled(session)
            if self._state in (MachineState.HOLDING, MachineState.HELD):
                self._condition.apply(Event.ABORT)
            if self._state is MachineState.RUNNING or (self._state is MachineState.STOPPING and self._aborting):
                self._condition.apply(Event.FINISHED)
        self._aborting = False
        text = None if job.error is None else str(job.error)
        self._condition.write_log("motion_end", motion=job.id, what=job.kind.value, error=text)
        if is_settled and self._is_open(session):
            await self.save(dirty=False)

    async def save(self, *, dirty: bool) -> None:
        """Write the position file; in the order of the calls: the end of one motion and the beginning of the next may
        meet here.
        """
        async with self._saves:
            await self._loop.run_in_executor(None, lambda: self._arm_state.save(dirty=dirty))

    async def _settled(self, session: BoardSession) -> bool:
        """Bring the board of `session` to rest after a motion that broke off; False, and ESTOP, when it does not tell
        where that is: planning the next motion from a guess would lead the arm along another path than was checked.
        """
        try:
            try:
                await self._drive.resync()
            except (Rm501Error, TimeoutError) as first:
                # what was under way to the board may have met it in between
                self._condition.write_log("resync_again", error=str(first))
                await asyncio.sleep(_NOTICE_S)
                if self._is_open(session):
                    await self._drive.resync()
        except (Rm501Error, TimeoutError) as error:
            if self._is_open(session):
                silence_s = session.silence_s
                reason = str(error) or f"it did not come to rest within {REST_TIMEOUT_S:.0f} s"
                self.fault(causes.silent(silence_s) if silence_s else causes.unsettled(reason), "rest unknown")
                return False
        return self._is_open(session)

    def _is_open(self, session: BoardSession | None) -> bool:
        """Whether this is the session still; what is wrong with one that is over, its end has told."""
        return session is not None and session is self._port.session and session.failure is None

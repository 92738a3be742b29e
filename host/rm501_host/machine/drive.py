"""The motors as the machine drives them: their power, and the stream of motion that exists while they are on.

The stream mirrors where the board is, exactly. What breaks off in an unknown place is brought to rest, and the stream
takes the board's positions over (`resync`); switching the motors on begins a new one.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from rm501_host.errors import RefusedError
from rm501_host.machine import causes
from rm501_host.machine.arm_state import ArmState
from rm501_host.machine.condition import Condition
from rm501_host.machine.feed_override import FeedOverride
from rm501_host.machine.limits import RuntimeLimits
from rm501_host.machine.settling import settle
from rm501_host.machine.states import Event, MachineState, describe
from rm501_host.motion import MotionStream
from rm501_host.session import BoardSession
from rm501_protocol.enums import BoardState
from rm501_protocol.messages import MotionEnded, SetPower


class Drive:
    """Power and stream. `session` gives the open session and raises NoBoardError when there is none."""

    def __init__(
        self,
        session: Callable[[], BoardSession],
        condition: Condition,
        arm_state: ArmState,
        limits: RuntimeLimits,
        override: FeedOverride,
    ) -> None:
        self.stream: MotionStream | None = None
        self.last_end: MotionEnded | None = None
        self._session = session
        self._condition = condition
        self._arm_state = arm_state
        self._limits = limits
        self._override = override

    def newest_end(self) -> MotionEnded | None:
        """The newest report of an end of motion, None when there was none since the motion began."""
        return self.last_end

    def motion_ended(self, report: MotionEnded) -> None:
        """The board reports an end of motion; one that the stream does not take for its own is not kept."""
        if self.stream is None or self.stream.motion_ended(report):
            self.last_end = report

    async def power_on(self, session: BoardSession) -> None:
        """Motors on, with a stream that begins where the board stands; the state becomes IDLE."""
        stream = MotionStream(session, self._limits.file)
        old, self.stream = self.stream, None
        if old is not None:
            with contextlib.suppress(ValueError):
                old.detach()
        await stream.prepare()
        stream.offsets.set(self._arm_state.leads_deg)
        if self._override.ratio != 1.0:
            session.post(self._override.message)
        self.stream = stream
        self._condition.apply(Event.POWER_ON)
        self._condition.causes.clear()

    async def power_off(self, who: str) -> None:
        """Motors off at rest; raises RefusedError unless OFF or IDLE, NoBoardError, BoardRefusedError."""
        state = self._condition.state
        if state is MachineState.OFF:
            return
        if state is not MachineState.IDLE:
            raise RefusedError(f"the machine is {describe(state)}; stop it first")
        self._condition.write_log("power_off", who=who)
        self._condition.apply(Event.POWER_OFF)
        self._condition.causes.add(causes.POWERED_OFF)
        await self._session().command(SetPower(False), lambda status: not status.power)

    async def resync(self) -> None:
        """After a motion that broke off in an unknown place: come to rest, take over the board's positions."""
        stream, session = self.stream, self._session()
        await settle(session, self.newest_end)
        if stream is not None and session.status is not None and session.status.state is BoardState.READY:
            await stream.prepare()

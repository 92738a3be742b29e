"""Getting the machine back after a stop or a fault: one reset at a time, and a stop meanwhile wins."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rm501_host.errors import RefusedError, Rm501Error, StoppedError
from rm501_host.machine import causes
from rm501_host.machine.condition import Condition
from rm501_host.machine.drive import Drive
from rm501_host.machine.settling import settle
from rm501_host.machine.states import Event, MachineState, TaskState, describe
from rm501_host.session import BoardSession
from rm501_host.session.refusals import BoardRefusedError
from rm501_protocol.enums import BoardState
from rm501_protocol.faults import FaultCode
from rm501_protocol.messages import Reset, Status


class Resetting:
    """Resets of the machine. `session` gives the open session and raises NoBoardError when there is none."""

    def __init__(self, session: Callable[[], BoardSession], condition: Condition, drive: Drive) -> None:
        self._session = session
        self._condition = condition
        self._drive = drive
        self._one_at_a_time = asyncio.Lock()
        self._stops = 0

    def stopped(self) -> None:
        """Somebody stops the machine: a reset that is under way does not go on."""
        self._stops += 1

    async def reset(self, who: str, fault: str | None, *, power: bool) -> None:
        """Clear the fault that is named, drop what is queued, switch the motors on if `power`.

        Raises RefusedError naming a fault that was not named, or for a name that none has, NoBoardError,
        BoardRefusedError when its cause is still there, StoppedError when somebody stops meanwhile.
        """
        async with self._one_at_a_time:
            stops = self._stops
            refused: Rm501Error | None = None
            try:
                await self._reset(who, fault, power=power, stops=stops)
            except (BoardRefusedError, StoppedError) as error:
                if self._stops == stops:
                    raise
                refused = error
            if self._stops != stops:
                self._condition.causes.add(causes.OPERATOR_STOP)
                raise StoppedError(
                    "somebody stopped the machine during the reset; look at the arm, then reset again"
                ) from refused

    async def _reset(self, who: str, fault: str | None, *, power: bool, stops: int) -> None:
        condition, session = self._condition, self._session()
        if session.status is None or session.status.state is not BoardState.FAULT:
            causes.require_fault(fault)
        if condition.state.task is TaskState.ON and condition.state is not MachineState.IDLE:
            raise RefusedError(f"the machine is {describe(condition.state)}; stop or abort first")
        if condition.state is MachineState.IDLE and session.status is not None and session.status.power:
            return
        condition.write_log("reset", who=who, fault=fault)
        status = await session.refresh_status()
        if status.state is BoardState.FAULT:
            status = await _clear_fault(session, status, fault)
        await settle(session, self._drive.newest_end)
        if self._stops != stops:
            return
        if session.status is not None and session.status.state is BoardState.IDLE:
            session.post(Reset(FaultCode.NONE))
        if condition.state is MachineState.ESTOP:
            condition.apply(Event.RESET)
        condition.causes.clear()
        condition.causes.add(causes.AFTER_RESET)
        if power:
            await self._drive.power_on(session)


async def _clear_fault(session: BoardSession, status: Status, named: str | None) -> Status:
    latched = FaultCode(status.fault)
    if named is None or named.upper() != latched.name:
        cause = causes.board_fault(latched)
        raise RefusedError(f"{cause.text}; {cause.remedy}; a reset has to name the fault: {latched.name}")
    return await session.command(
        Reset(latched, master_reset=latched is FaultCode.OVERFLOW),
        lambda now: now.state is not BoardState.FAULT,
    )

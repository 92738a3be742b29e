"""What the board's state means for the machine's: the board is the authority on motion, the machine follows it."""

from __future__ import annotations

from rm501_host.machine.states import Event, MachineState, TaskState
from rm501_protocol.enums import BoardState

_HOLDS = (BoardState.HOLDING, BoardState.HELD)


def events_of(board: BoardState, machine: MachineState, *, has_job: bool, is_waiting: bool) -> tuple[Event, ...]:
    """The events that bring the machine to where the board is, in order. `is_waiting`: for an operator, between two
    stretches of a program, when the board stands ready.

    A board in FAULT is told by its report, with the cause: nothing here.
    """
    if machine.task is not TaskState.ON or board is BoardState.FAULT:
        return ()
    if board in (BoardState.IDLE, BoardState.BOOT):
        # without motor power: after a stop, or because it was alone or idle for long
        if machine is MachineState.IDLE:
            return (Event.POWER_OFF,)
        return (Event.STOPPED,) if machine is MachineState.STOPPING else (Event.STOP, Event.STOPPED)
    if machine is MachineState.STOPPING or is_waiting:
        return ()
    if board in _HOLDS and has_job:
        held = (Event.AT_REST,) if board is BoardState.HELD else ()
        if machine is MachineState.RUNNING:
            return (Event.HOLD, *held)
        return held if machine is MachineState.HOLDING else ()
    if board in (BoardState.RUNNING, BoardState.READY) and machine in (MachineState.HOLDING, MachineState.HELD):
        return (Event.RESUME,)
    return ()

"""The machine follows its board: whatever the board is in, the events are legal and lead to where it is."""

from __future__ import annotations

from itertools import product

import pytest

from rm501_host.machine.following import events_of
from rm501_host.machine.states import Event, MachineState, RunState, TaskState, next_state
from rm501_protocol.enums import BoardState

CASES = list(product(BoardState, MachineState, (False, True), (False, True)))


def after(machine: MachineState, events: tuple[Event, ...]) -> MachineState:
    for event in events:
        machine = next_state(machine, event)
    return machine


@pytest.mark.parametrize(("board", "machine", "has_job", "is_waiting"), CASES)
def test_events_are_legal_lead_to_the_board_and_then_nothing_is_left(
    board: BoardState, machine: MachineState, has_job: bool, is_waiting: bool
) -> None:
    reached = after(machine, events_of(board, machine, has_job=has_job, is_waiting=is_waiting))
    assert not events_of(board, reached, has_job=has_job, is_waiting=is_waiting)
    if machine.task is not TaskState.ON or board is BoardState.FAULT:
        assert reached is machine, "ESTOP and OFF are left by an operator, a fault is told with its cause"
    elif board in (BoardState.IDLE, BoardState.BOOT):
        assert reached is MachineState.OFF, "no motor power"
    elif machine is MachineState.STOPPING or is_waiting:
        assert reached is machine, "its end is told by the motion that ends"
    elif board is BoardState.HELD and has_job and machine is not MachineState.IDLE:
        assert reached is MachineState.HELD
    elif board is BoardState.HOLDING and has_job and machine is MachineState.RUNNING:
        assert reached is MachineState.HOLDING
    elif board in (BoardState.RUNNING, BoardState.READY):
        assert reached.run not in (RunState.HOLDING, RunState.HELD)
    if machine is MachineState.IDLE:
        assert reached.run is RunState.IDLE, "a machine at rest starts nothing by itself"

"""The transition table: complete, reachable, refusing what is not in it, and the same as the documentation."""

from __future__ import annotations

import itertools

import pytest

from rm501_host.machine import TRANSITIONS, Event, IllegalTransitionError, MachineState, mermaid_diagram, next_state
from tests.support.virtual_machine import REPOSITORY


def test_whatever_is_not_listed_raises_with_state_event_and_remedy() -> None:
    for state, event in itertools.product(MachineState, Event):
        if (state, event) in TRANSITIONS:
            assert next_state(state, event) is TRANSITIONS[state, event]
            continue
        with pytest.raises(IllegalTransitionError) as caught:
            next_state(state, event)
        assert (caught.value.state, caught.value.event) == (state, event)
        assert event.value in str(caught.value) and ";" in str(caught.value)


def test_every_state_can_be_reached_and_left() -> None:
    reached = {MachineState.ESTOP}
    while True:
        more = {after for (state, _), after in TRANSITIONS.items() if state in reached} | reached
        if more == reached:
            break
        reached = more
    assert reached == set(MachineState)
    for state in MachineState:
        assert any(before is state and after is not state for (before, _), after in TRANSITIONS.items())


@pytest.mark.parametrize("event", [Event.STOP, Event.FAULT])
def test_stop_and_fault_are_possible_in_every_state(event: Event) -> None:
    assert all((state, event) in TRANSITIONS for state in MachineState)


def test_no_fault_and_no_stop_leads_back_to_motion_without_an_operator() -> None:
    """From ESTOP and OFF only reset and power on lead on: nothing resumes by itself."""
    for (state, event), after in TRANSITIONS.items():
        if state in (MachineState.ESTOP, MachineState.OFF) and after is not state:
            assert event in (Event.RESET, Event.POWER_ON, Event.FAULT)
    for (state, event), after in TRANSITIONS.items():
        if after is MachineState.RUNNING and state is not MachineState.RUNNING:
            assert event in (Event.START, Event.RESUME)


def test_the_documentation_holds_this_diagram() -> None:
    text = (REPOSITORY / "docs" / "operating.md").read_text("utf-8")
    assert mermaid_diagram() in text, "run `python -m rm501_host.daemon.documents docs`"

"""What the machine can be, and the one table of what may follow.

The machine is in one `MachineState`; an `Event` takes it to the next. What is not in `TRANSITIONS` cannot happen:
an operator's request is refused with the state and the remedy, an event of the machine itself raises
IllegalTransitionError, for then this table or the code is wrong.

A state has two readings that people and programs know from LinuxCNC: the task state (ESTOP, OFF, ON) and, when ON, the
run state (IDLE, RUNNING, HOLDING, HELD, STOPPING). The mode (MANUAL, MDI, AUTO) says who owns the motion when ON.

    IllegalTransitionError(Rm501Error)
"""

from __future__ import annotations

from enum import Enum

from rm501_host.errors import Rm501Error


class TaskState(Enum):
    """LinuxCNC's task states. ESTOP: something took the machine away. OFF: no motor power. ON: it may move."""

    ESTOP = "ESTOP"
    OFF = "OFF"
    ON = "ON"


class RunState(Enum):
    """What motion does."""

    IDLE = "IDLE"
    RUNNING = "RUNNING"
    HOLDING = "HOLDING"
    HELD = "HELD"
    STOPPING = "STOPPING"


class Mode(Enum):
    """Who owns the motion: a person with keys, a single block, a program."""

    MANUAL = "MANUAL"
    MDI = "MDI"
    AUTO = "AUTO"


class MachineState(Enum):
    """Task state and run state together; value = (task state, run state)."""

    ESTOP = (TaskState.ESTOP, RunState.IDLE)
    OFF = (TaskState.OFF, RunState.IDLE)
    IDLE = (TaskState.ON, RunState.IDLE)
    RUNNING = (TaskState.ON, RunState.RUNNING)
    HOLDING = (TaskState.ON, RunState.HOLDING)
    HELD = (TaskState.ON, RunState.HELD)
    STOPPING = (TaskState.ON, RunState.STOPPING)

    @property
    def task(self) -> TaskState:
        """The task state."""
        return self.value[0]

    @property
    def run(self) -> RunState:
        """The run state; IDLE when not ON."""
        return self.value[1]


class Event(Enum):
    """What happens to the machine."""

    RESET = "reset"
    POWER_ON = "power on"
    POWER_OFF = "power off"
    START = "start"
    HOLD = "hold"
    AT_REST = "at rest"
    RESUME = "resume"
    FINISHED = "finished"
    ABORT = "abort"
    STOP = "stop"
    STOPPED = "stopped"
    FAULT = "fault"


_S = MachineState
_E = Event

TRANSITIONS: dict[tuple[MachineState, Event], MachineState] = {
    # ESTOP is left only by an operator's reset, which succeeds only when the cause is gone
    (_S.ESTOP, _E.RESET): _S.OFF,
    (_S.ESTOP, _E.FAULT): _S.ESTOP,
    (_S.ESTOP, _E.STOP): _S.ESTOP,
    (_S.OFF, _E.RESET): _S.OFF,
    (_S.OFF, _E.POWER_ON): _S.IDLE,
    (_S.OFF, _E.POWER_OFF): _S.OFF,
    (_S.OFF, _E.STOP): _S.OFF,
    (_S.OFF, _E.FAULT): _S.ESTOP,
    (_S.IDLE, _E.RESET): _S.IDLE,
    (_S.IDLE, _E.POWER_ON): _S.IDLE,
    (_S.IDLE, _E.POWER_OFF): _S.OFF,
    (_S.IDLE, _E.START): _S.RUNNING,
    (_S.IDLE, _E.STOP): _S.STOPPING,
    (_S.IDLE, _E.FAULT): _S.ESTOP,
    # the board itself may hold: low water, a button
    (_S.RUNNING, _E.HOLD): _S.HOLDING,
    (_S.RUNNING, _E.FINISHED): _S.IDLE,
    (_S.RUNNING, _E.ABORT): _S.STOPPING,
    (_S.RUNNING, _E.STOP): _S.STOPPING,
    (_S.RUNNING, _E.FAULT): _S.ESTOP,
    (_S.HOLDING, _E.HOLD): _S.HOLDING,
    (_S.HOLDING, _E.AT_REST): _S.HELD,
    (_S.HOLDING, _E.RESUME): _S.RUNNING,
    # a hold that was asked for in the last instant of a motion: there is nothing left to hold
    (_S.HOLDING, _E.FINISHED): _S.IDLE,
    (_S.HOLDING, _E.ABORT): _S.STOPPING,
    (_S.HOLDING, _E.STOP): _S.STOPPING,
    (_S.HOLDING, _E.FAULT): _S.ESTOP,
    (_S.HELD, _E.HOLD): _S.HELD,
    (_S.HELD, _E.RESUME): _S.RUNNING,
    (_S.HELD, _E.ABORT): _S.STOPPING,
    (_S.HELD, _E.STOP): _S.STOPPING,
    (_S.HELD, _E.FAULT): _S.ESTOP,
    # STOP ends with the motors off (category 1), an abort with the motors held
    (_S.STOPPING, _E.STOP): _S.STOPPING,
    (_S.STOPPING, _E.ABORT): _S.STOPPING,
    (_S.STOPPING, _E.STOPPED): _S.OFF,
    (_S.STOPPING, _E.FINISHED): _S.IDLE,
    (_S.STOPPING, _E.FAULT): _S.ESTOP,
}


class IllegalTransitionError(Rm501Error):
    """An event for which the table has no line; `state` and `event` say which."""

    def __init__(self, state: MachineState, event: Event) -> None:
        super().__init__(f"{event.value} is not possible in {describe(state)}; {_remedy(state)}")
        self.state = state
        self.event = event


def next_state(state: MachineState, event: Event) -> MachineState:
    """The state after `event`; raises IllegalTransitionError when the table has no such line."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        raise IllegalTransitionError(state, event) from None


def describe(state: MachineState) -> str:
    """The state as an operator reads it: ESTOP, OFF, or ON and what motion does."""
    return state.task.value if state.task is not TaskState.ON else f"ON/{state.run.value}"


def mermaid_diagram() -> str:
    """The table as a Mermaid state diagram; `docs/operating.md` holds it and a test compares."""
    names = {state: describe(state).replace("/", "_") for state in MachineState}
    lines = ["stateDiagram-v2", "    [*] --> ESTOP"]
    lines += [f"    {names[state]} : {describe(state).replace('/', ' / ')}" for state in MachineState]
    edges: dict[tuple[MachineState, MachineState], list[str]] = {}
    for (state, event), after in TRANSITIONS.items():
        if state is not after:
            edges.setdefault((state, after), []).append(event.value)
    lines += [f"    {names[a]} --> {names[b]} : {', '.join(events)}" for (a, b), events in edges.items()]
    return "\n".join(lines)


def _remedy(state: MachineState) -> str:
    return {
        MachineState.ESTOP: "remove the cause that status names, then reset",
        MachineState.OFF: "reset switches the motors on",
        MachineState.IDLE: "start something first",
        MachineState.RUNNING: "hold or stop first, or wait for the end",
        MachineState.HOLDING: "wait until the arm is at rest, or stop",
        MachineState.HELD: "resume or stop first",
        MachineState.STOPPING: "wait until the arm is at rest",
    }[state]

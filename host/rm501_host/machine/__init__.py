"""The machine: one arm, its state, who moves it, how it is got back after something went wrong."""

from rm501_host.machine.jobs import Job, JobKind
from rm501_host.machine.lease import LeaseHeldError, MotionLease, Owner
from rm501_host.machine.machine import Machine, MachineParts
from rm501_host.machine.states import (
    TRANSITIONS,
    Event,
    IllegalTransitionError,
    MachineState,
    Mode,
    RunState,
    TaskState,
    mermaid_diagram,
    next_state,
)
from rm501_host.machine.status import MachineStatus, status_diff

__all__ = [
    "TRANSITIONS",
    "Event",
    "IllegalTransitionError",
    "Job",
    "JobKind",
    "LeaseHeldError",
    "Machine",
    "MachineParts",
    "MachineState",
    "MachineStatus",
    "Mode",
    "MotionLease",
    "Owner",
    "RunState",
    "TaskState",
    "mermaid_diagram",
    "next_state",
    "status_diff",
]

"""The machine's status, put together from the board's, the arm's and the program's."""

from __future__ import annotations

from typing import Protocol

from rm501_host.errors import Rm501Error
from rm501_host.machine.machine import Machine
from rm501_host.machine.operations import position
from rm501_host.machine.status import MachineStatus
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import BoardState, HoldCause
from rm501_protocol.faults import FaultCode
from rm501_protocol.messages import RATE_ONE, Status

_FRAME_MASK = 0xFFFFFFFF
_HOLD_REMEDIES = {
    HoldCause.NONE: "",
    HoldCause.USER: "resume goes on, abort ends the motion; the position is trusted",
    HoldCause.BUTTON: "CYCLE START or resume go on, abort ends the motion; the position is trusted",
    HoldCause.OVERRIDE: "raise the feed override",
    HoldCause.LOW_WATER: "the host was late; it goes on by itself once enough is queued",
    HoldCause.LINK_LOST: (
        "the line or this host was away for a while; the position is trusted: look at the arm, then resume or abort"
    ),
}


class ProgramView(Protocol):
    """What the status shows of the program."""

    @property
    def name(self) -> str:
        """Name of the loaded program, empty without one."""
        ...

    @property
    def line(self) -> int:
        """Line of the motion under way or the last one executed."""
        ...

    @property
    def block(self) -> str:
        """Text of that line."""
        ...

    @property
    def progress(self) -> float:
        """Done share of the path time."""
        ...

    @property
    def time_left_s(self) -> float:
        """Path time left."""
        ...

    @property
    def checked_to_line(self) -> int:
        """How far it has been checked."""
        ...

    @property
    def check_complete(self) -> bool:
        """Whether that is its end."""
        ...

    @property
    def single_block(self) -> bool:
        """Stop after every block."""
        ...

    @property
    def optional_stop(self) -> bool:
        """Pause at M1."""
        ...


def snapshot(machine: Machine, program: ProgramView, time_s: float, *, jog_damped: bool = False) -> MachineStatus:
    """The status now."""
    status = machine.board_status
    arm = machine.arm_state
    cause = machine.cause
    homed = arm.homed
    limits = machine.limits.in_force
    queue_lead_s = 0.0
    if status is not None and status.queue_used:
        frames = (status.queue_end_frame - status.motion_frame) & _FRAME_MASK
        queue_lead_s = frames * machine.frame_s
    return MachineStatus(
        time_s=round(time_s, 4),
        task_state=machine.state.task.value,
        run_state=machine.state.run.value,
        mode=machine.mode.value,
        cause=_why(machine, status) if cause is None else cause.text,
        remedy=_remedy(status) if cause is None else cause.remedy,
        activity=machine.job.kind.value if machine.job is not None else "",
        motion_id=machine.last_job_id,
        owner="" if machine.lease.owner is None else machine.lease.owner.name,
        connected=machine.connected,
        link_silent=machine.link_silent,
        board_state="" if status is None else BoardState(status.state).name,
        hold_cause="" if status is None or not status.hold_cause else HoldCause(status.hold_cause).name,
        fault="" if status is None or not status.fault else FaultCode(status.fault).name,
        homed=homed,
        joints_deg=tuple(round(angle, 4) for angle in arm.joints_deg),
        position=_position(machine) if all(homed) else None,
        steps=arm.steps,
        hand=arm.hand,
        inputs=() if status is None else tuple(name.name for name in InputId if status.inputs >> name & 1),
        outputs=0 if status is None else status.outputs,
        power=status is not None and status.power,
        rate=0.0 if status is None else round(status.rate / RATE_ONE, 4),
        override=machine.override,
        jog_damped=jog_damped,
        limits_reduced=machine.limits.are_reduced,
        velocity_limits_deg_s=limits.velocity_deg_s,
        acceleration_limits_deg_s2=limits.acceleration_deg_s2,
        tcp_limit_mm_s=limits.tcp_speed_mm_s,
        queue_used=0 if status is None else status.queue_used,
        queue_lead_s=round(queue_lead_s, 3),
        program=program.name,
        line=program.line,
        block=program.block,
        progress=round(program.progress, 4),
        time_left_s=round(program.time_left_s, 2),
        checked_to_line=program.checked_to_line,
        check_complete=program.check_complete,
        single_block=program.single_block,
        optional_stop=program.optional_stop,
        waiting=machine.waiting_for,
        messages=tuple(machine.messages),
        warnings=machine.warnings,
    )


def _why(machine: Machine, status: Status | None) -> str:
    if status is not None and status.hold_cause:
        return f"held: {HoldCause(status.hold_cause).name}"
    return ""


def _remedy(status: Status | None) -> str:
    return "" if status is None or not status.hold_cause else _HOLD_REMEDIES[HoldCause(status.hold_cause)]


def _position(machine: Machine) -> tuple[float, ...] | None:
    try:
        return tuple(round(value, 3) for value in position(machine))
    except Rm501Error:
        return None

"""Faults of the board in words: what, where, which joints, what to do."""

from __future__ import annotations

from rm501_protocol.board_config import InputId, Motor
from rm501_protocol.faults import FAULT_TEXTS, FaultCode
from rm501_protocol.messages import FaultReport

_JOINTS_OF_MOTOR = {
    Motor.WAIST: ("waist",),
    Motor.SHOULDER: ("shoulder",),
    Motor.ELBOW: ("elbow",),
    Motor.RIGHT_WRIST: ("pitch", "roll"),
    Motor.LEFT_WRIST: ("pitch", "roll"),
}


def fault_text(code: FaultCode) -> str:
    """Cause and remedy of a fault code, as one phrase."""
    text = FAULT_TEXTS.get(code)
    return f"fault {code}" if text is None else f"{text.cause}; {text.remedy}"


def describe_fault(report: FaultReport) -> str:
    """A fault report in words; an overflow names its line and the joints whose position is lost."""
    text = FAULT_TEXTS.get(report.fault)
    if text is None:
        return f"fault {report.fault} (source {report.source}, value {report.value}, limit {report.limit})"
    details = [
        f"{what} {number}"
        for what, number in ((text.source, report.source), (text.value, report.value), (text.limit, report.limit))
        if what
    ]
    if report.fault in (FaultCode.OVERFLOW, FaultCode.ESTOP) and report.source in list(InputId):
        details = [InputId(report.source).name]
    if report.fault is FaultCode.OVERFLOW:
        details.append(f"joints {', '.join(joints_of_motors(report.value))}: position lost")
    where = f" ({'; '.join(details)})" if details else ""
    return f"{text.cause}{where}; {text.remedy}"


def joints_of_motors(mask: int) -> tuple[str, ...]:
    """Names of the joints that the motors of a mask carry, each once, in joint order."""
    named = {name for motor, names in _JOINTS_OF_MOTOR.items() if mask >> motor & 1 for name in names}
    return tuple(name for name in ("waist", "shoulder", "elbow", "pitch", "roll") if name in named)

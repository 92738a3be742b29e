"""Faults in words: the line, the joints, the remedy."""

import pytest

from rm501_host.session.fault_words import describe_fault, fault_text, joints_of_motors
from rm501_protocol.board_config import INPUT_LINES, InputId
from rm501_protocol.faults import FAULT_TEXTS, FaultCode
from rm501_protocol.messages import FaultReport


def report(fault: FaultCode, source: int, value: int = 0) -> FaultReport:
    return FaultReport(fault, source, value, 0, 0, 0, 0)


def test_an_overflow_names_its_line_and_the_joints_of_its_board() -> None:
    for line in (InputId.OVERFLOW_724, InputId.OVERFLOW_732):
        text = describe_fault(report(FaultCode.OVERFLOW, line, INPUT_LINES[line].motors))
        assert line.name in text
        joints = ("waist", "elbow") if line is InputId.OVERFLOW_724 else ("shoulder", "pitch", "roll")
        assert ", ".join(joints) in text
        assert "home" in text


@pytest.mark.parametrize("fault", [fault for fault in FaultCode if fault is not FaultCode.NONE])
def test_every_fault_has_a_cause_and_a_remedy(fault: FaultCode) -> None:
    text = FAULT_TEXTS[fault]
    assert text.cause in describe_fault(report(fault, 0))
    assert text.remedy in fault_text(fault)


def test_a_wrist_motor_carries_two_joints_named_once() -> None:
    assert joints_of_motors(0b11000) == ("pitch", "roll")
    assert joints_of_motors(0) == ()

"""The full product: every message, stop and event in every state has the answer that the table defines, no other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rm501_firmware_model.states import MESSAGE_STIMULI, RULES, STATES, Stimulus, Verdict, diagram, rule
from rm501_protocol.board_config import RM501_BOARD, InputId
from rm501_protocol.config_pages import ConfigCommit
from rm501_protocol.declaration import Message
from rm501_protocol.enums import BoardState, Edge, SegmentFlag, TriggerAction
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import (
    ArmTrigger,
    DisarmTrigger,
    FaultReport,
    Hold,
    Lease,
    Refused,
    Reset,
    Resume,
    SetOutputs,
    SetOverride,
    SetPositions,
    SetPower,
    SetStatusPeriod,
    Start,
    Status,
    StatusRequest,
    Truncate,
)
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.rig import ONE, Rig

SPEED = 1 << 29  # an eighth of a step per frame: 390 steps/s


def cruise(rig: Rig, length: int = 20_000, *, jog: bool = False) -> list[Segment]:
    """Get up to speed, and a long way at that speed."""
    flags = SegmentFlag.JOG if jog else SegmentFlag.NONE
    a = (SPEED << 8) // 2000
    return [
        rig.segment(2000, MotorTerm(0, 0, a), flags=flags, hold=800, stop=1600),
        rig.segment(length, MotorTerm(0, SPEED), flags=flags, hold=800, stop=1600),
    ]


def to_boot() -> Rig:
    return Rig(configured=False)


def to_idle() -> Rig:
    return Rig(power=False)


def to_ready() -> Rig:
    return Rig()


def to_running() -> Rig:
    rig = Rig()
    rig.go(*cruise(rig))
    rig.run(3000)
    return rig


def to_holding() -> Rig:
    rig = to_running()
    rig.send(Hold())
    rig.run(50)
    return rig


def to_held() -> Rig:
    rig = to_holding()
    rig.run_to(BoardState.HELD)
    return rig


def to_stopping() -> Rig:
    rig = to_running()
    rig.stop()
    rig.run(20)
    return rig


def to_fault() -> Rig:
    rig = to_running()
    rig.stop(StopKind.KILL)
    rig.run(5)
    return rig


BRING: dict[BoardState, Callable[[], Rig]] = {
    BoardState.BOOT: to_boot,
    BoardState.IDLE: to_idle,
    BoardState.READY: to_ready,
    BoardState.RUNNING: to_running,
    BoardState.HOLDING: to_holding,
    BoardState.HELD: to_held,
    BoardState.STOPPING: to_stopping,
    BoardState.FAULT: to_fault,
}


def message_for(stimulus: Stimulus, rig: Rig) -> Message:
    """A message of the kind that is in order in as many states as possible."""
    made: dict[Stimulus, Message] = {
        Stimulus.SEGMENT: Segment(rig.start_frames, 1000, (MotorTerm(0, SPEED),), hold_slope=800, stop_slope=1600)
        if rig.start_frames
        else Segment(0, 1000, hold_slope=800, stop_slope=1600),
        Stimulus.HOLD: Hold(),
        Stimulus.RESUME: Resume(),
        Stimulus.SET_OVERRIDE: SetOverride(ONE // 2),
        Stimulus.TRUNCATE: Truncate(rig.start_frames),
        Stimulus.RESET: Reset(FaultCode(rig.core.fault)),
        Stimulus.SET_POSITIONS: SetPositions(1, (0,) * 6),
        Stimulus.ARM_TRIGGER: ArmTrigger(0, InputId.SWITCH_ELBOW, Edge.RISING, TriggerAction.LATCH),
        Stimulus.DISARM_TRIGGER: DisarmTrigger(0),
        Stimulus.SET_POWER: SetPower(True),
        Stimulus.SET_OUTPUTS: SetOutputs(0, 0),
        Stimulus.LEASE: Lease(200),
        Stimulus.START: Start(),
        Stimulus.SET_STATUS_PERIOD: SetStatusPeriod(0),
        Stimulus.CONFIG_PAGE: RM501_BOARD.timing,
        Stimulus.CONFIG_COMMIT: ConfigCommit(1),
        Stimulus.STATUS_REQUEST: StatusRequest(),
    }
    return made[stimulus]


# refused in these states by a guard, not by the table
GUARDED = {
    (BoardState.IDLE, Stimulus.SET_POSITIONS): RefusalReason.POWER_OFF,
    (BoardState.READY, Stimulus.START): RefusalReason.WRONG_STATE,  # nothing queued
    (BoardState.BOOT, Stimulus.CONFIG_COMMIT): RefusalReason.CONFIG_INVALID,  # no pages sent
    (BoardState.IDLE, Stimulus.CONFIG_COMMIT): RefusalReason.CONFIG_INVALID,
}

UNCHANGED = (
    "state",
    "rate",
    "override",
    "queue_used",
    "queue_end_frame",
    "power",
    "trusted_mask",
    "hold_cause",
    "fault",
)
"""What a refused message, or one without effect, leaves as it was."""


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.name)
@pytest.mark.parametrize("stimulus", MESSAGE_STIMULI, ids=lambda stimulus: stimulus.name)
def test_every_message_in_every_state(state: BoardState, stimulus: Stimulus) -> None:
    rig = BRING[state]()
    assert rig.state is state
    before = rig.status()
    rig.messages.clear()
    rig.send(message_for(stimulus, rig))
    answer = rule(state, stimulus)
    refusals = rig.got(Refused)
    if answer.verdict == Verdict.REFUSE:
        assert [refused.reason for refused in refusals] == [answer.reason]
    elif (state, stimulus) in GUARDED:
        assert [refused.reason for refused in refusals] == [GUARDED[state, stimulus]]
    else:
        assert refusals == []
    allowed = (state, *answer.targets) if answer.verdict == Verdict.DO else (state,)
    assert rig.state in allowed
    if refusals or answer.verdict == Verdict.SKIP:
        after = rig.status()
        for name in UNCHANGED:
            assert getattr(after, name) == getattr(before, name), name
    # no message makes a fault, one clears it
    assert rig.core.fault == (FaultCode.NONE if stimulus is Stimulus.RESET else before.fault)


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.name)
@pytest.mark.parametrize("stimulus", [s for s in Stimulus if s not in MESSAGE_STIMULI], ids=lambda s: s.name)
def test_every_event_in_every_state(state: BoardState, stimulus: Stimulus) -> None:
    """What the table calls impossible latches a fault; everything else does not."""
    rig = BRING[state]()
    core = rig.core
    fault_before = core.fault
    answer = rule(state, stimulus)
    acts = core.answers(stimulus)
    assert acts == (answer.verdict == Verdict.DO)
    if answer.verdict == Verdict.BAD:
        assert core.state is BoardState.FAULT
        assert core.fault == (fault_before or FaultCode.ILLEGAL_TRANSITION)
        if fault_before:
            assert core.later_faults == 1
    else:
        assert core.fault == fault_before


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.name)
def test_an_unlisted_transition_latches_a_fault(state: BoardState) -> None:
    rig = BRING[state]()
    core = rig.core
    core.stimulus = Stimulus.STATUS_REQUEST  # leads nowhere
    other = next(other for other in STATES if other not in (state, BoardState.FAULT))
    core.enter(other)
    assert core.state is BoardState.FAULT
    if state is not BoardState.FAULT:
        assert (core.fault, core.fault_source, core.fault_value) == (
            FaultCode.ILLEGAL_TRANSITION,
            state,
            Stimulus.STATUS_REQUEST,
        )
        rig.run(1)
        assert rig.got(FaultReport)[-1].fault is FaultCode.ILLEGAL_TRANSITION


@pytest.mark.parametrize("state", STATES, ids=lambda state: state.name)
def test_fault_28_stop_wins_in_every_state(state: BoardState) -> None:
    rig = BRING[state]()
    old_fault = rig.core.fault
    rig.send(*[Segment(rig.start_frames, 50)] * 3)  # in flight, some refused
    rig.stop()
    rig.run_to({BoardState.BOOT: state, BoardState.FAULT: state}.get(state, BoardState.IDLE))
    rig.run(200)
    status = rig.status()
    assert (status.rate, status.queue_used, status.power) == (0, 0, False)
    assert status.fault == old_fault
    counts = status.positions_steps
    rig.run(2000)
    assert rig.status().positions_steps == counts


def test_kill_in_every_state_makes_no_step_from_the_next_frame() -> None:
    for state in STATES:
        rig = BRING[state]()
        rig.stop(StopKind.KILL)
        counts = list(rig.core.stepgen.count)
        rig.run(500)
        status = rig.status()
        assert rig.state is BoardState.FAULT and status.fault is FaultCode.KILLED
        assert list(rig.core.stepgen.count) == counts
        assert (status.trusted_mask, status.power, status.outputs) == (0, False, 0)


def test_the_table_is_complete_and_reaches_every_state() -> None:
    assert set(RULES) == set(Stimulus)
    assert all(len(row) == len(STATES) for row in RULES.values())
    reached = {BoardState.BOOT}
    for _ in STATES:
        for state in list(reached):
            for row in RULES.values():
                reached |= set(row[state].targets)
    assert reached == set(STATES)
    # whatever has a reason is a refusal and the other way round
    for row in RULES.values():
        for answer in row:
            assert (answer.verdict == Verdict.REFUSE) == bool(answer.reason)


def test_the_diagram_in_the_documentation_is_the_table() -> None:
    page = Path(__file__).parents[2] / "docs" / "firmware.md"
    assert diagram() in page.read_text(encoding="utf-8")


def test_status_reports_every_state() -> None:
    for state in STATES:
        rig = BRING[state]()
        assert rig.status().state is state
        assert rig.got(Status)

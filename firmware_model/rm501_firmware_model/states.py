"""The board's states and the one table that says what every message and event does in each of them.

`RULES` has a row per stimulus and a column per state. `do(A, B)` obeys and may lead to A or B or stay; `skip` accepts
and has no effect; `no(reason)` refuses the message with that reason; `bad` cannot happen and latches
FAULT ILLEGAL_TRANSITION. What a stimulus does in a state beyond that is in `core` and `commands`; that nothing else
happens is checked when a state is entered. The diagram in the documentation is drawn from this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from rm501_protocol.enums import BoardState
from rm501_protocol.faults import RefusalReason

__all__ = ["MESSAGE_STIMULI", "RULES", "STATES", "Rule", "Stimulus", "Verdict", "diagram", "rule"]


class Stimulus(IntEnum):
    """Everything the board answers to: messages first, then events."""

    SEGMENT = 0
    HOLD = 1
    RESUME = 2
    SET_OVERRIDE = 3
    TRUNCATE = 4
    RESET = 5
    SET_POSITIONS = 6
    ARM_TRIGGER = 7
    DISARM_TRIGGER = 8
    SET_POWER = 9
    SET_OUTPUTS = 10
    LEASE = 11
    START = 12
    SET_STATUS_PERIOD = 13
    CONFIG_PAGE = 14
    CONFIG_COMMIT = 15
    STATUS_REQUEST = 16
    STOP = 17
    KILL = 18
    SESSION_OPENED = 19
    LOW_WATER = 20
    RATE_ZERO = 21
    DRAINED = 22
    UNDERRUN = 23
    LINK_LOST = 24
    LINK_IDLE = 25
    LEASE_OVER = 26
    TRIGGER_STOP = 27
    HOLD_BUTTON = 28
    CYCLE_START = 29
    ESTOP = 30
    OVERFLOW = 31
    SOFT_FAULT = 32
    HARD_FAULT = 33


MESSAGE_STIMULI = tuple(stimulus for stimulus in Stimulus if stimulus <= Stimulus.STATUS_REQUEST)


class Verdict(IntEnum):
    """What becomes of a stimulus."""

    DO = 0
    SKIP = 1
    REFUSE = 2
    BAD = 3


@dataclass(frozen=True, slots=True)
class Rule:
    """The answer to one stimulus in one state; `targets` are the states it may lead to besides staying."""

    verdict: Verdict
    reason: int = 0
    targets: tuple[BoardState, ...] = ()


STATES = tuple(BoardState)
_BOOT, _IDLE, _READY, _RUNNING, _HOLDING, _HELD, _STOPPING, _FAULT = STATES


def _do(*targets: BoardState) -> Rule:
    return Rule(Verdict.DO, 0, targets)


def _no(reason: RefusalReason) -> Rule:
    return Rule(Verdict.REFUSE, reason)


do = _do()
skip = Rule(Verdict.SKIP)
bad = Rule(Verdict.BAD)
_config = _no(RefusalReason.NOT_CONFIGURED)
_power = _no(RefusalReason.POWER_OFF)
_state = _no(RefusalReason.WRONG_STATE)
_rest = _no(RefusalReason.NOT_AT_REST)
_fault = _no(RefusalReason.FAULT_LATCHED)
_to_idle = _do(_IDLE)
_to_ready = _do(_READY)
_to_running = _do(_RUNNING)
_to_holding = _do(_HOLDING)
_to_held = _do(_HELD)
_to_stopping = _do(_STOPPING)
_to_fault = _do(_FAULT)
_on_again = _do(_RUNNING, _READY)
_reset = _do(_IDLE, _READY, _BOOT)
_stopped = _do(_IDLE, _READY, _FAULT)

# fmt: off
RULES: dict[Stimulus, tuple[Rule, ...]] = {
    # BOOT       IDLE       READY        RUNNING       HOLDING       HELD        STOPPING   FAULT
    Stimulus.SEGMENT:           (_config,   _power,    _to_running, do,           do,           do,         _state,
    _fault), Stimulus.HOLD:              (skip,      skip,      _to_held,    _to_holding,  do,           do,
    skip,      skip), Stimulus.RESUME:            (_config,   _state,    skip,        skip,         _to_running,
    _on_again,  _state,    _fault), Stimulus.SET_OVERRIDE:      (_config,   do,        do,          _to_holding,
    _to_running,  _on_again,  do,        do), Stimulus.TRUNCATE:          (_config,   do,        do,          do,
    do,           _to_ready,  _state,    _fault), Stimulus.RESET:             (do,        do,        _state,
    _state,       _state,       _state,     _state,    _reset), Stimulus.SET_POSITIONS:     (_config,   do,        do,
    _rest,        _rest,        _rest,      _rest,     _fault), Stimulus.ARM_TRIGGER:       (_config,   do,        do,
    _to_stopping, _to_stopping, _to_ready,  do,        do), Stimulus.DISARM_TRIGGER:    (_config,   do,        do,
    do,           do,           do,         do,        do), Stimulus.SET_POWER:         (_config,   _to_ready,
    _to_idle,    _rest,        _rest,        _to_idle,   _rest,     _fault), Stimulus.SET_OUTPUTS:       (_config,
    do,        do,          do,           do,           do,         do,        _fault), Stimulus.LEASE:
    (_config,   do,        do,          _to_stopping, _to_stopping, _to_ready,  do,        do), Stimulus.START:
    (_config,   _power,    _do(_RUNNING, _HOLDING), skip, _state,   _state,     _state,    _fault),
    Stimulus.SET_STATUS_PERIOD: (do,        do,        do,          do,           do,           do,         do,
    do), Stimulus.CONFIG_PAGE:       (do,        do,        _state,      _state,       _state,       _state,
    _state,    _fault), Stimulus.CONFIG_COMMIT:     (_to_idle,  do,        _state,      _state,       _state,
    _state,     _state,    _fault), Stimulus.STATUS_REQUEST:    (do,        do,        do,          do,           do,
    do,         do,        do), Stimulus.STOP:              (do,        do,        _to_idle,    _to_stopping,
    _to_stopping, _to_idle,   do,        do), Stimulus.KILL:              (_to_fault, _to_fault, _to_fault,
    _to_fault,    _to_fault,    _to_fault,  _to_fault, do), Stimulus.SESSION_OPENED:    (do,        do,        do,
    _to_holding,  do,           do,         do,        do), Stimulus.LOW_WATER:         (bad,       bad,       bad,
    _to_holding,  bad,          bad,        bad,       bad), Stimulus.RATE_ZERO:         (bad,       bad,       bad,
    bad,          _to_held,     bad,        _stopped,  bad), Stimulus.DRAINED:           (bad,       bad,       bad,
    _to_ready,    _to_held,     bad,        _stopped,  bad), Stimulus.UNDERRUN:          (bad,       bad,       bad,
    _to_fault,    _to_fault,    bad,        _to_fault, bad), Stimulus.LINK_LOST:         (skip,      skip,      skip,
    _to_holding,  do,           skip,       skip,      skip), Stimulus.LINK_IDLE:         (skip,      skip,
    _to_idle,    skip,         skip,         _to_idle,   skip,      skip), Stimulus.LEASE_OVER:        (skip,
    skip,      do,          _to_stopping, _to_stopping, _to_ready,  skip,      skip), Stimulus.TRIGGER_STOP:
    (skip,      skip,      do,          _to_stopping, _to_stopping, _to_ready,  skip,      skip),
    Stimulus.HOLD_BUTTON:       (skip,      skip,      _to_held,    _to_holding,  do,           do,         skip,
    skip), Stimulus.CYCLE_START:       (skip,      skip,      skip,        skip,         _to_running,  _on_again,
    skip,      skip), Stimulus.ESTOP:             (skip,      _to_fault, _to_fault,   _to_fault,    _to_fault,
    _to_fault,  _to_fault, do), Stimulus.OVERFLOW:          (skip,      _to_fault, _to_fault,   _to_fault,
    _to_fault,    _to_fault,  _to_fault, do), Stimulus.SOFT_FAULT:        (_to_fault, _to_fault, _to_fault,
    _to_stopping, _to_stopping, _to_fault,  do,        do), Stimulus.HARD_FAULT:        (_to_fault, _to_fault,
    _to_fault,   _to_fault,    _to_fault,    _to_fault,  _to_fault, do),
}
# fmt: on


def rule(state: int, stimulus: int) -> Rule:
    """The answer to `stimulus` in `state`."""
    return RULES[_STIMULI[stimulus]][state]


_STIMULI = tuple(Stimulus)


def diagram() -> str:
    """The states and what leads from one to another, as Mermaid text for the documentation."""
    lines = ["stateDiagram-v2", "    [*] --> BOOT"]
    for state in STATES:
        for target in STATES:
            causes = [stimulus.name for stimulus in Stimulus if target in RULES[stimulus][state].targets]
            if causes:
                lines.append(f"    {state.name} --> {target.name} : {', '.join(causes)}")
    return "\n".join(lines) + "\n"

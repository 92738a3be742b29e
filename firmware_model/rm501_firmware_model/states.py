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
_started = _do(_RUNNING, _HOLDING)
_reset = _do(_IDLE, _READY, _BOOT)
_stopped = _do(_IDLE, _READY, _FAULT)

_S = Stimulus

# fmt: off
RULES: dict[Stimulus, tuple[Rule, ...]] = {
    #                      BOOT       IDLE       READY        RUNNING       HOLDING       HELD       STOPPING   FAULT
    _S.SEGMENT:           (_config,   _power,    _started,    do,           do,           do,        _state,    _fault),
    _S.HOLD:              (skip,      skip,      _to_held,    _to_holding,  do,           do,        skip,      skip),
    _S.RESUME:            (_config,   _state,    skip,        skip,         _to_running,  _on_again, _state,    _fault),
    _S.SET_OVERRIDE:      (_config,   do,        do,          _to_holding,  _to_running,  _on_again, do,        do),
    _S.TRUNCATE:          (_config,   do,        do,          do,           do,           _to_ready, _state,    _fault),
    _S.RESET:             (do,        do,        _state,      _state,       _state,       _state,    _state,    _reset),
    _S.SET_POSITIONS:     (_config,   do,        do,          _rest,        _rest,        _rest,     _rest,     _fault),
    _S.ARM_TRIGGER:       (_config,   do,        do,          _to_stopping, _to_stopping, _to_ready, do,        do),
    _S.DISARM_TRIGGER:    (_config,   do,        do,          do,           do,           do,        do,        do),
    _S.SET_POWER:         (_config,   _to_ready, _to_idle,    _rest,        _rest,        _to_idle,  _rest,     _fault),
    _S.SET_OUTPUTS:       (_config,   do,        do,          do,           do,           do,        do,        _fault),
    _S.LEASE:             (_config,   do,        do,          _to_stopping, _to_stopping, _to_ready, do,        do),
    _S.START:             (_config,   _power,    _started,    skip,         _state,       _state,    _state,    _fault),
    _S.SET_STATUS_PERIOD: (do,        do,        do,          do,           do,           do,        do,        do),
    _S.CONFIG_PAGE:       (do,        do,        _state,      _state,       _state,       _state,    _state,    _fault),
    _S.CONFIG_COMMIT:     (_to_idle,  do,        _state,      _state,       _state,       _state,    _state,    _fault),
    _S.STATUS_REQUEST:    (do,        do,        do,          do,           do,           do,        do,        do),
    _S.STOP:              (do,        do,        _to_idle,    _to_stopping, _to_stopping, _to_idle,  do,        do),
    _S.KILL:              (_to_fault, _to_fault, _to_fault,   _to_fault,    _to_fault,    _to_fault, _to_fault, do),
    _S.SESSION_OPENED:    (do,        do,        do,          _to_holding,  do,           do,        do,        do),
    _S.LOW_WATER:         (bad,       bad,       bad,         _to_holding,  bad,          bad,       bad,       bad),
    _S.RATE_ZERO:         (bad,       bad,       bad,         bad,          _to_held,     bad,       _stopped,  bad),
    _S.DRAINED:           (bad,       bad,       bad,         _to_ready,    _to_held,     bad,       _stopped,  bad),
    _S.UNDERRUN:          (bad,       bad,       bad,         _to_fault,    _to_fault,    bad,       _to_fault, bad),
    _S.LINK_LOST:         (skip,      skip,      skip,        _to_holding,  do,           skip,      skip,      skip),
    _S.LINK_IDLE:         (skip,      skip,      _to_idle,    skip,         skip,         _to_idle,  skip,      skip),
    _S.LEASE_OVER:        (skip,      skip,      do,          _to_stopping, _to_stopping, _to_ready, skip,      skip),
    _S.TRIGGER_STOP:      (skip,      skip,      do,          _to_stopping, _to_stopping, _to_ready, skip,      skip),
    _S.HOLD_BUTTON:       (skip,      skip,      _to_held,    _to_holding,  do,           do,        skip,      skip),
    _S.CYCLE_START:       (skip,      skip,      skip,        skip,         _to_running,  _on_again, skip,      skip),
    _S.ESTOP:             (skip,      _to_fault, _to_fault,   _to_fault,    _to_fault,    _to_fault, _to_fault, do),
    _S.OVERFLOW:          (skip,      _to_fault, _to_fault,   _to_fault,    _to_fault,    _to_fault, _to_fault, do),
    _S.SOFT_FAULT:        (_to_fault, _to_fault, _to_fault,   _to_stopping, _to_stopping, _to_fault, do,        do),
    _S.HARD_FAULT:        (_to_fault, _to_fault, _to_fault,   _to_fault,    _to_fault,    _to_fault, _to_fault, do),
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

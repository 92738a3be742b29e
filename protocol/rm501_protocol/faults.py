"""Numbered faults and refusals of the board, each with its cause, effect and remedy in words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

__all__ = ["FAULT_TEXTS", "REFUSAL_TEXTS", "FaultCode", "FaultText", "RefusalReason", "RefusalText"]


class FaultCode(IntEnum):
    """Why the board latched FAULT. Cleared only by Reset naming the same code."""

    NONE = 0
    OVERFLOW = 1
    ESTOP = 2
    KILLED = 3
    POSITION_RANGE = 4
    STEP_LATE = 5
    MOTION_UNDERRUN = 6
    HAND_TIME = 7
    CONFIG_CORRUPT = 8
    ILLEGAL_TRANSITION = 9
    INTERNAL = 10
    CLOCK = 11


@dataclass(frozen=True, slots=True)
class FaultText:
    """A fault in words; `source`, `value` and `limit` say what these fields of FaultReport mean for it."""

    cause: str
    effect: str
    remedy: str
    source: str = ""
    value: str = ""
    limit: str = ""


FAULT_TEXTS: dict[FaultCode, FaultText] = {
    FaultCode.NONE: FaultText("no fault", "none", "none"),
    FaultCode.OVERFLOW: FaultText(
        "the up/down counter of a driver board overflowed: its motor did not follow the commanded steps",
        "steps stop from the next frame; the motors of that board are untrusted",
        "remove the obstacle or load, reset with master reset, home the joints of that board again",
        source="input number of the OVERFLOW line",
        value="mask of the motors on that board",
    ),
    FaultCode.ESTOP: FaultText(
        "the emergency stop line is open",
        "steps stop from the next frame, motor power off, every motor untrusted",
        "release the emergency stop, reset, home again",
        source="input number of the ESTOP line",
    ),
    FaultCode.KILLED: FaultText(
        "a KILL was received",
        "steps stop from the next frame, outputs at their safe levels, every motor untrusted",
        "reset, home again",
    ),
    FaultCode.POSITION_RANGE: FaultText(
        "a motor's position left the signed 32-bit range",
        "steps stop from the next frame; that motor is untrusted",
        "reset, home that joint again; report how it came about",
        source="motor",
        value="position in steps",
        limit="largest position in steps",
    ),
    FaultCode.STEP_LATE: FaultText(
        "a motor's made steps fell behind its position by more than legal segments can cause",
        "steps stop from the next frame; that motor is untrusted",
        "report it: a legal segment cannot cause this",
        source="motor",
        value="lag in 2^-16 step",
        limit="largest lag in 2^-16 step",
    ),
    FaultCode.MOTION_UNDERRUN: FaultText(
        "the queue ran empty while moving in spite of the low-water hold",
        "steps stop at speed; every motor is untrusted",
        "reset, home again; report it: slopes and queue cannot have been consistent",
        value="rate, Q0.24",
    ),
    FaultCode.HAND_TIME: FaultText(
        "the hand was powered for longer than its limit",
        "hand power off; motion holds on the path",
        "check for a jam, then reset",
        value="pulses made",
        limit="largest number of pulses",
    ),
    FaultCode.CONFIG_CORRUPT: FaultText(
        "the stored configuration no longer matches its hash",
        "steps stop from the next frame, motor power off, every motor untrusted",
        "reset, send the configuration again, home again",
        value="hash found",
        limit="hash expected",
    ),
    FaultCode.ILLEGAL_TRANSITION: FaultText(
        "an event arrived for which the state has no transition",
        "steps stop from the next frame; every motor is untrusted",
        "report it: this is an error of the firmware",
        source="state",
        value="event",
    ),
    FaultCode.INTERNAL: FaultText(
        "a check inside the firmware failed",
        "steps stop from the next frame; every motor is untrusted",
        "report it with source and value",
        source="number of the check",
        value="value found",
        limit="value allowed",
    ),
    FaultCode.CLOCK: FaultText(
        "the base period was missed: the tick ran for longer than it may",
        "steps stop from the next frame; every motor is untrusted",
        "use a longer base period or report it",
        value="ticks missed",
    ),
}


class RefusalReason(IntEnum):
    """Why the board refused one message. Nothing of a refused message takes effect."""

    UNKNOWN_MESSAGE = 1
    MALFORMED = 2
    WRONG_STATE = 3
    FAULT_LATCHED = 4
    POWER_OFF = 5
    NOT_CONFIGURED = 6
    CONFIG_INVALID = 7
    CONFIG_HASH = 8
    QUEUE_FULL = 9
    GAP = 10
    OVERLAP = 11
    LENGTH = 12
    RATE_LIMIT = 13
    ACCELERATION_LIMIT = 14
    VELOCITY_STEP = 15
    POSITION_RANGE = 16
    UNKNOWN_MOTOR = 17
    UNKNOWN_INPUT = 18
    UNKNOWN_TRIGGER = 19
    EVENT = 20
    HAND_BUSY = 21
    HAND_LIMIT = 22
    OUTPUT_NOT_FITTED = 23
    NOT_AT_REST = 24
    TOO_NEAR = 25
    WRONG_FAULT = 26
    STILL_ACTIVE = 27
    NO_LEASE = 28
    OVERRIDE_RANGE = 29
    WRONG_CAUSE = 30
    REAL_FRAME = 31
    SLOPE = 32
    NOT_SUPPORTED = 33
    ENDS_AT_SPEED = 34


@dataclass(frozen=True, slots=True)
class RefusalText:
    """A refusal in words; `value` and `limit` say what these fields of Refused mean for it."""

    cause: str
    remedy: str
    value: str = ""
    limit: str = ""


REFUSAL_TEXTS: dict[RefusalReason, RefusalText] = {
    RefusalReason.UNKNOWN_MESSAGE: RefusalText(
        "the board does not know this message", "compare protocol versions", value="message id"
    ),
    RefusalReason.MALFORMED: RefusalText("the payload does not fit the message", "report it: an encoder is wrong"),
    RefusalReason.WRONG_STATE: RefusalText(
        "not allowed in the present state", "wait for, or bring about, the state it needs", value="state"
    ),
    RefusalReason.FAULT_LATCHED: RefusalText("a fault is latched", "reset naming the fault", value="fault code"),
    RefusalReason.POWER_OFF: RefusalText("motor power is off", "switch motor power on first"),
    RefusalReason.NOT_CONFIGURED: RefusalText("no configuration is committed", "send every page and commit"),
    RefusalReason.CONFIG_INVALID: RefusalText(
        "the configuration contradicts itself", "check it on the host: it names the contradiction"
    ),
    RefusalReason.CONFIG_HASH: RefusalText(
        "the committed hash differs from the pages received",
        "send every page again",
        value="hash found",
        limit="hash expected",
    ),
    RefusalReason.QUEUE_FULL: RefusalText("no free slot in the segment queue", "respect the free slots reported"),
    RefusalReason.GAP: RefusalText(
        "the segment starts after the queue ends",
        "start it at the end of the queue",
        value="start frame",
        limit="end of the queue",
    ),
    RefusalReason.OVERLAP: RefusalText(
        "the segment starts before the queue ends",
        "start it at the end of the queue",
        value="start frame",
        limit="end of the queue",
    ),
    RefusalReason.LENGTH: RefusalText(
        "the segment's length is 0 or more than its order allows", "split it", value="length", limit="largest length"
    ),
    RefusalReason.RATE_LIMIT: RefusalText(
        "a motor would exceed its step rate",
        "plan slower",
        value="rate in 2^-32 step per frame",
        limit="limit, same unit",
    ),
    RefusalReason.ACCELERATION_LIMIT: RefusalText(
        "a motor would exceed its acceleration",
        "plan gentler",
        value="acceleration in 2^-40 step per frame^2",
        limit="limit, same unit",
    ),
    RefusalReason.VELOCITY_STEP: RefusalText(
        "a motor's speed jumps where the segment joins the queue",
        "make segments continuous in speed",
        value="jump in 2^-32 step per frame",
        limit="largest jump, same unit",
    ),
    RefusalReason.POSITION_RANGE: RefusalText(
        "a motor would leave the signed 32-bit range of positions",
        "set positions nearer to 0",
        value="position",
        limit="limit",
    ),
    RefusalReason.UNKNOWN_MOTOR: RefusalText("no such motor, or not one that segments move", "check the motor mask"),
    RefusalReason.UNKNOWN_INPUT: RefusalText(
        "no such input", "check the input number", value="input", limit="number of inputs"
    ),
    RefusalReason.UNKNOWN_TRIGGER: RefusalText(
        "no such trigger", "check the trigger number", value="trigger", limit="number of triggers"
    ),
    RefusalReason.EVENT: RefusalText(
        "an event lies outside its segment, is out of order or of unknown kind", "check the event", value="offset"
    ),
    RefusalReason.HAND_BUSY: RefusalText("the hand is still moving", "leave its stroke the time it takes"),
    RefusalReason.HAND_LIMIT: RefusalText(
        "more power pulses than the hand may get",
        "command fewer pulses",
        value="pulses",
        limit="largest number of pulses",
    ),
    RefusalReason.OUTPUT_NOT_FITTED: RefusalText(
        "the line is not fitted", "map the line in the configuration", value="mask"
    ),
    RefusalReason.NOT_AT_REST: RefusalText(
        "only possible at rest with an empty queue", "stop, then repeat", value="queue used"
    ),
    RefusalReason.TOO_NEAR: RefusalText(
        "the frame is nearer than the board needs to stop or to continue",
        "choose a later frame",
        value="frame",
        limit="earliest frame",
    ),
    RefusalReason.WRONG_FAULT: RefusalText(
        "Reset named another fault than the latched one", "name the latched fault", value="named", limit="latched"
    ),
    RefusalReason.STILL_ACTIVE: RefusalText(
        "the fault's cause is still there", "remove the cause first", value="fault code"
    ),
    RefusalReason.NO_LEASE: RefusalText("a jog segment without a running lease", "send Lease first"),
    RefusalReason.OVERRIDE_RANGE: RefusalText(
        "an override outside 0..2^24", "stay between 0 and 100 %", value="override", limit="2^24"
    ),
    RefusalReason.WRONG_CAUSE: RefusalText(
        "this cause may not resume this hold",
        "see the table of who resumes what",
        value="resume cause",
        limit="hold cause",
    ),
    RefusalReason.REAL_FRAME: RefusalText(
        "the real frame to start at is past or too far ahead",
        "choose a later frame",
        value="frame",
        limit="real frame now",
    ),
    RefusalReason.SLOPE: RefusalText(
        "a slope of 0, or a stop slope below the hold slope", "check the slopes", value="hold slope", limit="stop slope"
    ),
    RefusalReason.NOT_SUPPORTED: RefusalText("the board cannot do this", "see its capabilities"),
    RefusalReason.ENDS_AT_SPEED: RefusalText(
        "the segment claims to end at rest and does not",
        "end it at rest or drop the flag",
        value="speed in 2^-32 step per frame",
        limit="limit, same unit",
    ),
}

"""Every message between host and board, declared once: id, direction, fields, widths, units, meaning.

Encoder, decoder, the table in `docs/protocol.md` and the test vectors all come from these declarations. Ids never
change; fields are only added at the end, with a default. Motion frames and real frames are u32 and wrap; clocks are
u32 microseconds of the board and wrap. Configuration pages are in `config_pages`, the motion segment in
`segment_message`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from .config_pages import (
    ConfigCommit,
    ConfigHand,
    ConfigInputs,
    ConfigLink,
    ConfigMotors,
    ConfigPage,
    ConfigPins,
    ConfigSlots,
    ConfigTable,
    ConfigTiming,
)
from .declaration import Direction, Message, message
from .enums import (
    BoardState,
    Capability,
    Edge,
    EndCause,
    EventKind,
    HandState,
    HoldCause,
    ResumeCause,
    SegmentFlag,
    TriggerAction,
)
from .faults import FaultCode, RefusalReason
from .segment_message import MAX_MOTORS, MotorTerm, Segment, SegmentEvent, hand_event, output_event
from .wire_types import S32, S80, U8, U16, U32, Bool, Text, Vector

__all__ = [
    "MAX_MOTORS",
    "NO_MOTOR",
    "OVERRIDE_ONE",
    "PROTOCOL_MAJOR",
    "PROTOCOL_MINOR",
    "RATE_ONE",
    "Ack",
    "ArmTrigger",
    "BoardState",
    "Capability",
    "ClockQuery",
    "ClockReply",
    "ConfigAccepted",
    "ConfigCommit",
    "ConfigHand",
    "ConfigInputs",
    "ConfigLink",
    "ConfigMotors",
    "ConfigPage",
    "ConfigPins",
    "ConfigSlots",
    "ConfigTable",
    "ConfigTiming",
    "DisarmTrigger",
    "Edge",
    "EndCause",
    "EventKind",
    "FaultCode",
    "FaultReport",
    "HandState",
    "Hello",
    "Hold",
    "HoldCause",
    "Identify",
    "Kill",
    "Lease",
    "Message",
    "MotionEnded",
    "MotorTerm",
    "RefusalReason",
    "Refused",
    "Reset",
    "Resume",
    "ResumeCause",
    "Segment",
    "SegmentEvent",
    "SegmentFlag",
    "SetOutputs",
    "SetOverride",
    "SetPositions",
    "SetPower",
    "SetStatusPeriod",
    "Start",
    "Status",
    "StatusRequest",
    "Stop",
    "StopReply",
    "TriggerAction",
    "TriggerReport",
    "Truncate",
    "Truncated",
    "hand_event",
    "output_event",
]

PROTOCOL_MAJOR = 1
"""Differs when an old peer would misunderstand: no session is opened. What every version keeps: ADR 0017."""
PROTOCOL_MINOR = 0
"""Grows when messages or trailing fields were added: both sides go on."""

RATE_ONE = 1 << 24
"""Rate 1 in Q0.24: one motion frame per real frame."""
OVERRIDE_ONE = RATE_ONE
NO_MOTOR = 255

_UNVERSIONED_MAJOR, _UNVERSIONED_MINOR = 1, 0
"""What a peer speaks that does not say it; stays when PROTOCOL_MAJOR goes up."""

_TO_BOARD, _TO_HOST, _BOTH = Direction.TO_BOARD, Direction.TO_HOST, Direction.BOTH

# -------------------------------------------------------------------------------- the link


@message(0x01, _BOTH, sequenced=False)
@dataclass(frozen=True, slots=True)
class Ack(Message):
    """Carries a header and nothing else: sent when an acknowledgement is due and nothing else is."""


@message(0x02, _TO_BOARD, sequenced=False)
@dataclass(frozen=True, slots=True)
class Hello(Message):
    """Ask for a new session: a new nonce opens one, the present session's only gets Identify again, see Versions."""

    nonce: Annotated[int, U32("", "random, new for every handshake")]
    major: Annotated[int, U8("", "the host's protocol version; absent: 1")] = _UNVERSIONED_MAJOR
    minor: Annotated[int, U8("", "the host's protocol version; absent: 0")] = _UNVERSIONED_MINOR


@message(0x03, _TO_HOST, sequenced=False)
@dataclass(frozen=True, slots=True)
class Identify(Message):
    """Answer to Hello: who the board is. The header's epoch is the one of the new session; without the session flag
    there is none, because the major versions differ.
    """

    nonce: Annotated[int, U32("", "copied from Hello")] = 0
    major: Annotated[int, U8("", "the board's protocol version; absent: 1")] = _UNVERSIONED_MAJOR
    minor: Annotated[int, U8("", "the board's protocol version; absent: 0")] = _UNVERSIONED_MINOR
    boot_id: Annotated[int, U32("", "random at each boot; another one means that everything was lost")] = 0
    capabilities: Annotated[Capability, U16("", "see Capability")] = Capability.NONE
    base_period_us: Annotated[int, U16("us", "base period in force")] = 40
    frame_periods: Annotated[int, U8("base periods", "length of a frame")] = 8
    clock_hz: Annotated[int, U32("Hz", "ticks of the clock in ClockReply and Status")] = 1_000_000
    queue_depth: Annotated[int, U8("segments", "size of the segment queue")] = 32
    motor_count: Annotated[int, U8("", "motors, the hand included")] = 6
    max_step_rate: Annotated[int, U16("steps/s", "largest rate that the step timings allow")] = 1562
    config_hash: Annotated[int, U32("", "CRC-32 of the committed configuration, 0 without one")] = 0
    build: Annotated[str, Text(48, doc="name and version of the firmware")] = ""


@message(0x04, _TO_BOARD, sequenced=False)
@dataclass(frozen=True, slots=True)
class Stop(Message):
    """Category 1 stop: ramp down on the path at the stop slope, then motor power off; the queue is dropped. Needs no
    session.
    """

    generation: Annotated[int, U8("", "the new stop generation")]


@message(0x05, _TO_BOARD, sequenced=False)
@dataclass(frozen=True, slots=True)
class Kill(Message):
    """Category 0 stop: no step from the next frame on, outputs to their safe levels, positions untrusted. Needs no
    session.
    """

    generation: Annotated[int, U8("", "the new stop generation")]


@message(0x06, _TO_HOST, sequenced=False)
@dataclass(frozen=True, slots=True)
class StopReply(Message):
    """Answer to every copy of Stop and Kill; the header carries the generation now in force."""

    requested: Annotated[int, U8("", "generation in the Stop or Kill answered")]
    generation: Annotated[int, U8("", "generation now in force")]
    executed: Annotated[bool, Bool("", "false: older than a stop of the board's own, ask again beyond it")]


@message(0x07, _TO_BOARD, sequenced=False)
@dataclass(frozen=True, slots=True)
class ClockQuery(Message):
    """Ask for the board's clock."""

    host_us: Annotated[int, U32("us", "the host's clock when sent, returned as it is")]


@message(0x08, _TO_HOST, sequenced=False)
@dataclass(frozen=True, slots=True)
class ClockReply(Message):
    """The board's clock at arrival of the query and at sending of this reply."""

    host_us: Annotated[int, U32("us", "copied from ClockQuery")]
    received_ticks: Annotated[int, U32("ticks", "when the query arrived")]
    sent_ticks: Annotated[int, U32("ticks", "when this reply left")]


@message(0x09, _TO_BOARD, sequenced=False)
@dataclass(frozen=True, slots=True)
class StatusRequest(Message):
    """Ask for one Status now."""


# -------------------------------------------------------------------------------- motion, host to board
# 0x20 Segment: segment_message.py


@message(0x21, _TO_BOARD, sequenced=True, urgent=True)
@dataclass(frozen=True, slots=True)
class Hold(Message):
    """Category 2 stop: decelerate on the path at the hold slope, keep motors and queue."""


@message(0x22, _TO_BOARD, sequenced=True, urgent=True)
@dataclass(frozen=True, slots=True)
class Resume(Message):
    """Bring the rate back; refused when `cause` may not end the present hold."""

    cause: Annotated[ResumeCause, U8("", "who asks")] = ResumeCause.USER


@message(0x23, _TO_BOARD, sequenced=True, urgent=True)
@dataclass(frozen=True, slots=True)
class SetOverride(Message):
    """Feed override of the board: the rate's target, reached at the hold slope."""

    rate: Annotated[int, U32("Q0.24", "0..2^24; 2^24 = motion time runs as fast as real time")]


@message(0x24, _TO_BOARD, sequenced=True, urgent=True)
@dataclass(frozen=True, slots=True)
class Truncate(Message):
    """Drop queued segments that start at `frame` or later; refused when too near to stop before it or to continue
    from it.
    """

    frame: Annotated[int, U32("motion frames", "must be a segment boundary in the queue")]


@message(0x25, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class Reset(Message):
    """Clear the latched fault if it is `fault` and its cause is gone; or leave a latched stop with NONE."""

    fault: Annotated[FaultCode, U8("", "the fault to clear, NONE after a stop")] = FaultCode.NONE
    master_reset: Annotated[bool, Bool("", "pulse MASTER RESET: clears the counters of the driver boards")] = False


@message(0x26, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class SetPositions(Message):
    """Define the positions of some motors and trust them; only at rest with an empty queue."""

    motor_mask: Annotated[int, U8("", "bit per motor")]
    positions_steps: Annotated[
        tuple[int, ...], Vector(S32("steps"), MAX_MOTORS, "steps", "one per motor, from motor 0")
    ]


@message(0x27, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class ArmTrigger(Message):
    """Arm a trigger: at the first `edge` of `input_id` it latches, once. Fires at once when `level` and the input
    already is there.
    """

    trigger: Annotated[int, U8("", "number of the trigger, 0..7")]
    input_id: Annotated[int, U8("", "number of the input")]
    edge: Annotated[Edge, U8("", "which change fires")]
    action: Annotated[TriggerAction, U8("", "what it does")] = TriggerAction.LATCH_AND_STOP
    level: Annotated[bool, Bool("", "fire at once when the input already is past the edge")] = False


@message(0x28, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class DisarmTrigger(Message):
    """Disarm a trigger; nothing happens when it is not armed."""

    trigger: Annotated[int, U8("", "number of the trigger, 0..7")]


@message(0x29, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class SetPower(Message):
    """Motor power on or off; off only at rest (use Stop otherwise). Without the line: whether steps are made at all."""

    on: Annotated[bool, Bool("", "on or off")]


@message(0x2A, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class SetOutputs(Message):
    """Set digital outputs now; inside motion use an OUTPUT event."""

    mask: Annotated[int, U8("", "which of outputs 0..7 change")]
    levels: Annotated[int, U8("", "the levels they take")]


@message(0x2B, _TO_BOARD, sequenced=True, urgent=True)
@dataclass(frozen=True, slots=True)
class Lease(Message):
    """Grant or renew the jog lease; JOG segments run only under one. When it ends the board ramps down and drops
    them.
    """

    duration_ms: Annotated[int, U16("ms", "from now; 0 ends the jog")]


@message(0x2C, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class Start(Message):
    """Start motion though the queue is below high water, now or at a real frame."""

    at_real_frame: Annotated[bool, Bool("", "wait for `real_frame`")] = False
    real_frame: Annotated[int, U32("real frames", "not before")] = 0


@message(0x2D, _TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class SetStatusPeriod(Message):
    """Send Status every so often, unasked."""

    period_ms: Annotated[int, U16("ms", "0: only on request and on changes of state")]


# -------------------------------------------------------------------------------- board to host


@message(0x41, _TO_HOST, sequenced=True)
@dataclass(frozen=True, slots=True)
class Refused(Message):
    """A sequenced message had no effect at all, and why. What `value` and `limit` mean: REFUSAL_TEXTS."""

    message_id: Annotated[int, U8("", "id of the refused message")]
    sequence: Annotated[int, U8("", "its sequence number")]
    reason: Annotated[RefusalReason, U8("", "why")]
    motor: Annotated[int, U8("", "motor concerned, 255 for none")] = NO_MOTOR
    value: Annotated[int, S32("", "what was found")] = 0
    limit: Annotated[int, S32("", "what was allowed")] = 0


@message(0x42, _TO_HOST, sequenced=True)
@dataclass(frozen=True, slots=True)
class Truncated(Message):
    """Answer to Truncate: where the queue ends now; the next segment starts there."""

    end_frame: Annotated[int, U32("motion frames", "end of the queue")]


@message(0x43, _TO_HOST, sequenced=True)
@dataclass(frozen=True, slots=True)
class MotionEnded(Message):
    """Motion ended before its queue did; the next segment starts at `motion_frame` from exactly these positions."""

    cause: Annotated[EndCause, U8("", "why")]
    motion_frame: Annotated[int, U32("motion frames", "where motion ended")]
    real_frame: Annotated[int, U32("real frames", "when")]
    positions_q48: Annotated[tuple[int, ...], Vector(S80("2^-48 step"), MAX_MOTORS, "2^-48 step", "one per motor")]


@message(0x44, _TO_HOST, sequenced=True)
@dataclass(frozen=True, slots=True)
class TriggerReport(Message):
    """A trigger fired: what was latched at the first edge."""

    trigger: Annotated[int, U8("", "number of the trigger")]
    real_frame: Annotated[int, U32("real frames", "when the input first changed")]
    motion_frame: Annotated[int, U32("motion frames", "motion time then")]
    clock_ticks: Annotated[int, U32("ticks", "the board's clock then")]
    positions_steps: Annotated[tuple[int, ...], Vector(S32("steps"), MAX_MOTORS, "steps", "step counts then")]


@message(0x45, _TO_HOST, sequenced=True)
@dataclass(frozen=True, slots=True)
class FaultReport(Message):
    """The first fault since the last reset. What `source`, `value` and `limit` mean: FAULT_TEXTS."""

    fault: Annotated[FaultCode, U8("", "which")]
    source: Annotated[int, U8("", "input, motor or state concerned")]
    value: Annotated[int, S32("", "what was found")]
    limit: Annotated[int, S32("", "what was allowed")]
    clock_ticks: Annotated[int, U32("ticks", "when, board's clock")]
    real_frame: Annotated[int, U32("real frames", "when")]
    motion_frame: Annotated[int, U32("motion frames", "motion time then")]


@message(0x46, _TO_HOST, sequenced=True)
@dataclass(frozen=True, slots=True)
class ConfigAccepted(Message):
    """The configuration is in force."""

    config_hash: Annotated[int, U32("", "CRC-32 over its pages")]


@message(0x47, _TO_HOST, sequenced=False)
@dataclass(frozen=True, slots=True)
class Status(Message):
    """The board's state at one real frame. Positions are commanded, never measured."""

    real_frame: Annotated[int, U32("real frames", "since boot")]
    clock_ticks: Annotated[int, U32("ticks", "board's clock at that frame")]
    motion_frame: Annotated[int, U32("motion frames", "motion time")]
    phase: Annotated[int, U32("Q0.24", "part of the next motion frame already accumulated")]
    rate: Annotated[int, U32("Q0.24", "present rate, 2^24 = 1")]
    override: Annotated[int, U32("Q0.24", "target of the rate")]
    state: Annotated[BoardState, U8("", "state")]
    hold_cause: Annotated[HoldCause, U8("", "why the rate is, or goes to, 0")]
    fault: Annotated[FaultCode, U8("", "latched fault")]
    queue_used: Annotated[int, U8("segments", "segments queued, the running one included")]
    queue_free: Annotated[int, U8("segments", "free slots")]
    queue_end_frame: Annotated[int, U32("motion frames", "where the queue ends; the next segment starts there")]
    positions_steps: Annotated[
        tuple[int, ...], Vector(S32("steps"), MAX_MOTORS, "steps", "steps made, hand: pulses commanded")
    ]
    trusted_mask: Annotated[int, U8("", "motors whose position is trusted")]
    power: Annotated[bool, Bool("", "motor power")]
    hand: Annotated[HandState, U8("", "hand, as commanded")]
    inputs: Annotated[int, U32("", "debounced inputs, bit per input number, 1 = active")]
    outputs: Annotated[int, U8("", "digital outputs")]
    armed_triggers: Annotated[int, U8("", "bit per armed trigger")] = 0
    lease_ms: Annotated[int, U16("ms", "what is left of the jog lease")] = 0
    later_faults: Annotated[int, U16("", "faults after the latched one")] = 0
    bad_frames: Annotated[int, U16("", "frames dropped as malformed since boot, wraps")] = 0
    refused: Annotated[int, U16("", "messages refused since boot, wraps")] = 0

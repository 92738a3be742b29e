"""Closed sets of values that travel in messages. Numbers are part of the wire: never renumber, only add."""

from __future__ import annotations

from enum import IntEnum, IntFlag

__all__ = [
    "BoardState",
    "Capability",
    "Edge",
    "EndCause",
    "EventKind",
    "HandState",
    "HoldCause",
    "ResumeCause",
    "SegmentFlag",
    "TriggerAction",
]


class BoardState(IntEnum):
    """States of the board; the transition table lives with the firmware."""

    BOOT = 0  # after power-up, no configuration accepted yet
    IDLE = 1  # configured, motor power off
    READY = 2  # powered, at rest, no motion
    RUNNING = 3  # motion time advances, rate above 0 (also ramping up)
    HOLDING = 4  # rate ramps down to 0 on the path
    HELD = 5  # rate 0 on the path, queue kept
    STOPPING = 6  # rate ramps down to 0, then the queue is dropped
    FAULT = 7  # latched; cleared by Reset naming the fault


class HoldCause(IntEnum):
    """Why the rate goes, or went, to 0; it decides who may bring it back."""

    NONE = 0
    USER = 1  # Hold message: a user's resume
    BUTTON = 2  # HOLD input: a user's resume, or CYCLE START
    LOW_WATER = 3  # queue nearly empty, link alive: the host, once the queue is above high water
    LINK_LOST = 4  # link silent for link_timeout_ms while moving: a user, after the handshake
    LEASE = 5  # jog lease ran out: nobody, the jog ends after the ramp
    OVERRIDE = 6  # override target 0: a higher override


class ResumeCause(IntEnum):
    """Who asks to resume; the board compares it with the hold's cause."""

    USER = 1
    REFILLED = 2  # the host, after low water


class EndCause(IntEnum):
    """Why motion ended before the queue did."""

    STOP = 1
    KILL = 2
    TRIGGER = 3
    TRUNCATED = 4
    LEASE = 5
    FAULT = 6
    ESTOP = 7
    POWER_OFF = 8


class SegmentFlag(IntFlag):
    """Flags of a motion segment."""

    NONE = 0
    CUBIC = 0x01  # each motor carries j as well
    ENDS_AT_REST = 0x02  # the queue may run empty after this segment without a hold
    JOG = 0x04  # runs only under a jog lease
    START_AT_REAL_FRAME = 0x08  # carries a real frame before which it must not start


class EventKind(IntEnum):
    """What an event inside a segment does at its motion frame."""

    HAND = 1  # value: signed number of power pulses, positive opens
    OUTPUT = 2  # value: mask << 8 | levels of digital outputs 0..7


class Edge(IntEnum):
    """Which change of a debounced input fires a trigger."""

    RISING = 1  # inactive to active
    FALLING = 2  # active to inactive


class TriggerAction(IntEnum):
    """What a trigger does when it fires."""

    LATCH = 1  # latch frame, clock and positions
    LATCH_AND_STOP = 2  # latch, ramp to a stop on the path, drop the queue


class HandState(IntEnum):
    """The hand as commanded; it has no sensor, so nothing here is confirmed."""

    UNKNOWN = 0
    OPENING = 1
    CLOSING = 2
    OPEN = 3
    CLOSED = 4


class Capability(IntFlag):
    """What a board can do beyond the minimum, as Identify reports it."""

    NONE = 0
    CUBIC = 0x0001  # executes segments with j
    ENCODERS = 0x0002  # reports measured positions (the RM-501 board does not)
    MOTOR_POWER = 0x0004  # has the motor power line
    HEARTBEAT = 0x0008  # has the heartbeat line
    ESTOP = 0x0010  # reads the emergency stop line
    HOLD_BUTTON = 0x0020
    CYCLE_START_BUTTON = 0x0040

"""The motion segment as a message: one polynomial for every moving motor over one stretch of motion time.

Layout (little endian)::

    start_frames u32 | length_frames u16 | flags u8 | hold_slope u16 | stop_slope u16 | motor_mask u8
    real_frame u32                              only with START_AT_REAL_FRAME
    per set bit of motor_mask, lowest first:    v s32, a s32, and j s32 with CUBIC
    event_count u8, then per event              offset_frames u16, kind u8, value s16 (HAND) or u16 (OUTPUT)

The arithmetic that gives these numbers their meaning is in `segment`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar

from .declaration import CustomPayload, Direction, Message, message
from .enums import EventKind, SegmentFlag
from .errors import FieldRangeError

__all__ = ["MAX_EVENTS", "MAX_MOTORS", "MotorTerm", "Segment", "SegmentEvent", "hand_event", "output_event"]

MAX_MOTORS = 8
"""One byte of motor mask."""
MAX_EVENTS = 8
"""Keeps the largest segment (8 motors, cubic, 8 events: 157 bytes) below the frame limit and a queue slot small."""

_LAYOUT = __doc__ or ""
_FIXED = struct.Struct("<IHBHHB")
_REAL = struct.Struct("<I")
_QUADRATIC = struct.Struct("<ii")
_CUBIC = struct.Struct("<iii")
_EVENT_HEAD = struct.Struct("<HB")
_S32_MIN, _S32_MAX = -(1 << 31), (1 << 31) - 1


@dataclass(frozen=True, slots=True)
class MotorTerm:
    """One motor's polynomial: `v` in 2^-32 step/frame, `a` in 2^-40 step/frame^2, `j` in 2^-48 step/frame^3, each
    s32.
    """

    motor: int
    v: int
    a: int = 0
    j: int = 0


@dataclass(frozen=True, slots=True)
class SegmentEvent:
    """An action at `offset_frames` (0..length-1) into the segment; `value` depends on `kind`, see `EventKind`."""

    offset_frames: int
    kind: EventKind
    value: int

    @property
    def mask(self) -> int:
        """OUTPUT: which digital outputs change."""
        return self.value >> 8 & 0xFF

    @property
    def levels(self) -> int:
        """OUTPUT: the levels they take."""
        return self.value & 0xFF


def hand_event(offset_frames: int, pulses: int) -> SegmentEvent:
    """Start `pulses` power pulses of the hand: positive opens, negative closes, 0 cancels."""
    return SegmentEvent(offset_frames, EventKind.HAND, pulses)


def output_event(offset_frames: int, mask: int, levels: int) -> SegmentEvent:
    """Set the digital outputs in `mask` (bits 0..7) to `levels`."""
    return SegmentEvent(offset_frames, EventKind.OUTPUT, (mask & 0xFF) << 8 | (levels & mask & 0xFF))


@message(0x20, Direction.TO_BOARD, sequenced=True)
@dataclass(frozen=True, slots=True)
class Segment(CustomPayload, Message):
    """Move every motor in `motors` by its polynomial for `length_frames` motion frames; all others stand still."""

    start_frames: int
    """Motion frame (u32) where the previous segment ended."""
    length_frames: int
    """1..65535; 1..32767 when any j is not 0."""
    motors: tuple[MotorTerm, ...] = ()
    """In rising order of motor, each once."""
    flags: SegmentFlag = SegmentFlag.NONE
    hold_slope: int = 0xFFFF
    """Steepest change of rate in a hold, u16, 2^-20 of rate per real frame."""
    stop_slope: int = 0xFFFF
    """The same in a stop."""
    events: tuple[SegmentEvent, ...] = ()
    """At most MAX_EVENTS."""
    real_frame: int = 0
    """With START_AT_REAL_FRAME: real frame (u32) before which it must not start."""

    LAYOUT: ClassVar[str] = _LAYOUT

    @property
    def end_frames(self) -> int:
        """Motion frame at which the next segment starts (u32, wraps)."""
        return (self.start_frames + self.length_frames) & 0xFFFFFFFF

    @property
    def motor_mask(self) -> int:
        """Bit per moving motor."""
        mask = 0
        for term in self.motors:
            mask |= 1 << term.motor
        return mask

    def encode_into(self, out: bytearray) -> None:
        """Append the payload; raises FieldRangeError."""
        mask, last = 0, -1
        for term in self.motors:
            if not last < term.motor < MAX_MOTORS:
                raise FieldRangeError("Segment", "motors", term.motor, f"motors 0..{MAX_MOTORS - 1}, each once, rising")
            last = term.motor
            mask |= 1 << term.motor
        try:
            out += _FIXED.pack(
                self.start_frames, self.length_frames, self.flags, self.hold_slope, self.stop_slope, mask
            )
            if self.flags & SegmentFlag.START_AT_REAL_FRAME:
                out += _REAL.pack(self.real_frame)
        except struct.error as error:
            raise FieldRangeError("Segment", "start, length, flags, slopes or real frame", self, str(error)) from None
        cubic = bool(self.flags & SegmentFlag.CUBIC)
        for term in self.motors:
            try:
                out += _CUBIC.pack(term.v, term.a, term.j) if cubic else _QUADRATIC.pack(term.v, term.a)
            except struct.error:
                raise FieldRangeError("Segment", "motors", term, f"v, a, j within {_S32_MIN}..{_S32_MAX}") from None
            if term.j and not cubic:
                raise FieldRangeError("Segment", "motors", term, "j = 0 without the CUBIC flag")
        if len(self.events) > MAX_EVENTS:
            raise FieldRangeError("Segment", "events", len(self.events), f"at most {MAX_EVENTS}")
        out.append(len(self.events))
        for event in self.events:
            try:
                out += _EVENT_HEAD.pack(event.offset_frames, event.kind)
                out += struct.pack("<h" if event.kind is EventKind.HAND else "<H", event.value)
            except struct.error as error:
                raise FieldRangeError("Segment", "events", event, str(error)) from None

    @classmethod
    def decode_from(cls, data: bytes) -> Segment:
        """Read the payload; raises ValueError."""
        try:
            start, length, raw_flags, hold_slope, stop_slope, mask = _FIXED.unpack_from(data)
            if raw_flags & ~0x0F:
                raise ValueError(f"unknown flags 0x{raw_flags:02x}")
            flags = SegmentFlag(raw_flags)
            offset = _FIXED.size
            real_frame = 0
            if flags & SegmentFlag.START_AT_REAL_FRAME:
                (real_frame,) = _REAL.unpack_from(data, offset)
                offset += _REAL.size
            terms = _CUBIC if flags & SegmentFlag.CUBIC else _QUADRATIC
            motors = []
            for motor in range(MAX_MOTORS):
                if mask >> motor & 1:
                    motors.append(MotorTerm(motor, *terms.unpack_from(data, offset)))
                    offset += terms.size
            (count,) = struct.unpack_from("<B", data, offset)
            offset += 1
            if count > MAX_EVENTS:
                raise ValueError(f"{count} events, at most {MAX_EVENTS}")
            events = []
            for _ in range(count):
                at, raw_kind = _EVENT_HEAD.unpack_from(data, offset)
                kind = EventKind(raw_kind)
                (value,) = struct.unpack_from("<h" if kind is EventKind.HAND else "<H", data, offset + 3)
                events.append(SegmentEvent(at, kind, value))
                offset += 5
        except struct.error:
            raise ValueError("the payload ends early") from None
        return cls(start, length, tuple(motors), flags, hold_slope, stop_slope, tuple(events), real_frame)

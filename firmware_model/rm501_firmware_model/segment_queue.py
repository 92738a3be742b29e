"""The ring of queued segments and the ring of their events: fixed size, full means a refusal.

A segment stays in its slot while it plays; `head` is the one that plays or plays next. Its start is not stored: it is
the end of the one before. `room` is the brake account of `motion`: the sum, over all motion frames not yet played, of
the slope at which the rate may change there, in 2^-20. The first frame of a segment counts with the smaller of its
own slope and its predecessor's, because a real frame that starts in one segment and ends in the next is ramped with
the first one's slope.
"""

from __future__ import annotations

from rm501_protocol.enums import SegmentFlag
from rm501_protocol.segment import A_SHIFT, V_SHIFT
from rm501_protocol.segment_message import Segment

__all__ = ["EVENT_RING_SLOTS", "QUEUE_SLOTS", "SLOPE_MAX", "SegmentQueue", "triangle"]

QUEUE_SLOTS = 32
"""Segments that the queue holds."""
EVENT_RING_SLOTS = 32
"""Events waiting at one time: one for every segment of a full queue."""
SLOPE_MAX = 0xFFFF
FRAME_MASK = 0xFFFFFFFF


def triangle(frames: int) -> int:
    """frames * (frames - 1) / 2, exact: one of the two factors is even."""
    return (frames * (frames - 1)) >> 1


class SegmentQueue:
    """Fixed arrays of `slots` segments for `motors` motors; terms are kept in 2^-48 step."""

    __slots__ = (
        "a",
        "count",
        "event_count",
        "event_frame",
        "event_head",
        "event_kind",
        "event_value",
        "flags",
        "head",
        "hold_slope",
        "j",
        "last_slope",
        "length",
        "motors",
        "rest_points",
        "room",
        "slots",
        "stop_slope",
        "v",
    )

    def __init__(self, slots: int, motors: int) -> None:
        self.slots = slots
        self.motors = motors
        self.head = 0  # u8
        self.count = 0  # u8
        self.length = [0] * slots  # u16
        self.flags = [0] * slots  # u8
        self.hold_slope = [SLOPE_MAX] * slots  # u16
        self.stop_slope = [SLOPE_MAX] * slots  # u16
        self.v = [0] * (slots * motors)  # s32 on the wire's scale in C, here already shifted
        self.a = [0] * (slots * motors)
        self.j = [0] * (slots * motors)
        self.room = 0  # u48
        self.last_slope = SLOPE_MAX  # u16, hold slope of the segment before head
        self.rest_points = 0  # u8, queued segments that end at rest
        self.event_head = 0  # u8
        self.event_count = 0  # u8
        self.event_frame = [0] * EVENT_RING_SLOTS  # u32, motion frame
        self.event_kind = [0] * EVENT_RING_SLOTS  # u8
        self.event_value = [0] * EVENT_RING_SLOTS  # s16 or u16

    def slot_of(self, index: int) -> int:
        """The slot of the `index`-th queued segment, 0 = head."""
        slot = self.head + index
        return slot - self.slots if slot >= self.slots else slot

    def slope_before(self, index: int) -> int:
        """Hold slope of the segment in front of the `index`-th queued one."""
        return self.last_slope if index == 0 else self.hold_slope[self.slot_of(index - 1)]

    def push(self, segment: Segment) -> None:
        """Take a checked segment; there is a free slot and room for its events."""
        slot = self.slot_of(self.count)
        self.length[slot] = segment.length_frames
        self.flags[slot] = segment.flags
        self.hold_slope[slot] = segment.hold_slope
        self.stop_slope[slot] = segment.stop_slope
        base = slot * self.motors
        for motor in range(self.motors):
            self.v[base + motor] = 0
            self.a[base + motor] = 0
            self.j[base + motor] = 0
        for term in segment.motors:
            self.v[base + term.motor] = term.v << V_SHIFT
            self.a[base + term.motor] = term.a << A_SHIFT
            self.j[base + term.motor] = term.j
        self.room += self.share(self.count, 0)
        if segment.flags & SegmentFlag.ENDS_AT_REST:
            self.rest_points += 1
        self.count += 1
        for event in segment.events:
            at = self.event_slot(self.event_count)
            self.event_frame[at] = (segment.start_frames + event.offset_frames) & FRAME_MASK
            self.event_kind[at] = event.kind
            self.event_value[at] = event.value
            self.event_count += 1

    def share(self, index: int, played: int) -> int:
        """What the `index`-th queued segment, of which `played` frames are played, has in `room`."""
        slot = self.slot_of(index)
        slope = self.hold_slope[slot]
        if played:
            return slope * (self.length[slot] - played)
        before = self.slope_before(index)
        first = before if before < slope else slope
        return first + slope * (self.length[slot] - 1)

    def pop(self) -> None:
        """Give the slot of the head free; all its frames are played."""
        slot = self.head
        self.last_slope = self.hold_slope[slot]
        if self.flags[slot] & SegmentFlag.ENDS_AT_REST:
            self.rest_points -= 1
        self.head = self.slot_of(1)
        self.count -= 1

    def keep(self, segments: int, end_frame: int, played: int) -> None:
        """Drop every segment behind the first `segments` ones and every event from motion frame `end_frame` on."""
        self.count = segments
        self.room = 0
        self.rest_points = 0
        for index in range(segments):
            self.room += self.share(index, played if index == 0 else 0)
            if self.flags[self.slot_of(index)] & SegmentFlag.ENDS_AT_REST:
                self.rest_points += 1
        while self.event_count:
            at = self.event_slot(self.event_count - 1)
            behind = (self.event_frame[at] - end_frame) & FRAME_MASK
            if behind > FRAME_MASK >> 1:
                return
            self.event_count -= 1

    def clear(self) -> None:
        """Drop everything, the head too."""
        self.count = 0
        self.room = 0
        self.rest_points = 0
        self.last_slope = SLOPE_MAX
        self.event_count = 0

    def event_slot(self, index: int) -> int:
        """The slot of the `index`-th waiting event."""
        slot = self.event_head + index
        return slot - EVENT_RING_SLOTS if slot >= EVENT_RING_SLOTS else slot

    def pop_event(self) -> None:
        """Give the slot of the first event free."""
        self.event_head += 1
        if self.event_head == EVENT_RING_SLOTS:
            self.event_head = 0
        self.event_count -= 1

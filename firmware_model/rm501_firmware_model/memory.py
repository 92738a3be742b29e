"""How wide every field of the state is, and how much memory the state takes as packed C.

The model's integers are unbounded; the chip's are not. Every mutable field of the tick path is declared here with its
width, a test watches that no value ever leaves it, and the sum must fit the memory of the chip. Arrays are counted
for the motors that segments move, the hand has its own fields. `python -m rm501_firmware_model.memory` prints the
table.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

from rm501_protocol.board_config import RM501_BOARD

from .inputs import TRIGGER_SLOTS
from .layout import BoardLayout
from .segment_queue import EVENT_RING_SLOTS, QUEUE_SLOTS

__all__ = ["BUDGET_BYTES", "CONSTANT", "FIELDS", "LINK_BYTES", "Field", "packed_bytes", "table"]

BUDGET_BYTES = 4096
"""Half of the ATmega2560's 8 KiB: the rest is for the stack and for what a port adds."""
WIRE_TERM_BYTES = 4


@dataclass(frozen=True, slots=True)
class Field:
    """One field of the state: its width in bits and sign, how many there are, and the bytes that each takes in C.

    `count` names what it is an array of: "", "motors", "motors twice", "segments", "segments x motors", "events",
    "inputs", "triggers", "triggers x motors", "slots" or "periods".
    """

    name: str
    bits: int
    signed: bool = False
    count: str = ""

    @property
    def minimum(self) -> int:
        """Smallest value that fits."""
        return -(1 << (self.bits - 1)) if self.signed else 0

    @property
    def maximum(self) -> int:
        """Largest value that fits."""
        return (1 << (self.bits - int(self.signed))) - 1

    @property
    def bytes_each(self) -> int:
        """Whole bytes of one value; terms wait in the queue as they came over the wire, event values in the wire's 16
        bits.
        """
        if self.count == "segments x motors":
            return WIRE_TERM_BYTES
        return 2 if self.name == "event_value" else (self.bits + 7) // 8


def _u(name: str, bits: int, count: str = "") -> Field:
    return Field(name, bits, False, count)


def _s(name: str, bits: int, count: str = "") -> Field:
    return Field(name, bits, True, count)


FIELDS: dict[str, tuple[Field, ...]] = {
    "StepGenerator": (
        _s("position", 80, "motors"),  # s32 of whole steps and 48 bits of fraction; a port keeps count and lag
        _s("count", 32, "motors"),
        _u("dir_level", 1, "motors"),
        _u("high_frames", 8, "motors"),
        _u("rise_wait", 8, "motors"),
        _u("dir_wait", 8, "motors"),
        _u("late", 8),
        _u("enabled", 1),
        _u("slot_words", 32, "slots"),
    ),
    # v, a and j as wide as they get while they are played; a port keeps those of the next segment ready as well
    "StepGenerator.terms": (
        _s("velocity", 48, "motors twice"),
        _s("acceleration", 40, "motors twice"),
        _s("jerk", 32, "motors twice"),
    ),
    "SegmentQueue": (
        _u("head", 8),
        _u("count", 8),
        _u("length", 16, "segments"),
        _u("flags", 8, "segments"),
        _u("hold_slope", 16, "segments"),
        _u("stop_slope", 16, "segments"),
        _s("v", 48, "segments x motors"),  # a port keeps what came over the wire: 32 bits
        _s("a", 40, "segments x motors"),
        _s("j", 32, "segments x motors"),
        _u("room", 48),
        _u("last_slope", 16),
        _u("rest_points", 8),
        _u("event_head", 8),
        _u("event_count", 8),
        _u("event_frame", 32, "events"),
        _u("event_kind", 8, "events"),
        _s("event_value", 17, "events"),
    ),
    "Motion": (
        _u("motion_frame", 32),
        _u("played", 16),
        _u("rate", 25),
        _u("phase", 24),
        _u("target", 25),
        _u("moving", 1),
        _u("braking", 2),
        _u("gated", 1),
        _u("start_frame", 32),
        _u("notices", 8),
    ),
    "SegmentChecker": (
        _u("end_frame", 32),
        _s("end_speed", 49, "motors"),
        _s("end_position", 80, "motors"),
        _u("hand_free", 32),
        _u("hand_known", 1),
    ),
    "Hand": (
        _s("pending", 16),
        _s("count", 32),
        _u("phase", 25),
        _u("dir_level", 1),
        _u("high_frames", 8),
        _u("rise_wait", 8),
        _u("dir_wait", 8),
        _u("state", 8),
    ),
    "Inputs": (
        _u("pins", 32),
        _u("raw", 32),
        _u("active", 32),
        _u("changed", 32),
        _u("unsettled", 32),
        _u("agree", 8, "inputs"),
    ),
    "Triggers": (
        _u("state", 1, "triggers"),
        _u("input_id", 8, "triggers"),
        _u("edge", 8, "triggers"),
        _u("action", 8, "triggers"),
        _u("latched", 1, "triggers"),
        _u("real_frame", 32, "triggers"),
        _u("motion_frame", 32, "triggers"),
        _s("positions", 32, "triggers x motors"),
    ),
    "Core": (
        _u("configured", 1),
        _u("state", 8),
        _u("stimulus", 8),
        _u("real_frame", 64),
        _u("causes", 8),
        _u("resting", 1),
        _u("start_pending", 1),
        _u("settling", 1),
        _u("end_cause", 8),
        _u("stop_latched", 1),
        _u("power", 1),
        _u("trusted", 8),
        _u("digital", 8),
        _u("fault", 8),
        _u("fault_source", 8),
        _s("fault_value", 32),
        _s("fault_limit", 32),
        _u("fault_frame", 32),
        _u("fault_motion_frame", 32),
        _u("later_faults", 16),
        _u("ended_cause", 8),
        _u("ended_frame", 32),
        _u("fired", 8),
        _u("reports", 8),
        _u("heard_frame", 64),
        _u("link_silent", 2),
        _u("lease_end", 64),
        _u("master_reset_end", 64),
        _u("status_frames", 32),
        _u("status_due", 64),
        _u("sampled", 1),
        _u("wake", 64),
        _u("line_word", 32),
        _u("words", 32, "periods"),
    ),
}

CONSTANT: dict[str, tuple[str, ...]] = {
    "StepGenerator": (
        "dir_mask",
        "dir_wait_frames",
        "motor_slot",
        "motors",
        "rise_wait_frames",
        "setup_frames",
        "step_length_frames",
        "step_mask",
    ),
    "SegmentQueue": ("motors", "slots"),
    "Motion": ("queue", "stepgen"),
    "SegmentChecker": ("layout", "queue", "refusal"),
    "Hand": ("layout",),
    "Inputs": ("layout",),
    "Triggers": ("motors",),
    "Core": ("checker", "hand", "inputs", "layout", "motion", "queue", "stepgen", "triggers"),
}
"""Slots that are references or copies of configuration."""

CONFIGURATION_BYTES = 320
"""Configuration as the tick uses it: entry words, masks, limits, inputs; about the size of the pages."""
LINK_BYTES = 256 + 4 * 84 + 32
"""Link: a frame being received, unstuffed in place; four reports that may have to be sent again, 84 bytes at most.

The link lets eight packets be in flight; a port that keeps four sends reports a little later, and loses none: they
wait as bits.
"""


def _counts(layout: BoardLayout, queue_slots: int) -> dict[str, int]:
    motors = len(layout.moved)
    return {
        "": 1,
        "motors": motors,
        "motors twice": 2 * motors,
        "segments": queue_slots,
        "segments x motors": queue_slots * motors,
        "events": EVENT_RING_SLOTS,
        "inputs": layout.input_count,
        "triggers": TRIGGER_SLOTS,
        "triggers x motors": TRIGGER_SLOTS * (motors + 1),
        "slots": len(layout.slot_words),
        "periods": layout.periods,
    }


def table(layout: BoardLayout, queue_slots: int) -> tuple[tuple[str, int], ...]:
    """Bytes by part of the state; single bits take a byte each in arrays and share bytes otherwise."""
    counts = _counts(layout, queue_slots)
    rows = []
    for part, fields in FIELDS.items():
        flags = sum(1 for field in fields if field.bits == 1 and not field.count)
        total = (flags + 7) // 8
        total += sum(field.bytes_each * counts[field.count] for field in fields if field.bits > 1 or field.count)
        rows.append((part, total))
    rows.append(("configuration", CONFIGURATION_BYTES))
    rows.append(("link", LINK_BYTES))
    return tuple(rows)


def packed_bytes(layout: BoardLayout, queue_slots: int) -> int:
    """Bytes of the whole state as packed C."""
    return sum(size for _, size in table(layout, queue_slots))


def main() -> None:
    """Print the table."""
    layout = BoardLayout(RM501_BOARD)
    for part, size in table(layout, QUEUE_SLOTS):
        sys.stdout.write(f"{part:24s}{size:6d} bytes\n")
    total = packed_bytes(layout, QUEUE_SLOTS)
    sys.stdout.write(f"{'sum':24s}{total:6d} bytes of {BUDGET_BYTES}, queue of {QUEUE_SLOTS} segments\n")


if __name__ == "__main__":
    main()

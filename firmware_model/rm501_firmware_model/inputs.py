"""Debounced inputs, and triggers that latch where everything was at the first edge.

An input takes a new level after so many equal samples, one sample a frame. Until then the raw level may bounce as it
likes: every sample that agrees with the old level restarts the count. What a trigger latches is the frame in which
the burst began, not the one in which it was over: the first sample that differs while the level was stable. The burst
is forgotten when the old level has been there for the same number of samples, so that a lone glitch latches nothing,
neither then nor later. Because the latch belongs to the trigger and not to the input, only armed triggers cost
memory.
"""

from __future__ import annotations

from rm501_protocol.enums import Edge

from .layout import BoardLayout

__all__ = ["TRIGGER_SLOTS", "Inputs", "Triggers"]

TRIGGER_SLOTS = 4


class Triggers:
    """Armed triggers, each with the latch of a burst that may turn out to be its edge."""

    __slots__ = ("action", "edge", "input_id", "latched", "motion_frame", "motors", "positions", "real_frame", "state")

    def __init__(self, motors: int) -> None:
        self.motors = motors
        self.state = [0] * TRIGGER_SLOTS  # u1: armed
        self.input_id = [0] * TRIGGER_SLOTS  # u8
        self.edge = [0] * TRIGGER_SLOTS  # u8
        self.action = [0] * TRIGGER_SLOTS  # u8
        self.latched = [0] * TRIGGER_SLOTS  # u1: a burst has begun
        self.real_frame = [0] * TRIGGER_SLOTS  # u32
        self.motion_frame = [0] * TRIGGER_SLOTS  # u32
        self.positions = [0] * (TRIGGER_SLOTS * motors)  # s32, steps

    def arm(self, trigger: int, input_id: int, edge: int, action: int) -> None:
        """Arm a trigger, also one that is armed already."""
        self.state[trigger] = 1
        self.input_id[trigger] = input_id
        self.edge[trigger] = edge
        self.action[trigger] = action
        self.latched[trigger] = 0

    def disarm(self, trigger: int) -> None:
        """Disarm a trigger."""
        self.state[trigger] = 0
        self.latched[trigger] = 0

    def latch(self, trigger: int, real_frame: int, motion_frame: int, count: list[int]) -> None:
        """Remember this frame as the possible edge."""
        self.latched[trigger] = 1
        self.real_frame[trigger] = real_frame
        self.motion_frame[trigger] = motion_frame
        base = trigger * self.motors
        for motor in range(self.motors):
            self.positions[base + motor] = count[motor]

    def armed_mask(self) -> int:
        """Bit per armed trigger."""
        mask = 0
        for trigger in range(TRIGGER_SLOTS):
            mask |= self.state[trigger] << trigger
        return mask


class Inputs:
    """Raw and debounced levels, bit per input number, 1 = active."""

    __slots__ = ("active", "agree", "changed", "layout", "pins", "raw", "unsettled")

    def __init__(self, layout: BoardLayout) -> None:
        self.layout = layout
        self.pins = 0  # u32, the input word of the last frame, only the pins in use
        self.raw = 0  # u32
        self.active = 0  # u32, debounced
        self.changed = 0  # u32, debounced levels that changed in this frame
        self.unsettled = 0  # u32, inputs in a burst
        self.agree = [0] * layout.input_count  # u8, equal samples in a row

    def preset(self, pins: int) -> None:
        """Take the levels as they are, without a change."""
        self.pins = pins & self.layout.input_pins_mask
        self.raw = self.decode()
        self.active = self.raw
        self.unsettled = 0

    def decode(self) -> int:
        """Levels by input number from the input word."""
        layout = self.layout
        raw = 0
        for number in range(layout.input_count):
            raw |= ((self.pins >> layout.input_bit[number] & 1) ^ layout.input_inverted[number]) << number
        return raw

    def quiet(self, pins: int) -> int:
        """Whether a frame with this input word would change nothing."""
        return 1 if self.unsettled == 0 and pins & self.layout.input_pins_mask == self.pins else 0

    def frame(self, pins: int, real_frame: int, motion_frame: int, count: list[int], triggers: Triggers) -> int:
        """One sample of all inputs, when not `quiet`; the mask of debounced levels that changed."""
        self.changed = 0
        before = self.raw
        self.pins = pins & self.layout.input_pins_mask
        self.raw = self.decode()
        flipped = before ^ self.raw
        begun = (self.raw ^ self.active) & ~self.unsettled
        self.unsettled |= begun
        for number in range(self.layout.input_count):
            bit = 1 << number
            if self.unsettled & bit == 0:
                continue
            self.agree[number] = 1 if flipped & bit else self.agree[number] + 1
            if self.agree[number] >= self.layout.input_debounce_frames[number]:
                self.unsettled &= ~bit
                self.changed |= (self.raw ^ self.active) & bit
        for trigger in range(TRIGGER_SLOTS):
            if triggers.state[trigger]:
                bit = 1 << triggers.input_id[trigger]
                if begun & bit:
                    triggers.latch(trigger, real_frame, motion_frame, count)
        self.active ^= self.changed
        return self.changed

    def fires(self, trigger: int, triggers: Triggers) -> int:
        """Whether an armed trigger's edge was confirmed in this frame."""
        bit = 1 << triggers.input_id[trigger]
        if triggers.state[trigger] == 0 or self.changed & bit == 0:
            return 0
        rising = 1 if self.active & bit else 0
        return 1 if (triggers.edge[trigger] == Edge.RISING) == rising else 0

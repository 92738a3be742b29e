"""The hand: a direction in one slot of the scan and power pulses in another, on real frames.

An event of a segment starts a stroke at its exact motion frame; from there on the pulses run on real frames, whatever
happens to motion time. A stroke is a signed number of pulses, positive opens. Strokes add up, so a stroke commanded
while another one runs neither loses nor doubles a pulse; the queue's checks leave each one its time. Force is the
number of pulses beyond the full stroke: `grip_pulses` are added when closing. The number is bounded, hence so is the
time.

DIR is 1 for closing (negative), as for every motor, and the four step timings hold here as well.
"""

from __future__ import annotations

from rm501_protocol.enums import HandState

from .layout import BoardLayout

__all__ = ["Hand"]

ONE_PULSE = 1 << 24


class Hand:
    """Pulses still to make, the levels, and what was commanded last."""

    __slots__ = (
        "count",
        "dir_level",
        "dir_wait",
        "high_frames",
        "layout",
        "pending",
        "phase",
        "rise_wait",
        "state",
    )

    def __init__(self, layout: BoardLayout) -> None:
        self.layout = layout
        self.pending = 0  # s16, pulses still to make
        self.count = 0  # s32, pulses made, opening ones positive
        self.phase = 0  # u25, Q0.24
        self.dir_level = 0  # u1
        self.high_frames = 0  # u8
        self.rise_wait = 0  # u8
        self.dir_wait = 0  # u8
        self.state: int = HandState.UNKNOWN  # u8

    def command(self, pulses: int) -> int:
        """Begin a stroke, 0 cancels; 0 when more pulses than allowed would be waiting: then nothing changes."""
        if pulses == 0:
            self.cancel()
            return 1
        layout = self.layout
        total = self.pending + (pulses if pulses > 0 else pulses - layout.hand_grip_pulses)
        limit = layout.hand_max_pulses + layout.hand_grip_pulses
        if not -limit <= total <= limit:
            return 0
        if self.pending == 0:
            self.phase = ONE_PULSE
        self.pending = total
        self.state = HandState.OPENING if pulses > 0 else HandState.CLOSING
        return 1

    def cancel(self) -> None:
        """Make no more pulses."""
        if self.pending:
            self.state = HandState.UNKNOWN
        self.pending = 0

    def frame(self) -> None:
        """One real frame."""
        layout = self.layout
        if self.high_frames:
            self.high_frames -= 1
            if self.high_frames == 0:
                layout.slot_words[layout.hand_pulse_slot] ^= layout.hand_pulse_mask
        if self.rise_wait:
            self.rise_wait -= 1
        if self.dir_wait:
            self.dir_wait -= 1
        if self.pending == 0:
            return
        if self.phase < ONE_PULSE:
            self.phase += layout.hand_increment
        if (self.pending < 0) != self.dir_level:
            if self.dir_wait == 0:
                self.dir_level ^= 1
                layout.slot_words[layout.hand_dir_slot] ^= layout.hand_dir_mask
                if self.rise_wait < layout.dir_setup_frames:
                    self.rise_wait = layout.dir_setup_frames
        elif self.rise_wait == 0 and self.phase >= ONE_PULSE:
            self.pulse()

    def pulse(self) -> None:
        """Raise the power line for one pulse."""
        layout = self.layout
        self.phase -= ONE_PULSE
        layout.slot_words[layout.hand_pulse_slot] ^= layout.hand_pulse_mask
        self.high_frames = layout.step_length_frames
        self.rise_wait = layout.step_length_frames + layout.step_space_frames
        self.dir_wait = layout.dir_wait_frames
        if self.pending > 0:
            self.pending -= 1
            self.count += 1
        else:
            self.pending += 1
            self.count -= 1
        if self.pending == 0:
            self.state = HandState.CLOSED if self.dir_level else HandState.OPEN

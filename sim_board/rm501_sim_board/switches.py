"""Limit switches: where they act, how far they lag, how they bounce, how badly they repeat.

`angle_deg` is the joint angle at which the switch releases when the joint moves away from its active side: the edge
that homing latches. On the way in it acts `hysteresis_deg` deeper. Every actuation draws a new position error of
standard deviation `repeatability_deg`; after every change of state the contact bounces for `bounce_frames`.

All chance is decided when the contact changes, not when somebody looks, so the level at a frame does not depend on how
often the switch was read.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_NEVER_FRAME = 1 << 62
# Mean number of extra closures inside one bounce; a snap switch of that age bounces a handful of times.
_BOUNCES = 6


@dataclass(frozen=True, slots=True)
class SwitchParameters:
    """One limit switch. `active_below` tells its active side; angles in DH deg, durations in frames."""

    angle_deg: float
    active_below: bool
    hysteresis_deg: float = 0.0
    repeatability_deg: float = 0.0
    bounce_frames: int = 0
    glitches_per_second: float = 0.0


# Release edges in DH degrees, after the machine sheet; the shoulder's switch is active above its angle.
SWITCHES: tuple[SwitchParameters, ...] = (
    SwitchParameters(-150.1, True),
    SwitchParameters(102.35, False),
    SwitchParameters(-90.4, True),
    SwitchParameters(0.26, True),
    SwitchParameters(-66.63, True),
)


class Switch:
    """The contact of one switch over time. Call `level` with frames that never go back."""

    def __init__(self, parameters: SwitchParameters, rng: np.random.Generator, frames_per_second: float) -> None:
        self.parameters = parameters
        self.stuck: bool | None = None
        self._rng = rng
        self._frames_per_second = frames_per_second
        self._pressed: bool | None = None
        self._toggle_frames: list[int] = []
        self._bouncing_level = False
        self._side = 1.0 if parameters.active_below else -1.0
        self._offset_deg = self._draw_offset()
        self._next_glitch_frame = self._draw_glitch(0)

    @property
    def pressed(self) -> bool:
        """Whether the lever is pressed, bounce and stuck contacts aside."""
        return bool(self._pressed)

    def level(self, frame: int, joint_deg: float) -> bool:
        """The contact (True = active) at real `frame`, with the joint at `joint_deg`."""
        depth_deg = self._depth_deg(joint_deg)
        if self._pressed is None:
            self._pressed = depth_deg > 0.0
        elif self._pressed and depth_deg < 0.0:
            self._change(frame, False)
        elif not self._pressed and depth_deg >= self.parameters.hysteresis_deg:
            self._change(frame, True)
        level = self._pressed
        if self._toggle_frames:
            while self._toggle_frames and self._toggle_frames[0] <= frame:
                self._toggle_frames.pop(0)
                self._bouncing_level = not self._bouncing_level
            level = self._bouncing_level
        if frame >= self._next_glitch_frame:
            if frame == self._next_glitch_frame:
                level = not level
            else:
                self._next_glitch_frame = self._draw_glitch(frame)
        return level if self.stuck is None else self.stuck

    def steady_frames(self, frame: int, joint_deg: float, frames_to_travel: Callable[[float], int]) -> int:
        """For how many frames from `frame` on the contact cannot change; at least 1.

        `frames_to_travel` tells for how long the joint surely moves less than a distance in deg. To be asked at the
        frame at which `level` was read last.
        """
        if self.stuck is not None:
            return _NEVER_FRAME
        until_event = self._next_glitch_frame - frame
        if self._toggle_frames:
            until_event = min(until_event, self._toggle_frames[0] - frame)
        if until_event <= 0:
            return 1
        depth_deg = self._depth_deg(joint_deg)
        margin_deg = depth_deg if self._pressed else self.parameters.hysteresis_deg - depth_deg
        return max(1, min(frames_to_travel(margin_deg), until_event))

    def reclock(self, frame: int, frames_per_second: float) -> None:
        """Frames have another length from `frame` on; a bounce under way ends."""
        self._frames_per_second = frames_per_second
        self._toggle_frames = []
        self._next_glitch_frame = self._draw_glitch(frame)

    def restart_glitches(self, frame: int) -> None:
        """The rate of needles has changed: draw the next one anew."""
        self._next_glitch_frame = self._draw_glitch(frame)

    def _depth_deg(self, joint_deg: float) -> float:
        """How deep the joint is past the release edge, positive on the active side."""
        return self._side * (self.parameters.angle_deg + self._offset_deg - joint_deg)

    def _change(self, frame: int, pressed: bool) -> None:
        self._pressed = pressed
        if pressed:
            # The next release edge is where this actuation will let go; drawn on the way in.
            self._offset_deg = self._draw_offset()
        bounce = self.parameters.bounce_frames
        if bounce > 0:
            count = 2 * int(self._rng.integers(1, _BOUNCES))
            frames = frame + 1 + np.unique(self._rng.integers(0, bounce, size=count))
            if len(frames) % 2:
                frames = np.append(frames, frame + 1 + bounce)
            self._toggle_frames = frames.tolist()
            self._bouncing_level = pressed

    def _draw_offset(self) -> float:
        sigma_deg = self.parameters.repeatability_deg
        if sigma_deg <= 0.0:
            return 0.0
        # Clipped: a mechanical switch has no infinite tails, and hysteresis must stay wider than the scatter.
        limit_deg = min(3.0 * sigma_deg, 0.4 * self.parameters.hysteresis_deg or math.inf)
        return float(np.clip(self._rng.normal(0.0, sigma_deg), -limit_deg, limit_deg))

    def _draw_glitch(self, frame: int) -> int:
        rate = self.parameters.glitches_per_second
        if rate <= 0.0:
            return _NEVER_FRAME
        return frame + 1 + int(self._rng.exponential(self._frames_per_second / rate))

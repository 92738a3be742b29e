"""The two-finger hand: power pulses move the fingers between the stops, an object or a jam holds them.

One full stroke is `stroke_pulses` power pulses. Pulses against an obstacle are absorbed by the slipping drive; they
build grip force, never position. Nothing on the machine measures the fingers: what this module knows, the board does
not.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class HandParameters:
    """Stroke of the hand. Opening of 60 mm is the RM-501's data sheet figure for its motor-operated hand."""

    stroke_pulses: int = 800
    opening_mm: float = 60.0
    power_up_opening: float = 1.0
    grip_pulses_full_force: int = 120


class Hand:
    """State of the fingers: `position_pulses` 0 closed to `stroke_pulses` open, and what is between them."""

    def __init__(self, parameters: HandParameters) -> None:
        self.parameters = parameters
        self.position_pulses = round(parameters.stroke_pulses * parameters.power_up_opening)
        self.pulses_open = 0
        self.pulses_closed = 0
        self.jammed = False
        self.object_mm = 0.0
        self.object_mass_kg = 0.0
        self._squeeze_pulses = 0

    @property
    def opening_mm(self) -> float:
        """Distance between the fingers."""
        return self.parameters.opening_mm * self.position_pulses / self.parameters.stroke_pulses

    @property
    def gripping(self) -> bool:
        """Whether the fingers press on the object between them."""
        return self.object_mm > 0.0 and self._squeeze_pulses > 0

    @property
    def payload_kg(self) -> float:
        """Mass the arm carries now."""
        return self.object_mass_kg if self.gripping else 0.0

    def offer_object(self, width_mm: float, mass_kg: float) -> None:
        """Put an object of that width and mass between the fingers (0 mm takes it away)."""
        self.object_mm = max(0.0, width_mm)
        self.object_mass_kg = mass_kg if width_mm > 0.0 else 0.0
        if self.object_mm == 0.0:
            self._squeeze_pulses = 0

    def pulse(self, sign: int) -> None:
        """One power pulse: +1 opens, -1 closes."""
        if sign > 0:
            self.pulses_open += 1
        else:
            self.pulses_closed += 1
        if self.jammed:
            return
        if sign > 0:
            if self._squeeze_pulses:
                self._squeeze_pulses = 0
            self.position_pulses = min(self.position_pulses + 1, self.parameters.stroke_pulses)
            return
        floor_pulses = round(self.parameters.stroke_pulses * self.object_mm / self.parameters.opening_mm)
        if self.position_pulses > floor_pulses:
            self.position_pulses -= 1
        else:
            self._squeeze_pulses = min(self._squeeze_pulses + 1, self.parameters.grip_pulses_full_force)

    def pulses(self, count: int, sign: int) -> None:
        """`count` power pulses in one direction."""
        for _ in range(count):
            self.pulse(sign)

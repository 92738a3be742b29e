"""What the answers of a person at the arm mean for the configuration.

Single joints: commanded plus and seen minus turns the drive's sign. Wrist: the motors were commanded by the configured
matrix M; where the person saw the joints do D instead (columns: what pitch+ and roll+ did, in pitch and roll), the true
matrix is M D^-1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum

import numpy as np

from rm501_host.errors import Rm501Error

Matrix = tuple[tuple[float, float], tuple[float, float]]


class Seen(Enum):
    """What a person saw when the wrist was commanded; value: (pitch, roll)."""

    PITCH_PLUS = (1.0, 0.0)
    PITCH_MINUS = (-1.0, 0.0)
    ROLL_PLUS = (0.0, 1.0)
    ROLL_MINUS = (0.0, -1.0)


class CommissionError(Rm501Error):
    """The answers contradict each other."""


def wrist_matrix(configured: Matrix, on_pitch: Seen, on_roll: Seen) -> Matrix:
    """The matrix that belongs to what was seen; raises CommissionError when both commands turned the same joint."""
    seen = np.array([on_pitch.value, on_roll.value]).T
    if abs(np.linalg.det(seen)) < 0.5:
        raise CommissionError(
            "pitch and roll turned the same joint; look at the selects of both wrist motors, try again"
        )
    true = np.array(configured) @ np.linalg.inv(seen)
    (a, b), (c, d) = np.round(true, 9).tolist()
    return ((a + 0.0, b + 0.0), (c + 0.0, d + 0.0))


def drive_signs(configured: Sequence[int], turned_as_commanded: Sequence[bool]) -> tuple[int, ...]:
    """Signs of the first three drives."""
    return tuple(sign if right else -sign for sign, right in zip(configured, turned_as_commanded, strict=True))


def switches_swapped(pressed_and_seen: Mapping[str, str], swap_now: bool) -> bool:
    """Whether the two wrist switches are wired the other way round than configured.

    `pressed_and_seen`: switch pressed -> input that became active. Raises CommissionError for any other mix-up.
    """
    wrist = {"SWITCH_PITCH", "SWITCH_ROLL"}
    wrong = {pressed: seen for pressed, seen in pressed_and_seen.items() if pressed != seen}
    if not wrong:
        return swap_now
    if set(wrong) == wrist and set(wrong.values()) == wrist:
        return not swap_now
    text = ", ".join(f"{pressed} showed as {seen}" for pressed, seen in wrong.items())
    raise CommissionError(f"switches are mixed up: {text}; correct the wiring, then begin again")

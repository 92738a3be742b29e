"""Builds port words by hand from latched levels, after the machine sheet: a stand-in for any firmware."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from tests.support.pin_decoder import PINS, bit_of

PERIODS = 8
IDLE_WORD = sum(1 << bit_of(name) for name in PINS)

# slot: motor on bus 1, motor on bus 2, selects
_SLOTS = (
    ("elbow", "shoulder", ("ELBOW SELECT", "SHOULDER SELECT")),
    ("waist", "left wrist", ("WAIST SELECT", "LEFT WRIST SELECT")),
    ("hand direction", "right wrist", ("HAND DIRECTION", "RIGHT WRIST SELECT")),
    ("hand power", None, ("HAND POWER",)),
)


def frame_words(
    steps: Mapping[str, bool], directions: Mapping[str, bool], lines: Mapping[str, bool] | None = None
) -> list[int]:
    """The eight words of one frame; keys of `steps` and `directions` are motors, "hand" being power and direction."""
    words = []
    for first, second, selects in _SLOTS:
        active = {name for name, level in (lines or {}).items() if level} | set(selects)
        if first == "hand direction":
            levels_1 = (directions.get("hand", False), True)
        elif first == "hand power":
            levels_1 = (steps.get("hand", False), False)
        else:
            levels_1 = (steps.get(first, False), directions.get(first, False))
        levels_2 = (False, False) if second is None else (steps.get(second, False), directions.get(second, False))
        if levels_1[0]:
            active |= {"STEP_1", "HAND_1", "HAND_3"}
        if levels_1[1]:
            active |= {"DIR_1", "HAND_2"}
        if levels_2[0]:
            active.add("STEP_2")
        if levels_2[1]:
            active.add("DIR_2")
        word = IDLE_WORD & ~sum(1 << bit_of(name) for name in active)
        words += [word, word & ~(1 << bit_of("STROBE"))]
    return words


def run_words(
    frames: Sequence[tuple[Mapping[str, bool], Mapping[str, bool]]], lines: Mapping[str, bool] | None = None
) -> npt.NDArray[np.uint32]:
    """Port words of several frames."""
    words: list[int] = []
    for steps, directions in frames:
        words += frame_words(steps, directions, lines)
    return np.array(words, dtype=np.uint32)


def step_words(motor: str, count: int, lines: Mapping[str, bool] | None = None) -> npt.NDArray[np.uint32]:
    """`count` signed steps of one motor at the fastest legal rate: direction first, then one frame high, one low."""
    negative = {motor: count < 0}
    frames = [({}, negative)] + [({motor: high}, negative) for _ in range(abs(count)) for high in (True, False)]
    return run_words(frames, lines)

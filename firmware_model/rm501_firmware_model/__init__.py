"""The microcontroller of the board, as an executable specification: integers, fixed buffers, one `run_until(frame)`."""

from __future__ import annotations

from .board import Board
from .fast import FastBoard
from .layout import BoardLayout
from .pins import Pins, QuietPins, inactive_inputs
from .states import RULES, Rule, Stimulus, Verdict

__all__ = [
    "RULES",
    "Board",
    "BoardLayout",
    "FastBoard",
    "Pins",
    "QuietPins",
    "Rule",
    "Stimulus",
    "Verdict",
    "inactive_inputs",
]

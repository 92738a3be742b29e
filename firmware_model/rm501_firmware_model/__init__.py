"""The microcontroller of the board, as an executable specification: integers, fixed buffers, one `run_until(frame)`."""

from __future__ import annotations

from .board import Board
from .layout import BoardLayout
from .pins import Pins, QuietPins
from .states import RULES, Rule, Stimulus, Verdict

__all__ = ["RULES", "Board", "BoardLayout", "Pins", "QuietPins", "Rule", "Stimulus", "Verdict"]

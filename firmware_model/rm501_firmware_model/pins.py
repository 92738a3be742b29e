"""The pins: everything that the board sees of the world, and the world of the board.

The board puts out one port word per base period and reads one input word per frame, at its start. Frame numbers are
real frames since boot and never wrap here. Bits are those of the configuration's pin tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from rm501_protocol.board_config import BoardConfig

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Pins", "QuietPins", "inactive_inputs"]


class Pins(Protocol):
    """What an environment of the board implements."""

    def read_inputs(self, frame: int) -> int:
        """The input word at the start of `frame`, after every word written before it."""

    def inputs_stable_until(self, frame: int) -> int:
        """Promise that from `frame` up to the returned frame, exclusive, `read_inputs` gives what it gives at `frame`.

        However the motors move meanwhile. `frame + 1` promises nothing and is always right.
        """

    def write_frame(self, frame: int, words: Sequence[int]) -> None:
        """One frame: the port word of each of its base periods. `words` is the board's buffer: copy what is kept."""

    def write_block(self, first_frame: int, words: NDArray[np.uint32]) -> None:
        """Many frames at once, from the fast board only: shape (frames, base periods), C order, not reused."""


class QuietPins:
    """An environment with constant inputs that forgets what is written to it; a base for tests and measurements."""

    def __init__(self, inputs: int = 0) -> None:
        self.inputs = inputs

    def read_inputs(self, frame: int) -> int:
        """The constant input word."""
        return self.inputs

    def inputs_stable_until(self, frame: int) -> int:
        """Far beyond any run."""
        return frame + (1 << 40)

    def write_frame(self, frame: int, words: Sequence[int]) -> None:
        """Forget."""

    def write_block(self, first_frame: int, words: NDArray[np.uint32]) -> None:
        """Forget."""


def inactive_inputs(config: BoardConfig) -> int:
    """The input word in which no input of the configuration is active."""
    word = 0
    for pin in config.inputs.inputs:
        if pin.inverted:
            word |= 1 << pin.bit
    return word

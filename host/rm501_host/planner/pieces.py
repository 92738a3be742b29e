"""Pieces: what the planner yields, one after another: stretches of motion, waits, and marks for the session."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm
from rm501_host.moves import Move, Source

Array = NDArray[np.float64]


class Action(Protocol):
    """Anything else in a stream of moves that the session acts upon; the planner only brings the arm to rest."""

    @property
    def source(self) -> Source:
        """The block that asks for it."""
        ...


class PieceKind(Enum):
    """What a piece is."""

    MOTION = "motion"
    """Joints move by a law."""
    DWELL = "dwell"
    """Nothing moves for a time."""
    HAND = "hand"
    """The hand's stroke, waited for: an event at the start, then a dwell of the stroke's length."""
    OUTPUT = "output"
    """A digital output changes (at rest), over one frame."""
    MARK = "mark"
    """No motion and no time: a move that the session acts upon (pause, input, message, end), at rest."""
    NOTE = "note"
    """No motion and no time, and no rest either: something to write down when its turn comes (log comments)."""


class EventKind(Enum):
    """What happens at an exact moment."""

    HAND = "hand"
    OUTPUT = "output"


@dataclass(frozen=True, slots=True)
class PieceEvent:
    """An action at `offset_s` into its piece. HAND: `value` in pulses, positive opens; OUTPUT: `mask`, `levels`."""

    offset_s: float
    kind: EventKind
    value: int = 0
    mask: int = 0
    levels: int = 0
    source: Source | None = None


class Law(Protocol):
    """An ideal law in joint space, times from 0 (PathLaw, and laws given from outside)."""

    def q_deg(self, time_s: Array) -> Array:
        """Joint angles (n, 5) in deg."""
        ...

    def states(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Joint angles, rates, accelerations, each (n, 5), in deg, deg/s, deg/s^2."""
        ...

    def lines(self, time_s: Array) -> NDArray[np.int64]:
        """Source line at the times, (n,)."""
        ...

    def kinks_s(self) -> tuple[Array, Array]:
        """Times (n,) at which the accelerations may jump, and on which side they are larger: -1 before, 1 after, 0
        unknown."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stretch of the plan over [start_s, start_s + duration_s] of plan time.

    A law ends at or before the piece does (a piece that ends at rest is filled up to whole frames); without a law the
    arm stands at `rest_deg`. `move`: what a MARK asks for. `motion_s`: how much of it joints move. `arm`: with the tool
    of that moment.
    """

    kind: PieceKind
    source: Source
    start_s: float
    duration_s: float
    rest_deg: tuple[float, ...]
    law: Law | None = None
    starts_at_rest: bool = True
    ends_at_rest: bool = True
    events: tuple[PieceEvent, ...] = ()
    move: Move | Action | None = None
    motion_s: float = 0.0
    arm: Arm | None = None

    @property
    def end_s(self) -> float:
        """Plan time at the end."""
        return self.start_s + self.duration_s

    def q_deg(self, time_s: Array) -> Array:
        """Joint angles (n, 5) in deg at times (n,) from the start of the piece."""
        if self.law is None:
            return np.broadcast_to(np.array(self.rest_deg), (len(time_s), 5)).copy()
        return self.law.q_deg(time_s)

    def states(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Joint angles, rates and accelerations, each (n, 5), in deg, deg/s, deg/s^2."""
        if self.law is None:
            still = np.zeros((len(time_s), 5))
            return self.q_deg(time_s), still, still.copy()
        return self.law.states(time_s)

    def qd_deg_s(self, time_s: Array) -> Array:
        """Joint rates (n, 5)."""
        return self.states(time_s)[1]

    def qdd_deg_s2(self, time_s: Array) -> Array:
        """Joint accelerations (n, 5)."""
        return self.states(time_s)[2]

    def lines(self, time_s: Array) -> NDArray[np.int64]:
        """Source line at the times, (n,)."""
        if self.law is None:
            return np.full(len(time_s), self.source.line, dtype=np.int64)
        return self.law.lines(time_s)

"""Running back along the path that was come, from where the arm has stopped on it.

The elements of the pieces are reversed (s -> length - s) and planned again, fastest law under the same limits, from
rest to rest: the arm retraces its path exactly, however it was timed on the way here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rm501_host.config import Config

from .elements import Array, Curve, Element
from .errors import PlanError
from .grid import GridBuilder
from .jerk import JerkLaw
from .limits import Limits
from .pieces import Piece, PieceKind
from .ways import along
from .window import Window

KEPT_S = 30.0
"""How far back, in time at 100 %, it goes."""


@dataclass(frozen=True, slots=True, eq=False)
class _Backwards:
    """A curve run through from its end."""

    curve: Curve
    end: float

    def evaluate(self, s: Array) -> tuple[Array, Array, Array]:
        values, slopes, bends = self.curve.evaluate(self.end - s)
        return values, -slopes, bends


def reversed_element(element: Element) -> Element:
    """The same geometry from its end to its start."""
    if element.curve is not None:
        end = element.curve_start + element.length
        return replace(element, curve=_Backwards(element.curve, end), curve_start=0.0, marks=())
    at_end = element.trimmed(element.length, 2.0 * element.length) if element.length else element
    c0, c1, c2, c3 = at_end.coefficients
    return replace(
        at_end,
        length=element.length,
        coefficients=np.stack((c0, -c1, c2, -c3)),
        sine=-at_end.sine,
        growth=-at_end.growth,
    )


def plan_run_back(
    config: Config, pieces: Sequence[Piece], stopped_s: float, seconds: float, *, start_s: float = 0.0
) -> tuple[Piece, ...]:
    """Pieces that lead back along `pieces` from plan time `stopped_s`, as far as they came in `seconds` of plan time.

    Stops where the path stopped; waits, the hand and outputs are left out. Laws timed from outside cannot be run back:
    raises PlanError for them.
    """
    limits = Limits.from_config(config)
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    earliest = stopped_s - seconds
    result: list[Piece] = []
    window: Window | None = None
    is_smooth = False
    at = start_s

    def close() -> None:
        nonlocal at, window
        if window is None or window.is_empty:
            return
        stretch = window.finish()
        assert stretch is not None
        fastest = stretch.law
        law = JerkLaw.over(fastest, stretch.lines, limits, frame_s) if is_smooth else fastest
        rest = tuple(law.q_deg(np.array([law.duration_s]))[0].tolist())
        first = stretch.elements[0].source
        result.append(
            Piece(PieceKind.MOTION, first, at, law.duration_s, rest, law=law, motion_s=law.duration_s, arm=law.arm)
        )
        at += law.duration_s
        window = None

    for piece in reversed(pieces):
        if piece.end_s <= earliest or piece.start_s >= stopped_s:
            continue
        if piece.ends_at_rest:
            close()
        if piece.law is None:
            continue
        law = along(piece.law)
        if law is None:
            raise PlanError("only paths can be run back, not timed laws", source=piece.source)
        first, last = max(0.0, earliest - piece.start_s), min(law.duration_s, stopped_s - piece.start_s)
        elements = [reversed_element(element) for element in reversed(law.elements_between(first, last))]
        if window is None:
            window = Window(law.arm, GridBuilder(law.arm, limits, check_limits=False), frame_s)
            is_smooth = isinstance(law, JerkLaw)
        window.extend(elements)
    close()
    return tuple(result)

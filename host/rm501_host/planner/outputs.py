"""M62, M63: output changes that happen on the path, while the arm moves.

A change belongs to the place where the next motion begins: the start of the next element, or, where a blend leads into
it, the middle of the blend (the place nearest to the programmed corner). It is kept as a mark on the element, so that
neither path nor time law know of it; once the law is made, the mark's place gives its time, and the segmenter plays it
on the first frame that is not before that. Changes at one place are one event: the last one of each output counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rm501_host.moves import OutputChange

from .elements import ElementTable, OutputMark
from .pieces import EventKind, PieceEvent

Place = tuple[int, float]
"""An element's number and s on it."""


def combined(changes: Sequence[OutputChange], at: float) -> OutputMark:
    """One mark for all changes at a place, in their order."""
    mask = levels = 0
    for change in changes:
        bit = 1 << change.output
        mask |= bit
        levels = levels | bit if change.on else levels & ~bit
    return OutputMark(at, mask, levels, changes[0].source)


def output_events(
    table: ElementTable, first: Place, last: Place, time_at: Callable[[int, float], float]
) -> tuple[PieceEvent, ...]:
    """Events for the marks from `first` on and before `last`; `time_at`: when the law passes a place."""
    found = []
    for number in range(first[0], last[0] + 1):
        for mark in table.elements[number].marks:
            if first <= (number, mark.at) < last:
                offset_s = time_at(number, mark.at)
                found.append(
                    PieceEvent(offset_s, EventKind.OUTPUT, mask=mark.mask, levels=mark.levels, source=mark.source)
                )
    return tuple(found)

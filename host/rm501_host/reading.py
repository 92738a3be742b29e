"""Long reading shows itself: what `check`, `plan` and `run` say while a program is read and nothing else happens."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator

from rm501_host.errors import RefusedError
from rm501_host.moves import Move
from rm501_host.planner.pieces import Action

EVERY_S = 3.0
"""Most programs are read before the first word is due."""


def tell_while_reading(
    moves: Iterator[Move | Action],
    tell: Callable[[int, int], None],
    clock_s: Callable[[], float],
    *,
    every_s: float = EVERY_S,
) -> Generator[Move | Action, None, None]:
    """The moves as they are taken; `tell` is called with the line and the number of moves so far, every `every_s`.

    What the taker does with a move counts: the time is looked at when the next one is asked for.
    """
    taken, due_s = 0, clock_s() + every_s
    try:
        for move in moves:
            yield move
            taken += 1
            if clock_s() >= due_s:
                tell(move.source.line, taken)
                due_s = clock_s() + every_s
    finally:
        if isinstance(moves, Generator):
            moves.close()


def at_most(moves: Iterator[Move | Action], most: int, remedy: str) -> Generator[Move | Action, None, None]:
    """The moves up to `most`; the next one is refused, RefusedError naming it and the remedy."""
    for count, move in enumerate(moves):
        if count >= most:
            raise RefusedError(f"{move.source}: more than {most} moves, does it ever end? {remedy}")
        yield move

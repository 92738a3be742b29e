"""A stream of pieces cut where something has to be done at rest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

from rm501_host.planner import Piece, PieceKind


class PieceRuns:
    """Cuts pieces at their marks; pieces are taken, and with it planned, only as they are wanted.

    Use: `while runs.peek() or runs.mark: play runs.until_mark(), then act on runs.mark`.
    """

    def __init__(self, pieces: Iterable[Piece]) -> None:
        self._pieces = iter(pieces)
        self._first: Piece | None = None
        self.mark: Piece | None = None
        """The mark that ended the last run, None at the end of all."""

    def peek(self) -> bool:
        """Plan the next piece: True when it is something to play; False when it is a mark, or the end."""
        self.mark = None
        piece = next(self._pieces, None)
        if piece is None or piece.kind is PieceKind.MARK:
            self.mark = piece
            return False
        self._first = piece
        return True

    def until_mark(self) -> Iterator[Piece]:
        """The pieces up to the next mark, which is then in `mark`."""
        first, self._first = self._first, None
        for piece in chain([] if first is None else [first], self._pieces):
            if piece.kind is PieceKind.MARK:
                self.mark = piece
                return
            yield piece

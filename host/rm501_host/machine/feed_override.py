"""The operator's feed override, and how much of it falls to the board.

Feeds of a program may have been planned multiplied (`plan_scale`) so that an override above 1 can be reached; the board
then plays at `ratio / plan_scale`, never above 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from rm501_protocol.messages import OVERRIDE_ONE, SetOverride

HIGHEST_OVERRIDE = 2.0


@dataclass(slots=True)
class FeedOverride:
    """What was asked for, and by how much the feeds that are played now were multiplied already."""

    ratio: float = 1.0
    plan_scale: float = 1.0

    @property
    def message(self) -> SetOverride:
        """The board's part of it."""
        return SetOverride(round(min(1.0, self.ratio / self.plan_scale) * OVERRIDE_ONE))

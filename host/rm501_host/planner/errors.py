"""What the planner refuses.

PlanError            with the source line, the place on the path, the amount and the remedy
├── UnreachableError     no joint angles put the tool there (or not on this branch)
├── JointLimitError      a joint would leave its range
└── OrientationError     a six-dimensional orientation that five joints cannot take
"""

from __future__ import annotations

from rm501_host.errors import Rm501Error
from rm501_host.moves import Source


class PlanError(Rm501Error):
    """A move that cannot be planned.

    `source`: the block; `place_mm`: distance along the move (None where it has none); `q_deg`: joints there or just
    before it, where known; `amount`: how far beyond, with its unit in the text; `remedy`: what to do.
    """

    def __init__(
        self,
        problem: str,
        *,
        source: Source | None = None,
        place_mm: float | None = None,
        q_deg: tuple[float, ...] | None = None,
        amount: float | None = None,
        remedy: str = "",
    ) -> None:
        self.problem = problem
        self.source = source
        self.place_mm = place_mm
        self.q_deg = q_deg
        self.amount = amount
        self.remedy = remedy
        where = f"{source}: " if source is not None else ""
        place = f" ({place_mm:.3f} mm along the move)" if place_mm is not None else ""
        cure = f"; {remedy}" if remedy else ""
        super().__init__(f"{where}{problem}{place}{cure}")


class UnreachableError(PlanError):
    """No joint angles put the tool there, or none on the branch that the move started on."""


class JointLimitError(PlanError):
    """A joint would leave its range."""


class OrientationError(PlanError):
    """A six-dimensional orientation that the five joints cannot take."""

"""What a preflight finds, and its report."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from rm501_host.moves import Source, Target


class Severity(Enum):
    """Whether a finding forbids the start."""

    ERROR = "error"
    WARNING = "warning"


class FindingKind(Enum):
    """What is wrong; the first three are the path problems of thesis 4.2.1."""

    UNREACHABLE = "unreachable"
    """A point on the way that no joint angles reach."""
    SINGULARITY = "singularity"
    """The tool must slow down far below its feed because joints would run away."""
    BRANCH = "branch"
    """Start and goal lie on different branches of the arm."""
    JOINT_LIMIT = "joint_limit"
    """A joint would leave its range on the way."""
    ORIENTATION = "orientation"
    """Five joints cannot take this orientation."""
    KEEP_OUT = "keep_out"
    """A link or the hand would enter a box or go below the table."""
    MOTOR_RATE = "motor_rate"
    """A motor's step rate keeps the tool below its feed."""
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Via:
    """A pose to go by: the target of a linear move and the joints there."""

    target: Target
    q_deg: tuple[float, ...]

    def __str__(self) -> str:
        x, y, z, a, b, c = self.target
        tail = f" C{c:.2f}" if c else ""
        return f"X{x:.2f} Y{y:.2f} Z{z:.2f} A{a:.2f} B{b:.2f}{tail}"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: where (line, mm along the move, joints there), how much, what to do, a pose that helps."""

    severity: Severity
    kind: FindingKind
    source: Source
    text: str
    place_mm: float | None = None
    q_deg: tuple[float, ...] | None = None
    amount: float | None = None
    unit: str = ""
    remedy: str = ""
    via: Via | None = None
    count: int = 1

    def __str__(self) -> str:
        place = f", {self.place_mm:.2f} mm along the move" if self.place_mm is not None else ""
        joints = f", joints {', '.join(f'{q:.2f}' for q in self.q_deg)} deg" if self.q_deg is not None else ""
        more = f" ({self.count} moves)" if self.count > 1 else ""
        via = f"; by way of {self.via}" if self.via is not None else ""
        cure = f"; {self.remedy}" if self.remedy else ""
        return f"{self.source}: {self.severity.value}: {self.text}{more}{place}{joints}{cure}{via}"


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """What was checked and found.

    `complete`: the program was checked to its end; else `stopped_by` says why not, and the check goes on rolling
    ahead of the motion from `checked_to_line`. Times are None where there are errors, or where no estimate was asked
    for; `estimated_s` stands in for `cycle_s` where a program is too long to be planned. `needed_lead_s`: motion to
    keep queued; `needed_lead_segments`: in how many segments.
    """

    findings: tuple[Finding, ...]
    checked_to_line: int
    complete: bool
    stopped_by: str
    moves: int
    cycle_s: float | None = None
    motion_s: float | None = None
    stop_horizon_s: float | None = None
    needed_lead_s: float | None = None
    needed_lead_segments: int | None = None
    estimated_s: float | None = None
    limits: dict[str, float] = field(default_factory=dict)

    @property
    def errors(self) -> tuple[Finding, ...]:
        """The findings that forbid the start."""
        return tuple(finding for finding in self.findings if finding.severity is Severity.ERROR)

    @property
    def ok(self) -> bool:
        """Nothing forbids the start."""
        return not self.errors

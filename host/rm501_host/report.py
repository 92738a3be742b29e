"""The report of a run: what `run --report` writes and what the terminal shows at the end."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rm501_host.storage import write_atomic


@dataclass(frozen=True, slots=True)
class WireFigures:
    """What went over the wire during the run, framing included; `bad_frames` came in broken and were sent again."""

    bytes_out: int
    bytes_in: int
    retransmits: int
    bad_frames: int = 0


@dataclass(frozen=True, slots=True)
class LimitFigures:
    """Largest share of a limit that the ideal law reached; 1.0 is the limit itself."""

    joint_velocity_ratio: float
    joint_acceleration_ratio: float
    motor_rate_ratio: float


@dataclass(frozen=True, slots=True)
class TrackingFigures:
    """Largest distance between the ideal law and the segments as the board plays them, bit for bit."""

    max_step_error: float
    max_tcp_error_mm: float


@dataclass(frozen=True, slots=True)
class RunReport:
    """What happened: `result` is "ok", or why it ended otherwise; cycle_s and motion_s do not count homing."""

    program: str
    result: str
    cycle_s: float
    motion_s: float
    segments: int
    wire: WireFigures
    limits: LimitFigures
    tracking: TrackingFigures
    speed_ratio: float
    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    picture: str | None = None

    def as_json(self) -> str:
        """One JSON object, keys in the order of the fields."""
        return json.dumps(asdict(self), indent=2)

    def write(self, path: Path) -> None:
        """Write the JSON to `path`, replacing what was there in one step; raises StorageError."""
        write_atomic(path, f"{self.as_json()}\n".encode())

    def as_text(self) -> str:
        """The few lines for a person."""
        wire, limits = self.wire, self.limits
        lines = [
            f"{self.program}: {self.result}",
            f"  time       {self.cycle_s:.2f} s, of which {self.motion_s:.2f} s in motion "
            f"({self.speed_ratio:.1f} x real time)",
            f"  segments   {self.segments}",
            f"  wire       {wire.bytes_out} bytes out, {wire.bytes_in} in, {wire.retransmits} sent again",
            f"  limits     joint velocity {limits.joint_velocity_ratio:.1%}, acceleration "
            f"{limits.joint_acceleration_ratio:.1%}, motor rate {limits.motor_rate_ratio:.1%}",
            f"  path error {self.tracking.max_tcp_error_mm:.3f} mm at the tool, "
            f"{self.tracking.max_step_error:.3f} step at a motor",
            f"  faults     {len(self.faults) or 'none'}",
        ]
        lines += [f"  warning    {warning}" for warning in self.warnings]
        if self.picture is not None:
            lines.append(f"  picture    {self.picture}")
        return "\n".join(lines)

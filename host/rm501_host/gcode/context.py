"""What the parts of the interpreter share while a block is executed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from rm501_host.gcode.canon import Axes, CanonCall, Units, UserMKind
from rm501_host.gcode.errors import Location
from rm501_host.gcode.parameters import Parameters
from rm501_host.gcode.state import State
from rm501_host.gcode.tools import ToolTable


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """Outcome of a probing move: where (program coordinates and units) and whether contact was made."""

    position: Axes
    success: bool


class MachineFeedback(Protocol):
    """What only the machine knows. Asked after the call that needs it was taken by the consumer, never before."""

    def probe_result(self, target: Axes) -> ProbeResult:
        """Result of the probing move to `target` that the consumer has carried out."""

    def input_value(self, index: int, analog: bool, mode: int, timeout_s: float) -> float:
        """Result of M66: 1 or 0, an analog value, or -1 after a timeout."""


class OfflineFeedback:
    """No machine: probing ends at its target without contact and inputs read 0, as `rs274 -g` has it."""

    def probe_result(self, target: Axes) -> ProbeResult:
        """The target, without contact."""
        return ProbeResult(target, False)

    def input_value(self, index: int, analog: bool, mode: int, timeout_s: float) -> float:
        """Always 0."""
        del index, analog, mode, timeout_s
        return 0.0


BUILT_IN_USER_M: Mapping[int, UserMKind] = {
    101: UserMKind.HAND,
    102: UserMKind.HAND,
    110: UserMKind.JOINT,
    111: UserMKind.JOINT,
}


@dataclass(slots=True)
class Context:
    """State, parameters, tools, and where canonical calls and warnings go."""

    state: State
    parameters: Parameters
    tools: ToolTable
    feedback: MachineFeedback
    emit: Callable[[CanonCall], None]
    warn: Callable[[str], None]
    user_m: Mapping[int, UserMKind]
    machine_units: Units
    peer_standalone: bool = False
    """Reproduce `rs274 -g` where it differs from LinuxCNC itself (M61 does not load the tool's data)."""
    at: Location = field(default_factory=lambda: Location("", 0))
    pending: Callable[[], None] | None = None
    """Runs before the next block is read: takes the machine's answer to a probe or an input."""

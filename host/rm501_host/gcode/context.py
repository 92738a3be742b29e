"""What the parts of the interpreter share while a block is executed."""

from __future__ import annotations

import math
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
    """Outcome of a probing move in program coordinates and units: where contact was (the target without any), where
    the tool stopped, and whether there was contact.
    """

    contact: Axes
    stopped_at: Axes
    success: bool


class MachineFeedback(Protocol):
    """What only the machine knows. Asked after the call that needs it was taken by the consumer, never before."""

    def probe_result(self, start: Axes, target: Axes, units: Units) -> ProbeResult:
        """Result of the probing move from `start` to `target` that the consumer has carried out."""

    def input_value(self, index: int, analog: bool, mode: int, timeout_s: float) -> float:
        """Result of M66: 1 or 0, an analog value, or -1 after a timeout."""


class OfflineFeedback:
    """No machine: a probe finds nothing up to its target, and inputs read 0."""

    def probe_result(self, start: Axes, target: Axes, units: Units) -> ProbeResult:
        """The target, without contact."""
        del start, units
        return ProbeResult(target, target, False)

    def input_value(self, index: int, analog: bool, mode: int, timeout_s: float) -> float:
        """Always 0."""
        del index, analog, mode, timeout_s
        return 0.0


class PeerFeedback(OfflineFeedback):
    """The machine that `rs274 -g` pretends to be: after a probe the tool stands 0.01 inch short of the target."""

    def probe_result(self, start: Axes, target: Axes, units: Units) -> ProbeResult:
        """Stopped short, without contact."""
        distance = math.dist(start[:3], target[:3])
        if distance == 0.0:
            return ProbeResult(target, target, False)
        k = 0.254 / units.mm / distance
        x, y, z = (t - k * (t - s) for s, t in zip(start[:3], target[:3], strict=True))
        return ProbeResult(target, (x, y, z, *target[3:]), False)


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
    peer_mark: tuple[list[float], list[float]] | None = None
    """Position after and before a call that the peer's pretended machine does not follow (splines, tool length)."""
    pending: Callable[[], None] | None = None
    """Runs before the next block is read: takes the machine's answer to a probe or an input."""

    def mark_unfollowed(self, before: list[float]) -> None:
        """The peer's machine stays at `before` while the program goes on from the position in force."""
        if self.peer_standalone:
            self.peer_mark = (self.state.position.copy(), before)

    def machine_stands_at(self) -> list[float]:
        """Where the machine believes to be: the position, but for what `rs274 -g`'s does not follow."""
        mark = self.peer_mark
        if mark is not None and mark[0] == self.state.position:
            return mark[1]
        return self.state.position

    def resynchronise(self) -> None:
        """Before the next block the position is taken from the machine (only the peer's pretended one can differ)."""
        if not self.peer_standalone or self.pending is not None:
            return

        def take_position() -> None:
            self.state.position = self.machine_stands_at().copy()

        self.pending = take_position

"""Makes faults happen on a running board: now, at a time, when a joint passes an angle, or at random.

Every fault strikes between two runs of the board, at the loop's present time, with the emulator brought up to it: so
two runs with one seed on virtual time see it in the same frame.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rm501_sim_board.errors import FaultSpecError
from rm501_sim_board.fault_kinds import BY_NAME, FAULT_KINDS, FaultKind, Undo, Value
from rm501_sim_board.fault_spec import AtAngle, AtRandom, AtTime, FaultSpec, parse_fault
from rm501_sim_board.pacing import PacedBoard
from rm501_sim_board.randomness import stream


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """Something that was done to the board: fault name, real frame, and whether it began or ended."""

    frame: int
    name: str
    began: bool


class FaultInjector:
    """Holds the faults of one board; `log` tells what struck when."""

    def __init__(self, board: PacedBoard) -> None:
        self.log: list[FaultEvent] = []
        self._board = board
        self._origin_s = board.loop.time()
        self._active: dict[str, Undo] = {}
        self._timers: list[asyncio.TimerHandle] = []
        self._count = 0

    @property
    def active(self) -> tuple[str, ...]:
        """Faults that hold now."""
        return tuple(self._active)

    def inject(self, fault: FaultSpec | str) -> None:
        """Arrange a fault as written (`parse_fault`) or as specified; FaultSpecError when it makes no sense."""
        spec = parse_fault(fault) if isinstance(fault, str) else fault
        kind, values = check_fault(spec)
        self._count += 1
        when = spec.when
        if isinstance(when, AtTime):
            self._call_at(self._origin_s + when.seconds, lambda: self._strike(kind, values, spec))
        elif isinstance(when, AtRandom):
            rng = stream(self._board.emulator.options.seed, f"fault {self._count} {spec.name}")
            self._again(kind, values, spec, lambda: float(rng.exponential(1.0 / when.per_second)))
        else:
            self._watch(kind, values, spec, when)

    def clear(self, name: str) -> bool:
        """End a fault that holds; False when none of that name does."""
        undo = self._active.pop(name, None)
        if undo is None:
            return False
        self._board.run_to_now()
        undo()
        self.log.append(FaultEvent(self._board.emulator.frame, name, False))
        return True

    def close(self) -> None:
        """Nothing strikes any more."""
        for timer in self._timers:
            timer.cancel()

    def _call_at(self, time_s: float, action: Callable[[], object]) -> None:
        loop = self._board.loop
        if time_s <= loop.time():
            action()
            return
        self._timers = [timer for timer in self._timers if not timer.cancelled() and timer.when() > loop.time()]
        self._timers.append(loop.call_at(time_s, action))

    def _strike(self, kind: FaultKind, values: Mapping[str, Value], spec: FaultSpec) -> None:
        if self._board.closed:
            return
        self._board.run_to_now()
        undo = kind.apply(self._board, values)
        self.log.append(FaultEvent(self._board.emulator.frame, kind.name, True))
        if undo is None:
            return
        self._active[kind.name] = undo
        if spec.duration_s is not None:
            self._call_at(self._board.loop.time() + spec.duration_s, lambda: self.clear(kind.name))

    def _again(self, kind: FaultKind, values: Mapping[str, Value], spec: FaultSpec, draw: Callable[[], float]) -> None:
        def strike() -> None:
            self._strike(kind, values, spec)
            self._again(kind, values, spec, draw)

        self._call_at(self._board.loop.time() + draw(), strike)

    def _watch(self, kind: FaultKind, values: Mapping[str, Value], spec: FaultSpec, when: AtAngle) -> None:
        def passed() -> None:
            self._board.loop.call_soon(self._strike, kind, values, spec)

        self._board.emulator.bench.when_passing(when.joint, when.upwards, when.angle_deg, passed)


def check_fault(spec: FaultSpec) -> tuple[FaultKind, dict[str, Value]]:
    """The kind and the parameter values of a specification; FaultSpecError when something does not fit."""
    kind = BY_NAME.get(spec.name)
    if kind is None:
        raise FaultSpecError(f"fault {spec.name!r} is not known; see --list-faults")
    known = {parameter.name for parameter in kind.parameters}
    for name in spec.parameters:
        if name not in known:
            takes = ", ".join(sorted(known)) or "none"
            raise FaultSpecError(f"fault {spec.name}: no parameter {name!r}; it takes {takes}")
    values: dict[str, Value] = {p.name: p.read(spec.name, spec.parameters.get(p.name)) for p in kind.parameters}
    return kind, values


def fault_table() -> str:
    """Every fault with its parameters, one a line, as `--list-faults` prints it."""
    lines = [f"{'fault':24}{'row':9}what happens; parameters"]
    for kind in FAULT_KINDS:
        rows = ",".join(map(str, kind.rows))
        parts = []
        for p in kind.parameters:
            shown = "..." if p.default is None else f"{p.default:g}" if isinstance(p.default, float) else p.default
            choices = f": {'|'.join(p.choices)}" if 0 < len(p.choices) <= 5 else ""
            parts.append(f"{p.name}={shown} ({p.text}{choices})")
        lines.append(f"{kind.name:24}{rows:9}{kind.text}" + (f"; {', '.join(parts)}" if parts else ""))
    lines.append("")
    lines.append("NAME[:KEY=VALUE,...][@WHEN][/DURATION]; WHEN: 2.5s | elbow<-45 | 0.2/s; DURATION: 0.5s")
    lines.append("Rows 20 to 23 are faults of the host alone (clients, disks, configuration).")
    return "\n".join(lines)

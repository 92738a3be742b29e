"""The planner: moves in, pieces of the ideal law out, with a bounded look-ahead.

moves -> elements (path) -> runs, blended and stopped at (joining) -> window -> pieces

Elements are collected before they are joined: a numpy call costs as much for one as for a hundred. They are planned
when there are `CHUNK_ELEMENTS` of them, when they take `AHEAD_S` and may stop in between, and wherever the arm has to
come to rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import ceil

import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics import Arm
from rm501_host.moves import (
    ArcMove,
    Dwell,
    HandMove,
    JointMove,
    LinearMove,
    Move,
    OutputChange,
    PathMode,
    PathModeChange,
    ProbeMove,
    ProgramEnd,
    RapidMove,
    Source,
    SplineMove,
    ToolChange,
)

from .corners import CornerMaker
from .elements import Array, Element
from .errors import PlanError
from .grid import Grid, GridBuilder
from .jerk import JerkLaw
from .jerk_window import JerkStretch, JerkWindow
from .joining import Arrival, Joiner, Run
from .law import PathLaw
from .limits import Limits
from .merging import LineMerger
from .outputs import combined
from .path import PathBuilder
from .pieces import Action, EventKind, Piece, PieceEvent, PieceKind
from .smoothing import LineSmoother
from .window import Stretch, Window

CHUNK_ELEMENTS = 128
"""Elements that are joined and enter the window at once: enough to spread numpy's cost per call."""
AHEAD_S = 2.0
"""Nominal time of elements from which on those that may stop at their corners do not wait for more."""
_NOMINAL_SPEED = 60.0
"""mm/s or deg/s where a move has no feed."""


class Planner:
    """Plans moves into pieces, lazily: `plan` reads only as many moves ahead as the look-ahead needs.

    `start_deg`: joints (5,) at the start. `speed_scale`: feed override, 0 < scale <= 2, of programmed feeds only.
    """

    def __init__(
        self, arm: Arm, config: Config, start_deg: Sequence[float] | Array, *, speed_scale: float = 1.0
    ) -> None:
        self._config = config
        self._limits = Limits.from_config(config)
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self._path = PathBuilder(
            arm,
            np.array(start_deg, dtype=np.float64),
            linear_rapids=config.planner.linear_rapids,
            speed_scale=speed_scale,
            checks_ends=False,
        )
        self._jerk_limited = config.planner.jerk_limited
        self._mode = PathMode.EXACT_PATH
        self._tolerance_mm = 0.0
        self._pending_mode = (self._mode, self._tolerance_mm)
        self._start_s = 0.0
        self._chain_s = 0.0
        self._merger = LineMerger()
        self._smoother = LineSmoother()
        self._merged_mm = 0.0
        self._waiting_s = 0.0
        self._is_broken = False
        self._is_last_run = True
        self._ready: list[Element] = []
        self._outputs: list[OutputChange] = []
        self._set_arm()

    @property
    def q_deg(self) -> Array:
        """Joints at the end of what has been read."""
        return self._path.q_deg

    @property
    def limits(self) -> Limits:
        """The limits it plans under."""
        return self._limits

    def plan(self, moves: Iterable[Move | Action]) -> Iterator[Piece]:
        """Yield the pieces of the law; raises PlanError at the move that cannot be planned, after all before it."""
        try:
            for move in moves:
                yield from self._take(move)
            yield from self._stop()
            yield from self._settle_outputs()
        except Exception:
            # the error may come from reading a move while those before it wait to be planned
            if not self._is_broken:
                yield from self._advance()
            raise

    def come_to_rest(self) -> Iterator[Piece]:
        """After `plan` has raised PlanError: the path up to the last element that can be planned, to rest there."""
        behind = self._joiner.left_over() if self._is_last_run else []
        for element in [*self._ready, *behind]:
            try:
                self._window.extend([element])
            except PlanError:
                break
        self._ready = []
        while (stretch := self._window.finish()) is not None:
            yield self._piece(stretch)

    def _set_arm(self) -> None:
        builder = self._builder = GridBuilder(self._path.arm, self._limits)
        self._joiner = Joiner(
            CornerMaker(
                self._path.arm,
                self._limits,
                parabolic=self._config.planner.blend == "parabolic",
                jerk_limited=self._jerk_limited,
            ),
            touching=self._jerk_limited,
        )
        self._window: Window | JerkWindow = (
            JerkWindow(self._path.arm, builder, self._limits, self._frame_s)
            if self._jerk_limited
            else Window(self._path.arm, builder, self._frame_s)
        )

    def _take(self, move: Move | Action) -> Iterator[Piece]:
        match move:
            case RapidMove():
                yield from self._add(self._path.rapid(move))
            case LinearMove():
                yield from self._add(self._path.linear(move))
            case ArcMove():
                yield from self._add(self._path.arc(move))
            case JointMove():
                yield from self._add(self._path.joint(move))
            case SplineMove():
                for part in self._path.spline_parts(move):
                    yield from self._add(part)
            case PathModeChange():
                yield from self._join_held()
                self._mode = move.mode
                self._tolerance_mm = move.tolerance_mm or 0.0
                merge_mm = move.naive_cam_tolerance_mm or 0.0 if move.mode is PathMode.BLEND else 0.0
                self._merger.tolerance_mm = min(merge_mm, 0.5 * self._tolerance_mm)
                is_moved = self._jerk_limited and move.mode is PathMode.BLEND
                self._smoother.tolerance_mm = self._tolerance_mm if is_moved else 0.0
            case Dwell():
                yield from self._stop()
                yield from self._wait(PieceKind.DWELL, move.seconds, move.source)
            case HandMove():
                yield from self._stop()
                hand = self._config.hand
                pulses = hand.stroke_pulses if move.open else -hand.stroke_pulses
                event = PieceEvent(0.0, EventKind.HAND, value=pulses, source=move.source)
                seconds = hand.stroke_pulses / hand.pulse_rate_steps_s + hand.settle_s
                yield from self._wait(PieceKind.HAND, seconds, move.source, (event,))
            case OutputChange(synchronised=True):
                yield from self._join_held()
                self._outputs.append(move)
            case OutputChange():
                yield from self._stop()
                yield from self._switch([move])
            case ToolChange():
                yield from self._stop()
                self._path.use_tool(move.length_mm, move.offset_mm)
                self._set_arm()
            case ProgramEnd():
                yield from self._stop()
                yield from self._settle_outputs()
                yield self._mark(move)
            case ProbeMove():
                yield from self._stop()
                yield self._mark(move)
                yield from self._add(self._path.linear(LinearMove(move.target, move.feed, move.source)))
                yield from self._stop()
            case _:
                yield from self._stop()
                yield self._mark(move)

    def _mark(self, move: Move | Action) -> Piece:
        return Piece(
            PieceKind.MARK,
            move.source,
            self._start_s,
            0.0,
            tuple(self._path.q_deg.tolist()),
            move=move,
            arm=self._path.arm,
        )

    def _wait(
        self, kind: PieceKind, seconds: float, source: Source, events: tuple[PieceEvent, ...] = ()
    ) -> Iterator[Piece]:
        duration = self._whole_frames(seconds)
        if duration > 0.0:
            rest = tuple(self._path.q_deg.tolist())
            yield Piece(kind, source, self._start_s, duration, rest, events=events, arm=self._path.arm)
            self._start_s += duration

    def _switch(self, changes: Sequence[OutputChange]) -> Iterator[Piece]:
        """Outputs that change at rest."""
        mark = combined(changes, 0.0)
        event = PieceEvent(0.0, EventKind.OUTPUT, mask=mark.mask, levels=mark.levels, source=mark.source)
        yield from self._wait(PieceKind.OUTPUT, self._frame_s, mark.source, (event,))

    def _settle_outputs(self) -> Iterator[Piece]:
        """Changes that waited for a motion which did not come: at rest, at the end."""
        changes, self._outputs = self._outputs, []
        if changes:
            yield from self._switch(changes)

    def _whole_frames(self, seconds: float) -> float:
        return ceil(seconds / self._frame_s - 1e-6) * self._frame_s

    def _add(self, element: Element | None) -> Iterator[Piece]:
        if element is None:
            return
        if self._merger.tolerance_mm > 0.0 or self._smoother.tolerance_mm > 0.0:
            # the element that comes out of these is another one
            self._path.check_ends()
        for merged in self._merger.add(element):
            for finished in self._smoother.add(merged):
                yield from self._join(finished)

    def _join_held(self) -> Iterator[Piece]:
        """Go on with the lines that were held back to be merged or moved."""
        for merged in self._merger.take():
            for finished in self._smoother.add(merged):
                yield from self._join(finished)
        for finished in self._smoother.take():
            yield from self._join(finished)

    def _join(self, element: Element) -> Iterator[Piece]:
        before, self._pending_mode = self._pending_mode, (self._mode, self._tolerance_mm)
        mode, tolerance_mm = _corner_mode(before, self._pending_mode)
        # merging and blending share the tolerance: together they stay within it
        tolerance_mm -= max(self._merged_mm, element.merged_mm)
        self._merged_mm = element.merged_mm
        outputs, self._outputs = tuple(self._outputs), []
        self._joiner.add(Arrival(element, mode, tolerance_mm, outputs))
        self._waiting_s += element.length / min(element.feed_mm_s, element.rate, _NOMINAL_SPEED)
        may_stop = mode is not PathMode.BLEND
        if len(self._joiner) >= CHUNK_ELEMENTS or (may_stop and self._waiting_s >= AHEAD_S):
            yield from self._advance()

    def _stop(self) -> Iterator[Piece]:
        """Come to rest at the end of the path so far."""
        yield from self._join_held()
        yield from self._advance(to_rest=True)

    def _advance(self, *, to_rest: bool = False) -> Iterator[Piece]:
        """Join what waits, hand it to the window and yield what is settled; raises PlanError, after all before it."""
        self._waiting_s = 0.0
        self._is_broken = True
        refused = self._path.refused_end()
        if refused is not None:
            self._joiner.drop_from(refused[0])
        runs = self._joiner.join(to_rest=to_rest and refused is None)
        for run, grid in zip(runs, self._grids(runs), strict=True):
            self._ready = run.elements
            self._is_last_run = run is runs[-1]
            if isinstance(self._window, Window):
                self._window.extend(run.elements, grid)
            else:
                self._window.extend(run.elements)
            self._ready = []
            settled = self._window.finish if run.ends_at_rest else self._window.commit
            while (stretch := settled()) is not None:
                yield self._piece(stretch)
        if refused is not None:
            raise refused[1]
        self._is_broken = False

    def _grids(self, runs: Sequence[Run]) -> Sequence[Grid | None]:
        """The grids of all runs from one call; None for each where one has to raise its error by itself."""
        if self._jerk_limited or sum(1 for run in runs if run.elements) < 2:
            return [None] * len(runs)
        try:
            return self._builder.build_each([run.elements for run in runs])
        except PlanError:
            return [None] * len(runs)

    def _piece(self, stretch: Stretch | JerkStretch) -> Piece:
        law: PathLaw | JerkLaw = stretch.law
        start_s = self._start_s + self._chain_s
        self._chain_s += law.duration_s
        duration = law.duration_s
        if stretch.ends_at_rest:
            whole = self._whole_frames(self._chain_s)
            duration += whole - self._chain_s
            self._start_s += whole
            self._chain_s = 0.0
        rest = law.q_deg(np.array([law.duration_s]))[0]
        return Piece(
            PieceKind.MOTION,
            stretch.elements[0].source,
            start_s,
            duration,
            tuple(rest.tolist()),
            law=law,
            events=law.outputs(),
            starts_at_rest=stretch.starts_at_rest,
            ends_at_rest=stretch.ends_at_rest,
            motion_s=law.duration_s,
            arm=stretch.law.arm,
        )


def _corner_mode(before: tuple[PathMode, float], after: tuple[PathMode, float]) -> tuple[PathMode, float]:
    """How the corner between moves of two modes is passed: a blend takes from both, so both have to allow it."""
    for strictest in (PathMode.EXACT_STOP, PathMode.EXACT_PATH):
        if strictest in (before[0], after[0]):
            return strictest, 0.0
    return PathMode.BLEND, min(before[1], after[1])

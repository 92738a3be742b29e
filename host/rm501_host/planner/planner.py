"""The planner: moves in, pieces of the ideal law out, with a bounded look-ahead.

moves -> elements (path) -> joined or blended or stopped at (joints of the path) -> window -> pieces
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
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

from .bends import TouchingBlend, joined
from .corners import Corner, CornerMaker
from .elements import Array, Element
from .errors import PlanError
from .grid import GridBuilder
from .jerk import JerkLaw
from .jerk_window import JerkStretch, JerkWindow
from .law import PathLaw
from .limits import Limits
from .merging import LineMerger
from .outputs import combined
from .path import PathBuilder
from .pieces import Action, EventKind, Piece, PieceEvent, PieceKind
from .smoothing import LineSmoother
from .window import Stretch, Window

CHUNK_ELEMENTS = 256
"""Elements that enter the window at once: enough to spread numpy's cost per call."""


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
        self._path = PathBuilder(arm, np.array(start_deg, dtype=np.float64), linear_rapids=config.planner.linear_rapids)
        self._speed_scale = speed_scale
        self._jerk_limited = config.planner.jerk_limited
        self._mode = PathMode.EXACT_PATH
        self._tolerance_mm = 0.0
        self._pending_mode = (self._mode, self._tolerance_mm)
        self._start_s = 0.0
        self._chain_s = 0.0
        self._merger = LineMerger()
        self._smoother = LineSmoother()
        self._pending: Element | None = None
        self._used = 0.0
        self._ready: list[Element] = []
        self._touching: TouchingBlend | None = None
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
        for move in moves:
            yield from self._take(move)
        yield from self._stop()
        yield from self._settle_outputs()

    def come_to_rest(self) -> Iterator[Piece]:
        """After `plan` has raised PlanError: the path up to the last element that can be planned, to rest there."""
        self._settle_blend()
        ready, self._ready = self._ready, []
        self._pending = None
        for element in ready:
            try:
                self._window.extend([element])
            except PlanError:
                break
        while (stretch := self._window.finish()) is not None:
            yield self._piece(stretch)

    def _set_arm(self) -> None:
        builder = GridBuilder(self._path.arm, self._limits)
        self._corners = CornerMaker(
            self._path.arm,
            self._limits,
            parabolic=self._config.planner.blend == "parabolic",
            jerk_limited=self._jerk_limited,
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

    def _marked(self, element: Element, at: float) -> Element:
        """The element with the output changes that wait for the next motion, if any, at s = `at`."""
        changes, self._outputs = self._outputs, []
        return replace(element, marks=(combined(changes, at),)) if changes else element

    def _whole_frames(self, seconds: float) -> float:
        return ceil(seconds / self._frame_s - 1e-6) * self._frame_s

    def _add(self, element: Element | None) -> Iterator[Piece]:
        if element is None:
            return
        if self._speed_scale != 1.0:
            scale = self._speed_scale
            element = replace(element, feed_mm_s=element.feed_mm_s * scale, rate=element.rate * scale)
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
        pending = self._pending
        before, self._pending_mode = self._pending_mode, (self._mode, self._tolerance_mm)
        if pending is None:
            self._pending, self._used = self._marked(element, 0.0), 0.0
            return
        # merging and blending share the tolerance: together they stay within it
        mode, tolerance_mm = _corner_mode(before, self._pending_mode)
        tolerance_mm -= max(pending.merged_mm, element.merged_mm)
        corner = self._corners.between(pending, self._used, element, mode, tolerance_mm)
        if corner is None:
            yield from self._rest()
            self._pending, self._used = self._marked(element, 0.0), 0.0
            return
        if corner.elements:
            blend = corner.elements[0]
            share = corner.before / (corner.before + corner.after) if self._jerk_limited else 0.5
            at = share * blend.length
            corner = replace(corner, elements=(self._marked(blend, at), *corner.elements[1:]))
        else:
            element = self._marked(element, 0.0)
        self._pass_corner(pending, element, corner)
        if len(self._ready) >= CHUNK_ELEMENTS:
            yield from self._advance()

    def _pass_corner(self, pending: Element, element: Element, corner: Corner) -> None:
        last = pending.length - corner.before
        is_straight_before = last - self._used > 1e-9
        blend = TouchingBlend.of(corner.elements, corner.spare_mm) if self._jerk_limited else None
        if self._touching is not None and blend is not None and not is_straight_before:
            finished, blend = joined(self._touching, blend)
            self._ready.append(finished)
            self._touching = None
        self._settle_blend()
        if is_straight_before:
            self._ready.append(pending.trimmed(self._used, last))
        if blend is None:
            self._ready.extend(corner.elements)
        self._touching = blend
        self._pending, self._used = element, corner.after

    def _settle_blend(self) -> None:
        """The blend before the pending element is not touched by another one."""
        if self._touching is not None:
            self._ready.append(self._touching.finished())
            self._touching = None

    def _advance(self) -> Iterator[Piece]:
        """Hand what is ready to the window and yield what is settled."""
        self._window.extend(self._ready)
        self._ready = []
        while (stretch := self._window.commit()) is not None:
            yield self._piece(stretch)

    def _stop(self) -> Iterator[Piece]:
        """Come to rest at the end of the path so far."""
        yield from self._join_held()
        yield from self._rest()

    def _rest(self) -> Iterator[Piece]:
        pending, self._pending = self._pending, None
        if pending is None:
            return
        self._settle_blend()
        self._ready.append(pending.trimmed(self._used, pending.length))
        self._window.extend(self._ready)
        self._ready = []
        while (stretch := self._window.finish()) is not None:
            yield self._piece(stretch)

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

"""G73, G81, G82, G83, G85, G89: drilling along the normal of the selected plane."""

from __future__ import annotations

from rm501_host.gcode.canon import (
    CanonDwell,
    MotionMode,
    SetMotionControlMode,
    SetNaivecamTolerance,
    StraightFeed,
    StraightTraverse,
    Units,
)
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeModalError
from rm501_host.gcode.expressions import to_integer
from rm501_host.gcode.motion import PLANE_AXES, Words, as_axes, end_point, need_feed
from rm501_host.gcode.state import AXES, CycleWords

CYCLES = (730, 810, 820, 830, 850, 890)
PECK_CLEARANCE = {Units.MM: 0.254, Units.INCH: 0.01}
"""G73 backs off by this, G83 comes back to this above the last depth (LinuxCNC 2.9)."""
MAX_PECKS = 100_000


class _Drill:
    """Moves with two axes fixed and the third, the depth, running."""

    def __init__(self, ctx: Context, plane_point: list[float], depth_axis: int) -> None:
        self.ctx = ctx
        self.point = plane_point
        self.axis = depth_axis

    def traverse(self, depth: float) -> None:
        self.point[self.axis] = depth
        self.ctx.emit(StraightTraverse(as_axes(self.point), self.ctx.at))

    def feed(self, depth: float) -> None:
        self.point[self.axis] = depth
        self.ctx.emit(StraightFeed(as_axes(self.point), self.ctx.at))

    def dwell(self, seconds: float) -> None:
        self.ctx.emit(CanonDwell(seconds, self.ctx.at))


def cycle(ctx: Context, code: int, words: Words) -> None:
    """One block of a canned cycle. Raises GcodeModalError."""
    state = ctx.state
    first, second, normal = PLANE_AXES[state.plane]
    name = f"G{code // 10}"
    need_feed(state, "feed")
    if state.inverse_time:
        raise GcodeModalError("cannot use inverse time feed with canned cycles", "Switch to G94.")
    repeats = to_integer(words["l"], "L, the repeats") if "l" in words else 1
    if repeats == 0:
        raise GcodeModalError("cannot do zero repeats of cycle", "L is at least 1.")
    if repeats < 0:
        raise GcodeModalError("cannot do negative repeats of cycle", "L is at least 1.")
    sticky = _merge(ctx, code, words, AXES[normal], state.position[normal], name)
    r, depth = sticky.r, sticky.depth
    if r < depth:
        raise GcodeModalError(
            f"R less than {AXES[normal].upper()} in cycle in {state.plane.value} plane",
            "R is the plane above the hole, the axis word its bottom.",
        )
    start = state.position.copy()
    old = sticky.series_start
    if old < r:
        old = start[normal] = r
        ctx.emit(StraightTraverse(as_axes(start), ctx.at))
    elif not state.retract_r:
        start[normal] = old
    clear = r if state.retract_r else old
    previous_mode = state.control_mode
    if previous_mode is not MotionMode.EXACT_PATH:
        ctx.emit(SetMotionControlMode(MotionMode.EXACT_PATH, 0.0, ctx.at))
    state.position = start
    _check_words(code, sticky, r, depth)
    plane_words = {w: v for w, v in words.items() if w in (AXES[first], AXES[second], "@", "^")}
    for _ in range(repeats):
        target = end_point(ctx, plane_words)
        current = state.position[normal]
        drill = _Drill(ctx, target, normal)
        drill.traverse(current)
        if current != r:
            drill.traverse(r)
        _one_hole(drill, code, sticky, r, depth, clear)
        target[normal] = clear
        state.position = target
    if previous_mode is not MotionMode.EXACT_PATH:
        ctx.emit(SetMotionControlMode(previous_mode, state.control_tolerance, ctx.at))
        ctx.emit(SetNaivecamTolerance(state.naivecam_tolerance, ctx.at))
    state.cycle = sticky


def _merge(ctx: Context, code: int, words: Words, depth_word: str, current: float, name: str) -> CycleWords:
    """Words of this block over those that stick from the cycle before, as absolute coordinates."""
    state = ctx.state
    series = state.cycle if state.motion in CYCLES else None
    old = series if state.motion == code else None
    if "r" in words:
        r = words["r"] + (0.0 if state.absolute else current)
    elif old is not None:
        r = old.r
    else:
        raise GcodeModalError("R clearance plane unspecified in cycle", f"The first {name} needs an R word.")
    if depth_word in words:
        depth = words[depth_word] + (0.0 if state.absolute else r)
    elif old is not None:
        depth = old.depth
    else:
        raise GcodeModalError(
            f"{depth_word.upper()} value unspecified in cycle", f"The first {name} needs the depth of the hole."
        )
    return CycleWords(
        r,
        depth,
        words.get("p", old.p if old else None),
        words.get("q", old.q if old else None),
        series.series_start if series is not None else current,
    )


def _check_words(code: int, sticky: CycleWords, r: float, depth: float) -> None:
    if code in (820, 890) and sticky.p is None:
        raise GcodeModalError(f"dwell time P word missing with G{code // 10}", "P is in seconds.")
    if code in (730, 830):
        if sticky.q is None or sticky.q <= 0.0:
            raise GcodeModalError(f"Q word missing or not positive with G{code // 10}", "Q is the depth of one peck.")
        if (r - depth) / sticky.q > MAX_PECKS:
            raise GcodeModalError(f"more than {MAX_PECKS} pecks in one hole", "Use a larger Q.")


def _one_hole(drill: _Drill, code: int, sticky: CycleWords, r: float, depth: float, clear: float) -> None:
    if code in (730, 830):
        _peck(drill, code, sticky, r, depth)
    drill.feed(depth)
    if code in (820, 890):
        drill.dwell(sticky.p or 0.0)
    if code == 850:
        drill.feed(r)
        drill.traverse(clear)
    elif code == 890:
        drill.feed(clear)
    else:
        drill.traverse(clear)


def _peck(drill: _Drill, code: int, sticky: CycleWords, r: float, depth: float) -> None:
    peck = sticky.q or 0.0
    clearance = PECK_CLEARANCE[drill.ctx.state.units]
    current = r - peck
    while current > depth:
        drill.feed(current)
        if code == 830:
            drill.traverse(r)
        drill.traverse(current + clearance)
        current -= peck

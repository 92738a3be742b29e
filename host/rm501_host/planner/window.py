"""The look-ahead window: a path that grows at one end while its time law is committed at the other.

The squared speeds that can still reach the end depend on what follows. So the backward pass is made twice, from two
assumptions about the window's far end: that the path ends there (speed 0) and that it goes on as fast as the limits
at that point allow. Where both give the same law, nothing that is added later can change it any more: that part is
committed, and the speed never drops because of the window. Only where the window has grown to `most_intervals`
without that happening is the careful law (the one that could stop at the end) taken for the first half.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from rm501_host.kinematics import Arm

from .elements import Array, Element, ElementTable, Indices
from .grid import Grid, GridBuilder
from .law import PathLaw
from .timelaw import IntervalLines, backward_pass, forward_pass, joined_lines, law_duration, sliced_lines

MOST_INTERVALS = 12_000
"""Bound of the window; the spiral of 5000 lines of 0.2 mm at 100 mm/s needs about 1000."""

SHORT_FRAMES = 400
"""0.13 s: phases of acceleration from or to rest that are shorter keep a reserve of acceleration."""
RESERVE_FRAMES = 3.0
"""Reserve of a phase of n frames: this over n of its acceleration, so half of this in frames of time."""
LEAST_SHARE = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A committed part of the law: whether it starts and ends at rest, its elements in order, the limits of its
    intervals."""

    law: PathLaw
    elements: tuple[Element, ...]
    starts_at_rest: bool
    ends_at_rest: bool
    lines: IntervalLines


class Window:
    """Elements go in at one end (`extend`), the fastest law comes out at the other (`commit`, `finish`).

    A window may also take over from another law over the same elements, in motion: `joins` says where that can be left
    for the fastest one, `pass_on` forgets what the other law has gone through.
    """

    def __init__(self, arm: Arm, builder: GridBuilder, frame_s: float, *, most_intervals: int = MOST_INTERVALS) -> None:
        self._arm = arm
        self._builder = builder
        self._frame_s = frame_s
        self._committed_s = 0.0
        self._most = most_intervals
        self._elements: list[Element] = []
        self._grid: Grid | None = None
        self._first_x = 0.0
        self._at_rest = True
        self._is_softened = False

    @property
    def intervals(self) -> int:
        """Grid intervals not yet committed."""
        return 0 if self._grid is None else len(self._grid)

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return self._grid is None

    @property
    def ways(self) -> Array:
        """How far each grid point (n + 1,) lies from the first one, in the elements' own parameters."""
        lengths = np.zeros(0) if self._grid is None else self._grid.lines.length
        return np.concatenate((np.zeros(1), np.cumsum(lengths)))

    def joins(self, squared: Array) -> int | None:
        """The first grid point at which a law that passes them at these squared speeds (n + 1,) can be left for this
        window's: from there on it can still stop at the end of what is known. None where it never can.
        """
        grid = self._grid
        if grid is None:
            return None
        found = np.flatnonzero(squared <= backward_pass(grid.lines, 0.0))
        return int(found[0]) if len(found) else None

    def pass_on(self, count: int, squared: float, seconds: float) -> None:
        """Forget the first `count` intervals, which something else passes in `seconds`, in motion at the end of them:
        its squared speed there.
        """
        grid = self._grid
        assert grid is not None
        assert squared > 0.0
        self._committed_s += seconds
        self._forget(grid, count)
        self._first_x, self._at_rest = squared, False

    def take_over(self, elements: list[Element], grid: Grid) -> None:
        """Begin with elements whose grid is known."""
        self._elements, self._grid = list(elements), grid

    def extend(self, elements: list[Element], grid: Grid | None = None) -> None:
        """Add elements that join the last one smoothly, with their grid if it is known; raises PlanError where they
        leave what the arm can do.
        """
        if not elements:
            return
        if grid is None:
            grid = self._builder.build(ElementTable(elements))
        if self._grid is None:
            self._grid, self._elements = grid, list(elements)
            return
        offset = len(self._elements)
        old = self._grid
        self._elements.extend(elements)
        self._grid = Grid(
            np.concatenate((old.element, grid.element + offset)),
            np.concatenate((old.start, grid.start)),
            np.concatenate((old.stop, grid.stop)),
            joined_lines(old.lines, grid.lines),
        )

    def commit(self) -> Stretch | None:
        """The part of the law that nothing added later can change, or None when that is too little yet."""
        grid = self._grid
        if grid is None:
            return None
        count = len(grid)
        lines = grid.lines
        if self._at_rest and not self._is_softened:
            softer = _softened(
                lines, forward_pass(lines, 0.0, backward_pass(lines, 0.0)), self._frame_s, head=True, tail=False
            )
            self._is_softened = True
            if softer is not None:
                grid = self._grid = replace(grid, lines=softer)
                lines = softer
        careful = backward_pass(lines, 0.0)
        hopeful = backward_pass(lines, float(lines.y_cap[-1]), known=careful)
        speeds = forward_pass(lines, self._first_x, careful)
        settled, first = count, _first_apart(careful, hopeful)
        if first is not None:
            # the law itself may not touch the bound that is still open: compare the laws, not only the bounds
            at = max(0, first - 1)
            apart = _first_apart(speeds[at:], forward_pass(lines, float(speeds[at]), hopeful[at:], at))
            settled = count - 1 if apart is None else at + apart - 1
        if settled < min(64, count - 1) or settled <= 0:
            if count < self._most:
                return None
            settled = count // 2
        return self._take(min(settled, count - 1), speeds, at_end=False)

    def finish(self) -> Stretch | None:
        """The rest of the law, ending at rest at the end of the last element, a whole number of frames after the
        start of the first: the law is slowed down by less than one frame for that.
        """
        grid = self._grid
        if grid is None:
            return None
        speeds = forward_pass(grid.lines, self._first_x, backward_pass(grid.lines, 0.0))
        speeds[-1] = 0.0
        softer = _softened(grid.lines, speeds, self._frame_s, head=self._at_rest and not self._is_softened, tail=True)
        if softer is not None:
            reach = backward_pass(softer, 0.0)
            if reach[0] >= self._first_x:
                grid = replace(grid, lines=softer)
                speeds = forward_pass(softer, self._first_x, reach)
                speeds[-1] = 0.0
        duration = law_duration(grid.lines.length, speeds)
        frames = ceil((self._committed_s + duration) / self._frame_s - 1e-7)
        wanted = frames * self._frame_s - self._committed_s
        if self._at_rest:
            speeds *= (duration / wanted) ** 2
        elif wanted - duration > 1e-10:
            speeds = _delayed(grid.lines, speeds, wanted)
        return self._take(len(grid), speeds, at_end=True)

    def _take(self, count: int, speeds: Array, *, at_end: bool) -> Stretch:
        grid = self._grid
        assert grid is not None
        last = int(grid.element[count - 1])
        taken = self._elements[: last + 1]
        law = PathLaw.from_speeds(
            self._arm,
            ElementTable(taken),
            grid.element[:count],
            grid.start[:count],
            grid.stop[:count],
            speeds[: count + 1],
        )
        stretch = Stretch(law, tuple(taken), self._at_rest, at_end, sliced_lines(grid.lines, 0, count))
        self._committed_s += law.duration_s
        if at_end:
            self._grid, self._elements, self._first_x, self._at_rest = None, [], 0.0, True
            self._committed_s = 0.0
            self._is_softened = False
            return stretch
        self._forget(grid, count)
        self._first_x = float(speeds[count])
        self._at_rest = False
        return stretch

    def _forget(self, grid: Grid, count: int) -> None:
        first: Indices = grid.element[count:]
        low = int(first[0])
        self._elements = self._elements[low:]
        self._grid = Grid(first - low, grid.start[count:], grid.stop[count:], sliced_lines(grid.lines, count))


def _first_apart(one: Array, other: Array) -> int | None:
    """Where two rows of squared speeds part; None where they are one."""
    apart = np.flatnonzero(np.abs(one - other) > 1e-12 * (one + 1e-30))
    return int(apart[0]) if len(apart) else None


def _softened(lines: IntervalLines, speeds: Array, frame_s: float, *, head: bool, tail: bool) -> IntervalLines | None:
    """The limits, lower over a short first and a short last phase between rest and motion; None for no change.

    Phases begin and end between frames, segments only on frames: over a phase of n frames that can add 2/n to the
    accelerations of the segments, which must stay below what the board refuses.
    """
    roots = np.sqrt(speeds)
    durations = 2.0 * lines.length / (roots[:-1] + roots[1:])
    u = np.diff(roots) / durations
    slight = 0.05 * np.abs(u).max(initial=0.0)
    rising, falling = u > slight, u < -slight
    scale = np.ones(len(u))
    times = np.cumsum(durations)
    if head:
        last = max(0, int(np.argmin(rising)) - 1)
        frames = times[last] / frame_s
        if frames < SHORT_FRAMES:
            scale[: last + 2] = max(LEAST_SHARE, 1.0 - RESERVE_FRAMES / frames)
    if tail:
        first = min(len(u) - 1, len(u) - int(np.argmin(falling[::-1])))
        frames = (times[-1] - (times[first - 1] if first else 0.0)) / frame_s
        if frames < SHORT_FRAMES:
            scale[max(0, first - 1) :] = np.minimum(
                scale[max(0, first - 1) :], max(LEAST_SHARE, 1.0 - RESERVE_FRAMES / frames)
            )
    if float(scale.min()) == 1.0:
        return None
    column = scale[:, None]
    return replace(
        lines,
        alpha=lines.alpha * column,
        gamma=lines.gamma * column,
        peak_x=lines.peak_x * scale,
        peak_y=lines.peak_y * scale,
    )


def _delayed(lines: IntervalLines, speeds: Array, wanted_s: float) -> Array:
    """The law made slower, to take `wanted_s`: one grid point near the end is passed less fast.

    Only the last intervals are solved again; what comes before keeps its speed.
    """
    whole = law_duration(lines.length, speeds)
    count = len(lines.length)
    result = speeds
    for tail in (256, 1024, 4096, count):
        first = max(0, count - tail)
        end = sliced_lines(lines, first)
        before = whole - law_duration(end.length, speeds[first:])
        dip = _fit_dip(end, speeds[first:], wanted_s - before)
        if dip is not None:
            return np.concatenate((speeds[:first], dip))
        if first == 0:
            break
    return result


def _fit_dip(lines: IntervalLines, speeds: Array, wanted_s: float) -> Array | None:
    """Lower the cap of the fastest later grid point until the law takes `wanted_s`; None when the start forbids it."""
    count = len(lines.length)
    place = count // 4 + int(np.argmax(speeds[count // 4 : -1]))
    if place < 1 or place >= count:
        return None
    low, high = 0.0, float(speeds[place])
    best = speeds
    for _ in range(60):
        cap = 0.5 * (low + high)
        caps = lines.y_cap.copy()
        caps[place - 1] = cap
        trial_lines = replace(lines, y_cap=caps)
        reach = backward_pass(trial_lines, 0.0)
        if reach[0] < speeds[0] * (1.0 - 1e-12):
            low = cap
            continue
        best = forward_pass(trial_lines, float(speeds[0]), reach)
        best[-1] = 0.0
        excess = law_duration(lines.length, best) - wanted_s
        if abs(excess) < 2e-10:
            return best
        if excess > 0.0:
            low = cap
        else:
            high = cap
    return best if abs(law_duration(lines.length, best) - wanted_s) < 1e-8 else None

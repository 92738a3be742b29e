"""The look-ahead window of the jerk-limited mode: a jerk-limited law that grows while its beginning is played.

The jerk-limited law at a time t is the average of a base law over [t - w, t] (`jerk`). So whatever of the base law is
settled settles the average up to the same time, and the average needs w of the base law's past. As in `Window` the base
law is made twice, as if the path ended at the window's end and as if it went on; where both agree it is settled, except
for the last 3 w, which are kept so that limits that are violated beyond can still be met by slowing down before.

Where the average breaks a limit, the base law is slowed down in the intervals over which the average was taken: its own
speeds by as much as is missing and its accelerations by the square of that, until all is legal.
Nothing is committed before that, so what is committed can always be followed by the stop that was planned with it:
should no legal law be found that leaves it at once, one is looked for that follows it a while. Only when there is none
either, the arm comes to rest there and starts anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rm501_host.kinematics import Arm

from .elements import Array, Element, ElementTable, Indices
from .geometry import path_points
from .grid import Grid, GridBuilder
from .jerk import PROBE_S, JerkLaw, window_of
from .jerk_lead import SmoothLead
from .jerk_slowing import needed_scale, slowdown_of_intervals, slowed
from .law import PathLaw
from .limits import Limits
from .outputs import Place
from .timelaw import backward_pass, forward_pass, joined_lines, sliced_lines
from .window import MOST_INTERVALS, Stretch, Window

_FIRST_CAP = 1.4
"""Measured on a spiral of 0.2 mm lines: below, laws are slower; from 2 on, some windows find no legal law."""
_LEGAL = 1.0004
"""Of what `slowdowns` gives, which holds 0.05 % and more in reserve."""
_GENTLE = 0.4
_ROUNDS = 20
"""Where a law is found it takes 2 to 9."""
_PATIENCE = 3
"""Rounds after which more and more is taken than what seems to be missing."""
_OVER = 1.0005
"""How much more than needed is taken, so that it comes to an end."""
_FOLLOWED = (0.25, 0.5, 0.75, 1.0)
"""Shares of the time that the known stop takes, after which it is left when nothing better is found."""
_KEPT_WINDOWS = 3.0
_PROBED_BEFORE_S = 4e-3
"""Limits are probed from here before what is committed: jerks are differences."""
_LEAST_COMMITTED = 64
_LEAST_LEFT = 33
"""Grid points from where a law before is left to the end of what is known."""
_TRIES_APART = 0.5
"""In windows: how far apart the places lie at which a law before may be left."""
_MOST_TRIES = 4
_HELD_WINDOWS = 2.0
"""For so long after it is left the law before is not slowed down below itself."""


@dataclass(frozen=True, slots=True, eq=False)
class JerkStretch:
    """A committed part of the jerk-limited law."""

    law: JerkLaw
    elements: tuple[Element, ...]
    starts_at_rest: bool
    ends_at_rest: bool


@dataclass(frozen=True, slots=True, eq=False)
class _KnownStop:
    """A legal end of the base law behind what is committed: squared speeds (n + 1,) and what they were found under."""

    squared: Array
    scale: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Past:
    """What has been committed of the base law and the average still needs: at least w of it. `place`: how far the
    average has come, as an element of `elements` and s on it."""

    elements: tuple[Element, ...]
    element: Indices
    start: Array
    stop: Array
    squared: Array
    is_from_rest: bool
    place: Place


class JerkWindow:
    """Elements go in at one end (`extend`), the jerk-limited law comes out at the other (`commit`, `finish`)."""

    def __init__(
        self,
        arm: Arm,
        builder: GridBuilder,
        limits: Limits,
        frame_s: float,
        *,
        most_intervals: int | None = None,
        window_s: float | None = None,
    ) -> None:
        """`window_s`: over which to average, where a law before is gone on from."""
        self._arm = arm
        self._limits = limits
        self._frame_s = frame_s
        self._builder = builder
        self._most = MOST_INTERVALS if most_intervals is None else most_intervals
        self._window_s = window_of(limits) if window_s is None else window_s
        self._window = Window(arm, builder, frame_s)
        self._past: _Past | None = None
        self._scale = np.zeros(0)
        self._cap = np.zeros(0)
        self._first_cap = np.zeros(0)
        self._elements: list[Element] = []
        self._grid: Grid | None = None
        self._known: _KnownStop | None = None
        self._is_fresh = False
        # laws are probed at the same instants again and again: what was found legal must not look otherwise later
        self._anchor_s = 0.0
        self.emergency_stops = 0
        """How often no legal law was found beyond what was planned already."""

    @property
    def intervals(self) -> int:
        """Grid intervals not yet committed."""
        return 0 if self._grid is None else len(self._grid)

    def extend(self, elements: list[Element]) -> None:
        """Add elements that join the last one smoothly; raises PlanError where they leave what the arm can do."""
        if not elements:
            return
        grid = self._builder.build(ElementTable(elements))
        self._is_fresh = True
        if self._grid is None:
            self._grid, self._elements = grid, list(elements)
        else:
            old, offset = self._grid, len(self._elements)
            self._elements.extend(elements)
            self._grid = Grid(
                np.concatenate((old.element, grid.element + offset)),
                np.concatenate((old.start, grid.start)),
                np.concatenate((old.stop, grid.stop)),
                joined_lines(old.lines, grid.lines),
            )
        self._scale = np.concatenate((self._scale, np.ones(len(grid))))
        first_caps = self._first_caps(ElementTable(elements), grid)
        self._first_cap = np.concatenate((self._first_cap, first_caps))
        self._cap = np.concatenate((self._cap, first_caps))

    def _first_caps(self, table: ElementTable, grid: Grid) -> Array:
        """Squared speeds v^2 at which d3q/ds3 v^3 alone takes all of a joint's jerk, (n,): where to begin."""
        length = grid.stop - grid.start
        before = path_points(self._arm, table, grid.element, grid.start).q2
        after = path_points(self._arm, table, grid.element, grid.stop).q2
        share = (np.abs(after - before) / length[:, None] / self._limits.jerk_deg_s3).max(axis=1)
        caps: Array = _FIRST_CAP * np.cbrt(1.0 / np.maximum(share, 1e-30)) ** 2
        return caps

    def commit(self) -> JerkStretch | None:
        """The part of the law that nothing added later can change, or None when that is too little yet."""
        grid = self._grid
        if grid is None or not self._is_fresh or len(grid) < 2 * _LEAST_COMMITTED:
            return None
        self._is_fresh = False
        solved = self._solve() or self._solve_gently() or self._solve_from_known_stop()
        if solved is None:
            return self._give_up()
        squared, law, begin = solved
        # without the slowing down, which has been found for a law that stops: with it even the other one would stop
        lines = slowed(grid.lines, np.ones(len(grid)), self._first_cap)
        careful = forward_pass(lines, float(squared[0]), backward_pass(lines, 0.0))
        hopeful = forward_pass(lines, float(squared[0]), backward_pass(lines, float(lines.y_cap[-1])))
        apart = np.flatnonzero(np.abs(hopeful - careful) > 1e-9 * (hopeful + 1e-30))
        settled = int(apart[0]) - 1 if len(apart) else len(grid) - 1
        times = law.base.time_s[begin:]
        count = int(np.searchsorted(times, times[max(0, settled)] - _KEPT_WINDOWS * self._window_s, side="right")) - 1
        if count < _LEAST_COMMITTED and len(grid) >= self._most:
            # whatever is committed can be followed by its stop: the window need not grow for more
            settled = count = len(grid) // 2
        if count < _LEAST_COMMITTED:
            # the slowing down that was found behind what is settled belongs to a stop that may not come
            self._forget_slowing(settled, times)
            return None
        stretch = self._part(law, begin, count)
        self._known = _KnownStop(squared[count:], self._scale[count:].copy())
        self._forget_slowing(settled, times)
        self._drop(grid, law, begin, count)
        return stretch

    def finish(self) -> JerkStretch | None:
        """The rest of the law, ending at rest; None when there is nothing. Call it until then: after an emergency stop
        there is more."""
        grid = self._grid
        if grid is None:
            return None
        if self._past is None:
            return self._whole(grid)
        solved = self._solve() or self._solve_gently() or self._solve_from_known_stop()
        if solved is None:
            return self._give_up()
        _, law, begin = solved
        stretch = self._part(law, begin, None)
        self._clear()
        return stretch

    def follow(self, lead: SmoothLead) -> tuple[list[tuple[JerkLaw, float]], bool]:
        """Go on from a law before, whose base law is now where this window begins: parts of it that have to be played
        first (with the scales of their feeds), and whether this window's law has taken over behind them.
        """
        grid = self._grid
        if grid is None or len(grid) <= _LEAST_LEFT:
            return [], False
        ways = np.concatenate((np.zeros(1), np.cumsum(grid.lines.length)))
        squared, times = lead.squared(ways), lead.times_s(ways)
        reach = backward_pass(slowed(grid.lines, np.ones(len(grid)), self._first_cap), 0.0)
        possible = np.flatnonzero((squared <= reach)[: len(grid) - _LEAST_LEFT])
        tried_s = -np.inf
        tries: list[int] = []
        for k in possible.tolist():
            if times[k] >= tried_s + _TRIES_APART * self._window_s and len(tries) < _MOST_TRIES:
                tries.append(k)
                tried_s = float(times[k])
        for join in tries:
            if self._take_over(lead, grid, join, ways, squared, times):
                return lead.until(float(ways[join])), True
        last = tries[-1] + 1 if tries else len(grid) // 2
        parts = lead.until(float(ways[last]))
        self._shorten(grid, last)
        return parts, False

    def _take_over(self, lead: SmoothLead, grid: Grid, join: int, ways: Array, squared: Array, times: Array) -> bool:
        """Whether there is a legal law that leaves the one before at a grid point; if so, go on from there."""
        before = self._elements, self._grid, self._scale, self._cap, self._first_cap
        if join:
            self._shorten(grid, join)
        assert self._grid is not None
        left = self._grid = self._beginning_anew(self._grid)
        passed = lead.past(float(ways[join]))
        self._past = _Past(passed.elements, passed.element, passed.start, passed.stop, passed.squared, False, (0, 0.0))
        held = int(np.searchsorted(times, times[join] + _HELD_WINDOWS * self._window_s)) - join
        law = squared[join : join + max(1, min(held, len(left))) + 1]
        law[0] = passed.squared[-1]
        self._known = _KnownStop(law, needed_scale(left.lines, law))
        solved = self._solve()
        if solved is None:
            self._scale, self._cap = np.ones(len(left)), _GENTLE * self._first_cap
            self._keep_known_stop()
            solved = self._solve()
        if solved is None:
            self._elements, self._grid, self._scale, self._cap, self._first_cap = before
            self._past = self._known = None
            return False
        found, average, begin = solved
        self._known = _KnownStop(found, self._scale.copy())
        self._past = replace(self._past, place=_place(average, float(average.base.time_s[begin])))
        self._is_fresh = True
        return True

    def _beginning_anew(self, grid: Grid) -> Grid:
        """The same grid with its first element cut off where it begins: the past holds a part of its own."""
        begin = float(grid.start[0])
        if begin == 0.0:
            return grid
        first = self._elements[0]
        self._elements = [first.trimmed(begin, first.length), *self._elements[1:]]
        cut = np.where(grid.element == 0, begin, 0.0)
        return replace(grid, start=grid.start - cut, stop=grid.stop - cut)

    # ------------------------------------------------------------------------------------------------ the base law

    def _solve(self, followed: int = 0) -> tuple[Array, JerkLaw, int] | None:
        """The base law from where it is committed to rest at the end, slowed down until its average is legal: squared
        speeds (n + 1,), the whole average, number of intervals of the past in it. None when there is none. The first
        `followed` intervals are passed as by the stop that is known.
        """
        grid, past = self._grid, self._past
        assert grid is not None
        first_x = 0.0 if past is None else float(past.squared[-1])
        for turn in range(_ROUNDS):
            lines = slowed(grid.lines, self._scale, self._cap)
            if followed and self._known is not None:
                caps = lines.y_cap.copy()
                caps[:followed] = np.minimum(caps[:followed], self._known.squared[1 : followed + 1])
                lines = replace(lines, y_cap=caps)
            reach = backward_pass(lines, 0.0)
            if reach[0] < first_x * (1.0 - 1e-9):
                return None
            squared = forward_pass(lines, first_x, reach)
            squared[-1] = 0.0
            law, begin = self._average(squared)
            from_s = float(law.base.time_s[begin]) if begin else 0.0
            times, ratios = law.slowdowns(self._limits, max(0.0, from_s - _PROBED_BEFORE_S), self._anchor_s)
            if ratios.max() <= _LEGAL:
                return squared, law, begin
            self._slow_down(law, begin, times, ratios, 1.0 + max(0, turn - _PATIENCE))
        return None

    def _solve_gently(self) -> tuple[Array, JerkLaw, int] | None:
        """Once more, beginning at lower speeds: a law that is too fast at first may have been slowed down in vain."""
        self._scale = np.ones(len(self._scale))
        self._cap = _GENTLE * self._first_cap
        self._keep_known_stop()
        return self._solve()

    def _solve_from_known_stop(self) -> tuple[Array, JerkLaw, int] | None:
        """A law that leaves the stop that is known only farther on, the later the better its chances: in the end where
        the base law rests for an instant, from where it may go on as slowly as it has to.
        """
        grid, known = self._grid, self._known
        if grid is None or known is None:
            return None
        speeds = np.sqrt(known.squared)
        times = np.cumsum(2.0 * grid.lines.length[: len(speeds) - 1] / (speeds[:-1] + speeds[1:]))
        for share in _FOLLOWED:
            self._scale = np.ones(len(self._scale))
            self._cap = _GENTLE * self._first_cap
            self._keep_known_stop()
            solved = self._solve(int(np.searchsorted(times, share * times[-1], side="right")))
            if solved is not None:
                return solved
        return None

    def _average(self, squared: Array) -> tuple[JerkLaw, int]:
        """The average of the past and these speeds (n + 1,) behind it, and how many intervals are the past's."""
        grid, past = self._grid, self._past
        assert grid is not None
        if past is None:
            base = PathLaw.from_speeds(
                self._arm, ElementTable(self._elements), grid.element, grid.start, grid.stop, squared
            )
            return JerkLaw.smoothed(base, self._window_s), 0
        shared = past.elements[-1] is self._elements[0]
        offset = len(past.elements) - shared
        base = PathLaw.from_speeds(
            self._arm,
            ElementTable([*past.elements, *self._elements[shared:]]),
            np.concatenate((past.element, grid.element + offset)),
            np.concatenate((past.start, grid.start)),
            np.concatenate((past.stop, grid.stop)),
            np.concatenate((past.squared, squared[1:])),
        )
        return JerkLaw.smoothed(base, self._window_s), len(past.element)

    def _slow_down(self, law: JerkLaw, begin: int, times: Array, ratios: Array, gain: float) -> None:
        """Where the average is too fast by `ratios`, (n,), slow down what it is made of: speeds by as much, and
        accelerations by its square; by powers of that, `gain`, where it takes long.
        """
        needed = slowdown_of_intervals(law.base.time_s[begin:], times, ratios, self._window_s)
        factor = np.where(needed > 1.0, (needed * _OVER) ** (-2.0 * gain), 1.0)
        speeds = law.base.speed[begin:]
        own = np.maximum(speeds[:-1], speeds[1:]) ** 2
        self._cap = np.where(needed > 1.0, np.minimum(self._cap, own * factor), self._cap)
        self._scale = self._scale * factor
        self._keep_known_stop()

    def _keep_known_stop(self) -> None:
        """The stop that is known stays possible, whatever else is slowed down."""
        if self._known is not None:
            stop = self._known.squared
            held = slice(0, len(stop) - 1)
            self._cap[held] = np.maximum(self._cap[held], np.maximum(stop[:-1], stop[1:]))
            self._scale[held] = np.maximum(self._scale[held], self._known.scale)

    def _forget_slowing(self, settled: int, times: Array) -> None:
        since = int(np.searchsorted(times, times[max(0, settled)] - self._window_s))
        self._scale[since:] = 1.0
        self._cap[since:] = self._first_cap[since:]

    # --------------------------------------------------------------------------------------------- what is committed

    def _part(self, law: JerkLaw, begin: int, count: int | None) -> JerkStretch:
        """The average from where it has come to, as far as the base law's next `count` intervals; None: to its rest."""
        base, past = law.base, self._past
        lead_s = 0.0 if past is None else float(base.time_s[begin])
        low = 0
        if past is not None:
            low = max(0, int(np.searchsorted(base.time_s, lead_s - self._window_s, side="right")) - 2)
        high = len(base.element) if count is None else begin + count
        end_s = base.duration_s + self._window_s if count is None else float(base.time_s[high])
        first, last = (0, 0.0) if past is None else past.place, None
        if count is not None:
            last = _place(law, end_s)
        element = int(base.element[low])
        elements = base.table.elements[element : int(base.element[high - 1]) + 1]
        piece = PathLaw.from_speeds(
            self._arm,
            ElementTable(elements),
            base.element[low:high] - element,
            base.start[low:high],
            base.stop[low:high],
            base.speed[low : high + 1] ** 2,
        )
        part = replace(
            JerkLaw.smoothed(piece, self._window_s),
            lead_s=lead_s - float(base.time_s[low]),
            length_s=end_s - lead_s,
            first=(first[0] - element, first[1]),
            last=None if last is None else (last[0] - element, last[1]),
        )
        place = _place(law, lead_s)[0] - element
        return JerkStretch(part, tuple(elements[max(0, place) :]), past is None, count is None)

    def _drop(self, grid: Grid, law: JerkLaw, begin: int, count: int) -> None:
        """Make the next `count` intervals the past."""
        base = law.base
        now = begin + count
        end_s = float(base.time_s[now])
        needed_s = self._window_s + 2.0 * _PROBED_BEFORE_S
        low = max(0, int(np.searchsorted(base.time_s, end_s - needed_s, side="right")) - 3)
        element, last = int(base.element[low]), int(base.element[now - 1])
        place = _place(law, end_s)
        self._anchor_s = (self._anchor_s - float(base.time_s[low])) % PROBE_S
        self._past = _Past(
            base.table.elements[element : last + 1],
            base.element[low:now] - element,
            base.start[low:now],
            base.stop[low:now],
            base.speed[low : now + 1] ** 2,
            low == 0 and (self._past is None or self._past.is_from_rest),
            (place[0] - element, place[1]),
        )
        self._shorten(grid, count)

    def _shorten(self, grid: Grid, count: int) -> None:
        rest = grid.element[count:]
        low = int(rest[0])
        self._elements = self._elements[low:]
        self._grid = Grid(rest - low, grid.start[count:], grid.stop[count:], sliced_lines(grid.lines, count))
        self._scale, self._cap = self._scale[count:], self._cap[count:]
        self._first_cap = self._first_cap[count:]

    def _clear(self) -> None:
        self._grid, self._elements, self._past, self._known = None, [], None, None
        self._anchor_s = 0.0
        self._scale, self._cap, self._first_cap = np.zeros(0), np.zeros(0), np.zeros(0)

    def _whole(self, grid: Grid) -> JerkStretch:
        """Everything at once, from rest to rest."""
        window = Window(self._arm, self._builder, self._frame_s)
        window.take_over(self._elements, grid)
        stretch: Stretch | None = window.finish()
        assert stretch is not None
        law = JerkLaw.over(stretch.law, stretch.lines, self._limits, self._frame_s)
        elements = tuple(self._elements)
        self._clear()
        return JerkStretch(law, elements, True, True)

    def _give_up(self) -> JerkStretch:
        """The stop that was planned with what is committed; the rest of the path starts anew from there."""
        grid = self._grid
        assert grid is not None
        self.emergency_stops += 1
        if self._past is None or self._known is None:
            return self._whole(grid)
        squared = self._known.squared
        count = len(squared) - 1
        rest = self._elements, self._scale
        whole = grid
        self._grid = Grid(
            grid.element[:count], grid.start[:count], grid.stop[:count], sliced_lines(grid.lines, 0, count)
        )
        law, begin = self._average(squared)
        stretch = self._part(law, begin, None)
        self._elements, self._scale = rest
        self._past, self._known, self._anchor_s = None, None, 0.0
        if count >= len(whole):
            self._clear()
        else:
            self._shorten(whole, count)
            self._scale, self._cap = np.ones(len(self._scale)), self._first_cap.copy()
        return stretch


def _place(law: JerkLaw, time_s: float) -> Place:
    index, s = law.places(np.array([time_s]))
    return int(index[0]), float(s[0])

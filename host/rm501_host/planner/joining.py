"""From elements to runs: every corner passed, blended or stopped at, many at a time.

Elements wait here until there are enough of them, or until the path comes to rest. Then all their corners are decided
at once: geometry first, and what is in doubt (`CornerMaker.are_faster`) for all corners in as few calls as may be.
Whether a blend is faster than a stop depends on how much of the element before it is left, hence on the corner before.
So all corners are judged as if every one before were passed, then those again of which that was not true; each has
two cases, and nothing is asked twice, so this ends.

Blends that touch where the jerk is limited (`bends`) wait for one another: the last one waits here, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from rm501_host.moves import OutputChange, PathMode

from .bends import TouchingBlend, joined
from .corners import Corner, CornerMaker, Passage
from .elements import Element
from .outputs import combined

SHORTEST_PART = 1e-9
"""What is left of an element between two corners, in mm or deg, below which it is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """An element and how the corner before it may be passed; `outputs` change where it begins."""

    element: Element
    mode: PathMode = PathMode.EXACT_STOP
    tolerance_mm: float = 0.0
    outputs: tuple[OutputChange, ...] = ()

    def marked(self, element: Element, at: float) -> Element:
        """`element` with the output changes at s = `at`."""
        return replace(element, marks=(combined(self.outputs, at),)) if self.outputs else element


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Elements that go over into each other smoothly; whether the path comes to rest at the end of the last."""

    elements: list[Element]
    ends_at_rest: bool


class Joiner:
    """Elements in (`add`), runs out (`join`); the last element waits for what follows it. `touching`: blends that touch
    keep their curvature there.
    """

    def __init__(self, maker: CornerMaker, *, touching: bool = False) -> None:
        self._maker = maker
        self._touching = touching
        self._blend: TouchingBlend | None = None
        self._arrivals: list[Arrival] = []
        self._used = 0.0

    def __len__(self) -> int:
        return len(self._arrivals)

    def add(self, arrival: Arrival) -> None:
        """One more element."""
        self._arrivals.append(arrival)

    def drop_from(self, element: Element) -> None:
        """Forget an element and all after it, if it is here."""
        for number, arrival in enumerate(self._arrivals):
            if arrival.element is element:
                del self._arrivals[number:]
                return

    def join(self, *, to_rest: bool) -> list[Run]:
        """The runs of what has been added, the last one without the last element unless the path comes `to_rest`."""
        arrivals, used = self._arrivals, self._used
        if not arrivals:
            return []
        corners = self._decided(arrivals, used)
        arrivals[0] = replace(arrivals[0], element=arrivals[0].marked(arrivals[0].element, 0.0))
        runs: list[Run] = []
        run: list[Element] = []
        for number, (arrival, corner) in enumerate(zip(arrivals, corners, strict=False)):
            element, following = arrival.element, arrivals[number + 1]
            if corner is None:
                run += [*self._settled(), element.trimmed(used, element.length)]
                runs.append(Run(run, ends_at_rest=True))
                run, used = [], 0.0
            else:
                last = element.length - corner.before
                between = [element.trimmed(used, last)] if last - used > SHORTEST_PART else []
                run += self._passed(between, corner, following)
                used = corner.after
            if corner is None or not corner.elements:
                arrivals[number + 1] = replace(following, element=following.marked(following.element, 0.0))
        last_one = arrivals[-1].element
        if to_rest:
            run += [*self._settled(), last_one.trimmed(used, last_one.length)]
            self._arrivals, self._used = [], 0.0
        else:
            self._arrivals, self._used = [replace(arrivals[-1], outputs=())], used
        return [*runs, Run(run, ends_at_rest=to_rest)]

    def left_over(self) -> list[Element]:
        """What is known of the path behind the last run: a blend that waits for another one. It is forgotten."""
        return self._settled()

    def _settled(self) -> list[Element]:
        """The blend that waits, if any: no other one touches it."""
        blend, self._blend = self._blend, None
        return [] if blend is None else [blend.finished()]

    def _passed(self, between: list[Element], corner: Corner, following: Arrival) -> list[Element]:
        """What a corner that is passed adds to the path: `between` it and the corner before, and its blend."""
        if not corner.elements:
            return [*self._settled(), *between]
        share = corner.before / (corner.before + corner.after) if self._touching else 0.5
        blend = following.marked(corner.elements[0], share * corner.elements[0].length)
        elements = (blend, *corner.elements[1:])
        waiting = TouchingBlend.of(elements, corner.spare_mm) if self._touching else None
        found: list[Element] = []
        if waiting is not None and self._blend is not None and not between:
            finished, waiting = joined(self._blend, waiting)
            found, self._blend = [finished], None
        found += [*self._settled(), *between]
        if waiting is None:
            found += elements
        self._blend = waiting
        return found

    def _decided(self, arrivals: Sequence[Arrival], used: float) -> list[Corner | None]:
        """What happens at each corner between the elements."""
        corners = [
            self._maker.candidate(before.element, after.element, after.mode, after.tolerance_mm)
            for before, after in pairwise(arrivals)
        ]
        known: dict[tuple[int, float], bool] = {}
        while True:
            # as far as is known; what is not is taken as passed, and asked
            left, asked = used, {}
            decided: list[Corner | None] = []
            for number, corner in enumerate(corners):
                passed = corner
                if corner is not None and corner.is_doubtful:
                    is_faster = known.get((number, left))
                    if is_faster is None:
                        asked[number, left] = Passage(
                            arrivals[number].element, left, arrivals[number + 1].element, corner
                        )
                    elif not is_faster:
                        passed = None
                decided.append(passed)
                left = 0.0 if passed is None else passed.after
            if not asked:
                return decided
            known.update(zip(asked, self._maker.are_faster(list(asked.values())), strict=True))

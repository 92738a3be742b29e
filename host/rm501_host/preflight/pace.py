"""How long a program takes that is too long to be planned before its start: estimated from stretches of it.

At their feeds and the largest rates of joints and motors moves would take the nominal time; corners and accelerations
make them take longer, from a few per cent on long lines to ten times on tiny half circles. So stretches of a program
are kept as it is checked, at moves ever further apart, and some of them planned when somebody asks. Each is planned
twice, as a whole and its beginning alone: the difference is what its last moves take in the middle of a motion. The
first stretch, with the way to where the work begins, counts as planned. All of this is about time in motion: dwells
and strokes of the hand take what they take.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics import Arm
from rm501_host.moves import Dwell, HandMove, Move, PathModeChange
from rm501_host.planner.elements import Array
from rm501_host.planner.errors import PlanError
from rm501_host.planner.pieces import Action
from rm501_host.planner.planner import Planner

LEAD_MOVES = 40
MOVES = 120
"""Of a stretch; planned in 0.1 s of CPU."""
MOST_PLANNED = 5
FIRST_AT = 500
FURTHER = 1.3
"""Each stretch begins this many times as far into the program as the one before: 20 of them in 100,000 moves. Those
that are planned lie as evenly as these allow."""

Nominal = Callable[[Arm, Array, Sequence[Move | Action]], float]
"""The nominal time in motion, in s, of moves from joints (5,)."""


@dataclass(slots=True, eq=False)
class _Stretch:
    """Moves kept: from joints `q_deg` (5,), where the nominal time of all moves before was `before_s`."""

    arm: Arm
    q_deg: Array
    before_s: float
    moves: list[Move | Action] = field(default_factory=list)


class Pace:
    """Keeps stretches of the moves of a program, and tells how long it takes by them."""

    def __init__(self, config: Config, nominal: Nominal) -> None:
        self._config = config
        self._nominal = nominal
        self._stretches: list[_Stretch] = []
        self._mode: PathModeChange | None = None
        self._taken = 0
        self._next = 0

    def wants_to_begin(self) -> bool:
        """Whether a stretch begins with the next move: then `begin` comes before `take`."""
        return self._taken >= self._next

    def begin(self, arm: Arm, q_deg: Array, before_s: float) -> None:
        """A stretch begins at joints `q_deg` (5,); `before_s`: the nominal time up to there."""
        stretch = _Stretch(arm, q_deg.copy(), before_s)
        if self._mode is not None:
            stretch.moves.append(self._mode)
        self._stretches.append(stretch)
        self._next = max(FIRST_AT, int(FURTHER * self._taken))

    def take(self, move: Move | Action) -> None:
        """One more move of the program."""
        self._taken += 1
        if isinstance(move, PathModeChange):
            self._mode = move
        if len(self._stretches[-1].moves) < MOVES:
            self._stretches[-1].moves.append(move)

    def estimate_s(self, nominal_s: float, speed_scale: float) -> float:
        """Time in motion of the moves of which the nominal one is `nominal_s`, at so many times their feeds; plans
        stretches anew each time.
        """
        if not self._stretches:
            return nominal_s
        first = self._stretches[0]
        try:
            first_s = self._planned_s(first, first.moves, speed_scale)
        except PlanError:
            return nominal_s
        behind_s = self._nominal_of(first, first.moves)
        if nominal_s <= behind_s:
            return first_s
        known = [
            (max(stretch.before_s, behind_s), ratio)
            for stretch in self._chosen(behind_s, nominal_s)
            if (ratio := self._ratio(stretch, speed_scale)) > 0.0
        ]
        if not known:
            return first_s + nominal_s - behind_s
        begins = np.array([at for at, _ in known])
        ratios = np.array([ratio for _, ratio in known])
        # each ratio counts as far as half way to the next
        borders = np.concatenate(([behind_s], 0.5 * (begins[1:] + begins[:-1]), [nominal_s]))
        return first_s + float((np.diff(borders) * ratios).sum())

    def _chosen(self, first_s: float, last_s: float) -> list[_Stretch]:
        """Whole stretches, nearest to evenly spaced places between two nominal times."""
        whole = [stretch for stretch in self._stretches if len(stretch.moves) >= MOVES]
        if len(whole) <= MOST_PLANNED:
            return whole
        begins = np.array([stretch.before_s for stretch in whole])
        places = np.linspace(first_s, last_s, 2 * MOST_PLANNED + 1)[1::2]
        return [whole[k] for k in dict.fromkeys(int(np.argmin(np.abs(begins - at))) for at in places)]

    def _ratio(self, stretch: _Stretch, speed_scale: float) -> float:
        """Planned time over nominal time behind the beginning; 0 where it says nothing."""
        lead = stretch.moves[:LEAD_MOVES]
        try:
            nominal_s = self._nominal_of(stretch, stretch.moves) - self._nominal_of(stretch, lead)
            if not nominal_s > 0.0:
                return 0.0
            whole_s = self._planned_s(stretch, stretch.moves, speed_scale)
            return max(0.0, (whole_s - self._planned_s(stretch, lead, speed_scale)) / nominal_s)
        except PlanError:
            return 0.0  # a blend that leaves a joint's range, say: whoever plans it will tell

    def _nominal_of(self, stretch: _Stretch, moves: Sequence[Move | Action]) -> float:
        return self._nominal(stretch.arm, stretch.q_deg, moves)

    def _planned_s(self, stretch: _Stretch, moves: Sequence[Move | Action], speed_scale: float) -> float:
        planner = Planner(stretch.arm, self._config, stretch.q_deg, speed_scale=speed_scale)
        return sum(piece.motion_s for piece in planner.plan(list(moves)))


def still_s(config: Config, move: Move | Action) -> float:
    """What a move takes in which no joint moves."""
    if isinstance(move, Dwell):
        return move.seconds
    if isinstance(move, HandMove):
        hand = config.hand
        return hand.stroke_pulses / hand.pulse_rate_steps_s + hand.settle_s
    return 0.0

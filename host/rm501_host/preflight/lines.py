"""Straight moves as arrays: many consecutive lines followed at once.

Long programs are mostly short lines, and an `Element` for each costs a hundred times the arithmetic that checks it.
Here a run of linear moves becomes a few arrays, as long as nothing about them is special; the first move that is (it
does not move the tool, cannot be reached, turns whole turns, has no feed in mm/min) ends the run and goes the general
way. Only for XYZAB: orientations given as roll, pitch, yaw are curves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Branch
from rm501_host.moves import FeedMode, LinearMove, Source
from rm501_host.planner.path import SHORTEST, PathBuilder

Array = NDArray[np.float64]

_WAIST_MM = 1e-6
"""Tips nearer to the waist axis leave the waist angle to the joints before: one at a time."""
_SAME_PITCH_DEG = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class LineRun:
    """Consecutive straight moves in task space, on one branch.

    `start`, `end` (n, 5): x, y, z in mm of the base frame, pitch, roll in deg; `length_mm` (n,); `feed_mm_s` (n,);
    `start_deg` (n, 5): joints at the starts; `sources`: n blocks; `numbers` (n,): which move of the program each is.
    """

    start: Array
    end: Array
    length_mm: Array
    feed_mm_s: Array
    start_deg: Array
    branch: Branch
    sources: tuple[Source, ...]
    numbers: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sources)


def follow_lines(path: PathBuilder, moves: Sequence[LinearMove], first_number: int) -> LineRun:
    """The run of the first moves that need no special care (perhaps none); `path` then stands at its end."""
    targets = np.array([move.target for move in moves], dtype=np.float64)
    feeds = np.array(
        [move.feed.value if move.feed.mode is FeedMode.UNITS_PER_MINUTE else 0.0 for move in moves], dtype=np.float64
    )
    plain = np.isfinite(targets).all(axis=1) & (feeds > 0.0)
    count = _leading(plain)
    end = np.empty((count, 5))
    end[:, :3] = path.arm.frame.base_from_program(targets[:count, :3])
    end[:, 3:] = targets[:count, 3:5]
    start = np.concatenate((path.task[None], end))[:-1]
    shift = end[:, :3] - start[:, :3]
    q_deg, ok = path.arm.ik_batch(end[:, :3], end[:, 3], end[:, 4], path.branch)
    with np.errstate(invalid="ignore"):
        literal = np.abs(q_deg[:, 1] + q_deg[:, 2] + q_deg[:, 3] - end[:, 3]) < _SAME_PITCH_DEG
        ok &= literal & (np.abs(shift).max(axis=1, initial=0.0) > SHORTEST)
        ok &= np.hypot(end[:, 0], end[:, 1]) > _WAIST_MM
    count = _leading(ok)
    start_deg = np.concatenate((path.q_deg[None], q_deg[:count]))[:-1]
    if count:
        path.q_deg = q_deg[count - 1].copy()
        path.task = end[count - 1].copy()
    return LineRun(
        start[:count],
        end[:count],
        np.linalg.norm(shift[:count], axis=1),
        feeds[:count] / 60.0,
        start_deg,
        path.branch,
        tuple(move.source for move in moves[:count]),
        np.arange(first_number, first_number + count, dtype=np.int64),
    )


def _leading(flags: NDArray[np.bool_]) -> int:
    """How many are true before the first that is not."""
    return len(flags) if flags.all() else int(np.argmin(flags))

"""A neutral pose to go by when a straight line is refused.

Candidates lie on a coarse lattice over the arm's plane, between the azimuths of start and goal. Those from which both
straight lines, start to candidate and candidate to goal, stay inside every limit on one branch are ranked by
manipulability (|s3| r, the closed form's factors that vanish at the two singularities) times the distance to the
nearest joint limit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm, Branch
from rm501_host.moves import Target

from .findings import Via

Array = NDArray[np.float64]

_RADII_MM = np.linspace(120.0, 400.0, 8)
_HEIGHTS_MM = np.linspace(60.0, 440.0, 9)
_SHARES = (0.5, 0.0, 1.0, 0.25, 0.75)
_TRIED = 60
_POINTS = 60
_SCORE_DIGITS = 6


def suggest_via(arm: Arm, start_deg: Sequence[float] | Array, goal: Array) -> Via | None:
    """A pose by which straight lines lead from joints `start_deg` to `goal` (x, y, z mm, pitch, roll deg, base
    frame); None when no candidate does."""
    start_q = np.array(start_deg, dtype=np.float64)
    pose = arm.fk(start_q)
    start = np.array([*pose.xyz_mm, pose.pitch_deg, pose.roll_deg])
    branch = arm.branch_of(start_q)
    candidates = _candidates(start, goal)
    q_deg, ok = arm.ik_batch(candidates[:, :3], candidates[:, 3], candidates[:, 4], branch, float(start_q[0]))
    candidates, q_deg = candidates[ok], q_deg[ok]
    if not len(candidates):
        return None
    low, high = arm.limits_deg
    margin = (np.minimum(q_deg - low, high - q_deg) / (high - low)).min(axis=1)
    score = np.abs(np.sin(np.radians(q_deg[:, 2]))) * np.hypot(candidates[:, 0], candidates[:, 1]) * margin
    # equal but for rounding: the earlier one, so that the same question has one answer
    for index in np.argsort(-np.round(score, _SCORE_DIGITS), kind="stable")[:_TRIED]:
        via = candidates[index]
        if _line_is_free(arm, start, via, branch) and _line_is_free(arm, via, goal, branch):
            target: Target = arm.program_from_joints(q_deg[index])
            return Via(target, tuple(q_deg[index].tolist()))
    return None


def _candidates(start: Array, goal: Array) -> Array:
    first, last = np.arctan2(start[1], start[0]), np.arctan2(goal[1], goal[0])
    turn = (last - first + np.pi) % (2.0 * np.pi) - np.pi
    rows = []
    for share in _SHARES:
        azimuth = first + share * turn
        for pitch in dict.fromkeys((float(start[3]), float(goal[3]), 0.5 * float(start[3] + goal[3]))):
            for radius in _RADII_MM:
                for height in _HEIGHTS_MM:
                    rows.append((radius * np.cos(azimuth), radius * np.sin(azimuth), height, pitch, start[4]))
    return np.array(rows)


def _line_is_free(arm: Arm, start: Array, end: Array, branch: Branch) -> bool:
    shares = np.linspace(0.0, 1.0, _POINTS)[:, None]
    points = start + (end - start) * shares
    _, ok = arm.ik_batch(points[:, :3], points[:, 3], points[:, 4], branch)
    return bool(ok.all())

"""Following a path of poses without ever changing the branch unasked."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from rm501_host.kinematics import forward
from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.results import Branch, IkSolution, Joints, JointsLike, VectorLike


class TrackStatus(Enum):
    """What became of one step."""

    FOLLOWED = "followed"
    """The joints moved on within the largest step, on the same branch."""
    CROSSED = "crossed"
    """They moved on within the largest step, through a singularity, onto the branch named in `branch`."""
    JUMP = "jump"
    """Not followed: on the same branch, but a joint would have to move farther than the largest step."""
    MUST_SWITCH = "must_switch"
    """Not followed: only another branch, far away, reaches this pose inside the limits; see `alternative`."""
    LOST = "lost"
    """Not followed: no branch reaches this pose inside the limits."""


@dataclass(frozen=True, slots=True)
class TrackStep:
    """The joints after the step (unchanged unless followed or crossed), and why.

    `alternative`: the nearest solution inside the limits that was not taken; `largest_move_deg`: what it asks of
    the joint that would move most.
    """

    status: TrackStatus
    q_deg: Joints
    branch: Branch
    reason: str
    alternative: IkSolution | None
    largest_move_deg: float


class BranchTracker:
    """Follows poses from a start, step by step.

    It never jumps: a step in which a joint would move more than `max_step_deg` is not taken but reported, with the
    solution that exists. `switch_to` is the only way onto another branch that is not continuous.

    >>> from rm501_host.config import load_config
    >>> arm = Arm.from_config(load_config())
    >>> tracker = BranchTracker(arm, arm.ik((300, 0, 200), 0, 0).best.q_deg, max_step_deg=5)
    >>> tracker.step((301, 0, 200), 0, 0).status
    <TrackStatus.FOLLOWED: 'followed'>
    >>> tracker.step((-301, 0, 200), 0, 0).status
    <TrackStatus.LOST: 'lost'>
    """

    def __init__(self, arm: Arm, start_deg: JointsLike, max_step_deg: float) -> None:
        if not max_step_deg > 0:
            raise KinematicsError(f"the largest step must be above 0 deg, not {max_step_deg}")
        self._arm = arm
        self._max_step_deg = max_step_deg
        self._q = forward.joints_of(start_deg)
        self._branch = arm.branch_of(self._q)

    @property
    def q_deg(self) -> Joints:
        """Where the arm is, (5,) deg."""
        return self._q

    @property
    def branch(self) -> Branch:
        """The branch it is on."""
        return self._branch

    def step(self, xyz_mm: VectorLike, pitch_deg: float, roll_deg: float) -> TrackStep:
        """Go on to a pose (base frame, mm and deg), if a continuous way leads there."""
        result = self._arm.ik(xyz_mm, pitch_deg, roll_deg, self._q)
        inside = [solution for solution in result.solutions if solution.in_limits]
        if not inside:
            return TrackStep(TrackStatus.LOST, self._q, self._branch, result.reason, None, 0.0)
        nearest = min(inside, key=lambda solution: self._largest_move(solution.q_deg))
        move = self._largest_move(nearest.q_deg)
        if move <= self._max_step_deg:
            before, self._branch, self._q = self._branch, nearest.branch, nearest.q_deg
            if nearest.branch is before:
                return TrackStep(TrackStatus.FOLLOWED, self._q, before, "", None, move)
            reason = f"through a singularity from {before.name} to {nearest.branch.name}"
            return TrackStep(TrackStatus.CROSSED, self._q, nearest.branch, reason, None, move)
        same = [solution for solution in inside if solution.branch is self._branch]
        if same:
            move = self._largest_move(same[0].q_deg)
            reason = f"a joint would have to move {move:.4g} deg in one step, more than {self._max_step_deg:g}"
            return TrackStep(TrackStatus.JUMP, self._q, self._branch, reason, same[0], move)
        reason = (
            f"{self._branch.name} does not reach this pose inside the limits; {nearest.branch.name} does, "
            f"{move:.4g} deg away: stop, switch by a joint move, go on"
        )
        return TrackStep(TrackStatus.MUST_SWITCH, self._q, self._branch, reason, nearest, move)

    def switch_to(self, solution: IkSolution) -> None:
        """Take up a solution on any branch: the arm was brought there by a joint move."""
        self._q, self._branch = solution.q_deg, solution.branch

    def _largest_move(self, q_deg: Joints) -> float:
        return max(abs(angle - before) for angle, before in zip(q_deg, self._q, strict=True))

"""Preflight: a program's path through the kinematics, from its start to its end, before anything moves.

Every move is followed through points 1 mm apart (and wherever a joint turns between two of them), in batches of many
moves; consecutive lines, arcs and splines are followed as arrays (`runs`). A refused move is reported and stepped
over, so one run finds everything. The time estimate comes from the planner itself, which checks blends too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.kinematics import Arm, KinematicsError
from rm501_host.moves import (
    ArcMove,
    InputWait,
    JointMove,
    LinearMove,
    Move,
    PathMode,
    PathModeChange,
    ProbeMove,
    RapidMove,
    Source,
    SplineMove,
    ToolChange,
)
from rm501_host.planner.errors import JointLimitError, OrientationError, PlanError
from rm501_host.planner.limits import Limits
from rm501_host.planner.path import PathBuilder
from rm501_host.planner.pieces import Action
from rm501_host.planner.planner import Planner

from .along import AlongCheck
from .batch import Batch
from .collector import Collector
from .findings import Finding, FindingKind, PreflightReport, Severity, Via
from .keep_out import KeepOut
from .pace import Pace, still_s
from .runs import TaskMove, follow_moves
from .via import suggest_via

Array = NDArray[np.float64]

BATCH = 512
FEWEST_MOVES = 4
"""Shorter runs of moves are followed one by one."""
MOST_ESTIMATED_MOVES = 20_000
ONE_BY_ONE_COST = 12.0
"""What a move that goes the general way costs, in short straight lines read and checked: measured, as those below."""
SPLINE_COST = 120.0
ARC_COST = 2.0
TURNING_COST = 1.6
"""Of a move where orientations are given as roll, pitch, yaw."""
POINT_COST = 0.07
"""Of each checked point but the ends."""
TURNING_POINT_COST = 0.19
"""The same where orientations are given as roll, pitch, yaw."""
MOST_REFUSALS = 1000
"""A program with so many errors is not checked any further: it has to be corrected first."""


def check_program(
    arm: Arm,
    config: Config,
    moves: Iterable[Move | Action],
    start_deg: Sequence[float] | Array,
    *,
    max_moves: int | None = None,
    estimate: bool = True,
) -> PreflightReport:
    """Check moves from joints `start_deg` (5,) to their end, to the first that depends on the outside world, or to
    `max_moves` (default `[preflight] max_blocks`).

    `estimate`: also plan and segment programs of up to 20,000 moves for their times and the stop horizon, and estimate
    the time of longer ones. Raises what the stream of moves raises (GcodeError); never PlanError: that is a finding.
    """
    return ProgramCheck(arm, config, start_deg).run(moves, max_moves=max_moves, estimate=estimate)


class ProgramCheck:
    """`check_program` for a stream of moves that asks where the arm is: `q_deg` (5,) follows what has been taken."""

    def __init__(self, arm: Arm, config: Config, start_deg: Sequence[float] | Array) -> None:
        self._arm = arm
        self._config = config
        self._start_deg = start_deg
        self._check = _Check(arm, config, np.array(start_deg, dtype=np.float64))

    @property
    def q_deg(self) -> Array:
        """Joints at the end of the moves taken so far."""
        return self._check.q_deg

    @property
    def line(self) -> int:
        """The highest line taken so far."""
        return self._check.line

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What has been found so far (the moves of the last unfinished batch apart)."""
        return self._check.found.findings()

    def findings_since(self, count: int) -> tuple[Finding, ...]:
        """Findings after the first `count`, without the summaries of moves below their feed."""
        return self._check.found.since(count)

    @property
    def first_bad(self) -> int | None:
        """The first move with an error, counted from 0 over all that were taken."""
        return self._check.found.first_bad

    @property
    def has_enough(self) -> bool:
        """Whether so much is wrong that there is no use in going on."""
        return self._check.found.errors >= MOST_REFUSALS

    @property
    def cost(self) -> float:
        """How long reading and checking took so far, in short straight lines: what `[preflight] max_blocks` counts."""
        return self._check.cost

    @property
    def nominal_s(self) -> float:
        """What the moves checked so far take at their feeds and the largest joint rates, without accelerations."""
        return self._check.nominal_s

    def estimate_s(self, speed_scale: float = 1.0) -> float:
        """How long the moves checked so far take, at so many times their feeds, within a third: stretches of them
        are planned, in a second or two of CPU for a long program (`preflight.pace`).
        """
        return self._check.pace.estimate_s(self._check.moving_s, speed_scale) + self._check.still_s

    def take(self, move: Move | Action) -> None:
        """Check one more move: at once, or with the batch that it belongs to."""
        self._check.take(move)

    def flush(self) -> None:
        """Check what is still held back."""
        self._check.flush()

    def run(
        self,
        moves: Iterable[Move | Action],
        *,
        max_moves: int | None = None,
        estimate: bool = True,
        limit_error: type[Exception] | tuple[type[Exception], ...] = (),
    ) -> PreflightReport:
        """As `check_program`; an exception of type `limit_error` from the stream ends the check, incomplete."""
        check = self._check
        most = max_moves or self._config.preflight.max_blocks
        kept: list[Move | Action] = []
        stopped_by = ""
        count = 0
        try:
            for move in moves:
                if isinstance(move, InputWait | ProbeMove):
                    what = "an input" if isinstance(move, InputWait) else "a probe"
                    stopped_by = f"{move.source}: what follows depends on {what}"
                    break
                if count >= most:
                    stopped_by = f"{move.source}: more than {most} moves"
                    break
                if self.has_enough:
                    stopped_by = f"{MOST_REFUSALS} errors"
                    break
                count += 1
                if estimate and len(kept) <= MOST_ESTIMATED_MOVES:
                    kept.append(move)
                check.take(move)
        except limit_error as error:
            stopped_by = str(error)
        check.flush()
        report = PreflightReport(check.found.findings(), check.line, not stopped_by, stopped_by, count)
        if not (estimate and report.ok):
            return report
        if count <= MOST_ESTIMATED_MOVES:
            return _estimated(report, self._arm, self._config, kept, self._start_deg)
        return replace(report, estimated_s=self.estimate_s())


def _estimated(
    report: PreflightReport, arm: Arm, config: Config, moves: list[Move | Action], start_deg: Sequence[float] | Array
) -> PreflightReport:
    from rm501_host.planner.plan import Plan
    from rm501_host.segmenter import Segmenter, stop_horizon
    from rm501_host.segmenter.fit import to_q48

    positions = [*map(to_q48, arm.motors_from_joints(np.array(start_deg, dtype=np.float64)).tolist()), 0]
    try:
        plan = Plan(arm, config, Planner(arm, config, start_deg).plan(moves))
        horizon = stop_horizon(config, Segmenter(config, positions, 0).segments(plan.pieces))
    except PlanError as error:
        finding = _finding_of(error, error.source or Source("(program)", 0), None)
        return replace(report, findings=(*report.findings, finding))
    return replace(
        report,
        cycle_s=plan.duration_s + horizon.tail_s,
        motion_s=plan.motion_s,
        stop_horizon_s=horizon.stop_s,
        needed_lead_s=horizon.lead_s,
        needed_lead_segments=horizon.lead_segments,
    )


class _Check:
    """Follows the path and collects findings."""

    def __init__(self, arm: Arm, config: Config, start_deg: Array) -> None:
        self._path = PathBuilder(arm, start_deg, linear_rapids=config.planner.linear_rapids)
        self.found = Collector()
        self._along = AlongCheck(Limits.from_config(config), KeepOut(config), self.found)
        self._in_runs = (LinearMove, ArcMove, SplineMove, *((RapidMove,) if config.planner.linear_rapids else ()))
        self._batch = Batch()
        self._held: list[TaskMove] = []
        self._margin_mm = 0.0
        self._taken = 0
        self.line = 0
        self._config = config
        self.still_s = 0.0
        """Dwells and strokes of the hand among what was checked."""
        self.pace = Pace(config, self._nominal_of)
        self._least_cost = TURNING_COST if arm.frame.has_rpy else 1.0
        self.cost = 0.0

    @property
    def q_deg(self) -> Array:
        """Joints at the end of the moves taken so far."""
        self._follow()
        return self._path.q_deg

    def take(self, move: Move | Action) -> None:
        """Check one move (some are checked when the batch is full)."""
        if move.source.line > self.line:
            self.line = move.source.line
        if self.pace.wants_to_begin():
            self.flush()
            self.pace.begin(self._path.arm, self._path.q_deg, self.moving_s)
        self.pace.take(move)
        self.cost += ARC_COST if isinstance(move, ArcMove) else self._least_cost
        if isinstance(move, self._in_runs):
            self._held.append(move)
            self._taken += 1
            if len(self._batch) + len(self._held) >= BATCH:
                self._follow()
                self._flush_when_full()
            return
        self._follow()
        self._taken += 1
        self._take(move, self._taken - 1)

    def _follow(self) -> None:
        """Follow the moves held back: many at once where they are plain, one by one where they are not."""
        moves, self._held = self._held, []
        first_number = self._taken - len(moves)
        done, many = 0, BATCH
        while done < len(moves):
            if min(many, len(moves) - done) >= FEWEST_MOVES:
                run = follow_moves(self._path, moves[done : done + many], first_number + done)
                if len(run):
                    self._batch.add_run(run)
                done += len(run)
                many = max(FEWEST_MOVES, 2 * len(run))
            else:
                many = BATCH
            if done < len(moves):
                self._take(moves[done], first_number + done)
                done += 1

    def _take(self, move: Move | Action, number: int) -> None:
        start_deg = self._path.q_deg
        if isinstance(move, RapidMove | LinearMove | ArcMove | SplineMove | JointMove):
            self.cost += ONE_BY_ONE_COST
        try:
            match move:
                case RapidMove():
                    element = self._path.rapid(move)
                case LinearMove():
                    element = self._path.linear(move)
                case ArcMove():
                    element = self._path.arc(move)
                case SplineMove():
                    element = self._path.spline(move)
                case JointMove():
                    element = self._path.joint(move)
                case ToolChange():
                    self._check_batch()
                    self._path.use_tool(move.length_mm, move.offset_mm)
                    return
                case PathModeChange():
                    margin_mm = (move.tolerance_mm or 0.0) if move.mode is PathMode.BLEND else 0.0
                    if margin_mm != self._margin_mm:
                        self._check_batch()
                        self._margin_mm = margin_mm
                    return
                case _:
                    self.still_s += still_s(self._config, move)
                    return
        except PlanError as error:
            self._refuse(error, move, start_deg, number)
            return
        if element is not None:
            self._batch.add(element, start_deg, self._path.task, number)
            self._flush_when_full()

    def _refuse(self, error: PlanError, move: Move | Action, start_deg: Array, number: int) -> None:
        self._check_batch()
        goal: Array | None = None
        if isinstance(move, RapidMove | LinearMove | ArcMove | SplineMove):
            goal = self._go_on_at(move.target)
        finding = _finding_of(error, move.source, None)
        if goal is not None and not isinstance(move, RapidMove) and self.found.is_new(finding.source, finding.kind):
            finding = replace(finding, via=suggest_via(self._path.arm, start_deg, goal))
        self.found.add(finding, number)

    def _go_on_at(self, target: tuple[float, float, float, float, float, float]) -> Array | None:
        """Stand at a target as after a joint move, where there is one; its task-space values."""
        try:
            result = self._path.arm.joints_from_program(target, self._path.q_deg)
        except KinematicsError:
            return None
        if result.best is None:
            return None
        self._path.stand_at(np.array(result.best.q_deg))
        return self._path.task

    @property
    def nominal_s(self) -> float:
        """Time of what was checked, without accelerations."""
        return self.moving_s + self.still_s

    @property
    def moving_s(self) -> float:
        """The same without `still_s`."""
        return self._along.nominal_s

    def _nominal_of(self, arm: Arm, start_deg: Array, moves: Sequence[Move | Action]) -> float:
        check = _Check(arm, self._config, start_deg)
        for move in moves:
            check.take(move)
        check.flush()
        return check.moving_s

    def flush(self) -> None:
        """Check what has been collected."""
        self._follow()
        self._check_batch()

    def _flush_when_full(self) -> None:
        if len(self._batch) >= BATCH:
            self._check_batch()

    def _check_batch(self) -> None:
        batch, self._batch = self._batch, Batch()
        if len(batch):
            self.cost += SPLINE_COST * batch.splines
            each = TURNING_POINT_COST if self._path.arm.frame.has_rpy else POINT_COST
            for points in batch.parts():
                self.cost += each * max(0, len(points.index) - 2 * points.moves)
                self._along.check(self._path.arm, points, self._margin_mm)


def _finding_of(error: PlanError, source: Source, via: Via | None) -> Finding:
    kind = FindingKind.UNREACHABLE
    unit = "mm"
    if isinstance(error, JointLimitError):
        kind, unit = FindingKind.JOINT_LIMIT, "deg"
    elif isinstance(error, OrientationError):
        kind, unit = FindingKind.ORIENTATION, "deg"
    elif "another branch" in error.problem:
        kind = FindingKind.BRANCH
    elif type(error) is PlanError:
        kind, unit = FindingKind.OTHER, ""
    return Finding(
        Severity.ERROR,
        kind,
        error.source or source,
        error.problem,
        error.place_mm,
        error.q_deg,
        error.amount,
        unit,
        error.remedy,
        via,
    )

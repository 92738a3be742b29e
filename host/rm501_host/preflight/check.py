"""Preflight: a program's path through the kinematics, from its start to its end, before anything moves.

Every move is followed through points 1 mm apart (and wherever a joint turns between two of them), in batches of many
moves. A refused move is reported and stepped over, so one run finds everything. The time estimate comes from the
planner itself, which checks blends too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import JOINT_NAMES, MOTOR_NAMES, Config
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
from rm501_host.planner.elements import Element, ElementTable, Space
from rm501_host.planner.errors import JointLimitError, OrientationError, PlanError
from rm501_host.planner.geometry import joints_along
from rm501_host.planner.jointspace import joint_derivatives
from rm501_host.planner.limits import Limits
from rm501_host.planner.path import PathBuilder
from rm501_host.planner.pieces import Action
from rm501_host.planner.planner import Planner

from .findings import Finding, FindingKind, PreflightReport, Severity, Via
from .keep_out import KeepOut
from .via import suggest_via

Array = NDArray[np.float64]

SPACING_MM = 1.0
"""Between checked points (deg in joint space); between them joints are followed by their derivatives."""
MOST_POINTS = 2000
BATCH = 512
SLOW_SHARE = 0.1
"""Below this share of its feed a move is reported as running into a singularity."""
NEAR_SINE = 0.17
"""|sin q3| below which the elbow counts as nearly straight: 10 deg."""
NEAR_RADIUS_MM = 40.0
"""A tool nearer to the waist axis than this counts as near it."""
LIMIT_TOLERANCE_DEG = 1e-7
MOST_FINDINGS = 500
MOST_ESTIMATED_MOVES = 20_000


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

    `estimate`: also plan and segment programs of up to 20,000 moves for their times and the stop horizon. Raises what
    the stream of moves raises (GcodeError); never PlanError: that is a finding.
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
                count += 1
                if estimate and len(kept) <= MOST_ESTIMATED_MOVES:
                    kept.append(move)
                check.take(move)
        except limit_error as error:
            stopped_by = str(error)
        check.flush()
        report = PreflightReport(check.findings(), check.line, not stopped_by, stopped_by, count)
        if estimate and report.ok and count <= MOST_ESTIMATED_MOVES:
            return _estimated(report, self._arm, self._config, kept, self._start_deg)
        return report


def _estimated(
    report: PreflightReport, arm: Arm, config: Config, moves: list[Move | Action], start_deg: Sequence[float] | Array
) -> PreflightReport:
    from rm501_host.planner.plan import Plan
    from rm501_host.segmenter import Segmenter, stop_horizon
    from rm501_host.segmenter.fit import to_q48

    try:
        plan = Plan(arm, config, Planner(arm, config, start_deg).plan(moves))
    except PlanError as error:
        finding = _finding_of(error, error.source or Source("(program)", 0), None)
        return replace(report, findings=(*report.findings, finding))
    positions = [*map(to_q48, arm.motors_from_joints(np.array(start_deg, dtype=np.float64)).tolist()), 0]
    horizon = stop_horizon(config, Segmenter(config, positions, 0).segments(plan.pieces))
    return replace(
        report,
        cycle_s=plan.duration_s,
        motion_s=plan.motion_s,
        stop_horizon_s=horizon.stop_s,
        needed_lead_s=horizon.lead_s,
        needed_lead_segments=horizon.lead_segments,
    )


class _Check:
    """Follows the path and collects findings."""

    def __init__(self, arm: Arm, config: Config, start_deg: Array) -> None:
        self._limits = Limits.from_config(config)
        self._path = PathBuilder(arm, start_deg, linear_rapids=config.planner.linear_rapids)
        self._keep_out = KeepOut(config)
        self._batch: list[tuple[Element, Array, Array]] = []
        self._found: list[Finding] = []
        self._known: dict[tuple[str, int, FindingKind], int] = {}
        self._slow: dict[int, Finding] = {}
        self._margin_mm = 0.0
        self.line = 0

    @property
    def q_deg(self) -> Array:
        """Joints at the end of the moves taken so far."""
        return self._path.q_deg

    def findings(self) -> tuple[Finding, ...]:
        """Errors and warnings in order, then one summary per limit that keeps moves below their feed."""
        return (*self._found, *self._slow.values())

    def take(self, move: Move | Action) -> None:
        """Check one move (some are checked when the batch is full)."""
        self.line = max(self.line, move.source.line)
        start_deg = self._path.q_deg
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
                    self.flush()
                    self._path.use_tool(move.length_mm, move.offset_mm)
                    return
                case PathModeChange():
                    self.flush()
                    blends = move.mode is PathMode.BLEND
                    self._margin_mm = (move.tolerance_mm or 0.0) if blends else 0.0
                    return
                case _:
                    return
        except PlanError as error:
            self._refuse(error, move, start_deg)
            return
        if element is not None:
            self._batch.append((element, start_deg, self._path.task))
            if len(self._batch) >= BATCH:
                self.flush()

    def _refuse(self, error: PlanError, move: Move | Action, start_deg: Array) -> None:
        self.flush()
        goal: Array | None = None
        if isinstance(move, RapidMove | LinearMove | ArcMove | SplineMove):
            goal = self._go_on_at(move.target)
        via = None
        if goal is not None and not isinstance(move, RapidMove):
            via = suggest_via(self._path.arm, start_deg, goal)
        self._add(_finding_of(error, move.source, via))

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

    def _add(self, finding: Finding) -> None:
        """Keep a finding; the same kind on the same line again only counts."""
        key = (finding.source.file, finding.source.line, finding.kind)
        known = self._known.get(key)
        if known is not None:
            self._found[known] = replace(self._found[known], count=self._found[known].count + 1)
        elif len(self._found) < MOST_FINDINGS:
            self._known[key] = len(self._found)
            self._found.append(finding)

    def flush(self) -> None:
        """Check what has been collected."""
        batch, self._batch = self._batch, []
        if not batch:
            return
        table = ElementTable([element for element, _, _ in batch])
        counts = np.clip(np.ceil(table.length / SPACING_MM), 1, MOST_POINTS).astype(np.intp) + 1
        index = np.repeat(np.arange(len(table)), counts)
        within = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
        s = table.length[index] * within / (counts[index] - 1)
        arm = self._path.arm
        values, y1, y2 = table.evaluate(index, s)
        q_deg, _ = joints_along(arm, table, index, s)
        missing: NDArray[np.bool_] = np.asarray(np.isnan(q_deg).any(axis=1), dtype=np.bool_)
        with np.errstate(all="ignore"):
            joint = table.is_joint[index]
            q1 = y1.copy()
            task = ~joint & ~missing
            if task.any():
                q1[task], _ = joint_derivatives(arm, q_deg[task], y1[task], y2[task], values[task, :3])
        bad: set[int] = set()
        for point in _firsts(index, missing):
            bad.add(int(index[point]))
            self._missing(batch[index[point]], values[point], s[point])
        self._ranges(batch, index, s, q_deg, q1, counts, bad)
        self._speeds(batch, table, index, s, q_deg, q1, missing | ~np.isfinite(q1).all(axis=1))
        if not self._keep_out.is_empty:
            self._places(batch, index, s, q_deg, missing)

    def _missing(self, entry: tuple[Element, Array, Array], values: Array, s: float) -> None:
        element, start_deg, goal = entry
        result = self._path.arm.ik(values[:3], float(values[3]), float(values[4]), start_deg)
        amount = result.shortfalls[0].amount if result.shortfalls else None
        unit = result.shortfalls[0].unit if result.shortfalls else ""
        kind = FindingKind.UNREACHABLE if not result.ok else FindingKind.BRANCH
        reason = result.reason or "only on another branch of the arm"
        self._add(
            Finding(
                Severity.ERROR,
                kind,
                element.source,
                f"({values[0]:.2f}, {values[1]:.2f}, {values[2]:.2f}) mm on the way cannot be reached: {reason}",
                float(s),
                None,
                amount,
                unit,
                "go there with a joint move (G0)",
                suggest_via(self._path.arm, start_deg, goal),
            )
        )

    def _ranges(
        self,
        batch: list[tuple[Element, Array, Array]],
        index: NDArray[np.intp],
        s: Array,
        q_deg: Array,
        q1: Array,
        counts: NDArray[np.intp],
        bad: set[int],
    ) -> None:
        low, high = self._limits.min_deg, self._limits.max_deg
        with np.errstate(all="ignore"):
            beyond = np.maximum(low - q_deg, q_deg - high)
            same = index[1:] == index[:-1]
            length = np.diff(s)[:, None]
            d_a, d_b = q1[:-1] * length, q1[1:] * length
            turning = (d_a * d_b < 0.0) & same[:, None]
            peak = np.where(turning, q_deg[:-1] + 0.5 * d_a * d_a / np.where(turning, d_a - d_b, 1.0), q_deg[:-1])
            between = np.maximum(low - peak, peak - high)
            beyond[:-1] = np.maximum(beyond[:-1], np.where(turning, between, -np.inf))
        excess = np.nan_to_num(beyond, nan=-1.0, posinf=-1.0).max(axis=1)
        over: NDArray[np.bool_] = np.asarray(excess > LIMIT_TOLERANCE_DEG, dtype=np.bool_)
        for point in _firsts(index, over):
            element, start_deg, goal = batch[index[point]]
            if int(index[point]) in bad:
                continue
            rows = index == index[point]
            joint = int(np.argmax(np.nan_to_num(beyond[point], nan=-1.0)))
            worst = float(np.nanmax(beyond[rows][:, joint]))
            limit = low[joint] if low[joint] - q_deg[point, joint] > 0 or q1[point, joint] < 0 else high[joint]
            self._add(
                Finding(
                    Severity.ERROR,
                    FindingKind.JOINT_LIMIT,
                    element.source,
                    f"{JOINT_NAMES[joint]} would leave its range by up to {worst:.4g} deg (limit {limit:g} deg)",
                    float(s[point]),
                    tuple(float(v) for v in q_deg[point]),
                    worst,
                    "deg",
                    "go there with a joint move (G0)" if element.space is Space.TASK else "stay within the range",
                    suggest_via(self._path.arm, start_deg, goal) if element.space is Space.TASK else None,
                )
            )

    def _speeds(
        self,
        batch: list[tuple[Element, Array, Array]],
        table: ElementTable,
        index: NDArray[np.intp],
        s: Array,
        q_deg: Array,
        q1: Array,
        skip: NDArray[np.bool_],
    ) -> None:
        feed = np.minimum(table.feed_mm_s[index], table.rate[index])
        chosen = np.flatnonzero(~skip & np.isfinite(feed) & ~table.is_joint[index])
        if not len(chosen):
            return
        rates = np.abs(q1[chosen] @ self._limits.rows.T) / self._limits.velocity
        row = np.argmax(rates, axis=1)
        speed = 1.0 / np.maximum(rates.max(axis=1), 1e-300)
        share = speed / feed[chosen]
        slow = np.flatnonzero(share < 0.999)
        if not len(slow):
            return
        order = slow[np.argsort(share[slow])]
        seen: set[int] = set()
        for at in order.tolist():
            point = int(chosen[at])
            number = int(index[point])
            if number in seen:
                continue
            seen.add(number)
            self._slower(
                batch[number][0], float(s[point]), q_deg[point], int(row[at]), float(speed[at]), float(share[at])
            )

    def _slower(self, element: Element, s: float, q_deg: Array, row: int, speed: float, share: float) -> None:
        name = JOINT_NAMES[row] if row < 5 else f"{MOTOR_NAMES[row - 2]} motor"
        joints = tuple(float(v) for v in q_deg)
        bent = abs(float(np.sin(np.radians(q_deg[2]))))
        radius = float(np.hypot(*self._path.arm.fk(q_deg).xyz_mm[:2]))
        if share < SLOW_SHARE and (bent < NEAR_SINE or radius < NEAR_RADIUS_MM):
            self._add(
                Finding(
                    Severity.WARNING,
                    FindingKind.SINGULARITY,
                    element.source,
                    f"near a singularity the {name} slows the tool down to {speed:.3g} mm/s, {share:.1%} of its feed",
                    s,
                    joints,
                    speed,
                    "mm/s",
                    "keep the path away from full stretch and from the waist axis, or use a joint move (G0)",
                )
            )
            return
        known = self._slow.get(row)
        text = f"the {name} keeps the tool at {speed:.3g} mm/s, {share:.0%} of its feed"
        if known is None or (known.amount or 0.0) > speed:
            count = 1 if known is None else known.count + 1
            self._slow[row] = Finding(
                Severity.WARNING,
                FindingKind.MOTOR_RATE,
                element.source,
                text,
                s,
                joints,
                speed,
                "mm/s",
                "",
                None,
                count,
            )
        else:
            self._slow[row] = replace(known, count=known.count + 1)

    def _places(
        self,
        batch: list[tuple[Element, Array, Array]],
        index: NDArray[np.intp],
        s: Array,
        q_deg: Array,
        missing: NDArray[np.bool_],
    ) -> None:
        reachable = np.flatnonzero(~missing)
        begin = 0
        while begin < len(reachable):
            rows = reachable[begin:]
            entry = self._keep_out.first_entry(self._path.arm, q_deg[rows], self._margin_mm)
            if entry is None:
                return
            point = int(rows[entry[0]])
            element = batch[index[point]][0]
            self._add(
                Finding(
                    Severity.ERROR,
                    FindingKind.KEEP_OUT,
                    element.source,
                    entry[1],
                    float(s[point]),
                    tuple(float(v) for v in q_deg[point]),
                    entry[2],
                    "mm",
                    "go round it by way of another pose",
                )
            )
            # on with the next move
            begin += int(np.searchsorted(index[rows], index[point], side="right"))


def _firsts(index: NDArray[np.intp], flags: NDArray[np.bool_]) -> list[int]:
    """The first flagged point of each move that has one."""
    points = np.flatnonzero(flags)
    _, first = np.unique(index[points], return_index=True)
    result: list[int] = points[first].tolist()
    return result


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

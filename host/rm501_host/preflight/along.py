"""Checks along the points of a batch: what cannot be reached, joint ranges, speeds, places to keep out of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import JOINT_NAMES, MOTOR_NAMES
from rm501_host.kinematics import Arm
from rm501_host.planner.geometry import joints_at
from rm501_host.planner.jointspace import joint_derivatives
from rm501_host.planner.limits import Limits

from .batch import BatchPoints
from .collector import Collector
from .findings import Finding, FindingKind, Severity, Via
from .keep_out import KeepOut
from .singular import singular_places
from .via import suggest_via

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SLOW_SHARE = 0.1
"""Below this share of its feed a move is reported as running into a singularity."""
NEAR_SINE = 0.17
"""|sin q3| below which the elbow counts as nearly straight: 10 deg."""
NEAR_RADIUS_MM = 40.0
"""A tool nearer to the waist axis than this counts as near it."""
LIMIT_TOLERANCE_DEG = 1e-7
_SLOWER = 0.999
"""Shares of the feed above this are not worth a word."""


class AlongCheck:
    """Checks one batch after another; what it finds goes to the collector."""

    def __init__(self, limits: Limits, keep_out: KeepOut, found: Collector) -> None:
        self._limits = limits
        self._keep_out = keep_out
        self._found = found
        self.nominal_s = 0.0
        """What the moves checked so far take at their feeds and the largest rates of joints and motors, without
        accelerations."""

    def check(self, arm: Arm, points: BatchPoints, margin_mm: float) -> None:
        """Check a batch; blends may leave the path by `margin_mm`."""
        table, index, s = points.table, points.index, points.s
        values, y1, y2 = table.evaluate(index, s)
        q_deg, _ = joints_at(arm, table, index, values)
        missing: Flags = np.asarray(np.isnan(q_deg).any(axis=1), dtype=np.bool_)
        with np.errstate(all="ignore"):
            task = ~table.is_joint[index] & ~missing
            if task.all():
                q1, _ = joint_derivatives(arm, q_deg, y1, y2, values[:, :3])
            else:
                q1 = y1.copy()
                if task.any():
                    q1[task], _ = joint_derivatives(arm, q_deg[task], y1[task], y2[task], values[task, :3])
        bad: set[int] = set()
        for point in _firsts(index, missing):
            bad.add(int(index[point]))
            self._missing(arm, points, point, values[point])
        self._ranges(arm, points, q_deg, q1, bad)
        self._singular(arm, points, values, q_deg, q1, bad)
        self._speeds(arm, points, q_deg, q1, missing | ~np.isfinite(q1).all(axis=1))
        if not self._keep_out.is_empty:
            self._places(arm, points, q_deg, missing, margin_mm)

    def _missing(self, arm: Arm, points: BatchPoints, point: int, values: Array) -> None:
        number = int(points.index[point])
        start_deg = points.start_deg[number]
        result = arm.ik(values[:3], float(values[3]), float(values[4]), start_deg)
        reason = result.reason or "only on another branch of the arm"
        kind = FindingKind.UNREACHABLE if not result.ok else FindingKind.BRANCH
        source = points.sources[number]
        self._found.add(
            Finding(
                Severity.ERROR,
                kind,
                source,
                f"({values[0]:.2f}, {values[1]:.2f}, {values[2]:.2f}) mm on the way cannot be reached: {reason}",
                float(points.s[point]),
                None,
                result.shortfalls[0].amount if result.shortfalls else None,
                result.shortfalls[0].unit if result.shortfalls else "",
                "go there with a joint move (G0)",
                suggest_via(arm, start_deg, points.goal[number]) if self._found.is_new(source, kind) else None,
            ),
            points.numbers[number],
        )

    def _ranges(self, arm: Arm, points: BatchPoints, q_deg: Array, q1: Array, bad: set[int]) -> None:
        low, high = self._limits.min_deg, self._limits.max_deg
        index, s = points.index, points.s
        with np.errstate(all="ignore"):
            beyond = np.maximum(low - q_deg, q_deg - high)
            same = index[1:] == index[:-1]
            length = np.diff(s)[:, None]
            d_a, d_b = q1[:-1] * length, q1[1:] * length
            turning = (d_a * d_b < 0.0) & same[:, None]
            if turning.any():
                peak = np.where(turning, q_deg[:-1] + 0.5 * d_a * d_a / np.where(turning, d_a - d_b, 1.0), q_deg[:-1])
                between = np.maximum(low - peak, peak - high)
                beyond[:-1] = np.maximum(beyond[:-1], np.where(turning, between, -np.inf))
        excess = np.nan_to_num(beyond, nan=-1.0, posinf=-1.0).max(axis=1)
        over: Flags = np.asarray(excess > LIMIT_TOLERANCE_DEG, dtype=np.bool_)
        for point in _firsts(index, over):
            number = int(index[point])
            if number in bad:
                continue
            joint = int(np.argmax(np.nan_to_num(beyond[point], nan=-1.0)))
            worst = float(np.nanmax(beyond[index == number][:, joint]))
            limit = low[joint] if low[joint] - q_deg[point, joint] > 0 or q1[point, joint] < 0 else high[joint]
            in_task = not points.table.is_joint[number]
            source = points.sources[number]
            helps = in_task and self._found.is_new(source, FindingKind.JOINT_LIMIT)
            self._add_at(
                points,
                point,
                q_deg,
                Severity.ERROR,
                FindingKind.JOINT_LIMIT,
                f"{JOINT_NAMES[joint]} would leave its range by up to {worst:.4g} deg (limit {limit:g} deg)",
                worst,
                "deg",
                "go there with a joint move (G0)" if in_task else "stay within the range",
                suggest_via(arm, points.start_deg[number], points.goal[number]) if helps else None,
            )

    def _singular(self, arm: Arm, points: BatchPoints, values: Array, q_deg: Array, q1: Array, bad: set[int]) -> None:
        for point in singular_places(arm, self._limits, points.table, points.index, points.s, values, q1):
            number = int(points.index[point])
            if number in bad:
                continue
            self._add_at(
                points,
                point,
                q_deg,
                Severity.ERROR,
                FindingKind.SINGULARITY,
                "the path runs through a singularity, where the joints would have to jump",
                None,
                "",
                "pass it at a distance, or use a joint move (G0)",
            )

    def _speeds(self, arm: Arm, points: BatchPoints, q_deg: Array, q1: Array, skip: Flags) -> None:
        """Where joints or motors keep the tool below its feed: near singularities one by one, else summed up."""
        table, index = points.table, points.index
        valid = np.flatnonzero(~skip)
        feed = np.minimum(table.feed_mm_s[index[valid]], table.rate[index[valid]])
        rates = np.abs(q1[valid] @ self._limits.rows.T) / self._limits.velocity
        speed = 1.0 / np.maximum(rates.max(axis=1), 1e-300)
        points_of = np.maximum(np.bincount(index[valid], minlength=len(table)), 1)
        self.nominal_s += float((table.length[index[valid]] / np.minimum(feed, speed) / points_of[index[valid]]).sum())
        fed = np.isfinite(feed) & ~table.is_joint[index[valid]]
        chosen, feed, rates, speed = valid[fed], feed[fed], rates[fed], speed[fed]
        if not len(chosen):
            return
        share = speed / feed
        slow = np.flatnonzero(share < _SLOWER)
        if not len(slow):
            return
        # of each move its slowest place, the slowest first
        order = slow[np.argsort(share[slow])]
        _, firsts = np.unique(index[chosen[order]], return_index=True)
        order = order[np.sort(firsts)]
        place, speed, share = chosen[order], speed[order], share[order]
        row = np.argmax(rates[order], axis=1)
        singular = share < SLOW_SHARE
        if singular.any():
            near = np.flatnonzero(singular)
            at = q_deg[place[near]]
            radius_mm = np.hypot(*arm.fk_batch(at)[0][:, :2].T)
            singular[near] = (np.abs(np.sin(np.radians(at[:, 2]))) < NEAR_SINE) | (radius_mm < NEAR_RADIUS_MM)
            for k in np.flatnonzero(singular).tolist():
                self._near_singularity(points, int(place[k]), q_deg, int(row[k]), float(speed[k]), float(share[k]))
        others = np.flatnonzero(~singular)
        for limit in dict.fromkeys(row[others].tolist()):
            mine = others[row[others] == limit]
            k = int(mine[np.argmin(speed[mine])])
            point = int(place[k])
            self._found.add_slow(
                limit,
                Finding(
                    Severity.WARNING,
                    FindingKind.MOTOR_RATE,
                    points.sources[int(index[point])],
                    f"the {_name(limit)} keeps the tool at {speed[k]:.3g} mm/s, {share[k]:.0%} of its feed",
                    float(points.s[point]),
                    tuple(float(v) for v in q_deg[point]),
                    float(speed[k]),
                    "mm/s",
                    "",
                    None,
                    len(mine),
                ),
            )

    def _add_at(
        self,
        points: BatchPoints,
        point: int,
        q_deg: Array,
        severity: Severity,
        kind: FindingKind,
        text: str,
        amount: float | None,
        unit: str,
        remedy: str,
        via: Via | None = None,
    ) -> None:
        """A finding at one of the points, `q_deg` (n, 5) being the joints at all of them."""
        number = int(points.index[point])
        place, at_deg = float(points.s[point]), tuple(float(v) for v in q_deg[point])
        source = points.sources[number]
        finding = Finding(severity, kind, source, text, place, at_deg, amount, unit, remedy, via)
        self._found.add(finding, points.numbers[number])

    def _near_singularity(
        self, points: BatchPoints, point: int, q_deg: Array, row: int, speed: float, share: float
    ) -> None:
        self._add_at(
            points,
            point,
            q_deg,
            Severity.WARNING,
            FindingKind.SINGULARITY,
            f"near a singularity the {_name(row)} slows the tool down to {speed:.3g} mm/s, {share:.1%} of its feed",
            speed,
            "mm/s",
            "keep the path away from full stretch and from the waist axis, or use a joint move (G0)",
        )

    def _places(self, arm: Arm, points: BatchPoints, q_deg: Array, missing: Flags, margin_mm: float) -> None:
        reachable = np.flatnonzero(~missing)
        for row, text, depth_mm in self._keep_out.first_entries(
            arm, q_deg[reachable], points.index[reachable], margin_mm
        ):
            point = int(reachable[row])
            self._add_at(
                points,
                point,
                q_deg,
                Severity.ERROR,
                FindingKind.KEEP_OUT,
                text,
                depth_mm,
                "mm",
                "go round it by way of another pose",
            )


def _name(row: int) -> str:
    """Whose limit a row of `Limits.rows` is."""
    return JOINT_NAMES[row] if row < 5 else f"{MOTOR_NAMES[row - 2]} motor"


def _firsts(index: NDArray[np.intp], flags: Flags) -> list[int]:
    """The first flagged point of each move that has one."""
    points = np.flatnonzero(flags)
    _, first = np.unique(index[points], return_index=True)
    result: list[int] = points[first].tolist()
    return result

"""Judge a plan from the samples of `rm501-host plan` and the text of its program alone.

Theory. Let h be the spacing of the samples. A first difference is the mean of the rate over h, a second difference the
mean of the acceleration under a triangle of 2 h, on uneven spacing too; the distance between two places is at most the
way between them. Means of limited quantities are limited, also across jumps of acceleration: so a legal law never
shows more than 1, whatever h. Nothing is loosened but for rounding: places near 180 deg carry 3e-14 deg, so a second
difference over 1 ms carries 1e-7 deg/s^2 (6e-9 of a limit); where the last interval is shorter, its own rounding. The
arm stands before the first and after the last sample, so the samples are continued there: a law that begins or ends
with a speed shows it as an acceleration. Where the jerk is limited the same holds for third differences.

The path is compared with `judge_program`'s own geometry; each sample may lie on the ways its line names and on the
neighbours in the program's order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise

import numpy as np

from rm501_host.config import Config

from .judge_arm import Array, JudgeArm, angle_between
from .judge_program import NOTHING, Item, Wait, Way
from .plan_checker import motor_matrix

TOLERANCE = 1e-6
GOLDEN = 0.5 * (5.0**0.5 - 1.0)


@dataclass
class Verdict:
    """Ratios to the limits (1 is legal), distances, and everything that is wrong in words."""

    joint_velocity: float = 0.0
    joint_acceleration: float = 0.0
    joint_jerk: float = 0.0
    motor_rate: float = 0.0
    motor_acceleration: float = 0.0
    feed: float = 0.0
    tcp_speed: float = 0.0
    tcp_acceleration: float = 0.0
    largest_deviation_mm: float = 0.0
    beyond_tolerance_mm: float = 0.0
    at_limit_share: float = 0.0
    wrongs: list[str] = field(default_factory=list)

    @property
    def worst(self) -> float:
        return max(
            self.joint_velocity,
            self.joint_acceleration,
            self.joint_jerk,
            self.motor_rate,
            self.motor_acceleration,
            self.feed,
            self.tcp_speed,
            self.tcp_acceleration,
        )


def judge_plan(
    config: Config, items: Sequence[Item], samples: Mapping[str, Array], start_deg: Array, *, most_places: int = 400
) -> Verdict:
    """Judge the arrays of an npz (t_s, q_deg, tcp_mm, motor_steps, line) against what the program asked for."""
    verdict = Verdict()
    t_s, q_deg = np.asarray(samples["t_s"]), np.asarray(samples["q_deg"])
    spacing = np.diff(t_s)
    if (np.abs(spacing[:-1] - 1e-3) > 1e-9).any() or (spacing <= 0).any() or (spacing > 1e-3 + 1e-9).any():
        verdict.wrongs.append("samples are not 1 ms apart")
    _rates(config, verdict, t_s, q_deg)
    _ends(verdict, items, q_deg, start_deg)
    arms = _Runs(verdict, items, np.asarray(samples["line"]))
    places, same_tool = arms.places(q_deg)
    if np.abs(places - samples["tcp_mm"]).max(initial=0.0) > 1e-8:
        verdict.wrongs.append("tcp_mm is not where the joints are")
    steps = q_deg @ motor_matrix(config).T
    if np.abs(steps - samples["motor_steps"][:, :5]).max(initial=0.0) > 1e-6:
        verdict.wrongs.append("motor_steps are not those of the joints")
    _tool(config, verdict, t_s, places, same_tool)
    _feeds(verdict, t_s, q_deg, places, same_tool, arms)
    _waits(config, verdict, t_s, q_deg, samples["motor_steps"][:, 5], arms)
    _on_path(verdict, q_deg, places, arms, most_places)
    if verdict.worst > 1.0 + TOLERANCE:
        verdict.wrongs.append(f"a limit is exceeded: {verdict.worst:.9f}")
    if verdict.beyond_tolerance_mm > TOLERANCE:
        verdict.wrongs.append(f"{verdict.beyond_tolerance_mm:.3g} mm (deg) farther from the path than allowed")
    return verdict


def _rates(config: Config, verdict: Verdict, t_s: Array, q_deg: Array) -> None:
    joints, drives = config.joints.ordered, config.motors.ordered
    motors = motor_matrix(config)
    before, after = np.array([t_s[0] - 1e-3]), np.array([t_s[-1] + 1e-3])
    t = np.concatenate((before, t_s, after))
    q = np.concatenate((q_deg[:1], q_deg, q_deg[-1:]))
    h = np.diff(t)
    rates = np.diff(q, axis=0) / h[:, None]
    span = 0.5 * (h[1:] + h[:-1])
    accelerations = np.diff(rates, axis=0) / span[:, None]
    # four places of up to 256 deg with half a unit in the last place each
    rounding = 4.0 * 2.0**-45 / (np.minimum(h[1:], h[:-1]) * span)
    rounding = np.where(rounding > 1e-4, rounding, 0.0)[:, None]
    velocity = np.array([j.max_velocity_deg_s for j in joints])
    acceleration = np.array([j.max_acceleration_deg_s2 for j in joints])
    rate = np.array([m.max_rate_steps_s for m in drives])
    motor_acceleration = np.array([m.max_acceleration_deg_s2 * m.steps_per_deg for m in drives])
    size = np.maximum(np.abs(accelerations) - rounding, 0.0) / acceleration
    motor_size = np.maximum(np.abs(accelerations @ motors.T) - 80.0 * rounding, 0.0) / motor_acceleration
    fast, fast_motors = np.abs(rates) / velocity, np.abs(rates @ motors.T) / rate
    if config.planner.jerk_limited:
        _jerks(config, verdict, h, accelerations)
    verdict.joint_velocity = float(fast.max())
    verdict.joint_acceleration = float(size.max())
    verdict.motor_rate = float(fast_motors.max())
    verdict.motor_acceleration = float(motor_size.max())
    moving = np.abs(rates).max(axis=1)[1:] > 1e-6
    used = np.maximum(np.maximum(size.max(axis=1), motor_size.max(axis=1)), fast.max(axis=1)[1:])
    verdict.at_limit_share = float((used[moving] > 0.97).mean()) if moving.any() else 1.0
    low, high = np.array([j.min_deg for j in joints]), np.array([j.max_deg for j in joints])
    beyond = np.maximum(low - q_deg, q_deg - high).max()
    if beyond > TOLERANCE:
        verdict.wrongs.append(f"a joint is {beyond:.3g} deg beyond its range")


def _jerks(config: Config, verdict: Verdict, h: Array, accelerations: Array) -> None:
    """Third differences: means of the jerk under a bell of four places' span, on uneven spacing too.

    Their rounding is eight places' of up to 256 deg with half a unit in the last place over 1 ms cubed: 2e-4 deg/s^3,
    2e-6 of the least limit, and more where the last intervals are shorter: so much is allowed.
    """
    jerk = np.array([j.max_jerk_deg_s3 for j in config.joints.ordered])
    span = (h[2:] + h[1:-1] + h[:-2]) / 3.0
    found = np.abs(np.diff(accelerations, axis=0)) / span[:, None]
    least = np.minimum(np.minimum(h[2:], h[1:-1]), h[:-2])
    rounding = (8.0 * 2.0**-45 / (least**2 * span))[:, None]
    verdict.joint_jerk = float((np.maximum(found - rounding, 0.0) / jerk).max(initial=0.0))


def _ends(verdict: Verdict, items: Sequence[Item], q_deg: Array, start_deg: Array) -> None:
    if np.abs(q_deg[0] - start_deg).max() > TOLERANCE:
        verdict.wrongs.append("the plan does not begin where the arm stands")
    ways = [item for item in items if isinstance(item, Way)]
    end = ways[-1].end_deg if ways else start_deg
    if np.abs(q_deg[-1] - end).max() > 1e-5:
        verdict.wrongs.append(f"the plan ends {np.abs(q_deg[-1] - end).max():.3g} deg from the program's end")


@dataclass(frozen=True)
class _Run:
    """Samples [first, stop) of one line, and the items of the program from the group before to the group after."""

    first: int
    stop: int
    own: tuple[Item, ...]
    near: tuple[Item, ...]


class _Runs:
    """Samples matched with the program in its order."""

    def __init__(self, verdict: Verdict, items: Sequence[Item], line: Array) -> None:
        groups = [(number, tuple(members)) for number, members in groupby(items, key=lambda item: item.line)]
        changes = np.flatnonzero(np.diff(line)) + 1
        bounds = np.concatenate(([0], changes, [len(line)])).astype(int)
        matched: list[int] = []
        at = -1
        for first in bounds[:-1]:
            number = int(line[first])
            found = next((k for k in range(at + 1, len(groups)) if groups[k][0] == number), None)
            if found is None:
                verdict.wrongs.append(f"samples of line {number} where the program does not say so")
                found = max(at, 0)
            matched.append(found)
            at = found
        self.runs = []
        for k, (first, stop) in enumerate(pairwise(bounds)):
            low = matched[k - 1] if k else 0
            # a blend reaches into the next line, which stands for all that were merged into it
            high = matched[k + 2] if k + 2 < len(matched) else len(groups) - 1
            near = tuple(item for _, members in groups[low : high + 1] for item in members)
            self.runs.append(_Run(int(first), int(stop), groups[matched[k]][1] if groups else (), near))

    def places(self, q_deg: Array) -> tuple[Array, Array]:
        """Tool centre points (n, 3) with the tool of the moment, and where the next sample has it too (n - 1,)."""
        out, same = np.zeros((len(q_deg), 3)), np.ones(len(q_deg) - 1, dtype=bool)
        before: JudgeArm | None = None
        for run in self.runs:
            if not run.own:
                continue
            arm = run.own[0].arm
            out[run.first : run.stop] = arm.places(q_deg[run.first : run.stop])
            if run.first and before is not arm:
                same[run.first - 1] = False
            before = arm
        return out, same


def _tool(config: Config, verdict: Verdict, t_s: Array, places: Array, same_tool: Array) -> None:
    """The tool's own limits, as long as it is the same tool."""
    limit, most = config.planner.tcp_max_speed_mm_s, config.planner.tcp_max_acceleration_mm_s2
    if limit is None and most is None:
        return
    h = np.diff(t_s)
    speeds = np.where(same_tool, 1.0, 0.0)[:, None] * np.diff(places, axis=0) / h[:, None]
    if limit is not None:
        verdict.tcp_speed = float(np.linalg.norm(speeds, axis=1).max() / limit)
    if most is not None and len(h) > 2:
        even = (h[:-1] > 0.5e-3) & (h[1:] > 0.5e-3)
        size = np.linalg.norm(np.diff(speeds, axis=0), axis=1) / (0.5 * (h[1:] + h[:-1]))
        verdict.tcp_acceleration = float(size[even].max() / most)


def _feeds(verdict: Verdict, t_s: Array, q_deg: Array, places: Array, same_tool: Array, runs: _Runs) -> None:
    h = np.diff(t_s)
    way_mm = np.where(same_tool, np.linalg.norm(np.diff(places, axis=0), axis=1), 0.0)
    angles = np.stack((q_deg[:, 1:4].sum(axis=1), q_deg[:, 4]), axis=1)
    way_deg = np.linalg.norm(np.diff(angles, axis=0), axis=1)
    for run in runs.runs:
        ways = [item for item in run.own if isinstance(item, Way)]
        if not ways:
            continue
        seconds = (run.stop - run.first + 1) * 1e-3
        fewest = sum(way.fewest_s for way in ways if way.blend_mm is None)
        if fewest > 0.0 and len(ways) == 1 and seconds < fewest * (1.0 - 1e-6):
            verdict.wrongs.append(f"line {ways[0].line} takes {seconds:.4f} s, not {fewest:.4f}")
        for first, stop, members in (
            (run.first, run.stop - 1, ways),
            # the interval into the next line may hold both, and whatever lies between
            (
                run.stop - 1,
                min(run.stop, len(h)),
                [item for item in run.near[_index(run.near, ways[0]) :] if isinstance(item, Way)],
            ),
        ):
            if stop <= first:
                continue
            rows = slice(first, stop)
            rounding = 1e-12 / h[rows].min()
            speeds, turns = way_mm[rows] / h[rows] - rounding, way_deg[rows] / h[rows] - rounding
            # a turn on the spot has a feed in deg/min; where a blend leads out of it the tool moves, at the next feed
            turning = [way for way in members if np.isfinite(way.turn_deg_s)]
            after = [way for way in (*members, *_after(run.near, ways[-1])) if way not in turning]
            moving = way_mm[rows] > 1e-9
            if moving.any() and (travelling := [way for way in members if way not in turning] or after):
                limit = max(way.speed_mm_s for way in travelling)
                verdict.feed = max(verdict.feed, float((speeds[moving] / limit).max()))
            if len(turning) == len(members) and not moving.all():
                limit = max(way.turn_deg_s for way in turning)
                verdict.feed = max(verdict.feed, float((turns[~moving] / limit).max()))


def _after(items: Sequence[Item], way: Way) -> list[Way]:
    """The first way after `way`, if any."""
    found = [item for item in items[_index(items, way) + 1 :] if isinstance(item, Way)]
    return found[:1]


def _index(items: Sequence[Item], item: Item) -> int:
    return next(k for k, other in enumerate(items) if other is item)


def _waits(config: Config, verdict: Verdict, t_s: Array, q_deg: Array, hand: Array, runs: _Runs) -> None:
    wanted = 0
    for run in runs.runs:
        waits = [item for item in run.own if isinstance(item, Wait)]
        if not waits or any(isinstance(item, Way) for item in run.own):
            continue
        rows = slice(run.first, run.stop)
        if np.ptp(q_deg[rows], axis=0).max() > 1e-9:
            verdict.wrongs.append(f"the arm moves while line {waits[0].line} waits")
        until = t_s[min(run.stop, len(t_s) - 1)]
        if until - t_s[run.first] < sum(wait.seconds for wait in waits) - 1e-3 - 1e-9:
            verdict.wrongs.append(f"line {waits[0].line} waits too short")
        wanted += sum(wait.event[1] for wait in waits if wait.event is not None and wait.event[0] == "hand")
        if run.stop < len(hand) and abs(hand[run.stop] - wanted) > 1e-6:
            verdict.wrongs.append(f"the hand made {hand[run.stop]} pulses, not {wanted}, after line {waits[0].line}")
    total = sum(abs(np.diff(hand)))
    if total > 0 and abs(hand[-1] - wanted) > 1e-6:
        verdict.wrongs.append("the hand's pulses do not add up")


# -- path


def _on_path(verdict: Verdict, q_deg: Array, places: Array, runs: _Runs, most_places: int) -> None:
    every = max(1, len(q_deg) // most_places)
    for run in runs.runs:
        ways = [item for item in run.own if isinstance(item, Way)]
        near = [item for item in run.near if isinstance(item, Way)]
        if not ways:
            continue
        last = min(run.stop, len(q_deg) - 1)
        rows = np.unique(np.append(np.arange(run.first, run.stop, every), (run.stop - 1, last)))
        rows = rows[rows < run.stop]
        tolerance = max(way.blend_mm or 0.0 for way in ways)
        off, angle_off = _distances(ways, near, q_deg[rows], places[rows], exact=tolerance == 0.0)
        verdict.largest_deviation_mm = max(verdict.largest_deviation_mm, float(off.max()))
        beyond = float((off - tolerance).max())
        if tolerance == 0.0:
            beyond = max(beyond, float(angle_off.max()))
        if beyond > verdict.beyond_tolerance_mm:
            verdict.beyond_tolerance_mm = beyond
            if beyond > TOLERANCE:
                verdict.wrongs.append(f"line {ways[0].line}: off by {float(off.max()):.6g}, {tolerance} allowed")
    _corners(verdict, q_deg, places, runs)


def _distances(
    own: Sequence[Way], near: Sequence[Way], q_deg: Array, places: Array, *, exact: bool
) -> tuple[Array, Array]:
    """Distance (n,) in mm from the nearest way, and how far the angles are from those asked for there (deg)."""
    best = np.full(len(places), np.inf)
    angle = np.zeros(len(places))
    own_first = [*own, *(way for way in near if way not in own)]
    for way in own_first:
        open_rows = np.flatnonzero(best > 1e-9)
        if not len(open_rows):
            break
        q, p = q_deg[open_rows], places[open_rows]
        if way.is_joint and exact:
            distance, t = _to_line(q, way.start_deg, way.end_deg)
            off = np.zeros(len(t))
        else:
            distance, t = _to_way(way, p, q, exact=exact)
            off = _angles_off(way, t, q) if exact else np.zeros(len(t))
        better = np.maximum(distance, off) < np.maximum(best[open_rows], angle[open_rows])
        best[open_rows[better]], angle[open_rows[better]] = distance[better], off[better]
    return best, angle


def _to_line(points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    step = end - start
    t = np.clip((points - start) @ step / max(float(step @ step), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - start - t[:, None] * step, axis=1), t


def _to_way(way: Way, places: Array, q_deg: Array, *, exact: bool) -> tuple[Array, Array]:
    """Distance of places (n, 3) from a way of the tool, and where on it: all of it, then golden sections.

    `exact`: nearest in pitch and roll too (1 deg as 1 mm), since a circle passes its start twice.
    """
    angles = np.stack((q_deg[:, 1:4].sum(axis=1), q_deg[:, 4]), axis=1)
    with_angles = exact and not way.is_joint and way.rotation is None
    wanted = np.concatenate((places, angles), axis=1) if with_angles else places

    def at(t: Array) -> Array:
        if way.is_joint:
            return way.arm.places(way.at(t))
        return way.at(t) if with_angles else way.at(t)[:, :3]

    if way.is_straight and not way.is_joint:
        ends = way.at(np.array((0.0, 1.0)))
        if not with_angles and np.linalg.norm(ends[1, :3] - ends[0, :3]) < NOTHING:
            return np.linalg.norm(places - ends[0, :3], axis=1), np.zeros(len(places))
        _, t = _to_line(wanted, ends[0, : wanted.shape[1]], ends[1, : wanted.shape[1]])
        return np.linalg.norm(places - way.at(t)[:, :3], axis=1), t
    # part by part: a closed curve passes its start at both ends, a spline may cross itself
    count = int(np.clip(way.length, 64, 512))
    edges = np.linspace(0.0, 1.0, way.parts + 1).tolist()
    found = [_nearest(at, wanted, first, last, count) for first, last in pairwise(edges)]
    best = np.argmin(np.array([squares for _, squares in found]), axis=0)
    t = np.array([places_t for places_t, _ in found])[best, np.arange(len(wanted))]
    return np.linalg.norm(at(t)[:, :3] - places, axis=1), t


def _nearest(at: Callable[[Array], Array], wanted: Array, first: float, last: float, count: int) -> tuple[Array, Array]:
    """t (n,) in [first, last] at which a curve is nearest to each row wanted, and the squared distance there."""
    table_t = np.linspace(first, last, count + 1)
    table = at(table_t)
    nearest = np.array([int(np.argmin(((table - place) ** 2).sum(axis=1))) for place in wanted])
    low, high = table_t[np.maximum(nearest - 1, 0)], table_t[np.minimum(nearest + 1, count)]

    def squares(t: Array) -> Array:
        return np.asarray(((at(t) - wanted) ** 2).sum(axis=1))

    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    fa, fb = squares(a), squares(b)
    for _ in range(40):
        left = fa < fb
        high, low = np.where(left, b, high), np.where(left, low, a)
        a_new, b_new = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        f = squares(np.where(left, a_new, b_new))
        a, b, fa, fb = np.where(left, a_new, b), np.where(left, a, b_new), np.where(left, f, fb), np.where(left, fa, f)
    t = 0.5 * (low + high)
    # the ends themselves: a golden section comes close to them only
    for end in (first, last):
        t = np.where(squares(np.full(len(t), end)) <= squares(t), end, t)
    return t, squares(t)


def _angles_off(way: Way, t: Array, q_deg: Array) -> Array:
    if way.is_joint:
        return np.zeros(len(t))
    if way.rotation is not None:
        turned = [angle_between(way.arm.rotation(q), way.rotation(float(k))) for q, k in zip(q_deg, t, strict=True)]
        # orientation_tolerance_deg of the configurations
        return np.maximum(np.array(turned) - 0.0101, 0.0)
    angles = np.stack((q_deg[:, 1:4].sum(axis=1), q_deg[:, 4]), axis=1)
    return np.asarray(np.abs(angles - way.at(t)[:, 3:]).max(axis=1))


def _corners(verdict: Verdict, q_deg: Array, places: Array, runs: _Runs) -> None:
    """Every end of a way is passed within the tolerance, in the program's order.

    Between samples the tool turns off the chord by at most a h^2 / 8 at the joints' accelerations, and a corner may lie
    anywhere along it: distances are to the polyline of samples, less that sagitta (measured, not assumed).
    """
    bends = np.linalg.norm(np.diff(places, n=2, axis=0), axis=1) if len(places) > 2 else np.zeros(1)
    sag = float(bends.max(initial=0.0)) / 4.0
    for k, run in enumerate(runs.runs):
        before, after = runs.runs[max(k - 1, 0)], runs.runs[min(k + 1, len(runs.runs) - 1)]
        chain = [item for item in run.own if isinstance(item, Way)]
        between = [item for item in run.near[_index(run.near, run.own[0]) :] if isinstance(item, Way)] if chain else []
        for way in chain:
            if way.is_joint and way.blend_mm is None:
                continue
            follower = next((w for i, w in enumerate(between[1:], 1) if between[i - 1] is way), None)
            goal = way.arm.places(way.end_deg[None])[0]
            rows = places[before.first : min(after.stop, run.stop + 2000)]
            allowed = 0.0 if way.blend_mm is None or (follower and follower.blend_mm is None) else way.blend_mm
            if len(rows) < 2:
                continue
            distance = _to_polyline(goal, rows)
            if distance > allowed + sag + TOLERANCE:
                verdict.wrongs.append(
                    f"line {way.line}: its end is passed at {distance:.6g} mm, {allowed} allowed (sagitta {sag:.2g})"
                )


def _to_polyline(point: Array, rows: Array) -> float:
    steps = np.diff(rows, axis=0)
    squares = np.maximum((steps**2).sum(axis=1), 1e-300)
    share = np.clip(((point - rows[:-1]) * steps).sum(axis=1) / squares, 0.0, 1.0)
    return float(np.linalg.norm(rows[:-1] + share[:, None] * steps - point, axis=1).min())

"""Planning against its bounds: time-optimality, legality, speed.

    python -m benchmarks.planner [--n LINES]

Motion times stand beside the time-optimal bounds (and beside toppra's on the same grid of joint positions, where
toppra is installed). `own bound` (stops at every corner) and the spiral's bound (the smooth curve through its points)
come from the judge's phase plane (tests/support/judge_bound.py), which shares nothing with the planner; legality comes
from differences of 1 ms samples. `--n` sets how many lines of the spiral are planned with the jerk limit, too
(default 1000, at most 5000). CPU to the first segment and memory of long programs are measured through `run`:
`python -m benchmarks.long_program --n 1e5`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from math import atan2, copysign, cos, degrees, hypot, pi, radians, sin
from pathlib import Path

import msgspec
import numpy as np

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import ArcMove, Feed, JointMove, LinearMove, Move, PathMode, PathModeChange, Source
from rm501_host.planner import Plan, Planner
from rm501_host.planner import planner as planner_module
from rm501_host.planner.limits import Limits
from tests.host.planner.programs import (
    PICK_START_DEG,
    POLYLINE_START_DEG,
    mode,
    pick_and_place,
    polyline,
)
from tests.support.judge_arm import JudgeArm
from tests.support.judge_bound import bound_s
from tests.support.judge_program import Way, read_program
from tests.support.plan_checker import judge_samples

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
LIMITS = Limits.from_config(CONFIG)

CASES: tuple[tuple[str, Callable[[], list[Move]], tuple[float, ...], float, float], ...] = (
    ("pick and place F2800 G61.1", lambda: pick_and_place(2800, None), PICK_START_DEG, 35.5, 36.2),
    ("pick and place F6000 G61.1", lambda: pick_and_place(6000, None), PICK_START_DEG, 23.9, 24.4),
    ("pick and place F2800 P0.5", lambda: pick_and_place(2800, 0.5), PICK_START_DEG, 35.5, 35.5),
    ("pick and place F2800 P5", lambda: pick_and_place(2800, 5.0), PICK_START_DEG, 35.5, 35.5),
    ("pick and place F6000 P0.5", lambda: pick_and_place(6000, 0.5), PICK_START_DEG, 23.9, 23.9),
    ("pick and place F6000 P5", lambda: pick_and_place(6000, 5.0), PICK_START_DEG, 23.9, 23.9),
    ("polyline A, stopping", lambda: polyline(None), POLYLINE_START_DEG, 13.853, 14.13),
    ("polyline A, 5 mm blends", lambda: polyline(2.0711), POLYLINE_START_DEG, 12.817, 13.07),
)


def spiral_points(count: int) -> list[tuple[float, float]]:
    """Points 0.2 mm apart on a spiral about (300, 0), radius 10 to 36 mm."""
    points, angle = [(310.0, 0.0)], 0.0
    for i in range(count):
        radius = 10.0 + 26.0 * i / count
        angle += 0.2 / radius
        points.append((round(300.0 + radius * cos(angle), 4), round(radius * sin(angle), 4)))
    return points


def spiral(count: int) -> list[Move]:
    """The spiral as lines at F6000, G64 P0.5."""
    moves: list[Move] = [mode(0.5)]
    for line, (x, y) in enumerate(spiral_points(count)[1:], 3):
        moves.append(LinearMove((x, y, 150.0, 0.0, 0.0, 0.0), Feed(6000.0), Source("spiral.ngc", line)))
    return moves


class _Smooth:
    """A natural-looking curve through points by local cubic splines (scipy), as the bound's path."""

    def __init__(self, points: np.ndarray) -> None:
        from scipy.interpolate import CubicSpline

        chord = np.concatenate((np.zeros(1), np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
        kept = np.unique(np.append(np.arange(0, len(chord), 10), len(chord) - 1))
        self.length = float(chord[-1])
        self._spline = CubicSpline(chord[kept], points[kept])

    def evaluate(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = []
        for order in range(3):
            row = np.zeros((len(s), 5))
            row[:, :2] = self._spline(s, order)
            row[:, 2] = 150.0 if order == 0 else 0.0
            rows.append(row)
        return rows[0], rows[1], rows[2]


def spiral_bound_s(count: int, start_deg: tuple[float, ...]) -> float:
    """Bound of the smooth curve through the spiral's points: the judge's own phase plane, not the planner's."""
    smooth = _Smooth(np.array(spiral_points(count)))
    arm, start = JudgeArm.of(CONFIG), np.array(start_deg)
    way = Way(
        0,
        False,
        arm,
        lambda t: smooth.evaluate(t * smooth.length)[0],
        smooth.length,
        start,
        start,
        None,
        False,
        speed_mm_s=100.0,
    )
    return bound_s(CONFIG, way, 20_000)


def stopping_bound_s(moves: list[Move], start_deg: tuple[float, ...]) -> float:
    """Bound of lines and arcs with a stop at every corner, by the judge's phase plane."""
    rows = ["G21 G90 G94 G61.1"]
    at = np.array(ARM.fk(start_deg).xyz_mm)
    for move in moves:
        if isinstance(move, LinearMove | ArcMove):
            x, y, z, a, b, _ = move.target
            place = f"X{x:.9f} Y{y:.9f} Z{z:.9f} A{a:.9f} B{b:.9f} F{move.feed.value:g}"
            if isinstance(move, ArcMove):
                code = "G3" if move.angle_deg > 0 else "G2"
                rows.append(f"{code} {place} I{move.centre_mm[0] - at[0]:.9f} J{move.centre_mm[1] - at[1]:.9f}")
            else:
                rows.append(f"G1 {place}")
            at = np.array(move.target[:3])
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "stopping.ngc"
        program.write_text("\n".join([*rows, "M2", ""]))
        items = read_program(CONFIG, program, np.array(start_deg))
    return sum(bound_s(CONFIG, item, 2000) for item in items if isinstance(item, Way))


def toppra_s(plan: Plan) -> float | None:
    """toppra's time over the same joint path, piece by piece; joint limits only, no feed. None without toppra."""
    try:
        import toppra
        import toppra.algorithm as algorithm
        import toppra.constraint as constraint
    except ImportError:
        return None
    toppra.setup_logging("ERROR")
    total = 0.0
    for piece in plan.pieces:
        if piece.law is None:
            continue
        q = piece.q_deg(np.linspace(0.0, piece.duration_s, 400))
        way = np.concatenate((np.zeros(1), np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))))
        keep = np.concatenate((np.array([True]), np.diff(way) > 1e-9))
        path = toppra.SplineInterpolator(way[keep], q[keep])
        limits = [
            constraint.JointVelocityConstraint(
                np.stack((-LIMITS.joint_velocity_deg_s, LIMITS.joint_velocity_deg_s), 1)
            ),
            constraint.JointAccelerationConstraint(
                np.stack((-LIMITS.joint_acceleration_deg_s2, LIMITS.joint_acceleration_deg_s2), 1)
            ),
        ]
        law = algorithm.TOPPRA(limits, path).compute_trajectory(0, 0)
        if law is None:
            return None
        total += float(law.duration)
    return total


def run_cases() -> bool:
    """The table of motion times; whether all hold."""
    good = True
    print(
        f"{'case':30} {'motion s':>9} {'anchor s':>9} {'target s':>9} {'own bound':>10} {'worst ratio':>12} "
        f"{'toppra s':>9}"
    )
    for name, moves, start, bound, target in CASES:
        plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start).plan(moves()))
        samples = plan.sample()
        worst = judge_samples(CONFIG, samples.t_s, samples.q_deg).worst
        peer = toppra_s(plan)
        fine = plan.motion_s <= target and worst <= 1.0 + 1e-6
        good &= fine
        told = f"{peer:9.3f}" if peer is not None else f"{'-':>9}"
        mark = "" if fine else "  MISSED"
        stopping = "stopping" in name or "G61.1" in name
        own = f"{stopping_bound_s(moves(), start):10.3f}" if stopping else f"{'-':>10}"
        print(f"{name:30} {plan.motion_s:9.3f} {bound:9.3f} {target:9.3f} {own} {worst:12.6f} {told}{mark}")
    return good


def run_spiral(count: int) -> bool:
    """Time against the spiral's own bound, planning speed; whether both hold."""
    moves = spiral(count)
    start = ARM.ik((310.0, 0.0, 150.0), 0.0, 0.0).best
    assert start is not None
    before = time.process_time()
    plan = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start.q_deg).plan(moves))
    cpu = time.process_time() - before
    samples = plan.sample()
    worst = judge_samples(CONFIG, samples.t_s, samples.q_deg).worst
    bound = spiral_bound_s(count, start.q_deg)
    speed = plan.motion_s / cpu
    fine = plan.motion_s <= 1.03 * bound and worst <= 1.0 + 1e-6 and speed >= 10.0
    print(
        f"spiral of {count} lines: {plan.motion_s:.3f} s, its own bound {bound:.3f} s "
        f"({100 * (plan.motion_s / bound - 1):+.2f} %), worst ratio {worst:.6f}; planned at {speed:.1f} x real time, "
        f"{count / cpu:.0f} lines/s{'' if fine else '  MISSED'}"
    )
    return fine


ZIGZAG_TURNS_DEG = (180.0, 175.0, 135.0, 90.0, 30.0, 15.0)
ZIGZAG_LEGS_MM = (0.2, 1.0, 10.0)


def zigzag(count: int, leg_mm: float, turn_deg: float) -> list[Move]:
    """Legs that turn back by `turn_deg` again and again, at F6000 and G64 P0.5."""
    half = radians(180.0 - turn_deg) / 2.0
    moves: list[Move] = [mode(0.5)]
    x, y = 300.0, -30.0
    for i in range(count):
        x += leg_mm * cos(half) * (1 if i % 2 == 0 else -1)
        y += leg_mm * sin(half)
        y -= 120.0 if y > 60.0 else 0.0
        moves.append(LinearMove((x, y, 150.0, 0.0, 0.0, 0.0), Feed(6000.0), Source("zigzag.ngc", i + 2)))
    return moves


def run_zigzags(count: int) -> bool:
    """Planning speed where every corner is sharp; whether planning is well ahead of the motion (3 times) everywhere."""
    start = ARM.ik((300.0, -30.0, 150.0), 0.0, 0.0).best
    assert start is not None
    good = True
    print(f"zigzags of {count} lines, lines/s of planning (x real time) by turn")
    print(f"{'leg mm':>8}" + "".join(f"{turn:>14.0f} deg" for turn in ZIGZAG_TURNS_DEG))
    for leg in ZIGZAG_LEGS_MM:
        row = f"{leg:8.1f}"
        for turn in ZIGZAG_TURNS_DEG:
            moves = zigzag(count, leg, turn)
            before = time.process_time()
            motion_s = sum(piece.motion_s for piece in Planner(ARM, CONFIG, start.q_deg).plan(moves))
            cpu = time.process_time() - before
            good &= motion_s >= 3.0 * cpu
            row += f"{count / cpu:>9.0f} ({motion_s / cpu:>5.0f} x)"
        print(row)
    if not good:
        print("  MISSED: planning is less than 3 times as fast as the motion")
    return good


def engraving(count: int) -> list[Move]:
    """Short arcs, every second one with a corner before it, within 20 mm of one place, at F3000 and G64 P0.05."""
    draw = np.random.default_rng(3)
    moves: list[Move] = [mode(0.05)]
    x, y, heading = 300.0, 0.0, 0.0
    for i in range(count):
        radius, turn = float(draw.uniform(0.3, 3.0)), radians(float(draw.choice((-1.0, 1.0)) * draw.uniform(20, 120)))
        heading += float(draw.uniform(-1.0, 1.0)) * (i % 2)
        if hypot(x - 300.0, y) > 20.0:
            heading = atan2(-y, 300.0 - x)
        left = copysign(radius, turn)
        centre_x, centre_y = x - left * sin(heading), y + left * cos(heading)
        heading += turn
        x, y = centre_x + left * sin(heading), centre_y - left * cos(heading)
        goal, centre = (x, y, 150.0, 0.0, 0.0, 0.0), (centre_x, centre_y, 150.0)
        moves.append(ArcMove(goal, centre, (0.0, 0.0, 1.0), degrees(turn), Feed(3000.0), Source("arcs.ngc", i + 2)))
    return moves


def scribble(count: int) -> list[Move]:
    """Lines of 0.1 to 1 mm in any direction, within 30 mm of one place, at F6000 and G64 P0.1."""
    draw = np.random.default_rng(5)
    moves: list[Move] = [mode(0.1)]
    at = np.zeros(2)
    for i in range(count):
        angle = float(draw.uniform(0.0, 2.0 * pi))
        step = float(draw.uniform(0.1, 1.0)) * np.array((cos(angle), sin(angle)))
        at = at + step if float(np.linalg.norm(at + step)) < 30.0 else at - step
        goal = (300.0 + float(at[0]), float(at[1]), 150.0, 0.0, 0.0, 0.0)
        moves.append(LinearMove(goal, Feed(6000.0), Source("scribble.ngc", i + 2)))
    return moves


def in_mode(moves: list[Move], path_mode: PathMode) -> list[Move]:
    """The same moves in G61 or G61.1."""
    return [PathModeChange(path_mode, None, None, Source("mode.ngc", 1)), *moves[1:]]


STREAMED: tuple[tuple[str, Callable[[int], list[Move]], tuple[float, float, float]], ...] = (
    ("spiral, 0.2 mm, P0.5", lambda n: spiral(5000)[: n + 1], (310.0, 0.0, 150.0)),
    ("zigzag, 0.2 mm, 90 deg, P0.05", lambda n: [mode(0.05), *zigzag(n, 0.2, 90.0)[1:]], (300.0, -30.0, 150.0)),
    ("the same in G61", lambda n: in_mode(zigzag(n, 0.2, 90.0), PathMode.EXACT_PATH), (300.0, -30.0, 150.0)),
    ("zigzag, 0.2 mm, 30 deg, P0.5", lambda n: zigzag(n, 0.2, 30.0), (300.0, -30.0, 150.0)),
    ("zigzag, 0.2 mm, 135 deg, P0.5", lambda n: zigzag(n, 0.2, 135.0), (300.0, -30.0, 150.0)),
    ("short arcs, P0.05", engraving, (300.0, 0.0, 150.0)),
    ("lines of 0.1 to 1 mm, P0.1", scribble, (300.0, 0.0, 150.0)),
)


def run_streams(count: int) -> bool:
    """Planning speed of short moves, and what the window costs: streamed against planned as a whole."""
    good = True
    title = f"streams of {count} moves"
    print(f"{title:32} {'moves/s':>9} {'x real time':>12} {'motion s':>10} {'of whole':>9}")
    for name, program, place in STREAMED:
        moves, start = program(count), ARM.ik(place, 0.0, 0.0).best
        assert start is not None
        before = time.process_time()
        motion_s = sum(piece.motion_s for piece in Planner(ARM, CONFIG, start.q_deg).plan(moves))
        cpu = time.process_time() - before
        bounded, planner_module.CHUNK_ELEMENTS = planner_module.CHUNK_ELEMENTS, 1_000_000
        try:
            whole_s = sum(piece.motion_s for piece in Planner(ARM, CONFIG, start.q_deg).plan(moves))
        finally:
            planner_module.CHUNK_ELEMENTS = bounded
        fine = motion_s <= 1.0005 * whole_s and motion_s >= 3.0 * cpu
        good &= fine
        print(
            f"{name:32} {count / cpu:9.0f} {motion_s / cpu:12.1f} {motion_s:10.3f} {motion_s / whole_s:9.6f}"
            f"{'' if fine else '  MISSED'}"
        )
    return good


LEAST_JERK_SPEED = 8.0
"""Times real time; 10 to 15 where nothing else runs."""


def jerk_bound_s(travel_deg: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Least time of one joint from rest to rest over `travel_deg` under all three limits (deg/s, deg/s^2, deg/s^3)."""
    rise = acceleration / jerk
    if velocity >= acceleration * rise:
        # with phases of full acceleration; at full speed between them, or not
        needed = velocity * (velocity / acceleration + rise)
        if travel_deg >= needed:
            return travel_deg / velocity + velocity / acceleration + rise
        top = 0.5 * acceleration * (-rise + (rise * rise + 4.0 * travel_deg / acceleration) ** 0.5)
        if top >= acceleration * rise:
            return 2.0 * (top / acceleration + rise)
        return 4.0 * (travel_deg / (2.0 * jerk)) ** (1.0 / 3.0)
    ramp = 2.0 * (velocity / jerk) ** 0.5
    if travel_deg >= velocity * ramp:
        return travel_deg / velocity + ramp
    return 4.0 * (travel_deg / (2.0 * jerk)) ** (1.0 / 3.0)


TURN_START_DEG = (0.0, 30.0, -60.0, 30.0, 0.0)


def _turn(joint: int, angle_deg: float) -> list[Move]:
    return [JointMove(joint, angle_deg, True, Source("joint", 1))]


def run_jerk_cases() -> bool:
    """Motion times with the jerk limit against bounds: the law without it, and for single joints the least of all."""
    planned = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
    most = np.array([joint.max_jerk_deg_s3 for joint in CONFIG.joints.ordered])
    good = True
    print(f"{'jerk-limited':30} {'motion s':>9} {'bound s':>9} {'over it':>8} {'largest jerk':>13} {'worst ratio':>12}")
    cases = [(name, moves, start) for name, moves, start, _, _ in CASES]
    joints = ((0, 60.0), (0, 5.0), (1, 25.0), (2, 40.0))
    for joint, travel in joints:
        name = f"{CONFIG.joints.__struct_fields__[joint]} by {travel:g} deg"
        cases.append((name, partial(_turn, joint, travel), TURN_START_DEG))
    for k, (name, moves, start) in enumerate(cases):
        plan = Plan(ARM, planned, Planner(ARM, planned, start).plan(moves()))
        samples = plan.sample()
        worst = judge_samples(CONFIG, samples.t_s, samples.q_deg).worst
        jerk = float((np.abs(np.diff(samples.q_deg, 3, axis=0))[:-1] / 1e-9 / most).max())
        if k < len(CASES):
            bound = Plan(ARM, CONFIG, Planner(ARM, CONFIG, start).plan(moves())).motion_s
        else:
            joint, travel = joints[k - len(CASES)]
            bound = jerk_bound_s(travel, LIMITS.velocity[joint], LIMITS.acceleration[joint], float(most[joint]))
        good &= worst <= 1.0 + 1e-6 and jerk <= 1.0 + 1e-5
        print(
            f"{name:30} {plan.motion_s:9.3f} {bound:9.3f} {100 * (plan.motion_s / bound - 1):+7.1f}% {jerk:13.4f} "
            f"{worst:12.6f}"
        )
    return good


def run_jerk(count: int) -> bool:
    """The first lines of the same spiral with the jerk limit, as they stream; whether legal and without a stop."""
    planned = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
    start = ARM.ik((310.0, 0.0, 150.0), 0.0, 0.0).best
    assert start is not None
    before = time.process_time()
    plan = Plan(ARM, planned, Planner(ARM, planned, start.q_deg).plan(spiral(5000)[: count + 1]))
    cpu = time.process_time() - before
    samples = plan.sample()
    worst = judge_samples(CONFIG, samples.t_s, samples.q_deg).worst
    most = np.array([joint.max_jerk_deg_s3 for joint in CONFIG.joints.ordered])
    jerk = float((np.abs(np.diff(samples.q_deg, 3, axis=0))[:-1] / 1e-9 / most).max())
    stops = sum(piece.ends_at_rest for piece in plan.pieces) - 1
    # what no law beats, the jerk limited or not
    bound = sum(piece.motion_s for piece in Planner(ARM, CONFIG, start.q_deg).plan(spiral(5000)[: count + 1]))
    fine = worst <= 1.0 + 1e-6 and jerk <= 1.0 + 1e-3 and not stops and plan.motion_s >= LEAST_JERK_SPEED * cpu
    print(
        f"its first {count} lines, jerk-limited: {plan.motion_s:.3f} s "
        f"({100 * (plan.motion_s / bound - 1):+.2f} % of the law without that limit), worst ratio {worst:.6f}, "
        f"largest jerk / limit {jerk:.4f}, unplanned stops {stops}; planned at {plan.motion_s / cpu:.1f} x real time"
        f"{'' if fine else '  MISSED'}"
    )
    return fine


def main() -> int:
    """Print the tables; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=float, default=1000, help="lines planned with the jerk limit, up to 5000")
    options = parser.parse_args()
    good = run_cases()
    good &= run_spiral(5000)
    good &= run_jerk_cases()
    good &= run_jerk(min(5000, int(options.n)))
    good &= run_zigzags(100)
    good &= run_streams(1000)
    print("CPU to the first segment and memory of long programs: python -m benchmarks.long_program --n 1e5")
    print("planner: every target met" if good else "planner: TARGETS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

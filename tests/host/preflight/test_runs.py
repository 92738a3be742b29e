"""Moves checked as arrays: the same findings as one by one, whatever stands between them."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from rm501_host.config import load_config
from rm501_host.config.schema import BoxSection, Config
from rm501_host.kinematics import Arm
from rm501_host.moves import (
    ArcMove,
    Dwell,
    Feed,
    FeedMode,
    JointMove,
    LinearMove,
    Move,
    PathMode,
    PathModeChange,
    RapidMove,
    SplineMove,
    Target,
    ToolChange,
    Vector,
)
from rm501_host.preflight import Finding, PreflightReport, ProgramCheck, Via
from rm501_host.preflight import along as along_module
from rm501_host.preflight import batch as batch_module
from rm501_host.preflight import check as check_module
from tests.host.planner.programs import PICK_START_DEG, at, target

PLAIN = load_config()
PLAIN_ARM = Arm.from_config(PLAIN)
POST = BoxSection(name="post", min_mm=(150.0, 120.0, 0.0), max_mm=(190.0, 180.0, 500.0))
GUARDED = msgspec.structs.replace(
    PLAIN, keep_out=msgspec.structs.replace(PLAIN.keep_out, boxes=(POST,), table_z_mm=105.0)
)
THESIS = load_config(Path(__file__).parents[3] / "configs" / "thesis.toml")
CONFIGS = {
    "plain": PLAIN,
    "guarded": GUARDED,
    "thesis": THESIS,
    "thesis guarded": msgspec.structs.replace(THESIS, keep_out=GUARDED.keep_out),
    "linear rapids": msgspec.structs.replace(PLAIN, planner=msgspec.structs.replace(PLAIN.planner, linear_rapids=True)),
    "tilted tool": msgspec.structs.replace(
        THESIS, tool=msgspec.structs.replace(THESIS.tool, offset_mm=(0.0, 4.0), tilt_deg=(3.0, 0.0))
    ),
}
CASES = [
    *((name, seed) for name in ("plain", "thesis") for seed in (0, 1)),
    *((name, 2) for name in CONFIGS if name not in ("plain", "thesis")),
]


class Words:
    """Writes what is meant in the base frame, with pitch and roll, as moves of an arm's program frame."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._q_deg: tuple[float, ...] = PICK_START_DEG

    def point(self, x: float, y: float, z: float) -> Vector:
        px, py, pz = self._arm.frame.program_from_base(np.array((x, y, z))).tolist()
        return (px, py, pz)

    def target(self, x: float, y: float, z: float, pitch: float, roll: float) -> Target:
        if not self._arm.frame.has_rpy:
            return (*self.point(x, y, z), pitch, roll, 0.0)
        best = self._arm.ik((x, y, z), pitch, roll, self._q_deg).best
        if best is not None:
            self._q_deg = best.q_deg
            return self._arm.program_from_joints(best.q_deg)
        return (*self.point(x, y, z), 0.0, 0.0, 0.0)

    def arc(self, end: Target, centre: Vector, angle_deg: float, feed: Feed, line: int) -> ArcMove:
        up = self._arm.frame.rotation.T @ np.array((0.0, 0.0, 1.0))
        axis = (float(up[0]), float(up[1]), float(up[2]))
        return ArcMove(end, self.point(*centre), axis, angle_deg, feed, at(line))


def random_program(rng: random.Random, count: int, arm: Arm = PLAIN_ARM) -> list[Move]:
    """Wanders about, mostly by short lines and arcs, sometimes out of reach, through the post, or by something else."""
    words = Words(arm)
    x, y, z, a, b = 280.0, 0.0, 200.0, 0.0, 0.0
    moves: list[Move] = [RapidMove(words.target(x, y, z, a, b), at(1))]
    line = 1
    heading = 0.0
    while len(moves) < count:
        line += 1
        feed = Feed(rng.choice((600.0, 3000.0, 30000.0)))
        kind = rng.random()
        if kind < 0.60:
            step = rng.choice((0.2, 0.2, 1.5, 12.0))
            heading += rng.gauss(0.0, 0.4)
            x, y = x + step * math.cos(heading), y + step * math.sin(heading)
            z += rng.gauss(0.0, 0.2 * step)
            if rng.random() < 0.02:
                x, y, z = rng.uniform(200, 360), rng.uniform(-200, 200), rng.uniform(100, 300)
            if rng.random() < 0.01:
                x, y = -0.2 * x, -0.2 * y  # past the waist axis, or through it
            if rng.random() < 0.1:
                a, b = a + rng.uniform(-2, 2), b + rng.uniform(-5, 5)
        elif kind < 0.80:
            radius, angle = rng.choice((0.3, 2.0, 25.0)), rng.choice((-400.0, -90.0, 20.0, 180.0, 360.0))
            heading += rng.gauss(0.0, 1.0)
            centre = (x + radius * math.cos(heading), y + radius * math.sin(heading), z)
            away = heading + math.pi + math.radians(angle)
            grown = radius * rng.choice((1.0, 1.0, 1.0002))
            x, y = centre[0] + grown * math.cos(away), centre[1] + grown * math.sin(away)
            z += rng.choice((0.0, 0.0, 3.0))
            b += rng.choice((0.0, 0.0, 4.0))
            if rng.random() < 0.05:
                feed = Feed(10.0, FeedMode.INVERSE_TIME)
            moves.append(words.arc(words.target(x, y, z, a, b), centre, angle, feed, line))
            continue
        elif kind < 0.83:
            points = [words.point(x, y, z)]
            for _ in range(3):
                x, y, z = x + rng.uniform(-8, 8), y + rng.uniform(-8, 8), z + rng.uniform(-2, 2)
                points.append(words.point(x, y, z))
            b += rng.choice((0.0, 0.0, 4.0))
            knots = (0.0,) * 4 + (1.0,) * 4
            end = words.target(x, y, z, a, b)
            moves.append(SplineMove(end, tuple(points), (1.0, 1.0, 2.0, 1.0), knots, 3, feed, at(line)))
            continue
        elif kind < 0.85:
            feed = Feed(rng.choice((3.0, 20.0)), FeedMode.INVERSE_TIME)
            x += 1.0
        elif kind < 0.86:
            b += rng.choice((0.0, 10.0))  # no move, or one of an angle alone
        elif kind < 0.87:
            x, b = x + 0.01, b + rng.choice((-25.0, 25.0))  # next to none
        elif kind < 0.88:
            feed = Feed(0.0)
            y += 1.0
        elif kind < 0.89:
            moves.append(LinearMove(words.target(x + 400.0, y, z, a, b), feed, at(line)))
            continue
        elif kind < 0.90:
            wild = words.target(x, y, z, a, b)
            turned = (*wild[:3], wild[3] + rng.choice((0.0, 0.004, 10.0, 175.0, 360.0)), *wild[4:])
            moves.append(LinearMove(turned, feed, at(line)))
            continue
        elif kind < 0.92:
            moves.append(RapidMove(words.target(x, y, z, a, b), at(line)))
            continue
        elif kind < 0.94:
            moves.append(PathModeChange(PathMode.BLEND, rng.choice((0.5, 2.0)), None, at(line)))
            continue
        elif kind < 0.95:
            moves.append(ToolChange(rng.choice((0.0, 20.0)), (0.0, rng.choice((0.0, 3.0))), at(line)))
            continue
        elif kind < 0.96:
            moves.append(JointMove(4, rng.uniform(-20, 20), True, at(line)))
            continue
        else:
            moves.append(Dwell(0.1, at(line)))
            continue
        moves.append(LinearMove(words.target(x, y, z, a, b), feed, at(line)))
    return moves


def literal(text: str) -> str:
    """Without the whole turns in which a pitch that nobody reaches is told."""
    return re.sub(r"pitch (-?[0-9.]+) deg cannot", lambda m: f"pitch {float(m[1]) % 360.0:.1f} deg cannot", text)


def alike(first: Finding, second: Finding) -> bool:
    """Equal but for what rounding may do to the place, the joints and the amount."""
    if (first.severity, first.kind, first.source, literal(first.text), first.remedy, first.count) != (
        second.severity, second.kind, second.source, literal(second.text), second.remedy, second.count,
    ):  # fmt: skip
        return False
    assert (first.via is None) == (second.via is None)
    if first.via is not None and second.via is not None:
        assert first.via.target == pytest.approx(second.via.target, abs=1e-6)
        assert first.via.q_deg == pytest.approx(second.via.q_deg, abs=1e-6)
    for one, other in ((first.place_mm, second.place_mm), (first.amount, second.amount)):
        assert (one is None) == (other is None)
        assert one is None or one == pytest.approx(other, rel=1e-7, abs=1e-7)
    return first.q_deg is None or first.q_deg == pytest.approx(second.q_deg, abs=1e-6)


def found_both_ways(
    config: Config, moves: list[Move], monkeypatch: pytest.MonkeyPatch
) -> tuple[PreflightReport, PreflightReport]:
    """The reports of the arrays and of the elements, after comparing where they leave the arm."""
    arm = Arm.from_config(config)

    def where_asked(arm: Arm, start_deg: Sequence[float], goal: NDArray[np.float64]) -> Via:
        """Instead of looking for a pose: the question."""
        x, y, z, pitch, roll = goal.tolist()
        return Via((x, y, z, pitch, roll, 0.0), tuple(float(q) for q in start_deg))

    for module in (check_module, along_module):
        monkeypatch.setattr(module, "suggest_via", where_asked)

    def report() -> tuple[PreflightReport, list[float], float]:
        check = ProgramCheck(arm, config, PICK_START_DEG)
        made = check.run(moves, estimate=False)
        return made, check.q_deg.tolist(), check.nominal_s

    fast, fast_end, fast_s = report()
    with monkeypatch.context() as patch:
        patch.setattr(check_module, "FEWEST_MOVES", 10**9)
        slow, slow_end, slow_s = report()
    assert fast_end == pytest.approx(slow_end, abs=1e-9)
    assert fast_s == pytest.approx(slow_s, rel=1e-6)
    assert (fast.checked_to_line, fast.moves) == (slow.checked_to_line, slow.moves)
    return fast, slow


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_arrays_find_what_elements_find(name: str, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    config = CONFIGS[name]
    moves = random_program(random.Random(seed), 250, Arm.from_config(config))
    fast, slow = found_both_ways(config, moves, monkeypatch)
    assert len(fast.findings) == len(slow.findings)
    for one, other in zip(fast.findings, slow.findings, strict=True):
        assert alike(one, other), f"{one}\n{other}"
    assert len(slow.findings) > 5


def test_every_move_is_checked_however_many_points_are_looked_at_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    moves = random_program(random.Random(7), 120)
    found = []
    for at_once in (10, 300, 10**6):
        monkeypatch.setattr(batch_module, "POINTS_AT_ONCE", at_once)
        check = ProgramCheck(PLAIN_ARM, GUARDED, PICK_START_DEG)
        report = check.run(moves, estimate=False)
        errors = {(error.source.line, error.kind, error.text) for error in report.errors}
        found.append((errors, pytest.approx(check.nominal_s)))
    assert len(found[0][0]) > 5
    assert found[0] == found[2] and found[1] == found[2]


def test_an_error_is_not_lost_behind_many_warnings() -> None:
    """Each line near full stretch is a warning of its own; the one that cannot be reached must still be told."""
    arm = Arm.from_config(PLAIN)
    start = arm.ik((464.9, 0.0, 230.0), 90.0, 0.0).best
    assert start is not None
    moves: list[Move] = [
        LinearMove(target(464.9 + 0.05 * (i % 2), 0, 230, 90), Feed(60000.0), at(i + 2)) for i in range(1200)
    ]
    moves.append(LinearMove(target(900, 0, 230, 90), Feed(60000.0), at(1202)))
    report = ProgramCheck(arm, PLAIN, start.q_deg).run(moves, estimate=False)
    assert len(report.findings) > 400
    assert [finding.source.line for finding in report.errors] == [1202]

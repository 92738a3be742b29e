"""Lines checked as arrays: the same findings as one by one, whatever stands between the lines."""

from __future__ import annotations

import math
import random

import msgspec
import pytest

from rm501_host.config import load_config
from rm501_host.config.schema import BoxSection
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
    ToolChange,
)
from rm501_host.preflight import Finding, PreflightReport, ProgramCheck
from rm501_host.preflight import check as check_module
from tests.host.planner.programs import PICK_START_DEG, at, target

PLAIN = load_config()
POST = BoxSection(name="post", min_mm=(150.0, 120.0, 0.0), max_mm=(190.0, 180.0, 500.0))
GUARDED = msgspec.structs.replace(
    PLAIN, keep_out=msgspec.structs.replace(PLAIN.keep_out, boxes=(POST,), table_z_mm=105.0)
)


def random_program(rng: random.Random, count: int) -> list[Move]:
    """Wanders about, mostly by short lines, sometimes out of reach, through the post, or by something else."""
    x, y, z, a, b = 280.0, 0.0, 200.0, 0.0, 0.0
    moves: list[Move] = [RapidMove(target(x, y, z, a, b), at(1))]
    line = 1
    heading = 0.0
    while len(moves) < count:
        line += 1
        feed = Feed(rng.choice((600.0, 3000.0, 30000.0)))
        kind = rng.random()
        if kind < 0.80:
            step = rng.choice((0.2, 0.2, 1.5, 12.0))
            heading += rng.gauss(0.0, 0.4)
            x, y = x + step * math.cos(heading), y + step * math.sin(heading)
            z += rng.gauss(0.0, 0.2 * step)
            if rng.random() < 0.02:
                x, y, z = rng.uniform(200, 360), rng.uniform(-200, 200), rng.uniform(100, 300)
            if rng.random() < 0.1:
                a, b = a + rng.uniform(-2, 2), b + rng.uniform(-5, 5)
        elif kind < 0.83:
            feed = Feed(rng.choice((3.0, 20.0)), FeedMode.INVERSE_TIME)
            x += 1.0
        elif kind < 0.86:
            b += rng.choice((0.0, 10.0))  # no move, or one of an angle alone
        elif kind < 0.87:
            feed = Feed(0.0)
            y += 1.0
        elif kind < 0.88:
            moves.append(LinearMove(target(x + 400.0, y, z, a, b), feed, at(line)))
            continue
        elif kind < 0.90:
            moves.append(RapidMove(target(x, y, z, a, b), at(line)))
            continue
        elif kind < 0.92:
            centre = (x + 5.0, y, z)
            x += 10.0
            moves.append(ArcMove(target(x, y, z, a, b), centre, (0.0, 0.0, 1.0), 180.0, feed, at(line)))
            continue
        elif kind < 0.94:
            moves.append(PathModeChange(PathMode.BLEND, rng.choice((0.5, 2.0)), None, at(line)))
            continue
        elif kind < 0.95:
            moves.append(ToolChange(rng.choice((0.0, 20.0)), (0.0, 0.0), at(line)))
            continue
        elif kind < 0.96:
            moves.append(JointMove(4, rng.uniform(-20, 20), True, at(line)))
            continue
        else:
            moves.append(Dwell(0.1, at(line)))
            continue
        moves.append(LinearMove(target(x, y, z, a, b), feed, at(line)))
    return moves


def alike(first: Finding, second: Finding) -> bool:
    """Equal but for what rounding may do to the place, the joints and the amount."""
    if (first.severity, first.kind, first.source, first.text, first.remedy, first.count) != (
        second.severity, second.kind, second.source, second.text, second.remedy, second.count,
    ):  # fmt: skip
        return False
    assert (first.via is None) == (second.via is None)
    for one, other in ((first.place_mm, second.place_mm), (first.amount, second.amount)):
        assert (one is None) == (other is None)
        assert one is None or one == pytest.approx(other, rel=1e-7, abs=1e-7)
    return first.q_deg is None or first.q_deg == pytest.approx(second.q_deg, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("config", [PLAIN, GUARDED], ids=["plain", "guarded"])
def test_arrays_find_what_elements_find(seed: int, config: object, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(config, type(PLAIN))
    arm = Arm.from_config(config)
    moves = random_program(random.Random(seed), 900)

    def report() -> tuple[PreflightReport, list[float]]:
        check = ProgramCheck(arm, config, PICK_START_DEG)
        made = check.run(moves, estimate=False)
        return made, check.q_deg.tolist()

    fast, fast_end = report()
    monkeypatch.setattr(check_module, "FEWEST_LINES", 10**9)
    slow, slow_end = report()
    assert len(fast.findings) == len(slow.findings)
    for one, other in zip(fast.findings, slow.findings, strict=True):
        assert alike(one, other), f"{one}\n{other}"
    assert len(slow.findings) > 5
    assert fast_end == pytest.approx(slow_end, abs=1e-9)
    assert (fast.checked_to_line, fast.moves) == (slow.checked_to_line, slow.moves)


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

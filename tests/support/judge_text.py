"""From the text of a program to verdicts: plan and segment it as `rm501-host plan` does, then judge both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rm501_host.config import Config
from rm501_host.kinematics import Arm
from rm501_host.planner import Piece, Plan, PlanError, Planner
from rm501_host.preflight import PreflightReport, ProgramCheck
from rm501_host.program import read_moves
from rm501_host.segmenter import Segmenter
from rm501_host.segmenter.fit import to_q48

from .judge_arm import Array
from .judge_plan import Verdict, judge_plan
from .judge_program import Item, UnreachableTarget, read_program
from .judge_segments import SegmentVerdict, judge_segments


@dataclass(frozen=True)
class Judgement:
    """What came of a program: refused by the planner or judged; the judge's own reading may find no way either."""

    refused: PlanError | None
    plan: Plan | None
    law: Verdict | None
    segments: SegmentVerdict | None
    items: list[Item]
    unreachable: str = ""

    @property
    def wrongs(self) -> list[str]:
        found = [] if self.law is None else list(self.law.wrongs)
        return found + ([] if self.segments is None else self.segments.wrongs)


def judge_program(
    config: Config, program: Path, start_deg: tuple[float, ...], *, segments: bool = True, most_places: int = 400
) -> Judgement:
    """Plan a file from joints `start_deg` (5,), and judge the law and its segments. Raises GcodeError."""
    arm = Arm.from_config(config)
    items: list[Item] = []
    unreachable = ""
    try:
        items = read_program(config, program, np.array(start_deg))
    except UnreachableTarget as error:
        unreachable = str(error)
    planner = Planner(arm, config, start_deg)
    moves = read_moves(program, arm, lambda: planner.q_deg.tolist(), config=config)
    try:
        plan = Plan(arm, config, planner.plan(moves))
        made = []
        first = [*map(to_q48, arm.motors_from_joints(start_deg).tolist()), 0]
        if segments and plan.duration_s > 0.0:
            made = [item.segment for item in Segmenter(config, first, 0).segments(plan.pieces)]
    except PlanError as error:
        return Judgement(error, None, None, None, items, unreachable)
    if unreachable or plan.duration_s == 0.0:
        return Judgement(None, plan, None, None, items, unreachable)
    found = plan.sample()
    samples = {
        "t_s": found.t_s,
        "q_deg": found.q_deg,
        "tcp_mm": found.tcp_mm,
        "motor_steps": found.motor_steps,
        "line": found.line,
    }
    law = judge_plan(config, items, samples, np.array(start_deg), most_places=most_places)
    judged = judge_segments(config, items, made, first, ideal(plan.pieces)) if made else None
    return Judgement(None, plan, law, judged, items)


def ideal(pieces: tuple[Piece, ...]):  # type: ignore[no-untyped-def]  # a closure for judge_segments
    timed = [piece for piece in pieces if piece.duration_s > 0.0]
    ends = np.array([piece.end_s for piece in timed]) - timed[0].start_s

    def joints(time_s: Array) -> Array:
        out = np.zeros((len(time_s), 5))
        which = np.minimum(np.searchsorted(ends, time_s - 1e-9), len(timed) - 1)
        for k in np.unique(which):
            rows = which == k
            piece = timed[k]
            offset = time_s[rows] - (piece.start_s - timed[0].start_s)
            out[rows] = piece.q_deg(np.clip(offset, 0.0, piece.duration_s))
        return out

    return joints


def preflight(config: Config, program: Path, start_deg: tuple[float, ...]) -> PreflightReport:
    """What the preflight says without asking the planner. Raises GcodeError."""
    arm = Arm.from_config(config)
    check = ProgramCheck(arm, config, start_deg)
    moves = read_moves(program, arm, lambda: check.q_deg.tolist(), config=config)
    return check.run(moves, estimate=False)

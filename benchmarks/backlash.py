"""Backlash: where links end up, with and without compensation, and what it costs.

    python -m benchmarks.backlash [--no-emulator]

An arm with play is a gap between motor and link: segments are stepped in integers, links follow through the gap. The
last rows are the emulated board with play in the waist's gear, homed and moved. Limits: law and take-up together from
differences at every motion frame, segments from their integers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config, load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import JointMove, Move
from rm501_host.planner import Planner
from rm501_host.planner.limits import Limits
from rm501_host.segmenter import OffsetLaw, PlannedSegment, Segmenter
from rm501_host.segmenter.backlash import REVERSAL_STEPS
from rm501_host.segmenter.fit import to_q48
from rm501_host.virtual_time import run_virtual
from rm501_protocol.enums import SegmentFlag
from rm501_sim_board.presets import PRESETS
from tests.host.planner.programs import PICK_START_DEG, at, pick_and_place
from tests.support.loose_bench import LOOSE, loose_bench, waist_errors_deg
from tests.support.plan_checker import judge_samples, motor_matrix, play_segments
from tests.support.play import ideal_deg, links_deg, motor_side_deg, with_backlash

Array = NDArray[np.float64]
PLAIN = load_config()
ARM = Arm.from_config(PLAIN)
PLAY_DEG = (0.2, 0.1, 0.1, 0.15, 0.15)
EMULATED_PLAY_DEG = 0.6
WRIST_PLAY_DEG = (0.3, 0.2)
WORST_REST_STEPS = REVERSAL_STEPS + 0.001
"""A joint that comes back by less is not sent over: it stands off by what it came back."""
WORST_SPREAD_STEPS = 1.5
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True)
class Row:
    """What one run left: rest and largest errors of the link in deg and of the tool in mm, times, ratios."""

    rest_deg: float
    rest_mm: float
    most_mm: float
    off_s: float
    cycle_s: float
    tail_s: float
    segments: int
    law: float
    played: float


def zigzag() -> list[Move]:
    """The waist to and fro, 20 to 0.2 deg."""
    return [JointMove(0, way, True, at(line + 1)) for line, way in enumerate((20, -20, 5, -5, 1, -1, 0.2, -0.2))]


def run(config: Config, moves: Sequence[Move], play_deg: Sequence[float]) -> Row:
    """Plan and segment under `config`, on an arm with `play_deg`, every joint hanging on its lower flank."""
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    lead = 0.5 * np.array([joint.backlash_deg for joint in config.joints.ordered])
    pieces = list(Planner(ARM, config, PICK_START_DEG).plan(moves))
    start = [*map(to_q48, (motor_matrix(config) @ (np.array(PICK_START_DEG) + lead)).tolist()), 0]
    planned = list(Segmenter(config, start, 0, OffsetLaw.still(lead.tolist())).segments(pieces))
    side, ideal = motor_side_deg(config, planned), ideal_deg(config, planned, pieces)
    links = links_deg(side, play_deg, 0.5 * np.array(play_deg))
    if not lead.any():
        links = links + 0.5 * np.array(play_deg)
    tool = np.linalg.norm(ARM.fk_batch(links)[0] - ARM.fk_batch(ideal)[0], axis=1)
    ends = np.cumsum([item.segment.length_frames for item in planned])
    rests = [end for end, item in zip(ends, planned, strict=True) if item.segment.flags & SegmentFlag.ENDS_AT_REST]
    judged = judge_samples(config, np.arange(len(ideal)) * frame_s, ideal + offsets_deg(planned))
    return Row(
        float(np.abs(links - ideal)[rests].max()),
        float(tool[rests].max()),
        float(tool.max()),
        float((tool > 0.1).sum() * frame_s),
        len(ideal) * frame_s,
        sum(item.tail_frames for item in planned) * frame_s,
        len(planned),
        judged.worst,
        play_segments(config, planned, pieces).worst,
    )


def offsets_deg(planned: Sequence[PlannedSegment]) -> Array:
    """Offsets (frames + 1, 5) that the segments carry."""
    blocks = [
        item.offsets.at(np.arange(item.start_frame + (number > 0), item.end_frame + 1, dtype=np.float64))[0]
        for number, item in enumerate(planned)
    ]
    return np.concatenate(blocks)


def compare() -> bool:
    """With and without on several programs; False when a target is missed."""
    good = True
    print(f"play {PLAY_DEG} deg; share of acceleration {PLAIN.planner.backlash_acceleration_share}")
    print(
        "                                     rest error      largest   off by     cycle    tail  segm.  "
        "law/     segments/"
    )
    print(
        "                                     deg      mm     mm        0.1 mm, s  s        s            limit    limit"
    )
    cases = (
        ("waist to and fro", zigzag(), False),
        ("pick and place F2800 G61.1", pick_and_place(2800.0, None), False),
        ("pick and place F6000 P5", pick_and_place(6000.0, 5.0), False),
        ("pick and place F6000 P5, jerk", pick_and_place(6000.0, 5.0), True),
    )
    step_deg = 1.0 / 40.0
    for name, moves, jerk in cases:
        for with_it in (False, True):
            config = with_backlash(PLAIN, PLAY_DEG if with_it else (0.0,) * 5, jerk_limited=jerk)
            row = run(config, moves, PLAY_DEG)
            print(
                f"{name:30} {'with' if with_it else '':5} {row.rest_deg:.4f} {row.rest_mm:6.3f} {row.most_mm:6.3f} "
                f"{row.off_s:10.2f} {row.cycle_s:12.3f} {row.tail_s:6.3f} {row.segments:6} "
                f"{row.law:10.6f} {row.played:8.4f}"
            )
            good &= row.law <= 1.0 + 1e-6 and row.played <= 1.02
            good &= not with_it or row.rest_deg <= WORST_REST_STEPS * step_deg
    return good


def wrist() -> bool:
    """Play in the wrist's gear trains: not compensated, as if it were the joints', and as what it is."""
    points = [PICK_START_DEG]
    for pitch, roll in ((5, 5), (9, 4), (7, 0), (7, -4), (5, -4), (8, -2), (8.3, -2), (8.0, -2.6)):
        points.append((*PICK_START_DEG[:3], PICK_START_DEG[3] + pitch, PICK_START_DEG[4] + roll))
    moves = [
        JointMove(joint, last[joint] - first[joint], True, at(line + 1))
        for line, (first, last) in enumerate(pairwise(points))
        for joint in (3, 4)
        if first[joint] != last[joint]
    ]
    mean = sum(WRIST_PLAY_DEG) / 2
    print(f"\n{WRIST_PLAY_DEG} deg of play in the wrist's motors, pitch and roll in turn      rest error, deg")
    worst = 0.0
    for name, config in (
        ("not compensated", PLAIN),
        (f"as play of {mean} deg in pitch and roll", with_backlash(PLAIN, (0.0, 0.0, 0.0, mean, mean))),
        ("as play of the motors", with_backlash(PLAIN, (0.0,) * 5, WRIST_PLAY_DEG)),
    ):
        pieces = list(Planner(ARM, config, PICK_START_DEG).plan(moves))
        start = [*map(to_q48, (motor_matrix(config) @ PICK_START_DEG).tolist()), 0]
        planned = list(Segmenter(config, start, 0).segments(pieces))
        side, ideal = motor_side_deg(config, planned), ideal_deg(config, planned, pieces)
        matrix = np.array(config.drive.wrist_matrix)
        links = links_deg(side[:, 3:] @ matrix.T, WRIST_PLAY_DEG, (0.0, 0.0)) @ np.linalg.inv(matrix).T
        ends = np.cumsum([item.segment.length_frames for item in planned])
        rests = [e for e, item in zip(ends, planned, strict=True) if item.segment.flags & SegmentFlag.ENDS_AT_REST]
        worst = float(np.abs(links - ideal[:, 3:])[rests[2:]].max())
        print(f"  {name:68} {worst:.4f}")
    return worst <= 2.0 * WORST_REST_STEPS / 26.6


def shares() -> None:
    """What the reserve costs, and how soon the play is taken up."""
    print("\nshare of acceleration   take-up of waist, shoulder, pitch, s   pick and place F6000 P5, s")
    without = sum(piece.motion_s for piece in Planner(ARM, PLAIN, PICK_START_DEG).plan(pick_and_place(6000.0, 5.0)))
    print(f"{'none':>21}   {'':36}   {without:8.3f}")
    for share in SHARES:
        config = with_backlash(PLAIN, PLAY_DEG, backlash_acceleration_share=share)
        limits = Limits.from_config(config)
        takes = 2.0 * np.sqrt(limits.backlash_deg[:5] / limits.take_up_acceleration_deg_s2[:5])
        motion = sum(piece.motion_s for piece in Planner(ARM, config, PICK_START_DEG).plan(pick_and_place(6000.0, 5.0)))
        print(f"{share:21}   {takes[0]:10.3f} {takes[1]:12.3f} {takes[3]:12.3f}   {motion:8.3f}")


def emulated() -> bool:
    """The waist of the emulated arm, turned round several times; False when it does not come to the same place."""
    PRESETS[LOOSE] = loose_bench(EMULATED_PLAY_DEG)
    print(
        f"\nemulated board, {EMULATED_PLAY_DEG} deg of play in the waist: truth less command in deg\n"
        "after homing, up, up, down, down, up a little, down a little"
    )
    spreads = []
    for with_it in (False, True):
        config = with_backlash(PLAIN, (EMULATED_PLAY_DEG if with_it else 0.0, 0.0, 0.0, 0.0, 0.0))
        errors = run_virtual(waist_errors_deg(config, -120.0))
        spreads.append(float(np.ptp(errors)))
        row = " ".join(f"{error:7.3f}" for error in errors)
        print(
            f"{'with' if with_it else 'without':8} {row}   spread {spreads[-1]:.3f} deg = {40 * spreads[-1]:.1f} steps"
        )
    return 40.0 * spreads[1] <= WORST_SPREAD_STEPS


def main() -> int:
    """Print the tables; 1 when a target is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.backlash", description=__doc__)
    parser.add_argument("--no-emulator", action="store_true", help="leave the emulated board out")
    arguments = parser.parse_args()
    good = compare()
    good &= wrist()
    shares()
    if not arguments.no_emulator:
        good &= emulated()
    print(f"backlash: {'every target met' if good else 'MISSED'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

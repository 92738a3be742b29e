"""What motion costs on the wire, how much of it 32 segments hold, whether it drifts, and how fast the codec is.

python -m benchmarks.wire [--n 1e5] [--seed 1]

Bytes count segment frames only, whole (header, checksum, stuffing, delimiter), per second of motion, at the
configured tolerance (0.1 step). Three seeded workloads of about 60 s: 12 joint moves with a lead motor of 2000 to
6000 steps, 49 of 50 to 600 steps, 14 Cartesian lines. `--n` is the number of random segments whose exact end the
host's mirror and the board's stepping must agree on (1e6 in full); the board's side decodes the bytes and adds frame
by frame, in leaps of its own (powers of two by doubling), sharing no formula with the mirror.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, LinearMove, Move, PathMode, PathModeChange, Source
from rm501_host.planner import Piece, PlanError, Planner, plan_joint_move
from rm501_host.planner.limits import Limits
from rm501_host.segmenter import PlannedSegment, Segmenter, stop_horizon
from rm501_host.segmenter.fit import to_q48
from rm501_protocol.declaration import decode_payload, encode_payload
from rm501_protocol.framing import FRAME_OVERHEAD, StreamCodec
from rm501_protocol.header import HEADER
from rm501_protocol.messages import MotorTerm, Segment, SegmentFlag
from rm501_protocol.segment import ONE_STEP, end_positions_q48

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
LIMITS = Limits.from_config(CONFIG)
FRAME_S = CONFIG.board.base_period_us * len(CONFIG.board.table) * 1e-6
QUEUE = 32
STALL_S = 0.5
DRIFT_STEPS = 1e-6


@dataclass(frozen=True)
class Workload:
    """A seeded motion and its target in bytes per second of motion."""

    name: str
    target: float
    make: Callable[[random.Random], tuple[Sequence[float], list[Piece]]]


def _joint_moves(rng: random.Random, count: int, least: int, most: int) -> tuple[Sequence[float], list[Piece]]:
    start = np.array((0.0, 40.0, -45.0, 60.0, 0.0))
    here, pieces, start_s = start, [], 0.0
    while len(pieces) < count:
        there = np.array([rng.uniform(low, high) for low, high in zip(LIMITS.min_deg, LIMITS.max_deg, strict=True)])
        steps = np.abs(ARM.motors_from_joints(there) - ARM.motors_from_joints(here))
        there = here + (there - here) * (rng.uniform(least, most) / float(steps.max()))
        if np.any(there < LIMITS.min_deg) or np.any(there > LIMITS.max_deg):
            continue
        for piece in plan_joint_move(ARM, CONFIG, here, there, start_s=start_s):
            pieces.append(piece)
            start_s += piece.duration_s
        here = there
    return start, pieces


def _lines(rng: random.Random, count: int) -> tuple[Sequence[float], list[Piece]]:
    """Lines of 60 to 200 mm with pitch and roll along, each planned on its own, so that one that cannot be is drawn
    anew.
    """
    start = q_deg = np.array((-12.0, 60.0, -80.0, 50.0, 0.0))
    pose = ARM.fk(start)
    here = (*(float(value) for value in pose.xyz_mm), float(pose.pitch_deg), float(pose.roll_deg))
    moves: list[Move] = [PathModeChange(PathMode.EXACT_STOP, None, None, Source("wire", 1))]
    while len(moves) <= count:
        there = (
            rng.uniform(180, 330),
            rng.uniform(-200, 200),
            rng.uniform(120, 300),
            rng.uniform(0, 80),
            rng.uniform(-60, 60),
        )
        length = float(np.linalg.norm(np.subtract(there[:3], here[:3])))
        if not 60.0 <= length <= 200.0:
            continue
        move = LinearMove((*there, 0.0), Feed(6000.0), Source("wire", len(moves) + 1))
        trial = Planner(ARM, CONFIG, q_deg)
        try:
            list(trial.plan([moves[0], move]))
        except PlanError:
            continue
        q_deg, here = trial.q_deg, there
        moves.append(move)
    return start, list(Planner(ARM, CONFIG, start).plan(moves))


WORKLOADS = (
    Workload("12 joint moves, 2000-6000 steps", 150.0, lambda rng: _joint_moves(rng, 12, 2000, 6000)),
    Workload("49 joint moves, 50-600 steps", 600.0, lambda rng: _joint_moves(rng, 49, 50, 600)),
    Workload("14 Cartesian lines", 250.0, lambda rng: _lines(rng, 14)),
)


def frame_bytes(segment: Segment) -> int:
    """Bytes of the segment's frame on a serial line."""
    return len(encode_payload(segment)) + FRAME_OVERHEAD


def segments_of(start_deg: Sequence[float], pieces: list[Piece]) -> list[PlannedSegment]:
    """The segments of a motion from `start_deg`."""
    positions = [*map(to_q48, ARM.motors_from_joints(start_deg).tolist()), 0]
    return list(Segmenter(CONFIG, positions, 0).segments(pieces))


def held_s(segments: list[PlannedSegment]) -> float:
    """Least motion in seconds that a full queue holds."""
    lengths = [planned.segment.length_frames for planned in segments]
    windows = range(max(1, len(lengths) - QUEUE + 1))
    return min(sum(lengths[first : first + QUEUE]) for first in windows) * FRAME_S


def random_segments(count: int, seed: int) -> Iterator[Segment]:
    """Segments of five motors that stay about where they are, quadratic and cubic."""
    rng = random.Random(seed)
    start = 0
    for _ in range(count):
        cubic = rng.random() < 0.5
        length = rng.randrange(1, 2000)
        motors = tuple(
            MotorTerm(
                motor,
                rng.randrange(-(1 << 30), 1 << 30),
                rng.randrange(-(1 << 24), 1 << 24),
                rng.randrange(-(1 << 16), 1 << 16) if cubic else 0,
            )
            for motor in range(5)
        )
        yield Segment(start, length, motors, SegmentFlag.CUBIC if cubic else SegmentFlag.NONE)
        start = start + length & 0xFFFFFFFF


def stepped(term: MotorTerm, frames: int) -> int:
    """What stepping `frames` times adds to the position, by doubling.

    One frame maps (p, v, a, j) to (p + v, v + a, a + j, j): a unipotent map, whose n-th power is written as the
    increments (of v, a, j) that p, v and a get. Composing such powers is all that happens here.
    """
    leap = (1, 0, 0, 1, 0, 1)  # p += 1 v + 0 a + 0 j; v += 1 a + 0 j; a += 1 j
    p, v, a, j = 0, term.v << 16, term.a << 8, term.j
    while frames:
        pv, pa, pj, va, vj, aj = leap
        if frames & 1:
            p, v, a = p + pv * v + pa * a + pj * j, v + va * a + vj * j, a + aj * j
        leap = (2 * pv, 2 * pa + pv * va, 2 * pj + pv * vj + pa * aj, 2 * va, 2 * vj + va * aj, 2 * aj)
        frames >>= 1
    return p


def drift(count: int, seed: int) -> tuple[float, float, float]:
    """Largest difference in steps of mirror and board after `count` segments; segments/s encoded and decoded."""
    mirror: tuple[int, ...] = (0,) * 6
    board = [0] * 6
    codec, far = StreamCodec(), StreamCodec()
    encoding = decoding = 0.0
    header = HEADER.pack(Segment.ID, 0, 0, 0, 0, 0, 0)
    batch: list[Segment] = []
    source = random_segments(count, seed)
    for first in range(0, count, 1000):
        batch = [segment for segment, _ in zip(source, range(min(1000, count - first)), strict=False)]
        began = time.perf_counter()
        data = b"".join(codec.encode(header + encode_payload(segment)) for segment in batch)
        middle = time.perf_counter()
        decoded = [decode_payload(packet[0], packet[8:]) for packet in far.feed(data)]
        encoding += middle - began
        decoding += time.perf_counter() - middle
        for segment, received in zip(batch, decoded, strict=True):
            mirror = end_positions_q48(mirror, segment)
            assert isinstance(received, Segment)
            for term in received.motors:
                board[term.motor] += stepped(term, received.length_frames)
    worst = max(abs(a - b) for a, b in zip(mirror, board, strict=True))
    return worst / ONE_STEP, count / encoding, count / decoding


def main(arguments: list[str] | None = None) -> int:
    """Run it; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=float, default=1e5, help="segments of the drift part (default 1e5)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)

    failed = False
    head = f"{'workload':<34}{'motion s':>9}{'segments':>9}{'bytes/s':>9}{'target':>8}"
    print(f"{head}{'32 hold s':>11}{'needed s':>10}{'error':>8}")
    worst_share = 0.0
    for workload in WORKLOADS:
        start, pieces = workload.make(random.Random(options.seed))
        planned = segments_of(start, pieces)
        motion_s = sum(item.segment.length_frames for item in planned if item.segment.motors) * FRAME_S
        rate = sum(frame_bytes(item.segment) for item in planned) / motion_s
        horizon = stop_horizon(CONFIG, planned)
        needed_s = max(horizon.stop_s, horizon.hold_s) + STALL_S
        held = held_s(planned)
        error = max(item.max_error_steps for item in planned)
        missed = rate > workload.target or held < needed_s or error > CONFIG.planner.tolerance_steps
        failed = failed or missed
        worst_share = max(worst_share, rate / workload.target)
        print(
            f"{workload.name:<34}{motion_s:>9.1f}{len(planned):>9}{rate:>9.0f}{workload.target:>8.0f}"
            f"{held:>11.2f}{needed_s:>10.2f}{error:>8.3f}{'  MISSED' if missed else ''}"
        )
    count = int(options.n)
    difference, encoded, decoded = drift(count, options.seed)
    failed = failed or difference > DRIFT_STEPS
    print(f"drift after {count} segments: {difference:g} step (target {DRIFT_STEPS:g})")
    print(f"codec: {encoded:.0f} segments/s encoded and framed, {decoded:.0f} unframed and decoded (five motors)")
    print(f"wire: {'FAILED' if failed else 'ok'}, worst workload at {100 * worst_share:.0f} % of its bytes")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

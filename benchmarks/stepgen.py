"""The board: how fast the model runs, and whether anything makes it step wrong.

    python -m benchmarks.stepgen [--n 1e5] [--holds 1000] [--seed 1] [--only speed|segments|holds|stalls]

speed     reference >= 5 x, fast path >= 100 x real time, all motors at full rate, same port word in every base period
segments  n random ones, legal and malicious: no timing violation at the pins, no wrong step, |position - count| <= 0.54
holds     the pick-and-place program held and resumed so many times: same levels, no event lost, acceleration in bounds
stalls    the host silent for 0.1 .. 60 s at full speed: the arm stops on its path and goes on to the same end

Exit 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rm501_firmware_model import Board, BoardLayout, FastBoard
from rm501_host.config import load_config
from rm501_host.config.board import board_config_from
from rm501_host.kinematics import Arm
from rm501_host.planner import Planner
from rm501_host.program import read_moves
from rm501_host.segmenter import Segmenter
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState
from rm501_protocol.segment import ONE_STEP
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.holding import MOTORS, Ideal, Player, hold_often, stall, trace, worst_acceleration
from tests.firmware_model.rig import Rig
from tests.firmware_model.torture import torture

ROOT = Path(__file__).parents[1]
FULL_RATE = int(0.4 * 2**32)  # 1250 steps/s
REFERENCE_TARGET, FAST_TARGET = 5.0, 100.0
LAG_TARGET = 0.54
STALLS_S = (0.1, 0.5, 2.0, 10.0, 60.0)
LEAD_FRAMES = 8000
"""What a host keeps queued here: 2.56 s, the stop horizon and a stall budget."""


class CountingPins:
    """Constant inputs; keeps what it is told to, counts the rest."""

    def __init__(self, inputs: int, keep: bool) -> None:
        self.inputs = inputs
        self.keep = keep
        self.blocks: list[np.ndarray] = []  # type: ignore[type-arg]  # uint32, shape (frames, periods)
        self.words = 0

    def read_inputs(self, frame: int) -> int:
        """The constant input word."""
        return self.inputs

    def inputs_stable_until(self, frame: int) -> int:
        """For ever."""
        return frame + (1 << 40)

    def write_frame(self, frame: int, words: list[int]) -> None:
        """Count, and keep if told to."""
        self.words += len(words)
        if self.keep:
            self.blocks.append(np.array([words], dtype=np.uint32))

    def write_block(self, first_frame: int, words: np.ndarray) -> None:  # type: ignore[type-arg]
        """Count, and keep if told to."""
        self.words += words.size
        if self.keep:
            self.blocks.append(words)


def _full_rate(board: type[Board], keep: bool) -> tuple[Rig, CountingPins]:
    """A board with every motor at 1250 steps/s, in segments of 0.64 s, as a host would send them."""
    rig = Rig(board=board, connect=False)
    pins = CountingPins(rig.pins.inputs, keep)
    rig.board._pins = pins
    rig.connect()
    from rm501_protocol.messages import SetPower

    rig.send(SetPower(True))
    rig.run(1)
    ramp = 8000
    terms = [MotorTerm(m, 0, (FULL_RATE << 8) // ramp * (-1 if m % 2 else 1)) for m in MOTORS]
    rig.go(rig.segment(ramp, *terms), *[_cruise(rig) for _ in range(30)])
    rig.run(ramp + 10, 500)
    return rig, pins


def _cruise(rig: Rig) -> Segment:
    top = ((FULL_RATE << 8) // 8000 * 8000) >> 8
    return rig.segment(2000, *[MotorTerm(m, -top if m % 2 else top) for m in MOTORS])


def speed(frames: int) -> bool:
    """Real-time factors at full rate, and the words compared."""
    print(f"speed: all motors at 1250 steps/s, {frames} frames, one core")
    factors = {}
    kept = {}
    for name, board in (("reference", Board), ("fast path", FastBoard)):
        rig, pins = _full_rate(board, keep=False)
        pins.words = 0
        spent = 0.0
        done = 0
        while done < frames:
            begin = time.process_time()
            rig.run(1000, 500)
            spent += time.process_time() - begin
            done += 1000
            while rig.host.segment_credit > 2:
                rig.send(_cruise(rig))
        assert rig.state is BoardState.RUNNING, rig.state
        factors[name] = done * rig.board.frame_us * 1e-6 / spent
        print(
            f"  {name}: {factors[name]:7.1f} x real time, {pins.words / spent / 1e6:6.2f} M port words/s, link included"
        )
        rig, pins = _full_rate(board, keep=True)
        rig.run(3000, 500)
        kept[name] = np.concatenate(pins.blocks)
    same = np.array_equal(kept["reference"], kept["fast path"])
    print(f"  identical port words over {len(kept['reference'])} frames: {same}")
    return factors["reference"] >= REFERENCE_TARGET and factors["fast path"] >= FAST_TARGET and same


def segments(count: int, seed: int) -> bool:
    """Random segments, judged at the pins."""
    found = torture(count, seed)
    print(f"segments: {found.segments} offered, {found.accepted} accepted, {found.refused} refused whole")
    print(f"  refused for: {', '.join(f'{name} {times}' for name, times in sorted(found.refused_for.items()))}")
    print(f"  {found.frames} frames, {found.steps} steps at the pins")
    print(f"  timing violations {found.timing_violations}, motors with wrong counts {found.wrong_counts}, ", end="")
    print(f"disagreements with the judge {found.disagreements}, worst |position - count| {found.worst_lag:.4f} step")
    if found.first_problem:
        print(f"  first problem: {found.first_problem}")
    bad = found.timing_violations + found.wrong_counts + found.disagreements
    return bad == 0 and found.worst_lag <= LAG_TARGET


def pick_and_place() -> tuple[list[Segment], tuple[float, float]]:
    """The thesis's program as the host sends it, from motion frame 0 and step 0; hold and stop ratios it declares."""
    config = load_config(ROOT / "configs" / "thesis.toml")
    arm = Arm.from_config(config)
    planner = Planner(arm, config, config.home_deg)
    pieces = planner.plan(read_moves(ROOT / "examples" / "pick_and_place.ngc", arm, lambda: planner.q_deg.tolist()))
    first = tuple(round(step * ONE_STEP) for step in arm.motors_from_joints(config.home_deg))
    start = tuple(value // ONE_STEP * ONE_STEP for value in first)
    made = [planned.segment for planned in Segmenter(config, (*start, 0), 0).segments(pieces)]
    assert board_config_from(config).hash == RM501_BOARD.hash
    return made, (config.planner.hold_acceleration_ratio, config.planner.stop_acceleration_ratio)


def holds(count: int, seed: int) -> bool:
    """The program held and resumed over and over, against the undisturbed run."""
    program, (hold_ratio, stop_ratio) = pick_and_place()
    quiet = Player(program)
    quiet.play()
    quiet.settle()
    before = trace(quiet)
    held = hold_often(program, count, seed)
    after = trace(held)
    levels = np.array_equal(after.levels, before.levels)
    by_frame = np.array_equal(after.by_motion_frame, before.by_motion_frame)
    starts = len(after.hand_starts) == len(before.hand_starts) and all(
        abs(a - b) <= 1 for a, b in zip(after.hand_starts, before.hand_starts, strict=True)
    )
    ideal = Ideal(program)
    layout = BoardLayout(RM501_BOARD)
    limit = [layout.max_acceleration[m] / ONE_STEP for m in MOTORS]
    worst = max(worst_acceleration(ideal, after.motion_time, m) / limit[m] for m in MOTORS)
    plain = max(worst_acceleration(ideal, before.motion_time, m) / limit[m] for m in MOTORS)
    frames = (len(quiet.pins.motion_frames), len(held.pins.motion_frames))
    print(f"holds: pick and place, {len(program)} segments, held and resumed {count} times")
    print(f"  frames {frames[0]} undisturbed, {frames[1]} with holds; {len(before.levels)} changes of levels")
    print(f"  same levels with repeats removed: {levels}; the same in every motion frame: {by_frame}; ", end="")
    print(f"same counts: {after.counts == before.counts}")
    print(f"  hand: {len(before.hand)} pulses, the same: {after.hand == before.hand}, ", end="")
    print(f"{len(before.hand_starts)} strokes at their motion frames: {starts}")
    print(f"  smoothed acceleration / motor limit: {plain:.3f} undisturbed, {worst:.3f} with holds ", end="")
    print(f"(declared: hold {hold_ratio:g}, stop {stop_ratio:g})")
    same = levels and by_frame and after.counts == before.counts and after.hand == before.hand and starts
    return same and worst <= stop_ratio


def stalls() -> bool:
    """The host falls silent at full speed."""
    program, _ = pick_and_place()
    quiet = Player(program)
    quiet.play()
    quiet.settle()
    before = trace(quiet)
    at_frame = _fastest_frame(program)
    print(f"stalls: host silent from motion frame {at_frame} on, {LEAD_FRAMES} frames queued")
    print("  stall s   board then   cause        stood after s   steps lost   same levels   trusted")
    good = True
    for stall_s in STALLS_S:
        found = stall(program, at_frame, stall_s, LEAD_FRAMES, before)
        stood = f"{found.stopped_after_s:.3f}" if found.stopped_after_s > 0 else "moving"
        print(
            f"  {stall_s:7.1f}   {found.state.name:10s}   {found.cause.name:10s}   {stood:>13s}   "
            f"{found.steps_lost:10d}   {found.same_levels!s:>11s}   {found.trusted!s:>7s}"
        )
        good = good and found.steps_lost == 0 and found.same_levels and found.trusted
    return good


def _fastest_frame(program: list[Segment]) -> int:
    """Start of the segment in the middle of the program whose motors are fastest."""
    inner = program[len(program) // 4 : 3 * len(program) // 4]
    return max(inner, key=lambda segment: max((abs(term.v) for term in segment.motors), default=0)).start_frames


def main() -> int:
    """Run the parts asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=lambda text: int(float(text)), default=3000, help="random segments")
    parser.add_argument("--holds", type=lambda text: int(float(text)), default=100)
    parser.add_argument("--frames", type=lambda text: int(float(text)), default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=("speed", "segments", "holds", "stalls"))
    options = parser.parse_args()
    parts: dict[str, Callable[[], bool]] = {
        "speed": lambda: speed(options.frames),
        "segments": lambda: segments(options.n, options.seed),
        "holds": lambda: holds(options.holds, options.seed),
        "stalls": stalls,
    }
    random.seed(options.seed)
    results = {name: part() for name, part in parts.items() if options.only in (None, name)}
    missed = [name for name, good in results.items() if not good]
    print(f"stepgen: {'all targets met' if not missed else 'TARGET MISSED: ' + ', '.join(missed)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

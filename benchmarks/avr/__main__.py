"""Compile the tick for an ATmega2560, run it in simavr, compare it with the reference, print cycles and sizes.

`python -m benchmarks.avr` needs the Debian packages gcc-avr, avr-libc and simavr. Two figures for the tick: the worst
measured in each period, exact to the cycle, in programs with holds, reversals, inputs that always bounce, strokes of
the hand and a queue that runs low; and a bound, the longest path through the machine code, possible or not.
Exit 1 when a tick was measured that takes 60 % of its base period or more, when the bound is not below the base period
itself, or when the chip does anything else than the reference; exit 2 without the tools.
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from rm501_firmware_model.core import Core
from rm501_firmware_model.layout import BoardLayout
from rm501_firmware_model.memory import packed_bytes
from rm501_firmware_model.motion import RATE_ONE, Notice
from rm501_firmware_model.pins import inactive_inputs
from rm501_firmware_model.states import Stimulus
from rm501_firmware_model.stepgen import HALF_STEP
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState, HoldCause, SegmentFlag
from rm501_protocol.segment import A_SHIFT, FRACTION_BITS, V_SHIFT
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.programs import swinging_program

from .bound import longest_path

HERE = Path(__file__).parent
BASE_PERIOD_CYCLES = 640
TARGET_CYCLES = 384
ENTRY_CYCLES = 5 + 3
"""The chip enters an interrupt in 5 cycles; the vector table holds a jump."""
HELD = (900, 700, 1500)
"""Frames before the hold, holding, and after it."""
RUN_LOW = (3000, 0, 0)
"""The queue is given no more segments until motion has stopped for want of them."""
FIRST_MOTOR = 2
"""Period in which the first motor is updated, see kernel.h."""
MOTORS = 5
COMPILER_FLAGS = ("-O3", "-Wall", "-Wextra", "-std=gnu11")
WORK = ("first_period", "second_period", *["motor_frame"] * MOTORS, "last_period")
"""What each period calls."""
Outcome = tuple[int, int, tuple[tuple[int, int, int], ...], bool]
Frames = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the chip said."""

    outcome: Outcome
    worst: tuple[int, ...]
    mean: tuple[float, ...]
    sizes: tuple[int, int, int]
    flash: int
    bounds: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Wiring:
    """Where the kernel finds the levels: halves are 2 slot + port, masks are for that port."""

    order: tuple[int, ...]
    halves: tuple[int, ...]
    masks: tuple[tuple[int, int], ...]
    hand_slots: tuple[int, int]
    hand_mask: int
    heartbeat: int


def program(seed: int) -> list[Segment]:
    """Segments near every limit, the same for chip and reference: full rates, reversals, short pieces."""
    return swinging_program(random.Random(seed), 12)[:30]


def program_without_end(seed: int) -> list[Segment]:
    """As much of the program as is over soon, and no point of rest in it: the board has to brake by itself."""
    segments = []
    for segment in swinging_program(random.Random(seed), 12)[:8]:
        flags = segment.flags & ~SegmentFlag.ENDS_AT_REST
        segments.append(replace(segment, flags=flags, length_frames=min(segment.length_frames, 300)))
    return segments


def _c_bytes(value: int, count: int) -> str:
    return "{" + ", ".join(str(byte) for byte in value.to_bytes(count, "little", signed=True)) + "}"


def _c_segment(segment: Segment, order: tuple[int, ...], cubic: bool) -> str:
    terms = {term.motor: term for term in segment.motors}
    rows = []
    for motor in order:
        term = terms.get(motor, MotorTerm(motor, 0))
        columns = [_c_bytes(term.v << V_SHIFT, 6), _c_bytes(term.a << A_SHIFT, 5)]
        rows.append("{" + ", ".join([*columns, _c_bytes(term.j, 4)] if cubic else columns) + "}")
    flags = int(segment.flags) & SegmentFlag.ENDS_AT_REST
    slopes = f"{segment.hold_slope}, {segment.hold_slope << 4}, {segment.stop_slope << 4}"
    return f"{{{segment.length_frames}, {flags}, {slopes}, {{{', '.join(rows)}}}}}"


def wiring(layout: BoardLayout) -> Wiring:
    """Sort the motors by slot and check what the kernel relies on; ValueError for what it cannot do."""
    last_period = {slot: period for period, slot in enumerate(layout.entry_slots)}
    order = tuple(sorted(range(MOTORS), key=lambda motor: last_period[layout.motor_slot[motor]]))
    halves, masks = [], []
    for index, motor in enumerate(order):
        step, direction = layout.motor_step_mask[motor], layout.motor_dir_mask[motor]
        port = 0 if step & 0xFFFF else 1
        if (step | direction) & (0xFFFF if port else 0xFFFF0000):
            raise ValueError(f"STEP and DIR of motor {motor} are not on one port")
        if last_period[layout.motor_slot[motor]] > FIRST_MOTOR + index:
            raise ValueError(f"motor {motor} is updated in period {FIRST_MOTOR + index}, before its slot's last word")
        halves.append(2 * layout.motor_slot[motor] + port)
        masks.append((step >> 16 * port, direction >> 16 * port))
    if layout.hand_dir_mask != layout.hand_pulse_mask or layout.hand_dir_mask >> 16 or layout.heartbeat_mask >> 16:
        raise ValueError("the lines of the hand and HEARTBEAT are not where the kernel has them")
    if layout.periods != len(layout.entry_slots) or layout.periods != 8:
        raise ValueError(f"the table has {layout.periods} entries, the kernel 8")
    return Wiring(
        order,
        tuple(halves),
        tuple(masks),
        (layout.hand_dir_slot, layout.hand_pulse_slot),
        layout.hand_pulse_mask,
        layout.heartbeat_mask,
    )


def measure(segments: list[Segment], frames: Frames, cubic: bool) -> Measurement:
    """Compile, run, parse."""
    layout = BoardLayout(RM501_BOARD)
    wired = wiring(layout)
    rest = sum(1 for segment in segments if segment.flags & SegmentFlag.ENDS_AT_REST)
    entries = [
        f"{{{word}UL, &board.slot[{slot}], "
        f"{f'&board.motor[{period - FIRST_MOTOR}]' if 0 <= period - FIRST_MOTOR < MOTORS else '0'}}}"
        for period, (word, slot) in enumerate(zip(layout.entry_words, layout.entry_slots, strict=True))
    ]
    defines = {
        "CUBIC": str(int(cubic)),
        "F_CPU": "16000000UL",
        "ENTRIES": ", ".join(entries),
        "HALVES": ", ".join(str(half) for half in wired.halves),
        "MASKS": ", ".join(f"{{{step}, {direction}}}" for step, direction in wired.masks),
        "HAND_DIR_SLOT": str(wired.hand_slots[0]),
        "HAND_PULSE_SLOT": str(wired.hand_slots[1]),
        "HAND_MASK": str(wired.hand_mask),
        "HEARTBEAT": str(wired.heartbeat),
        "SEGMENTS": ", ".join(_c_segment(segment, wired.order, cubic) for segment in segments),
        "REST_POINTS": str(rest),
        "ROOM": f"{loaded(segments).queue.room}ULL",
        "FRAMES_BEFORE_HOLD": f"{frames[0]}UL",
        "FRAMES_HOLDING": f"{frames[1]}UL",
        "FRAMES_AFTER_HOLD": f"{frames[2]}UL",
    }
    with tempfile.TemporaryDirectory() as folder:
        header = Path(folder) / "parameters.h"
        header.write_text("".join(f"#define {name} {value}\n" for name, value in defines.items()))
        elf = Path(folder) / "tick.elf"
        subprocess.run(
            [
                *("avr-gcc", "-mmcu=atmega2560", *COMPILER_FLAGS, "-include", str(header), "-I", str(HERE)),
                *(str(HERE / "main.c"), "-o", str(elf)),
            ],
            check=True,
        )
        size = subprocess.run(["avr-size", str(elf)], check=True, capture_output=True, text=True)
        flash = int(size.stdout.splitlines()[1].split()[0])
        listing = subprocess.run(["avr-objdump", "-d", str(elf)], check=True, capture_output=True, text=True)
        bounds = tuple(
            ENTRY_CYCLES + longest_path(listing.stdout, "__vector_17", [name for name in set(WORK) if name != work])
            for work in WORK
        )
        ran = subprocess.run(
            ["simavr", "-m", "atmega2560", "-f", "16000000", str(elf)],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    return _parse(ran.stdout + ran.stderr, wired.order, flash, bounds)


def _parse(output: str, order: tuple[int, ...], flash: int, bounds: tuple[int, ...]) -> Measurement:
    found: dict[str, list[list[int]]] = {}
    for line in output.replace("\x1b[32m", "").replace("\x1b[0m", "").splitlines():
        words = line.strip().rstrip(".").split()
        if words and words[0] in ("hash", "frame", "motor", "notices", "period", "state"):
            found.setdefault(words[0], []).append([int(word, 16) for word in words[1:]])
    if len(found.get("period", [])) != 8:
        raise RuntimeError(f"the simulated chip did not come to its end:\n{output}")
    rows = [(_signed(c, 32), _signed(lag, 56), _signed(v, 48)) for c, lag, v in found["motor"]]
    motors = dict(zip(order, rows, strict=True))
    return Measurement(
        (
            found["hash"][0][0],
            found["frame"][0][0],
            tuple(motors[motor] for motor in range(MOTORS)),
            bool(found["notices"][0][0] & Notice.LOW_WATER),
        ),
        tuple(row[0] for row in found["period"]),
        tuple(row[1] / row[2] for row in found["period"]),
        (found["state"][0][0], found["state"][0][1], found["state"][0][2]),
        flash,
        bounds,
    )


def _signed(value: int, bits: int) -> int:
    return value - (1 << bits) if value >> (bits - 1) else value


def loaded(segments: list[Segment]) -> Core:
    """A reference board that runs, with these segments queued."""
    core = Core(BoardLayout(RM501_BOARD), 32, 1)
    core.frame(inactive_inputs(RM501_BOARD))
    core.state = BoardState.RUNNING
    core.power = 1
    core.line_word = 0
    for segment in segments:
        core.queue.push(segment)
    return core


def reference(segments: list[Segment], run: Frames) -> Outcome:
    """Hash of the port words, motion frame, motors and whether it braked by itself, after the same run."""
    core = loaded(segments)
    quiet = inactive_inputs(RM501_BOARD)
    core.motion.start()
    core.hand.pending = -1200
    core.hand.phase = RATE_ONE
    # the chip makes a frame's levels while the words of the frame before are on the pins
    shown = list(core.layout.slot_words)
    value = 2166136261
    line = 0

    def frames(count: int) -> None:
        nonlocal value, line, shown
        for _ in range(count):
            for period in range(8):
                word = core.layout.entry_words[period] ^ shown[core.layout.entry_slots[period]] ^ line
                for byte in word.to_bytes(4, "little"):
                    value = (value ^ byte) * 16777619 & 0xFFFFFFFF
            core.frame(quiet)
            shown = list(core.layout.slot_words)
            line ^= core.layout.heartbeat_mask

    frames(run[0])
    if run[1]:
        core.answers(Stimulus.HOLD)
        core.hold(HoldCause.USER)
        core.hand.pending += 2000
        frames(run[1])
        core.answers(Stimulus.RESUME)
        core.release(1 << HoldCause.USER)
        if not core.motion.moving:  # it came to a stop: the chip's main loop would start it, here it just goes on
            core.state = BoardState.RUNNING
            core.motion.resume()
        frames(run[2])
    motors = tuple(
        (
            core.stepgen.count[m],
            core.stepgen.position[m] + HALF_STEP - (core.stepgen.count[m] << FRACTION_BITS),
            core.stepgen.velocity[m],
        )
        for m in range(MOTORS)
    )
    return value, core.motion.motion_frame, motors, bool(core.causes & 1 << HoldCause.LOW_WATER)


def report(name: str, runs: list[tuple[list[Segment], Frames]], cubic: bool) -> bool:
    """Measure one order in all programs, print it; whether every target is met."""
    chips = [measure(segments, frames, cubic) for segments, frames in runs]
    expected = [reference(segments, frames) for segments, frames in runs]
    worst = [max(column) for column in zip(*(chip.worst for chip in chips), strict=True)]
    mean = [max(column) for column in zip(*(chip.mean for chip in chips), strict=True)]
    bounds = [max(column) for column in zip(*(chip.bounds for chip in chips), strict=True)]
    bound = max(bounds)
    print(f"{name:10s}" + "".join(f"{cycles:5d} ({average:3.0f})" for cycles, average in zip(worst, mean, strict=True)))
    print(f"{'':10s}" + "".join(f"{cycles:5d} bound" for cycles in bounds))
    print(
        f"{'':10s}   worst tick {max(worst)} cycles = {100 * max(worst) / BASE_PERIOD_CYCLES:.1f} %; bound from the "
        f"machine code, ways that exclude each other added: {bound} = {100 * bound / BASE_PERIOD_CYCLES:.1f} %"
    )
    print(
        f"{'':10s}   all 8 ticks of a frame {100 * sum(mean) / 8 / BASE_PERIOD_CYCLES:.0f} % on the average; state in "
        f"RAM {chips[0].sizes[0]} bytes (motor {chips[0].sizes[1]}, segment {chips[0].sizes[2]})"
    )
    same = sum(chip.outcome == wanted for chip, wanted in zip(chips, expected, strict=True))
    braked = sum(wanted[3] for wanted in expected)
    print(
        f"{'':10s}   port words, motion frame, positions, speeds identical to the reference in {same} of {len(runs)} "
        f"programs, {braked} of them end by braking for low water"
    )
    for chip, wanted in zip(chips, expected, strict=True):
        if chip.outcome != wanted:
            print(f"{'':10s}   chip {chip.outcome}\n{'':10s}   ref  {wanted}")
    above = [f"period {period} {cycles}" for period, cycles in enumerate(worst) if cycles >= TARGET_CYCLES]
    if bound >= BASE_PERIOD_CYCLES:
        above.append(f"longest path {bound}, which does not end within a base period")
    if above:
        print(f"{'':10s}   not under {TARGET_CYCLES} cycles: {', '.join(above)}")
    return same == len(runs) and braked > 0 and not above


def main() -> int:
    """Measure both orders; 0 when every target is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--programs", type=int, default=12, help="programs of each kind, from the seed on")
    arguments = parser.parse_args()
    missing = [tool for tool in ("avr-gcc", "avr-size", "avr-objdump", "simavr") if shutil.which(tool) is None]
    if missing:
        print(f"not found: {', '.join(missing)}; install the Debian packages gcc-avr, avr-libc and simavr")
        return 2
    print(f"ATmega2560 at 16 MHz, base period {BASE_PERIOD_CYCLES} cycles; target: every tick below {TARGET_CYCLES}")
    print("cycles of the whole interrupt, entry and return included, in periods 0 to 7: worst (mean)")
    good = True
    seeds = range(arguments.seed, arguments.seed + arguments.programs)
    for cubic in (False, True):
        runs = [(program(seed), HELD) for seed in seeds] + [(program_without_end(seed), RUN_LOW) for seed in seeds]
        if not cubic:
            runs = [([_without_jerk(segment) for segment in segments], frames) for segments, frames in runs]
        good = report("cubic" if cubic else "quadratic", runs, cubic) and good
    print(f"whole state of the firmware as packed C, queue of 32: {packed_bytes(BoardLayout(RM501_BOARD), 32)} bytes")
    print(f"avr: {'every tick measured is under 60 % of its base period' if good else 'TARGET MISSED'}")
    return 0 if good else 1


def _without_jerk(segment: Segment) -> Segment:
    terms = tuple(replace(term, j=0) for term in segment.motors)
    return replace(segment, motors=terms, flags=segment.flags & ~SegmentFlag.CUBIC)


if __name__ == "__main__":
    sys.exit(main())

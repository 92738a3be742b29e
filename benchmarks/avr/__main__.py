"""Compile the tick for an ATmega2560, run it in simavr, compare it with the reference, print cycles and sizes.

`python -m benchmarks.avr` needs the Debian packages gcc-avr, avr-libc and simavr. Exit 1 when the ticks of a frame
take more than 60 % of its base periods on the average, one of them more than its base period, or when the chip does
anything else than the reference; exit 2 without the tools. Single ticks above 60 % are printed, see docs/adr/0004.
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
from rm501_firmware_model.pins import inactive_inputs
from rm501_firmware_model.states import Stimulus
from rm501_firmware_model.stepgen import HALF_STEP
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState, HoldCause, SegmentFlag
from rm501_protocol.segment import A_SHIFT, FRACTION_BITS, V_SHIFT
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.programs import swinging_program

HERE = Path(__file__).parent
BASE_PERIOD_CYCLES = 640
TARGET_CYCLES = 384
FRAMES = (900, 700, 1500)
"""Frames before the hold, holding, and after it."""
MOTORS = 5
COMPILER_FLAGS = ("-O3", "-Wall", "-Wextra", "-std=gnu11")
Outcome = tuple[int, int, tuple[tuple[int, int, int], ...]]


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the chip said."""

    hash: int
    motion_frame: int
    motors: tuple[tuple[int, int, int], ...]
    worst: tuple[int, ...]
    mean: tuple[float, ...]
    sizes: tuple[int, int, int]
    flash: int


def program(seed: int) -> list[Segment]:
    """Segments near every limit, the same for chip and reference: full rates, reversals, short pieces."""
    return swinging_program(random.Random(seed), 12)[:30]


def _c_bytes(value: int, count: int) -> str:
    return "{" + ", ".join(str(byte) for byte in value.to_bytes(count, "little", signed=True)) + "}"


def _c_segment(segment: Segment, cubic: bool) -> str:
    terms = {term.motor: term for term in segment.motors}
    rows = []
    for motor in range(MOTORS):
        term = terms.get(motor, MotorTerm(motor, 0))
        columns = [_c_bytes(term.v << V_SHIFT, 6), _c_bytes(term.a << A_SHIFT, 5)]
        rows.append("{" + ", ".join([*columns, _c_bytes(term.j, 4)] if cubic else columns) + "}")
    flags = int(segment.flags) & SegmentFlag.ENDS_AT_REST
    slopes = f"{segment.hold_slope}, {segment.stop_slope}"
    return f"{{{segment.length_frames}, {flags}, {slopes}, {{{', '.join(rows)}}}}}"


def _wiring(layout: BoardLayout, motor: int) -> tuple[int, int, int]:
    """Which half of which slot word a motor's levels are in, and its STEP and DIR bits there."""
    step, direction = layout.motor_step_mask[motor], layout.motor_dir_mask[motor]
    port = 0 if step & 0xFFFF else 1
    if (step | direction) >> 16 * port >> 16 or (step | direction) & (0xFFFF if port else 0):
        raise ValueError(f"STEP and DIR of motor {motor} are not on one port")
    return 2 * layout.motor_slot[motor] + port, step >> 16 * port, direction >> 16 * port


def measure(segments: list[Segment], cubic: bool) -> Measurement:
    """Compile, run, parse."""
    layout = BoardLayout(RM501_BOARD)
    wiring = [_wiring(layout, motor) for motor in range(MOTORS)]
    rest = sum(1 for segment in segments if segment.flags & SegmentFlag.ENDS_AT_REST)
    defines = {
        "CUBIC": str(int(cubic)),
        "F_CPU": "16000000UL",
        "ENTRY_WORDS": ", ".join(f"{word & 0xFFFF}, {word >> 16}" for word in layout.entry_words),
        "HALVES": ", ".join(str(half) for half, _, _ in wiring),
        "MASKS": ", ".join(f"{{{step}, {direction}}}" for _, step, direction in wiring),
        "HAND_MASK": str(layout.hand_pulse_mask),
        "SEGMENTS": ", ".join(_c_segment(segment, cubic) for segment in segments),
        "REST_POINTS": str(rest),
        "FRAMES_BEFORE_HOLD": f"{FRAMES[0]}UL",
        "FRAMES_HOLDING": f"{FRAMES[1] - 3}UL",
        "FRAMES_AFTER_HOLD": f"{FRAMES[2]}UL",
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
        ran = subprocess.run(
            ["simavr", "-m", "atmega2560", "-f", "16000000", str(elf)],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    return _parse(ran.stdout + ran.stderr, flash)


def _parse(output: str, flash: int) -> Measurement:
    found: dict[str, list[list[int]]] = {}
    for line in output.replace("\x1b[32m", "").replace("\x1b[0m", "").splitlines():
        words = line.strip().rstrip(".").split()
        if words and words[0] in ("hash", "frame", "motor", "spin", "period", "state"):
            found.setdefault(words[0], []).append([int(word, 16) for word in words[1:]])
    if len(found.get("period", [])) != 8:
        raise RuntimeError(f"the simulated chip did not come to its end:\n{output}")
    motors = tuple((_signed(c, 32), _signed(lag, 56), _signed(v, 48)) for c, lag, v in found["motor"])
    spin = found["spin"][0][0]
    return Measurement(
        found["hash"][0][0],
        found["frame"][0][0],
        motors,
        tuple(row[0] - spin for row in found["period"]),
        tuple(row[1] / row[2] - spin for row in found["period"]),
        (found["state"][0][0], found["state"][0][1], found["state"][0][2]),
        flash,
    )


def _signed(value: int, bits: int) -> int:
    return value - (1 << bits) if value >> (bits - 1) else value


def reference(segments: list[Segment]) -> Outcome:
    """Hash of the port words, motion frame and motors after the same run of the reference."""
    core = Core(BoardLayout(RM501_BOARD), 32, 1)
    quiet = inactive_inputs(RM501_BOARD)
    core.frame(quiet)
    return _run_reference(core, segments, quiet)


def _run_reference(core: Core, segments: list[Segment], quiet: int) -> Outcome:
    core.state = BoardState.RUNNING
    core.power = 1
    core.line_word = 0
    for segment in segments:
        core.queue.push(segment)
    core.motion.start()
    core.hand.command(-40)
    # the chip decides in one frame, moves the motors in the next and shows it in the one after
    shown = [list(core.layout.slot_words)] * 2
    value = 2166136261
    line = 0

    def frames(count: int) -> None:
        nonlocal value, line, shown
        for _ in range(count):
            for period in range(8):
                word = core.layout.entry_words[period] ^ shown[0][core.layout.entry_slots[period]] ^ line
                for byte in word.to_bytes(4, "little"):
                    value = (value ^ byte) * 16777619 & 0xFFFFFFFF
            core.frame(quiet)
            shown = [shown[1], list(core.layout.slot_words)]
            line ^= core.layout.heartbeat_mask

    frames(FRAMES[0])
    core.answers(Stimulus.HOLD)
    core.hold(HoldCause.USER)
    frames(FRAMES[1])
    core.answers(Stimulus.RESUME)
    core.release(1 << HoldCause.USER)
    frames(FRAMES[2])
    motors = tuple(
        (
            core.stepgen.count[m],
            core.stepgen.position[m] + HALF_STEP - (core.stepgen.count[m] << FRACTION_BITS),
            core.stepgen.velocity[m],
        )
        for m in range(MOTORS)
    )
    return value, core.motion.motion_frame, motors


def main() -> int:
    """Measure both orders; 0 when every target is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    seed = parser.parse_args().seed
    missing = [tool for tool in ("avr-gcc", "avr-size", "simavr") if shutil.which(tool) is None]
    if missing:
        print(f"not found: {', '.join(missing)}; install the Debian packages gcc-avr, avr-libc and simavr")
        return 2
    print(f"ATmega2560 at 16 MHz, base period {BASE_PERIOD_CYCLES} cycles; target: the tick takes less than 60 % of it")
    print("cycles of the whole interrupt, all motors running, with a hold, bouncing inputs and the hand: worst (mean)")
    good = True
    for cubic in (False, True):
        name = "cubic" if cubic else "quadratic"
        segments = program(seed)
        if not cubic:
            segments = [_without_jerk(segment) for segment in segments]
        chip = measure(segments, cubic)
        cells = "  ".join(f"{worst:3d} ({mean:3.0f})" for worst, mean in zip(chip.worst, chip.mean, strict=True))
        print(f"{name:10s} period 0..7: {cells}")
        print(
            f"{'':10s} of a frame's 8 ticks {100 * sum(chip.mean) / 8 / BASE_PERIOD_CYCLES:.0f} % on the average, "
            f"{100 * sum(chip.worst) / 8 / BASE_PERIOD_CYCLES:.0f} % if all were at their worst; "
            f"worst single tick {max(chip.worst)} = {100 * max(chip.worst) / BASE_PERIOD_CYCLES:.0f} %; "
            f"state in RAM {chip.sizes[0]} bytes (motor {chip.sizes[1]}, segment {chip.sizes[2]}), flash {chip.flash}"
        )
        expected = reference(segments)
        same = (chip.hash, chip.motion_frame, chip.motors) == expected
        print(f"{'':10s} identical to the reference (port words, motion frame, positions, speeds): {same}")
        if not same:
            print(f"{'':10s}   chip {chip.hash:08x} {chip.motion_frame} {chip.motors}")
            print(f"{'':10s}   ref  {expected[0]:08x} {expected[1]} {expected[2]}")
        above = [f"period {n} {100 * worst / BASE_PERIOD_CYCLES:.0f} %" for n, worst in enumerate(chip.worst)]
        above = [text for text, worst in zip(above, chip.worst, strict=True) if worst > TARGET_CYCLES]
        print(f"{'':10s} single ticks that can exceed 60 % of their own base period: {', '.join(above) or 'none'}")
        good = good and same and sum(chip.mean) / 8 < TARGET_CYCLES and max(chip.worst) < BASE_PERIOD_CYCLES
    print(f"whole state of the firmware as packed C, queue of 32: {packed_bytes(BoardLayout(RM501_BOARD), 32)} bytes")
    print(f"avr: {'target met for the tick averaged over a frame' if good else 'TARGET MISSED'}")
    return 0 if good else 1


def _without_jerk(segment: Segment) -> Segment:
    terms = tuple(replace(term, j=0) for term in segment.motors)
    return replace(segment, motors=terms, flags=segment.flags & ~SegmentFlag.CUBIC)


if __name__ == "__main__":
    sys.exit(main())

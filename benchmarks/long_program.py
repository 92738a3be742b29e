"""Long programs through the real `run`: CPU to the first segment, checked lines a second, memory.

    python -m benchmarks.long_program [--n LINES] [--cpu SECONDS] [--gigabyte]

A program of `--n` short lines (default 20,000; 1e5 in full) is run by `run_program` on the emulated board, in virtual
time and in a process of its own. Its CPU is counted from the start of that process, so it holds the imports, the check
of the whole program, homing on the emulated board, and planning up to the first segment of the program that is sent.
The run then goes on for `--cpu` seconds (or to its end) while memory is watched (the emulated board keeps no words).
`--gigabyte`: the same with a file of 1 GB, which is checked ahead of the motion. Target: 5 s of CPU for 1e5 lines, and
memory that does not grow.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from math import cos, sin
from pathlib import Path

TARGET_CPU_S = 5.0
TARGET_AT_LINES = 100_000
GROWTH_MB = 25.0
"""What may come: the emulated board remembers its steps for ten minutes, 1.7 MB a minute; the rest is the host's."""
OBJECTS_SHARE = 1.05
"""Python objects after the first third, of those in it: a leak of the host would show here."""
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6
TURN = 2_000
"""Lines of one turn of the pattern: out and back on a spiral, 0.2 mm each."""


def write_program(path: Path, lines: int | None, size: int | None = None) -> int:
    """A program of short lines, so many or so many bytes; how many lines it has."""
    pattern = []
    angle = 0.0
    for i in range(TURN):
        share = i if i < TURN // 2 else TURN - i
        radius = 10.0 + 0.02 * share
        angle += (0.2 if i < TURN // 2 else -0.2) / radius
        pattern.append(f"G1 X{303 + radius * cos(angle):.4f} Y{radius * sin(angle):.4f}\n")
    turn = "".join(pattern)
    written = 2
    with path.open("w") as file:
        file.write("G21 G90 G94 G64 P0.5 F6000\nG0 X313 Y0 Z150 A0 B0\n")
        if size is not None:
            turns = size // len(turn)
            for _ in range(turns):
                file.write(turn)
            written += turns * TURN
        else:
            assert lines is not None
            whole, rest = divmod(lines, TURN)
            for _ in range(whole):
                file.write(turn)
            file.write("".join(pattern[:rest]))
            written += lines
        file.write("M2\n")
    return written + 1


def resident_mb() -> float:
    """Memory of this process that is in RAM."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_MB


def run_and_report(program: Path, cpu_s: float) -> dict[str, object]:
    """Run a program in this process for so much CPU; what happened when."""
    import random

    from rm501_host.config import load_config
    from rm501_host.motion import Progress
    from rm501_host.program_run import RunOptions, run_program
    from rm501_host.virtual_time import run_virtual

    marks: dict[str, float] = {"imported": time.process_time()}
    memory: list[float] = []
    objects: list[int] = []
    seen = {"line": 0, "frames": 0}

    class EnoughError(Exception):
        """It has run long enough."""

    class Watching:
        def phase(self, name: str) -> None:
            marks.setdefault(name, time.process_time())

        def progress(self, progress: Progress) -> None:
            now = time.process_time()
            if progress.planned_frames and "first segment" not in marks:
                marks["first segment"] = now
                marks["first resident"] = resident_mb()
            seen["frames"] = max(seen["frames"], progress.played_frames)
            if progress.source is not None:
                seen["line"] = max(seen["line"], progress.source.line)
            if "first segment" in marks:
                if not memory or now - marks["sampled"] > 1.0:
                    memory.append(resident_mb())
                    objects.append(len(gc.get_objects()))
                    marks["sampled"] = now
                if now - marks["first segment"] > cpu_s:
                    raise EnoughError

        def message(self, text: str) -> None:
            print(text, file=sys.stderr)

    nonces = random.Random(501)
    options = RunOptions("emu://?record=0", True, lambda: nonces.getrandbits(32))

    async def main() -> str:
        try:
            result = await run_program(program, load_config(), options, Watching())
        except EnoughError:
            return "ran"
        return result.report.result

    outcome = run_virtual(main())
    third = max(1, len(memory) // 3)
    return {
        "outcome": outcome,
        "imports_s": marks["imported"],
        "check_s": marks["connecting"] - marks["planning"],
        "homing_s": marks["running"] - marks["connecting"],
        "plan_s": marks["first segment"] - marks["running"],
        "first_segment_s": marks["first segment"],
        "cpu_s": time.process_time() - marks["first segment"],
        "start_mb": marks["first resident"],
        "early_mb": max(memory[:third]),
        "late_mb": max(memory[third:] or memory),
        "early_objects": max(objects[:third]),
        "late_objects": max(objects[third:] or objects),
        "line": seen["line"],
        "motion_s": seen["frames"] * 320e-6,
    }


def case(program: Path, lines: int, cpu_s: float, limit_s: float) -> bool:
    """Run one program in a process of its own and print a line about it; whether it meets its targets."""
    command = [sys.executable, "-m", "benchmarks.long_program", "--child", str(program), "--cpu", str(cpu_s)]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    if made.returncode:
        print(made.stderr[-2000:])
        return False
    told = json.loads(made.stdout.splitlines()[-1])
    growth = told["late_mb"] - told["early_mb"]
    flat = growth <= GROWTH_MB and told["late_objects"] <= OBJECTS_SHARE * told["early_objects"]
    good = told["first_segment_s"] <= limit_s and flat and told["outcome"] in ("ran", "ok")
    size_mb = program.stat().st_size / 1e6
    print(
        f"{lines} lines, {size_mb:.1f} MB: first segment after {told['first_segment_s']:.2f} s CPU (at most "
        f"{limit_s:.1f}): imports {told['imports_s']:.2f}, check {told['check_s']:.2f}, connect and home "
        f"{told['homing_s']:.2f}, plan {told['plan_s']:.2f}"
    )
    print(
        f"  then {told['cpu_s']:.0f} s CPU to line {told['line']} ({told['outcome']}), {told['motion_s']:.0f} s of "
        f"motion; resident {told['start_mb']:.0f} MB at the start, {told['early_mb']:.0f} MB at most in the first "
        f"third, {told['late_mb']:.0f} MB after it; Python objects {told['early_objects']} "
        f"and {told['late_objects']}{'' if good else '  MISSED'}"
    )
    return good


def check_speed(program: Path, lines: int) -> None:
    """Print how fast a program is read and checked."""
    from rm501_host.config import load_config
    from rm501_host.kinematics import Arm
    from rm501_host.preflight import ProgramCheck
    from rm501_host.program import read_moves

    config = load_config()
    arm = Arm.from_config(config)
    before = time.process_time()
    for _ in read_moves(program, arm, lambda: config.home_deg, config=config):
        pass
    read_s = time.process_time() - before
    before = time.process_time()
    check = ProgramCheck(arm, config, config.home_deg)
    moves = read_moves(program, arm, lambda: check.q_deg.tolist(), config=config)
    report = check.run(moves, max_moves=10**9, estimate=False)
    check_s = time.process_time() - before
    assert report.ok and report.complete
    print(f"read alone {lines / read_s:.0f} lines/s, read and checked {lines / check_s:.0f} lines/s")


def main() -> int:
    """Print the figures; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=float, default=20_000, help="lines of the program, such as 1e5")
    parser.add_argument("--cpu", type=float, default=15.0, help="seconds of CPU to run on after the first segment")
    parser.add_argument("--gigabyte", action="store_true", help="also a file of 1 GB")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child is not None:
        print(json.dumps(run_and_report(options.child, options.cpu)))
        return 0
    good = True
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "long.ngc"
        lines = write_program(program, int(options.n))
        check_speed(program, lines)
        good &= case(program, lines, options.cpu, TARGET_CPU_S * max(1.0, options.n / TARGET_AT_LINES))
        if options.gigabyte:
            lines = write_program(program, None, 1_000_000_000)
            good &= case(program, lines, options.cpu, 2.0 * TARGET_CPU_S)
    print("long programs: every target met" if good else "long programs: TARGETS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

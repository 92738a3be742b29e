"""Long programs through the real `run`: CPU to the first segment, checked moves a second, memory.

    python -m benchmarks.long_program [--n MOVES] [--cpu SECONDS] [--kinds] [--estimates] [--whole] [--gigabyte]

A program of `--n` short lines (default 20,000; 1e5 in full) is run by `run_program` on the emulated board, in virtual
time and in a process of its own. Its CPU is counted from the start of that process, so it holds the imports, the check
of the whole program, homing on the emulated board, and planning up to the first segment of the program that is sent.
The run then goes on for `--cpu` seconds (or to its end) while memory is watched (the emulated board keeps no words).
`--kinds`: also how fast each kind of move is read and checked. `--estimates`: how well the time of each is estimated
from planned stretches, by a fifth (splines: a fiftieth) of the moves planned whole. `--whole`: to its end, and then a
mixed program (XYZABC lines with a turning tool, arcs), too: minutes. `--gigabyte`: also a file of 1 GB, which is
checked ahead of the motion. Targets: 5 s of CPU for 1e5 lines, 40,000 XYZABC lines and 20,000 arcs checked a second,
and memory that does not grow.
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
from pathlib import Path
from typing import TYPE_CHECKING

from .program_texts import KINDS, MIXED, PLAIN, Kind, write_program

if TYPE_CHECKING:
    from rm501_host.config import Config

TARGET_CPU_S = 5.0
TARGET_AT_LINES = 100_000
GROWTH_MB = 25.0
"""What may come: the emulated board remembers its steps for ten minutes, 1.7 MB a minute; the rest is the host's."""
OBJECTS_SHARE = 1.05
"""Python objects after the first third, of those in it: a leak of the host would show here."""
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6
FOR_EVER_S = 1e9
ESTIMATE_ERROR = 0.35
KIND_TARGETS = {"XYZABC lines": 40_000, "XYZABC lines, C turning": 40_000, "half circles of 1 mm": 20_000}
"""Moves a second, read and checked."""


def resident_mb() -> float:
    """Memory of this process that is in RAM."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_MB


def configuration(is_thesis: bool) -> Config:
    """The default arm, in base coordinates or with the thesis's frame and XYZABC."""
    from rm501_host.config import load_config

    return load_config(Path(__file__).parents[1] / "configs" / "thesis.toml") if is_thesis else load_config()


def run_and_report(program: Path, cpu_s: float, is_thesis: bool) -> dict[str, object]:
    """Run a program in this process for so much CPU; what happened when."""
    import random

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
            result = await run_program(program, configuration(is_thesis), options, Watching())
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
        "tenths_mb": [max(memory[i * len(memory) // 10 : (i + 1) * len(memory) // 10] or [0.0]) for i in range(10)],
        "line": seen["line"],
        "motion_s": seen["frames"] * 320e-6,
    }


def case(name: str, program: Path, lines: int, cpu_s: float, limit_s: float, is_thesis: bool = False) -> bool:
    """Run one program in a process of its own and print a line about it; whether it meets its targets."""
    command = [sys.executable, "-m", "benchmarks.long_program", "--child", str(program), "--cpu", str(cpu_s)]
    made = subprocess.run([*command, *(["--thesis"] if is_thesis else [])], capture_output=True, text=True, check=False)
    if made.returncode:
        print(made.stderr[-2000:])
        return False
    told = json.loads(made.stdout.splitlines()[-1])
    growth = told["late_mb"] - told["early_mb"]
    flat = growth <= GROWTH_MB and told["late_objects"] <= OBJECTS_SHARE * told["early_objects"]
    good = told["first_segment_s"] <= limit_s and flat and told["outcome"] in ("ran", "ok")
    size_mb = program.stat().st_size / 1e6
    print(
        f"{name}, {lines} lines, {size_mb:.1f} MB: first segment after {told['first_segment_s']:.2f} s CPU (at most "
        f"{limit_s:.1f}): imports {told['imports_s']:.2f}, check {told['check_s']:.2f}, connect and home "
        f"{told['homing_s']:.2f}, plan {told['plan_s']:.2f}"
    )
    print(
        f"  then {told['cpu_s']:.0f} s CPU to line {told['line']} ({told['outcome']}), {told['motion_s']:.0f} s of "
        f"motion; resident {told['start_mb']:.0f} MB at the start, {told['early_mb']:.0f} MB at most in the first "
        f"third, {told['late_mb']:.0f} MB after it; Python objects {told['early_objects']} "
        f"and {told['late_objects']}{'' if good else '  MISSED'}"
    )
    if cpu_s >= FOR_EVER_S:
        print(f"  most MB in each tenth of it: {', '.join(f'{mb:.0f}' for mb in told['tenths_mb'])}", flush=True)
    return good


def check_speed(kind: Kind, moves: int, folder: Path) -> bool:
    """Print how fast a program of one kind is read and checked; whether that is fast enough."""
    from rm501_host.kinematics import Arm
    from rm501_host.preflight import ProgramCheck
    from rm501_host.program import read_moves

    program = folder / "kind.ngc"
    write_program(program, kind, moves)
    config = configuration(kind.is_thesis)
    arm = Arm.from_config(config)
    before = time.process_time()
    for _ in read_moves(program, arm, lambda: config.home_deg, config=config):
        pass
    read_s = time.process_time() - before
    before = time.process_time()
    check = ProgramCheck(arm, config, config.home_deg)
    report = check.run(
        read_moves(program, arm, lambda: check.q_deg.tolist(), config=config), max_moves=10**9, estimate=False
    )
    check_s = time.process_time() - before
    assert report.ok and report.complete, report.findings
    good = moves / check_s >= KIND_TARGETS.get(kind.name, 0)
    print(
        f"  {kind.name:24}{moves:9d} moves: read alone {moves / read_s:8.0f} a second, read and checked "
        f"{moves / check_s:8.0f}{'' if good else '  MISSED'}",
        flush=True,
    )
    return good


def estimate(kind: Kind, moves: int, folder: Path) -> bool:
    """Print how long a program is estimated to take, and how long it takes planned; whether that is near enough."""
    from rm501_host.kinematics import Arm
    from rm501_host.planner import Planner
    from rm501_host.preflight import ProgramCheck
    from rm501_host.program import read_moves

    program = folder / "kind.ngc"
    write_program(program, kind, moves)
    config = configuration(kind.is_thesis)
    arm = Arm.from_config(config)
    check = ProgramCheck(arm, config, config.home_deg)
    read = list(read_moves(program, arm, lambda: check.q_deg.tolist(), config=config))
    check.run(read, max_moves=10**9, estimate=False)
    before = time.process_time()
    estimated_s = check.estimate_s()
    cpu_s = time.process_time() - before
    took_s = sum(piece.duration_s for piece in Planner(arm, config, config.home_deg).plan(read))
    error = estimated_s / took_s - 1.0
    good = abs(error) <= ESTIMATE_ERROR
    print(
        f"  {kind.name:24}{moves:9d} moves: at their feeds {check.nominal_s:7.1f} s, estimated {estimated_s:7.1f} s in "
        f"{cpu_s:.2f} s CPU, planned {took_s:7.1f} s, error {error:+.1%}{'' if good else '  MISSED'}",
        flush=True,
    )
    return good


def main() -> int:
    """Print the figures; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=float, default=20_000, help="moves of the program, such as 1e5")
    parser.add_argument("--cpu", type=float, default=15.0, help="seconds of CPU to run on after the first segment")
    parser.add_argument("--kinds", action="store_true", help="how fast each kind of move is checked")
    parser.add_argument("--estimates", action="store_true", help="how well their times are estimated")
    parser.add_argument("--whole", action="store_true", help="run to the end, and a mixed program, too")
    parser.add_argument("--gigabyte", action="store_true", help="also a file of 1 GB")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--thesis", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child is not None:
        print(json.dumps(run_and_report(options.child, options.cpu, options.thesis)))
        return 0
    count = int(options.n)
    cpu_s = FOR_EVER_S if options.whole else options.cpu
    limit_s = TARGET_CPU_S * max(1.0, options.n / TARGET_AT_LINES)
    good = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in KINDS if options.kinds else (PLAIN,):
            good &= check_speed(kind, count, folder)
        for kind in KINDS if options.estimates else ():
            good &= estimate(kind, count // 50 if "splines" in kind.name else count // 5, folder)
        program = folder / "long.ngc"
        good &= case("lines", program, write_program(program, PLAIN, count), cpu_s, limit_s)
        if options.whole:
            good &= case("mixed", program, write_program(program, MIXED, count), cpu_s, 2.0 * limit_s, True)
        if options.gigabyte:
            lines = write_program(program, PLAIN, None, 1_000_000_000)
            good &= case("lines", program, lines, options.cpu, 2.0 * TARGET_CPU_S)
    print("long programs: every target met" if good else "long programs: TARGETS MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

"""Every benchmark at its short setting, one after the other: name, its closing line, exit code.

python -m benchmarks [NAME ...] [--verbose]

Exits 1 when any of them missed a target. Long settings are options of each: python -m benchmarks.NAME --help.
"""

from __future__ import annotations

import argparse
import subprocess
import sys

SHORT: dict[str, tuple[str, ...]] = {
    "kinematics": ("--n", "1e4", "--no-passages"),
    "interpreter": ("--n", "1e4", "--memory-lines", "1e5"),
    "planner": (),
    "overshoot": ("--program", "waist by 60 deg"),
    "backlash": ("--no-emulator",),
    "long_program": ("--n", "1e4"),
    "live_path": ("--n", "10"),
    "jogs": ("--n", "10"),
    "lying_board": ("--lies", "position,mixed"),
    "clock_sync": ("--n", "2000"),
    "fuzz_frames": ("--n", "1e5"),
    "soak": ("--hours", "0.2", "--stops", "200"),
    "wire": (),
    "stepgen": (),
    "emulator": ("--visits", "3"),
    "faults": ("--short",),
    "daemon": ("--short",),
}
"""Benchmarks and the options with which they take seconds, not minutes."""

LEFT_OUT: dict[str, str] = {
    "avr": "needs avr-gcc and simavr, which no virtual environment holds; exits 2 without them",
    "commission": "plays a person at a terminal in real time; the tests of the operator's commands do the same",
}
"""Benchmarks of their own that do not run with the others, and why not."""

PARTS: dict[str, str] = {
    "daemon_soak": "daemon",
    "daemon_takeaways": "daemon",
    "emulator_accuracy": "emulator",
    "fault_scenarios": "faults",
    "program_texts": "long_program",
    "starts": "jogs",
}
"""Modules that are no benchmarks: parts of one, which prints what they measure."""


def main() -> int:
    """Run the chosen ones; their tables are shown with --verbose or when they fail."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(SHORT)}; default all")
    parser.add_argument("--verbose", action="store_true", help="show every table")
    arguments = parser.parse_args()
    unknown = set(arguments.names) - set(SHORT)
    if unknown:
        reasons = [f"{name} ({LEFT_OUT[name]})" for name in sorted(unknown & set(LEFT_OUT))]
        if reasons:
            parser.error(f"run these alone, as python -m benchmarks.NAME: {', '.join(reasons)}")
        parser.error(f"no such benchmark: {', '.join(sorted(unknown))}")
    failed = []
    for name in arguments.names or SHORT:
        command = [sys.executable, "-m", f"benchmarks.{name}", *SHORT[name]]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        lines = (result.stdout.strip() or result.stderr.strip()).splitlines()
        if arguments.verbose or result.returncode:
            print("\n".join(lines))
        else:
            print(lines[-1] if lines else f"{name}: no output", flush=True)
        if result.returncode:
            failed.append(name)
    print(f"benchmarks: {len(failed)} failed{': ' + ', '.join(failed) if failed else ''}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

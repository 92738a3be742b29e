"""How fast the interpreter reads programs, beside `rs274` where it is installed.

    python -m benchmarks.interpreter [--n 1e5]

User CPU time of this process for each workload, the same program through `rs274 -g` as a ratio in the same run, memory
over a long program, and the time to the first motion of a long file. Ends with exit code 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rm501_host.gcode import FileLines, Interpreter, Settings
from rm501_host.gcode.canon import StraightFeed, StraightTraverse

MEMORY_TARGET_MB = 8.0
FIRST_MOTION_TARGET_MS = 50.0


@dataclass(frozen=True, slots=True)
class Workload:
    """A kind of program: `write` yields its lines for n units; `target` units/s of user CPU."""

    name: str
    unit: str
    target: float
    write: Callable[[int], Iterator[str]]


def _lines(n: int) -> Iterator[str]:
    yield "G21 G90 F600"
    for i in range(n):
        yield f"G1 X{100 + i % 997 * 0.1:.3f} Y{i % 313 * 0.25:.3f} Z{i % 71 * 0.5:.2f}"
    yield "M2"


def _arcs(n: int) -> Iterator[str]:
    yield "G21 G90 G17 F600"
    yield "G0 X0 Y0"
    for i in range(n):
        r = 5 + i // 2 % 89 * 0.125
        yield f"G2 X{2 * r:.4f} Y0 I{r:.4f} J0" if i % 2 == 0 else f"G3 X0 Y0 I{-r:.4f} J0"
    yield "M2"


def _while(n: int) -> Iterator[str]:
    yield from ("G21 G90 F600", "#1=0", "#2=0", f"o100 while [#1 LT {n}]")
    yield from ("#2=[#1*0.01]", "#3=[SIN[#2]*10]", "G1 X#2 Y#3", "#4=[#2+#3]", "#1=[#1+1]", "o100 endwhile", "M2")


def _calls(n: int) -> Iterator[str]:
    yield from ("G21 G90 F600", "o100 sub", "G1 X#1 Y#2", "o100 endsub", "#10=0", f"o101 repeat [{n}]")
    yield from ("o100 call [#10] [3]", "o101 endrepeat", "M2")


WORKLOADS = (
    Workload("G1 lines", "lines", 80e3, _lines),
    Workload("arcs", "arcs", 60e3, _arcs),
    Workload("while, five blocks", "iterations", 15e3, _while),
    Workload("O-calls", "calls", 15e3, _calls),
)


def _user_seconds() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_utime


def _children_seconds() -> float:
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


def _write(path: Path, lines: Iterator[str]) -> None:
    with path.open("w", encoding="ascii") as file:
        file.writelines(f"{line}\n" for line in lines)


def _read(path: Path) -> tuple[float, int]:
    """User seconds and calls of one pass."""
    source = FileLines.open(path)
    before = _user_seconds()
    count = 0
    for _ in Interpreter(source, Settings()).calls():
        count += 1
    seconds = _user_seconds() - before
    source.close()
    return seconds, count


def _peer(path: Path) -> float | None:
    if shutil.which("rs274") is None:
        return None
    before = _children_seconds()
    subprocess.run(["rs274", "-g", path.name], cwd=path.parent, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return _children_seconds() - before


def _memory_growth_mb(folder: Path, n: int) -> tuple[float, float]:
    """Traced memory (MB) held after a tenth of a long program, and the most above that until its end."""
    path = folder / "long.ngc"
    _write(path, _lines(n))
    source = FileLines.open(path)
    tracemalloc.start()
    first = peak = 0
    for count, _ in enumerate(Interpreter(source, Settings()).calls()):
        if count == n // 10:
            first = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
        elif count % 10_000 == 0 and count > n // 10:
            peak = max(peak, tracemalloc.get_traced_memory()[1])
    peak = max(peak, tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
    source.close()
    return first / 1e6, (peak - first) / 1e6


def _first_motion_ms(folder: Path) -> float:
    path = folder / "first.ngc"
    _write(path, _lines(100_000))
    before = _user_seconds()
    source = FileLines.open(path)
    for call in Interpreter(source, Settings()).calls():
        if isinstance(call, StraightFeed | StraightTraverse):
            break
    milliseconds = (_user_seconds() - before) * 1e3
    source.close()
    return milliseconds


def main(argv: list[str] | None = None) -> int:
    """Run all workloads; 0 when every target is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=float, default=1e5, help="units per workload (default 1e5)")
    parser.add_argument("--memory-lines", type=float, default=None, help="lines of the memory run (default 10 n)")
    options = parser.parse_args(argv)
    n = int(options.n)
    missed: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(f"{'workload':20} {'rate':>12} {'target':>10} {'unit':>12}  {'rs274 / ours':>12}")
        for workload in WORKLOADS:
            path = folder / "work.ngc"
            _write(path, workload.write(n))
            seconds, _ = min(_read(path) for _ in range(3))
            rate = n / max(seconds, 1e-9)
            peer = _peer(path)
            ratio = "-" if not peer else f"{seconds / peer:.2f} x"
            print(f"{workload.name:20} {rate:12,.0f} {workload.target:10,.0f} {workload.unit + '/s':>12}  {ratio:>12}")
            if rate < workload.target:
                missed.append(workload.name)
        lines = int(options.memory_lines or 10 * n)
        held, growth = _memory_growth_mb(folder, lines)
        print(f"memory over {lines:,} lines: {held:.2f} MB held, growth {growth:.2f} MB (target {MEMORY_TARGET_MB:g})")
        if not math.isfinite(growth) or growth > MEMORY_TARGET_MB:
            missed.append("memory")
        first = min(_first_motion_ms(folder) for _ in range(3))
        print(f"first motion of a 100,000-line program: {first:.1f} ms (target {FIRST_MOTION_TARGET_MS:g})")
        if first > FIRST_MOTION_TARGET_MS:
            missed.append("first motion")
    print("interpreter: all targets met" if not missed else f"interpreter: MISSED {', '.join(missed)}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

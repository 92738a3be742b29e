"""The whole chain on virtual time: host, link, fast firmware, bench; speed, determinism, accuracy, tuning.

    python -m benchmarks.emulator [--n RUNS] [--visits 30]

Speed is emulated seconds of the program per second of this process's CPU, planning not counted; with homing, which
looks at switches all the time, it is shown beside it. The fingerprints
cover every port word and the true motion; the second run happens in another process. The accuracy part visits the nine
points of the thesis's program with the preset `real` and prints AP and RP after ISO 9283 beside the thesis's.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.emulator_accuracy import measure
from rm501_host.config import load_config
from rm501_host.motion import Progress
from rm501_host.program_run import RunOptions, run_program
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.emu_transport import running_board, shut_down
from rm501_sim_board.presets import REAL_SERVOS
from rm501_sim_board.traces import truth_trace
from rm501_sim_board.tuning import tuning_study

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "configs" / "thesis.toml"
PROGRAM = ROOT / "examples" / "pick_and_place.ngc"
TARGETS = {"ideal": 50.0, "real": 20.0}


@dataclass(frozen=True, slots=True)
class ChainRun:
    """One run of the program: speed in emulated seconds per CPU second, and the fingerprints."""

    preset: str
    result: str
    emulated_s: float
    ratio: float
    homing_too: float
    pins: str
    truth: str


class _Stopwatch:
    """Notes emulated and CPU time when the program begins, after homing."""

    def __init__(self) -> None:
        self.began_s = self.cpu_began_s = 0.0
        self.ended_s = self.cpu_ended_s = 0.0

    def phase(self, name: str) -> None:
        """The last phase is the program itself."""
        if name == "running":
            self.began_s = asyncio.get_running_loop().time()
            self.cpu_began_s = time.process_time()

    def progress(self, progress: Progress) -> None:
        """The last of these comes with the program's end; the report is made after it."""
        self.ended_s = asyncio.get_running_loop().time()
        self.cpu_ended_s = time.process_time()

    def message(self, text: str) -> None:
        """Nobody watches."""


def run_chain(preset: str, seed: int) -> ChainRun:
    """Home and run the pick-and-place program on an emulated board."""

    async def main() -> ChainRun:
        nonces = random.Random(1)
        url = f"emu://bench?preset={preset}&seed={seed}"
        options = RunOptions(url, True, lambda: nonces.getrandbits(32), wall_clock_s=time.process_time)
        watch = _Stopwatch()
        result = await run_program(PROGRAM, load_config(CONFIG), options, watch)
        cpu_s = watch.cpu_ended_s - watch.cpu_began_s
        program_s = watch.ended_s - watch.began_s
        emulator = running_board("bench").emulator
        shut_down("bench")
        trace = truth_trace(emulator.bench)
        return ChainRun(
            preset,
            result.report.result,
            emulator.frame * emulator.clock.frame_us / 1e6,
            program_s / cpu_s,
            result.report.speed_ratio,
            emulator.recording.pin_hash,
            trace.fingerprint(),
        )

    return run_virtual(main())


def _in_another_process(preset: str, seed: int) -> ChainRun:
    command = [sys.executable, "-m", "benchmarks.emulator", "--one", preset, "--seed", str(seed)]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return ChainRun(**json.loads(out))


def speed_and_determinism(runs: int, seed: int) -> bool:
    """Print the table of both presets; False when a target is missed or two runs differ."""
    good = True
    print(
        f"{'preset':8}{'runs':>5}{'emulated s':>12}{'x real time':>13}{'target':>8}{'with homing':>13}"
        "  pins      truth     same elsewhere"
    )
    for preset, target in TARGETS.items():
        mine = [run_chain(preset, seed) for _ in range(runs)]
        other = _in_another_process(preset, seed)
        best = max(run.ratio for run in (*mine, other))
        same = len({(run.pins, run.truth) for run in (*mine, other)}) == 1
        done = all(run.result == "ok" for run in (*mine, other))
        good = good and same and done and best >= target
        print(
            f"{preset:8}{runs + 1:5}{mine[0].emulated_s:12.1f}{best:13.1f}{target:8.0f}"
            f"{max(run.homing_too for run in (*mine, other)):13.1f}  "
            f"{mine[0].pins[:8]}  {mine[0].truth[:8]}  {'yes' if same else 'NO'}"
            + ("" if done else f"  {[run.result for run in mine]}")
        )
    return good


def tuning_table() -> None:
    """Print what raised gains do to the shoulder's step response, the thesis's Table 4 in numbers."""
    print("\nshoulder, step of 200 steps under 12 Nm    rise ms  overshoot %  settling ms  steady error steps")
    for row in tuning_study(REAL_SERVOS[1], 200, 12.0, 0.5):
        f = row.figures
        print(
            f"  {row.gains:40}{f.rise_s * 1e3:8.1f}{f.overshoot * 100:13.1f}{f.settling_s * 1e3:13.0f}"
            f"{f.steady_error_steps:20.2f}"
        )


def accuracy_table(visits: int, seed: int) -> bool:
    """Print AP and RP of the preset `real` beside the thesis's; False when they are not of its order."""
    print(f"\n{visits} visits, preset real        AP mm   thesis    RP mm   thesis  arm alone")
    figures = measure("real", visits, seed)
    for f in figures:
        print(f"  {f.name:24}{f.ap_mm:9.3f}{f.thesis_ap_mm:9.3f}{f.rp_mm:9.3f}{f.thesis_rp_mm:9.3f}{f.arm_rp_mm:11.3f}")
    ap_mm = sum(f.ap_mm for f in figures) / len(figures)
    rp_mm = sum(f.rp_mm for f in figures) / len(figures)
    arm_rp_mm = sum(f.arm_rp_mm for f in figures) / len(figures)
    thesis_ap = sum(f.thesis_ap_mm for f in figures) / len(figures)
    thesis_rp = sum(f.thesis_rp_mm for f in figures) / len(figures)
    print(f"  {'mean':24}{ap_mm:9.3f}{thesis_ap:9.3f}{rp_mm:9.3f}{thesis_rp:9.3f}{arm_rp_mm:11.3f}")
    # Few visits estimate the spread badly: the band for RP is checked with 10 visits and more.
    return 2.5 <= ap_mm <= 3.5 and (visits < 10 or 0.4 <= rp_mm <= 0.6)


def main() -> int:
    """Run the benchmark; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=float, default=2, help="runs per preset")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--visits", type=int, default=30, help="visits to each of the nine points; 0 leaves that part out"
    )
    parser.add_argument("--one", metavar="PRESET", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(asdict(run_chain(arguments.one, arguments.seed))))
        return 0
    good = speed_and_determinism(max(1, int(arguments.n)), arguments.seed)
    tuning_table()
    if arguments.visits > 0:
        good = accuracy_table(max(2, arguments.visits), arguments.seed) and good
    print(f"\nemulator: {'all targets met' if good else 'TARGET MISSED'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

"""A board that cannot be believed, against the whole host: sound checksums, false contents.

python -m benchmarks.lying_board [--n SEEDS] [--lies POSITION,EPOCH,...] [--share 0.05]

For every kind of lie and every seed a homed arm runs a program while that share of the board's packets is altered,
repeated, kept back or made up (`tests/support/lying_line.py`); `mixed` tells all of them. What must hold every time:

- the host survives: no error but those that it means, and a motion that ends or can be stopped within seconds
- the tool stays on the programmed path, judged at the pins of the emulated board, which itself is honest
- afterwards, with the truth back, what the host takes for homed is where the steps at the pins say

The table tells how the runs ended: done, or which error told the operator. Exits 1 when something did not hold.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rm501_host.errors import Rm501Error
from rm501_host.virtual_time import run_virtual
from rm501_protocol.transport import Transport
from tests.support.live_cell import MOST_DEVIATION_MM, Array, LiveCell, live_cell, undisturbed
from tests.support.lying_line import Lie, LyingLine
from tests.support.plan_checker import path_deviation_mm
from tests.support.virtual_machine import ME

LONGEST_S = 60.0
"""Virtual; the program takes 19 s."""
STOPPED_WITHIN_S = 15.0
MEANT = "an error of the daemon"


@dataclass(frozen=True)
class Outcome:
    """One run: how it ended, what was told, and what did not hold."""

    ended: str
    told: int
    problems: tuple[str, ...]


async def reference(folder: Path) -> Array:
    """Where the tool goes from the home position, on an honest line."""
    async with live_cell(folder) as cell:
        return (await undisturbed(cell, runs=1)).places_mm


async def run(folder: Path, lies: Sequence[Lie], seed: int, share: float, honest_mm: Array) -> Outcome:
    """One program on a line that lies from its start to its end."""
    lines: list[LyingLine] = []

    def lying(transport: Transport) -> Transport:
        line = LyingLine(transport, seed + len(lines), lies, share)
        line.is_lying = any(other.is_lying for other in lines)
        lines.append(line)
        return line

    problems: list[str] = []
    async with live_cell(folder, on_transport=lying) as cell:
        first_frame = cell.frames()
        zero = _counts_at_the_pins(cell) - np.array(cell.service.machine.arm_state.steps[:5])
        for line in lines:
            line.is_lying = True
        ended = await _program(cell, problems)
        for line in lines:
            line.is_lying = False
        await asyncio.sleep(STOPPED_WITHIN_S)
        places = cell.places_mm(first_frame)
        if len(places) and (off_mm := path_deviation_mm(places, honest_mm)) > MOST_DEVIATION_MM:
            problems.append(f"{off_mm:.2f} mm off the path")
        problems += _trust(cell, zero)
    return Outcome(ended, sum(sum(line.told.values()) for line in lines), tuple(problems))


async def _program(cell: LiveCell, problems: list[str]) -> str:
    machine = cell.service.machine
    try:
        async with asyncio.timeout(LONGEST_S):
            job = await cell.service.programs.run(ME, "live.ngc")
            await job.wait()
    except Rm501Error as error:
        if MEANT in str(error):
            problems.append(str(error))
        return type(error).__name__
    except TimeoutError:
        try:
            async with asyncio.timeout(STOPPED_WITHIN_S):
                await machine.stop(ME)
                while machine.job is not None:  # noqa: ASYNC110  # polled from outside
                    await asyncio.sleep(0.1)
        except Rm501Error as error:
            return f"waits, stop: {type(error).__name__}"
        except TimeoutError:
            problems.append("hangs, and cannot be stopped")
        return "waits, stopped"
    return "done"


def _counts_at_the_pins(cell: LiveCell) -> Array:
    """Steps made since power-up, shape (5,)."""
    return cell.emulator.recording.positions_steps(np.array([cell.frames() - 1]))[0, :5]


def _trust(cell: LiveCell, zero: Array) -> list[str]:
    """What the host takes for homed has to be where the pins say; `zero`: their count at position 0."""
    machine = cell.service.machine
    status = machine.session.status if machine.connected else None
    if status is None or not all(machine.arm_state.homed):
        return []
    true_steps = tuple(int(steps) for steps in _counts_at_the_pins(cell) - zero)
    if tuple(status.positions_steps[:5]) != true_steps:
        return [f"homed at {status.positions_steps[:5]}, the pins say {true_steps}"]
    return []


def main(arguments: list[str] | None = None) -> int:
    """Print a row a kind; 1 when something did not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lying_board", description=__doc__)
    parser.add_argument("--n", type=float, default=1, help="seeds per kind of lie")
    parser.add_argument("--lies", default="", help="kinds, comma separated; default: each alone, and mixed")
    parser.add_argument("--share", type=float, default=0.05, help="share of packets that lie")
    options = parser.parse_args(arguments)
    wanted = [name for name in options.lies.split(",") if name]
    kinds = {lie.name.lower(): (lie,) for lie in Lie} | {"mixed": tuple(Lie)}
    bad = runs = 0
    with tempfile.TemporaryDirectory() as folder:
        honest_mm = run_virtual(reference(Path(folder)))
    print(f"{'lie':12s} {'runs':>4s} {'told':>6s}  ended")
    for name, lies in kinds.items():
        if wanted and name not in [word.lower() for word in wanted]:
            continue
        ends: Counter[str] = Counter()
        told = 0
        problems: list[str] = []
        for seed in range(1, int(options.n) + 1):
            with tempfile.TemporaryDirectory() as folder:
                outcome = run_virtual(run(Path(folder), lies, seed, options.share, honest_mm))
            ends[outcome.ended] += 1
            told += outcome.told
            problems += [f"seed {seed}: {problem}" for problem in outcome.problems]
        runs += ends.total()
        bad += len(problems)
        print(f"{name:12s} {ends.total():4d} {told:6d}  " + ", ".join(f"{end} {n}" for end, n in ends.most_common()))
        for problem in problems:
            print(f"             {problem}")
    print(f"lying_board: {runs} runs, {bad} problems")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())

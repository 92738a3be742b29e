"""Accuracy and repeatability after ISO 9283 of the emulated arm at the nine points of the thesis's program.

The arm is homed once and then visits the points in the program's order, with the object in the hand where the thesis
had it, and rests at each of them; what counts is where the tool tip truly is at the end of each rest, as an instrument
sees it. The host knows the drawing's geometry and nominal switch angles, the bench has others.

The thesis's RP (0.47 mm on average at a reach of 210 mm, 0.53 at 290, 0.56 at 340) hardly grows with the reach. Squares
of a part in proportion to it and of a constant one add up to these figures with 0.24 mm at 210 mm and 0.39 at 340 for
the arm's angles, and 0.41 mm for what does not depend on the arm: photographs taken over a week in changing light, each
place computed from its own set. That is a scatter of 0.41 / 3.6 mm in each coordinate (RP, a mean and three standard
deviations of a distance in space, is 3.6 times that).
"""

from __future__ import annotations

import random
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from rm501_host.config import load_config
from rm501_host.motion import Progress
from rm501_host.program_run import RunOptions, run_program
from rm501_host.virtual_time import run_virtual
from rm501_sim_board import servo_plant
from rm501_sim_board.emu_transport import open_transport, shut_down
from rm501_sim_board.traces import TruthTrace, truth_trace

CONFIG = Path(__file__).parents[1] / "configs" / "thesis.toml"
REST_S = 0.6
INSTRUMENT_MM = 0.113
"""Standard deviation of what the thesis's photogrammetry says of a coordinate; see above."""
LONGEST_VISIT_S = 90
"""A round takes 50 s."""
OBJECT_MM, OBJECT_KG = 30.0, 0.35

# Name, X, Y, Z in the thesis's frame, AP and RP that it measured; in the order of its program.
POINTS: tuple[tuple[str, float, float, float, float, float], ...] = (
    ("NP XZ", 210, 0, -150, 2.844, 0.514),
    ("NP YZ", 0, 210, -150, 2.971, 0.440),
    ("APP Y", 0, 340, -30, 3.347, 0.559),
    ("VER Y", 0, 340, 30, 2.662, 0.564),
    ("APP Y loaded", 0, 340, -30, 3.039, 0.553),
    ("NP YZ loaded", 0, 210, -150, 2.924, 0.431),
    ("NP XZ loaded", 210, 0, -150, 2.942, 0.495),
    ("APP X", 290, 0, -30, 3.146, 0.523),
    ("VER X", 290, 0, 30, 3.271, 0.537),
)


@dataclass(frozen=True, slots=True)
class PointFigures:
    """AP and RP of one point in mm, RP without the instrument's share, and the thesis's."""

    name: str
    ap_mm: float
    rp_mm: float
    arm_rp_mm: float
    thesis_ap_mm: float
    thesis_rp_mm: float


class _Silent:
    def phase(self, name: str) -> None:
        """Nobody watches."""

    def progress(self, progress: Progress) -> None:
        """Nobody watches."""

    def message(self, text: str) -> None:
        """Nobody watches."""


def measuring_program(visits: int) -> str:
    """The thesis's round, with a rest at every point, `visits` times."""
    rest = f"G4 P{REST_S}"
    round_trip = [
        "G1 X210 Y0 Z-150",
        rest,
        "G3 X0 Y210 Z-150 R210",
        rest,
        "G1 X0 Y340 Z-30",
        rest,
        "G1 X0 Y340 Z30",
        rest,
        "M102",
        "G1 X0 Y340 Z-30",
        rest,
        "G1 X0 Y210 Z-150",
        rest,
        "G2 X210 Y0 Z-150 R210",
        rest,
        "G1 X290 Y0 Z-30",
        rest,
        "G1 X290 Y0 Z30",
        rest,
        "M101",
        "G1 X290 Y0 Z-30",
    ]
    head = ["G21 G90 G94 G40 G49", "G61", "G0 X250 Y0 Z-80 A0 B0 C0", "F2800"]
    return "\n".join([*head, f"o100 repeat [{visits}]", *round_trip, "o100 endrepeat", "M2", ""])


def measure(preset: str, visits: int, seed: int) -> list[PointFigures]:
    """Run the measuring program and judge every point."""

    # the emulator remembers ten minutes of motion; this measures all of it
    servo_plant.TRACE_SECONDS = max(servo_plant.TRACE_SECONDS, LONGEST_VISIT_S * (visits + 1))

    async def main() -> TruthTrace:
        nonces = random.Random(seed)
        first = await open_transport(f"emu://bench?preset={preset}&seed={seed}&record=0")
        first.emulator.bench.hand.offer_object(OBJECT_MM, OBJECT_KG)
        await first.aclose()
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / "iso.ngc"
            program.write_text(measuring_program(visits))
            options = RunOptions("emu://bench", True, lambda: nonces.getrandbits(32))
            result = await run_program(program, load_config(CONFIG), options, _Silent())
        if result.error is not None:
            raise RuntimeError(f"the measuring program was stopped: {result.error}")
        return truth_trace(shut_down("bench").emulator.bench)

    trace = run_virtual(main())
    reached = _rests(trace)
    if len(reached) < visits * len(POINTS):
        raise RuntimeError(f"{len(reached)} rests found, {visits * len(POINTS)} expected")
    reached = reached[-visits * len(POINTS) :].reshape(visits, len(POINTS), 3)
    seen = reached + np.random.default_rng(seed).normal(0.0, INSTRUMENT_MM, reached.shape)
    figures: list[PointFigures] = []
    for index, (name, x, y, z, thesis_ap, thesis_rp) in enumerate(POINTS):
        target = np.array([x, -y, 160.0 - z])
        accuracy = float(np.linalg.norm(seen[:, index].mean(axis=0) - target))
        figures.append(
            PointFigures(name, accuracy, _rp_mm(seen[:, index]), _rp_mm(reached[:, index]), thesis_ap, thesis_rp)
        )
    return figures


def _rp_mm(cloud: npt.NDArray[np.float64]) -> float:
    """Mean distance from the centre of the visits (n, 3), and three standard deviations of it."""
    distances = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1)
    return float(distances.mean() + (3.0 * distances.std(ddof=1) if len(cloud) > 1 else 0.0))


def _rests(trace: TruthTrace) -> npt.NDArray[np.float64]:
    """Tool tip at the end of each rest of REST_S in the arm's commands, shape (rests, 3); hand strokes do not count."""
    moving = np.any(np.diff(trace.commanded_steps, axis=0) != 0.0, axis=1)
    changes = np.flatnonzero(moving)
    gaps = np.diff(trace.t_s[changes])
    ends = changes[1:][(gaps > 0.9 * REST_S) & (gaps < 2.5 * REST_S)]
    return trace.tcp_mm[ends - 5]

"""Cycle time against overshoot at the tool, with and without the jerk limit, on the emulator's `real` arm.

    python -m benchmarks.overshoot [--jerk SCALE ...] [--program NAME]

Each program runs on the emulated board and arm (dynamics, friction, backlash, an arm that differs from its drawing);
what is measured is the true tool tip at every stop of a second after a motion: how far it goes beyond where it comes to
rest, along the direction in which it arrives, and how long after the end of the commanded motion it stays within 0.5 mm
of that rest. `--jerk`: scales of the configured max_jerk_deg_s3 to try (default 1).
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from rm501_host.config import Config, load_config
from rm501_host.program_run import RunOptions, run_program
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.emu_transport import open_transport, shut_down
from rm501_sim_board.traces import TruthTrace, truth_trace

from .emulator_accuracy import _Silent

REST_S = 1.0
BAND_MM = 0.5
ARRIVAL_S = 0.05
SAVED_S = 2e-3
HEAD = ["G21 G90 G94"]
POLYLINE = ((340, -100), (340, -30), (310, -30), (310, 30), (340, 30), (340, 100), (280, 100))


def _pick(feed: int) -> list[str]:
    rest = f"G4 P{REST_S}"
    rows = ["G0 X210 Y0 Z320 A0 B0", rest, "G61.1", f"F{feed}"]
    for move in (
        "G3 X0 Y210 Z320 R210",
        "G1 X0 Y340 Z200",
        "G1 X0 Y340 Z140",
        "G1 X0 Y340 Z200",
        "G1 X0 Y210 Z320",
        "G2 X210 Y0 Z320 R210",
        "G1 X290 Y0 Z200",
        "G1 X290 Y0 Z140",
    ):
        rows += [move, rest]
    return rows


def _polyline() -> list[str]:
    rest = f"G4 P{REST_S}"
    rows = ["G0 X280 Y-100 Z100 A0 B0", rest, "G61.1 F30000"]
    for x, y in POLYLINE:
        rows += [f"G1 X{x} Y{y}", rest]
    return rows


PROGRAMS = {
    "pick and place F2800": _pick(2800),
    "pick and place F6000": _pick(6000),
    "polyline A": _polyline(),
    "waist by 60 deg": ["G0 X280 Y0 Z200 A0 B0", f"G4 P{REST_S}", "M110 P1 Q60", f"G4 P{REST_S}"],
    "shoulder by 25 deg": ["G0 X280 Y0 Z200 A0 B0", f"G4 P{REST_S}", "M111 P2 Q25", f"G4 P{REST_S}"],
}


@dataclass(frozen=True)
class Stops:
    """Motion time of the plan, and per stop the overshoot (mm) and the time to settle (s)."""

    motion_s: float
    overshoot_mm: tuple[float, ...]
    settle_s: tuple[float, ...]
    worst_beyond_mm: tuple[float, ...] = ()
    """Along the direction of arrival, at the stop with the largest overshoot, from ARRIVAL_S before its end on."""
    sample_s: float = 0.0


def measure(config: Config, rows: list[str], seed: int) -> Stops:
    """Run a program on the real arm and look at every stop; the first one (after the approach) does not count."""

    async def main() -> tuple[TruthTrace, float]:
        nonces = random.Random(seed)
        first = await open_transport(f"emu://overshoot?preset=real&seed={seed}&record=0")
        await first.aclose()
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / "overshoot.ngc"
            program.write_text("\n".join([*HEAD, *rows, "M2", ""]))
            options = RunOptions("emu://overshoot", True, lambda: nonces.getrandbits(32), keep_pieces=True)
            result = await run_program(program, config, options, _Silent())
        if result.error is not None:
            raise RuntimeError(f"the program was stopped: {result.error}")
        assert result.plan is not None
        return truth_trace(shut_down("overshoot").emulator.bench), sum(p.motion_s for p in result.plan.pieces[2:])

    trace, motion_s = run_virtual(main())
    return _stops(trace, motion_s)


def _stops(trace: TruthTrace, motion_s: float) -> Stops:
    dt = float(trace.t_s[1] - trace.t_s[0])
    changes = np.flatnonzero(np.any(np.diff(trace.commanded_steps, axis=0) != 0.0, axis=1)) + 1
    gaps = np.diff(trace.t_s[changes])
    chosen = np.flatnonzero((gaps > 0.9 * REST_S) & (gaps < 1.6 * REST_S))
    overshoot, settle = [], []
    worst: list[float] = []
    last_end = changes[-1]
    ends = [(int(changes[i]), int(changes[i + 1])) for i in chosen[1:]]
    if len(trace.t_s) - last_end > 0.9 * REST_S / dt:
        ends.append((int(last_end), int(last_end + REST_S / dt)))
    for end, after in ends:
        tip = trace.tcp_mm[end - round(ARRIVAL_S / dt) : after]
        rest = tip[-5:].mean(axis=0)
        arrival = rest - tip[0]
        size = float(np.linalg.norm(arrival))
        beyond = (tip - rest) @ (arrival / size) if size > 1e-6 else np.zeros(len(tip))
        if not overshoot or beyond.max() > max(overshoot):
            worst = beyond.tolist()
        overshoot.append(max(0.0, float(beyond.max())))
        outside = np.flatnonzero(np.linalg.norm(trace.tcp_mm[end:after] - rest, axis=1) > BAND_MM)
        settle.append(float((outside[-1] + 1) * dt) if len(outside) else 0.0)
    return Stops(motion_s, tuple(overshoot), tuple(settle), tuple(worst), dt)


def soft(config: Config, scale: float) -> Config:
    """Jerk-limited, with every joint's jerk times `scale`."""
    names = msgspec.structs.fields(type(config.joints))
    joints = {}
    for field in names:
        joint = getattr(config.joints, field.name)
        joints[field.name] = msgspec.structs.replace(joint, max_jerk_deg_s3=joint.max_jerk_deg_s3 * scale)
    return msgspec.structs.replace(
        config,
        joints=msgspec.structs.replace(config.joints, **joints),
        planner=msgspec.structs.replace(config.planner, jerk_limited=True),
    )


def save(path: Path, found: list[tuple[str, Stops]]) -> None:
    """What docs/figures/overshoot.py draws: per law the tool's way around its worst stop, every 2 ms, in um."""
    rows = {
        f"{law}: {stops.motion_s:.2f} s of motion": [
            round(1e3 * stops.worst_beyond_mm[k])
            for k in np.arange(0.0, len(stops.worst_beyond_mm) - 1, SAVED_S / stops.sample_s).astype(int).tolist()
        ]
        for law, stops in found
    }
    path.write_text(json.dumps({"first_ms": -1e3 * ARRIVAL_S, "step_ms": 1e3 * SAVED_S, "beyond_um": rows}) + "\n")


def main() -> int:
    """Print the table; 1 when the jerk limit does not lower the largest overshoot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jerk", type=float, nargs="+", default=[1.0], help="scales of max_jerk_deg_s3")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", choices=PROGRAMS, action="append", help="default: all")
    parser.add_argument("--save", type=Path, help="write the worst stops of pick and place F6000, for docs/figures")
    options = parser.parse_args()
    config = load_config()
    print(
        f"{'program':22} {'law':16} {'motion s':>9} {'overshoot mm: mean':>19} {'largest':>8} "
        f"{'settled s: largest':>19}"
    )
    better = True
    drawn: list[tuple[str, Stops]] = []
    for name in options.program or PROGRAMS:
        worst, rows = [], PROGRAMS[name]
        for law, used in (("time-optimal", config), *((f"jerk x {k:g}", soft(config, k)) for k in options.jerk)):
            found = measure(used, rows, options.seed)
            worst.append(max(found.overshoot_mm))
            if name == "pick and place F6000":
                drawn.append((law, found))
            print(
                f"{name:22} {law:16} {found.motion_s:9.2f} {np.mean(found.overshoot_mm):19.3f} "
                f"{max(found.overshoot_mm):8.3f} {max(found.settle_s):19.3f}",
                flush=True,
            )
        better &= min(worst[1:]) <= worst[0]
    if options.save is not None:
        save(options.save, drawn)
    print("overshoot: lower with the jerk limit everywhere" if better else "overshoot: NOT lower with the jerk limit")
    return 0 if better else 1


if __name__ == "__main__":
    sys.exit(main())

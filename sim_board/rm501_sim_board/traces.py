"""Truth traces as numpy archives: where the motors, joints and the tool tip really were.

Arrays of an archive, n samples on a regular grid: `t_s` (n), `commanded_steps` and `motor_steps` (n, 5, absolute: pose
at power-up included), `joint_deg` (n, 5), `tcp_mm` (n, 3).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rm501_sim_board.bench import Bench
from rm501_sim_board.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class TruthTrace:
    """The run as it really was; `frames` are real frames since power-up."""

    frames: np.ndarray[tuple[int], np.dtype[np.int64]]
    t_s: FloatArray
    commanded_steps: FloatArray
    motor_steps: FloatArray
    joint_deg: FloatArray
    tcp_mm: FloatArray

    def fingerprint(self) -> str:
        """SHA-256 over all positions rounded to 1e-6 step: equal for equal runs on any machine."""
        digest = hashlib.sha256(self.frames.astype("<i8").tobytes())
        digest.update(np.rint(self.motor_steps * 1e6).astype("<i8").tobytes())
        return digest.hexdigest()


def truth_trace(bench: Bench) -> TruthTrace:
    """The trace from power-up to the last settled frame."""
    trace = bench.plant.trace()
    train = bench.plant.drive_train
    start = train.steps_from_joints() @ np.asarray(bench.parameters.start_deg)
    joints: FloatArray = trace.actual_steps @ train.joints_from_steps().T
    return TruthTrace(
        frames=trace.frames,
        t_s=trace.frames.astype(np.float64) * (bench.clock.frame_us * 1e-6),
        commanded_steps=trace.commanded_steps + start,
        motor_steps=trace.actual_steps,
        joint_deg=joints,
        tcp_mm=bench.parameters.geometry.tcp_mm(joints),
    )


def write_trace(bench: Bench, path: Path) -> int:
    """Write the trace as an npz archive; returns the number of samples."""
    trace = truth_trace(bench)
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            t_s=trace.t_s,
            commanded_steps=trace.commanded_steps,
            motor_steps=trace.motor_steps,
            joint_deg=trace.joint_deg,
            tcp_mm=trace.tcp_mm,
        )
    return len(trace.frames)

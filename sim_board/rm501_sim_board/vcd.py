"""Value change dump of a recorded run: opens in GTKWave and PulseView.

Scopes: `pins` has the electrical levels of every output and input pin, `lines` the levels at the driver boards'
terminals behind wiring and inverters (so a swapped select shows as a difference between the two), `motors` the
registers' step counts and the joints' true angles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from rm501_protocol.board_config import INPUT_LINES, OUTPUT_LINES
from rm501_sim_board.bench import Bench
from rm501_sim_board.driver_boards import IntArray
from rm501_sim_board.geometry import ARM_MOTOR_COUNT, Joint, Motor

_CHUNK_WORDS = 250_000


@dataclass(frozen=True, slots=True)
class _Changes:
    """Changes of one variable: its code, times in us and the values already written out."""

    times_us: IntArray
    texts: list[str]


def write_vcd(bench: Bench, path: Path, first_frame: int | None = None, end_frame: int | None = None) -> int:
    """Write the kept port words (or a range of frames) and what followed from them; returns the number of frames."""
    per_frame = bench.clock.periods_per_frame
    first, words = bench.recording.words(
        None if first_frame is None else first_frame * per_frame, None if end_frame is None else end_frame * per_frame
    )
    with path.open("w", encoding="ascii", newline="\n") as file:
        _Writer(bench, file).run(first, words)
    return len(words) // per_frame


class _Writer:
    def __init__(self, bench: Bench, file: TextIO) -> None:
        self._bench = bench
        self._file = file
        self._codes: Iterator[str] = _codes()
        self._header: list[str] = []

    def run(self, first: int, words: np.ndarray[tuple[int], np.dtype[np.uint32]]) -> None:
        bench = self._bench
        period_us = bench.clock.base_period_us
        self._header = [
            "$comment rm501 emulated board $end",
            f"$comment preset {bench.parameters.name}, seed {bench.seed} $end",
            "$timescale 1 us $end",
        ]
        self._scope("pins")
        output_codes = [(line.bit, self._wire(line.name)) for line in OUTPUT_LINES]
        input_codes = [(line.bit, self._wire(line.name)) for line in INPUT_LINES]
        self._end_scope()
        self._scope("lines")
        line_codes = [(wire, self._wire(t.value)) for t, wire in bench.boards.wiring.wires.items()]
        self._end_scope()
        self._scope("motors")
        count_codes = [self._variable("integer", 32, f"{m.name.lower()}_steps") for m in Motor]
        error_codes = [self._variable("integer", 32, f"{m.name.lower()}_error") for m in list(Motor)[:ARM_MOTOR_COUNT]]
        angle_codes = [self._variable("real", 64, f"{joint.name.lower()}_deg") for joint in Joint]
        self._end_scope()
        self._file.write("\n".join(self._header) + "\n$enddefinitions $end\n")

        slow = self._slow_changes(first, first + len(words), input_codes, count_codes, error_codes, angle_codes)
        previous: int | None = None
        for start in range(0, len(words), _CHUNK_WORDS):
            chunk = words[start : start + _CHUNK_WORDS]
            times = (np.arange(len(chunk), dtype=np.int64) + first + start) * period_us
            changes: list[_Changes] = []
            for bit, code in output_codes:
                levels = (chunk >> np.uint32(bit)) & np.uint32(1)
                before = None if previous is None else bool(previous >> bit & 1)
                changes.append(_level_changes(times, levels != 0, before, code))
            for wire, code in line_codes:
                before = None if previous is None else wire.level(previous)
                changes.append(_level_changes(times, wire.levels(chunk), before, code))
            end_us = int(times[-1]) + period_us
            for item in slow:
                low, high = np.searchsorted(item.times_us, (int(times[0]), end_us))
                changes.append(_Changes(item.times_us[low:high], item.texts[low:high]))
            self._dump(changes)
            previous = int(chunk[-1])
        self._file.write(f"#{(first + len(words)) * period_us}\n")

    def _slow_changes(
        self,
        first: int,
        end: int,
        input_codes: list[tuple[int, str]],
        count_codes: list[str],
        error_codes: list[str],
        angle_codes: list[str],
    ) -> list[_Changes]:
        bench = self._bench
        period_us = bench.clock.base_period_us
        frame_us = bench.clock.frame_us
        out: list[_Changes] = []
        inputs = bench.recording.inputs
        input_times = np.array([change.frame * frame_us for change in inputs], dtype=np.int64)
        for bit, code in input_codes:
            texts = [f"{change.word >> bit & 1}{code}" for change in inputs]
            out.append(_clip(input_times, texts, first * period_us))
        for motor, code in enumerate(count_codes):
            steps = bench.recording.steps(motor)
            counts = np.concatenate(([0], np.cumsum(steps.signs))) + bench.recording.start_count(motor)
            times = np.concatenate(([0], steps.periods)) * period_us
            out.append(_clip(times, [f"b{_binary(int(n))} {code}" for n in counts], first * period_us))
        trace = bench.plant.trace()
        if len(trace.frames):
            to_joint = bench.plant.drive_train.joints_from_steps()
            joints = trace.actual_steps @ to_joint.T
            start = bench.plant.drive_train.steps_from_joints() @ np.asarray(bench.parameters.start_deg)
            errors = trace.commanded_steps + start - trace.actual_steps
            times = trace.frames * frame_us
            for column, code in enumerate(angle_codes):
                keep = _changed(joints[:, column])
                texts = [f"r{value:.6g} {code}" for value in joints[keep, column]]
                out.append(_clip(times[keep], texts, first * period_us))
            for column, code in enumerate(error_codes):
                whole = np.rint(errors[:, column]).astype(np.int64)
                keep = _changed(whole)
                texts = [f"b{_binary(int(n))} {code}" for n in whole[keep]]
                out.append(_clip(times[keep], texts, first * period_us))
        return out

    def _dump(self, changes: list[_Changes]) -> None:
        times = np.concatenate([change.times_us for change in changes])
        texts: list[str] = []
        for change in changes:
            texts += change.texts
        order = np.argsort(times, kind="stable")
        lines: list[str] = []
        last = -1
        for time_us, index in zip(times[order].tolist(), order.tolist(), strict=True):
            if time_us != last:
                lines.append(f"#{time_us}")
                last = time_us
            lines.append(texts[index])
        self._file.write("\n".join(lines) + "\n")

    def _scope(self, name: str) -> None:
        self._header.append(f"$scope module {name} $end")

    def _end_scope(self) -> None:
        self._header.append("$upscope $end")

    def _wire(self, name: str) -> str:
        return self._variable("wire", 1, name)

    def _variable(self, kind: str, bits: int, name: str) -> str:
        code = next(self._codes)
        self._header.append(f"$var {kind} {bits} {code} {name} $end")
        return code


def _codes() -> Iterator[str]:
    """Identifier codes: printable ASCII from ! to ~, shortest first."""
    symbols = [chr(n) for n in range(33, 127)]
    yield from symbols
    for first in symbols:
        for second in symbols:
            yield first + second


def _level_changes(times: IntArray, levels: np.ndarray, before: bool | None, code: str) -> _Changes:
    changed = np.empty(len(levels), dtype=np.bool_)
    changed[0] = before is None or bool(levels[0]) != before
    np.not_equal(levels[1:], levels[:-1], out=changed[1:])
    where = np.flatnonzero(changed)
    one, zero = "1" + code, "0" + code
    return _Changes(times[where], [one if level else zero for level in levels[where].tolist()])


def _changed(values: np.ndarray) -> np.ndarray:
    changed = np.ones(len(values), dtype=np.bool_)
    changed[1:] = values[1:] != values[:-1]
    return np.flatnonzero(changed)


def _clip(times_us: IntArray, texts: list[str], first_us: int) -> _Changes:
    """Drop what lies before the dump, but keep the value that holds at its start."""
    low = int(np.searchsorted(times_us, first_us, side="right")) - 1
    if low <= 0:
        return _Changes(times_us, texts)
    clipped = times_us[low:].copy()
    clipped[0] = first_us
    return _Changes(clipped, texts[low:])


def _binary(value: int) -> str:
    return format(value & 0xFFFFFFFF, "b")

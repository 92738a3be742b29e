"""Reading port words as the driver boards do, a whole recording at a time, and the timing rules on what they latch.

Independent of the firmware: it knows the configuration's pin table only. `tests/support/pin_decoder.py`, written from
the machine sheet, is the second opinion (`test_waves.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.config_pages import OutputSource, SlotSource


@dataclass(frozen=True, slots=True)
class MotorWave:
    """Latched levels of one motor, one per frame."""

    step: NDArray[np.bool_]
    direction: NDArray[np.bool_]

    def rises(self) -> NDArray[np.int64]:
        """Frames in which STEP is first high."""
        before = np.concatenate(([False], self.step[:-1]))
        return np.flatnonzero(self.step & ~before)

    def counts(self) -> NDArray[np.int64]:
        """Steps counted by the end of each frame."""
        made = np.zeros(len(self.step), dtype=np.int64)
        rises = self.rises()
        made[rises] = np.where(self.direction[rises], -1, 1)
        return np.cumsum(made)


def _level(words: NDArray[np.uint32], config: BoardConfig, source: int) -> NDArray[np.bool_]:
    (pin, *_) = config.outputs_from(source)
    level = (words >> np.uint32(pin.bit)) & np.uint32(1)
    return (level == 0) if pin.inverted else (level == 1)


def motor_waves(words: NDArray[np.uint32], config: BoardConfig = RM501_BOARD) -> dict[int, MotorWave]:
    """Latched levels by motor number; `words` has shape (frames, periods).

    A register latches where STROBE becomes active within the slot that carries the motor.
    """
    flat = words.reshape(-1)
    strobe = _level(flat, config, OutputSource.TABLE_BIT)
    edge = strobe & ~np.concatenate(([False], strobe[:-1]))
    order = config.table_order
    waves = {}
    for number, sources in enumerate(config.slots.slots):
        periods = [i for i, address in enumerate(order) if config.table.entries[address] >> 1 & 3 == number]
        grid = edge.reshape(words.shape)
        latching = [period for period in periods if grid[:, period].any()]
        assert len(latching) == 1 and grid[:, latching[0]].all(), "one strobe per slot and frame"
        at = words[:, latching[0]]
        for step, direction, step_line, dir_line in (
            (sources.step_1, sources.dir_1, OutputSource.STEP_1, OutputSource.DIR_1),
            (sources.step_2, sources.dir_2, OutputSource.STEP_2, OutputSource.DIR_2),
        ):
            if step >= SlotSource.STEP:
                assert direction - SlotSource.DIR == step - SlotSource.STEP
                waves[step - SlotSource.STEP] = MotorWave(_level(at, config, step_line), _level(at, config, dir_line))
    return waves


def hand_wave(words: NDArray[np.uint32], config: BoardConfig = RM501_BOARD) -> MotorWave:
    """Power pulses and direction of the hand as board 727 latches them; RM-501 table only."""
    return MotorWave(_level(words[:, 7], config, OutputSource.STEP_1), _level(words[:, 5], config, OutputSource.STEP_1))


def line_level(words: NDArray[np.uint32], source: int, config: BoardConfig = RM501_BOARD) -> NDArray[np.bool_]:
    """Logical level of a line that does not depend on the slot, one per frame."""
    level = _level(words, config, source)
    assert (level == level[:, :1]).all()
    return level[:, 0]


def timing_violations(wave: MotorWave, config: BoardConfig = RM501_BOARD) -> list[str]:
    """Every broken rule of step length, step space, direction setup and direction hold."""
    timing = config.timing
    found = []
    step = wave.step.astype(np.int8)
    rises = wave.rises()
    falls = np.flatnonzero(np.diff(step) == -1) + 1
    turns = np.flatnonzero(np.diff(wave.direction.astype(np.int8)) != 0) + 1
    closed = rises[: len(falls)]
    for rise, fall in zip(closed[falls - closed < timing.step_length_frames].tolist(), falls.tolist(), strict=False):
        found.append(f"step_length at frame {rise} (fall {fall})")
    later = rises[1 : 1 + len(falls)]
    for rise in later[later - falls[: len(later)] < timing.step_space_frames].tolist():
        found.append(f"step_space before frame {rise}")
    if len(turns):
        if len(rises):
            before = np.searchsorted(turns, rises, side="right") - 1
            known = before >= 0
            late = rises[known] - turns[before[known]] < timing.dir_setup_frames
            found += [f"dir_setup at frame {frame}" for frame in rises[known][late].tolist()]
            last = np.searchsorted(rises, turns, side="right") - 1
            known = last >= 0
            early = turns[known] - rises[last[known]] < timing.dir_hold_frames
            found += [f"dir_hold at frame {frame}" for frame in turns[known][early].tolist()]
        moved = wave.step[turns] & wave.step[turns - 1]
        found += [f"DIR moves under STEP at frame {frame}" for frame in turns[moved].tolist()]
    return found

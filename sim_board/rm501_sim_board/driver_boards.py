"""Boards 724, 732 and 727 seen from their terminals: select lines, strobe edge, latched step and direction levels.

Each motor has a register on its board. On the logical 0 -> 1 edge of the strobe the register whose select line is
active takes over the levels of the board's shared STEP and DIR lines. A latched STEP going 0 -> 1 is one step in the
direction latched with it (direction 1 is negative).

    period      0     1     2     3     4     5     6     7     0
    strobe   ___|‾‾‾‾‾|_____|‾‾‾‾‾|_____|‾‾‾‾‾|_____|‾‾‾‾‾|_____     edges at periods 1, 3, 5, 7
    select   elbow,shldr  waist,left  right, hand   hand power
    latched        ^ slot 0    ^ slot 1    ^ slot 2    ^ slot 3

Board 727 has two registers fed by HAND_1: the direction of the hand and its power; a power pulse is a 0 -> 1 of the
latter. Decoding is vectorised over blocks of port words and carries its state from block to block, so that the result
does not depend on how the words were cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from rm501_sim_board.wiring import BoolArray, Terminal, Wire, Wiring, WordArray

IntArray = npt.NDArray[np.int64]

CHANNEL_COUNT = 6
# Up to here plain Python beats array operations; measured.
_FEW_FRAMES = 16


class Board(IntEnum):
    """The driver boards by their part numbers."""

    ELBOW_WAIST = 724
    SHOULDER_WRIST = 732
    HAND = 727


@dataclass(frozen=True, slots=True)
class RegisterSpec:
    """Which terminals feed one register."""

    board: Board
    select: Terminal
    step: Terminal
    direction: Terminal
    strobe: Terminal


# Registers of the arm motors in motor order (waist, shoulder, elbow, right wrist, left wrist).
ARM_REGISTERS: tuple[RegisterSpec, ...] = (
    RegisterSpec(Board.ELBOW_WAIST, Terminal.WAIST_SELECT, Terminal.STEP_1, Terminal.DIR_1, Terminal.STROBE_724),
    RegisterSpec(Board.SHOULDER_WRIST, Terminal.SHOULDER_SELECT, Terminal.STEP_2, Terminal.DIR_2, Terminal.STROBE_732),
    RegisterSpec(Board.ELBOW_WAIST, Terminal.ELBOW_SELECT, Terminal.STEP_1, Terminal.DIR_1, Terminal.STROBE_724),
    RegisterSpec(
        Board.SHOULDER_WRIST, Terminal.RIGHT_WRIST_SELECT, Terminal.STEP_2, Terminal.DIR_2, Terminal.STROBE_732
    ),
    RegisterSpec(
        Board.SHOULDER_WRIST, Terminal.LEFT_WRIST_SELECT, Terminal.STEP_2, Terminal.DIR_2, Terminal.STROBE_732
    ),
)
HAND_DIRECTION_REGISTER = RegisterSpec(
    Board.HAND, Terminal.HAND_DIRECTION, Terminal.HAND_1, Terminal.HAND_2, Terminal.STROBE_727
)
HAND_POWER_REGISTER = RegisterSpec(
    Board.HAND, Terminal.HAND_POWER, Terminal.HAND_1, Terminal.HAND_2, Terminal.STROBE_727
)

MOTORS_OF_BOARD: dict[Board, tuple[int, ...]] = {
    board: tuple(motor for motor, spec in enumerate(ARM_REGISTERS) if spec.board is board)
    for board in (Board.ELBOW_WAIST, Board.SHOULDER_WRIST)
}


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps that one register counted: `periods` (base periods since boot, ascending) and `signs` (+1, -1)."""

    periods: IntArray
    signs: IntArray


@dataclass(frozen=True, slots=True)
class LevelChanges:
    """Changes of one plain line: the base period at which each new level holds, ascending."""

    periods: IntArray
    levels: BoolArray


_NO_PERIODS: IntArray = np.zeros(0, dtype=np.int64)
_NO_STEPS = Steps(_NO_PERIODS, _NO_PERIODS)
_NO_CHANGES = LevelChanges(_NO_PERIODS, np.zeros(0, dtype=np.bool_))


@dataclass(frozen=True, slots=True)
class BusActivity:
    """What the boards made of a block of port words, base periods [first_period, end_period).

    `steps` holds six entries in motor order; the sixth is the hand, whose steps are power pulses, +1 opening.
    """

    first_period: int
    end_period: int
    steps: tuple[Steps, ...]
    master_reset: LevelChanges
    motor_power: LevelChanges
    heartbeat_edges: int


class _Register:
    """One latch: the last latched levels, and the extraction of steps from the strobed words."""

    __slots__ = ("direction", "spec", "step")

    def __init__(self, spec: RegisterSpec) -> None:
        self.spec = spec
        self.step = False
        self.direction = False

    def latch(self, wiring: Wiring, words: WordArray, periods: IntArray) -> Steps:
        """Latch at the strobed `words`; returns the 0 -> 1 transitions of the latched step level."""
        wires = wiring.wires
        selected = wires[self.spec.select].levels(words)
        if not selected.all():
            words = words[selected]
            periods = periods[selected]
        if not words.size:
            return _NO_STEPS
        steps = wires[self.spec.step].levels(words)
        before = self.step
        self.step = bool(steps[-1])
        direction_wire = wires[self.spec.direction]
        self.direction = direction_wire.level(int(words[-1]))
        if not before and not steps.any():
            return _NO_STEPS
        rising = steps.copy()
        rising[1:] &= ~steps[:-1]
        if before:
            rising[0] = False
        where = np.flatnonzero(rising)
        if not where.size:
            return _NO_STEPS
        negative = direction_wire.levels(words[where])
        return Steps(periods[where], np.where(negative, -1, 1))


class _PlainLine:
    """A line that is not latched: only its changes matter."""

    __slots__ = ("level", "terminal")

    def __init__(self, terminal: Terminal) -> None:
        self.terminal = terminal
        self.level = False

    def changes_to(self, level: bool, first_period: int) -> LevelChanges:
        """The line has `level` all over the block."""
        if level == self.level:
            return _NO_CHANGES
        self.level = level
        return LevelChanges(np.array([first_period], dtype=np.int64), np.array([level]))

    def edges(self, wiring: Wiring, words: WordArray) -> int:
        """How often the line changes in the block."""
        wire = wiring.wires.get(self.terminal)
        if wire is None:
            return 0
        bits = words & np.uint32(1 << wire.bit)
        first = wire.level(int(words[0])) != self.level
        self.level = wire.level(int(words[-1]))
        return 0 if wire.stuck is not None else int(np.count_nonzero(bits[1:] != bits[:-1])) + first

    def changes(self, wiring: Wiring, words: WordArray, first_period: int) -> LevelChanges:
        wire = wiring.wires.get(self.terminal)
        if wire is None or not words.size:
            return _NO_CHANGES
        levels = wire.levels(words)
        before = self.level
        self.level = bool(levels[-1])
        # The common case by far: nothing moves.
        if levels.all() if before else not levels.any():
            return _NO_CHANGES
        changed = np.empty(levels.shape, dtype=np.bool_)
        changed[0] = levels[0] != before
        np.not_equal(levels[1:], levels[:-1], out=changed[1:])
        where = np.flatnonzero(changed)
        return LevelChanges(where + first_period, levels[where])


@dataclass(frozen=True, slots=True)
class _FramePattern:
    """A frame whose strobe and select lines are known: in which period each register latches, and what then to read.

    Index 0..4 are the arm's registers, 5 and 6 the hand's direction and power.
    """

    columns: npt.NDArray[np.intp]
    step_bits: WordArray
    step_idle: WordArray
    direction_wires: tuple[Wire, ...]
    scalars: tuple[tuple[int, int, int], ...]
    master_reset: bool
    motor_power: bool


class DriverBoards:
    """The digital side of the three driver boards: port words in, steps and line changes out.

    Whole frames in which the select, strobe and power lines repeat exactly (all frames of a healthy controller) are
    read in one piece, everything else line by line; both ways give the same.
    """

    def __init__(self, wiring: Wiring, periods_per_frame: int = 8) -> None:
        self.periods_per_frame = periods_per_frame
        self._patterns: dict[tuple[bytes, tuple[bool, ...]], _FramePattern | None] = {}
        self._wiring = wiring
        self._still_mask = np.uint32(0)
        self._arm = tuple(_Register(spec) for spec in ARM_REGISTERS)
        self._hand_direction = _Register(HAND_DIRECTION_REGISTER)
        self._hand_power = _Register(HAND_POWER_REGISTER)
        self._strobes = dict.fromkeys(_STROBES, False)
        self._master_reset = _PlainLine(Terminal.MASTER_RESET)
        self._motor_power = _PlainLine(Terminal.MOTOR_POWER)
        self._heartbeat = _PlainLine(Terminal.HEARTBEAT)
        self.wiring = wiring

    @property
    def wiring(self) -> Wiring:
        """The cable in use."""
        return self._wiring

    @wiring.setter
    def wiring(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._patterns.clear()
        mask = 0
        for terminal in _STILL_LINES:
            wire = wiring.wires.get(terminal)
            mask |= 0 if wire is None else 1 << wire.bit
        self._still_mask = np.uint32(mask)

    def set_frame(self, periods_per_frame: int) -> None:
        """Frames have another number of base periods from now on."""
        self.periods_per_frame = periods_per_frame
        self._patterns.clear()

    def decode(self, words: WordArray, first_period: int) -> BusActivity:
        """Run the boards over `words`, one per base period, the first of which is `first_period`."""
        per_frame = self.periods_per_frame
        if len(words) % per_frame == 0 and first_period % per_frame == 0 and len(words):
            frames = words.reshape(-1, per_frame)
            still = frames & self._still_mask
            if (still == still[0]).all():
                pattern = self._pattern(still[0])
                if pattern is not None:
                    return self._decode_frames(pattern, words, frames, first_period)
        return self._decode_lines(words, first_period)

    def _decode_lines(self, words: WordArray, first_period: int) -> BusActivity:
        """Line by line, whatever is on them."""
        strobed: dict[Terminal, tuple[WordArray, IntArray]] = {}
        edge_of_wire: dict[object, tuple[WordArray, IntArray, bool]] = {}
        for terminal in _STROBES:
            key = (self.wiring.wires[terminal], self._strobes[terminal])
            if key not in edge_of_wire:
                edge_of_wire[key] = self._strobe_edges(terminal, words, first_period)
            edge_words, periods, last = edge_of_wire[key]
            self._strobes[terminal] = last
            strobed[terminal] = (edge_words, periods)
        arm = tuple(register.latch(self.wiring, *strobed[register.spec.strobe]) for register in self._arm)
        return BusActivity(
            first_period=first_period,
            end_period=first_period + len(words),
            steps=(*arm, self._hand_pulses(*strobed[Terminal.STROBE_727])),
            master_reset=self._master_reset.changes(self.wiring, words, first_period),
            motor_power=self._motor_power.changes(self.wiring, words, first_period),
            heartbeat_edges=len(self._heartbeat.changes(self.wiring, words, first_period).periods),
        )

    def _pattern(self, still: WordArray) -> _FramePattern | None:
        """What a frame with these still lines does, after the strobe levels before it; None: not in one piece."""
        before = tuple(self._strobes.values())
        key = (still.tobytes(), before)
        if key not in self._patterns:
            self._patterns[key] = self._make_pattern(still)
        return self._patterns[key]

    def _make_pattern(self, still: WordArray) -> _FramePattern | None:
        wires = self._wiring.wires
        registers = (*self._arm, self._hand_direction, self._hand_power)
        columns: list[int] = []
        for register in registers:
            spec = register.spec
            strobe = wires[spec.strobe].levels(still)
            before = np.concatenate(([self._strobes[spec.strobe]], strobe[:-1]))
            where = np.flatnonzero(strobe & ~before & wires[spec.select].levels(still))
            # Every frame must begin as this one does, and each register must latch once.
            if len(where) != 1 or bool(strobe[-1]) != self._strobes[spec.strobe]:
                return None
            columns.append(int(where[0]))
        if columns[5] > columns[6]:
            return None
        step_wires = [wires[register.spec.step] for register in registers]
        levels: list[bool] = []
        for terminal in (Terminal.MASTER_RESET, Terminal.MOTOR_POWER):
            wire = wires.get(terminal)
            found = np.zeros(len(still), dtype=np.bool_) if wire is None else wire.levels(still)
            if found.any() != found.all():
                return None
            levels.append(bool(found[0]))
        if any(wire.stuck is not None for wire in step_wires):
            return None
        return _FramePattern(
            columns=np.array(columns, dtype=np.intp),
            step_bits=np.array([1 << wire.bit for wire in step_wires], dtype=np.uint32),
            step_idle=np.array([1 << wire.bit if wire.inverted else 0 for wire in step_wires], dtype=np.uint32),
            direction_wires=tuple(wires[register.spec.direction] for register in self._arm),
            scalars=tuple(
                (column, 1 << wire.bit, 1 << wire.bit if wire.inverted else 0)
                for column, wire in zip(columns, step_wires, strict=True)
            ),
            master_reset=levels[0],
            motor_power=levels[1],
        )

    def _decode_frames(
        self, pattern: _FramePattern, words: WordArray, frames: WordArray, first_period: int
    ) -> BusActivity:
        """All frames in one piece: a column of latched words per register."""
        if len(frames) <= _FEW_FRAMES:
            return self._decode_few_frames(pattern, words, first_period)
        columns = pattern.columns
        latched = frames[:, columns]
        levels = (latched & pattern.step_bits) != pattern.step_idle
        registers = (*self._arm, self._hand_direction, self._hand_power)
        before = [register.step for register in registers]
        rising = levels.copy()
        rising[1:] &= ~levels[:-1]
        rising[0] &= np.logical_not(before)
        steps: list[Steps] = [_NO_STEPS] * CHANNEL_COUNT
        last = latched[-1].tolist()
        for index, active in enumerate(rising.any(axis=0).tolist()):
            if active and index < 5:
                where = np.flatnonzero(rising[:, index])
                negative = pattern.direction_wires[index].levels(latched[where, index])
                periods = where * self.periods_per_frame + (first_period + int(columns[index]))
                steps[index] = Steps(periods, np.where(negative, -1, 1))
            elif active and index == 6:
                where = np.flatnonzero(rising[:, 6])
                periods = where * self.periods_per_frame + (first_period + int(columns[6]))
                steps[5] = Steps(periods, np.where(levels[where, 5], -1, 1))
        for index, (register, level) in enumerate(zip(registers, levels[-1].tolist(), strict=True)):
            register.step = level
            if index < 5:
                register.direction = pattern.direction_wires[index].level(last[index])
        return BusActivity(
            first_period=first_period,
            end_period=first_period + len(words),
            steps=tuple(steps),
            master_reset=self._master_reset.changes_to(pattern.master_reset, first_period),
            motor_power=self._motor_power.changes_to(pattern.motor_power, first_period),
            heartbeat_edges=self._heartbeat.edges(self._wiring, words),
        )

    def _decode_few_frames(self, pattern: _FramePattern, words: WordArray, first_period: int) -> BusActivity:
        """As `_decode_frames`, without arrays: faster for a handful of frames."""
        per_frame = self.periods_per_frame
        plain = words.tolist()
        steps: list[Steps] = [_NO_STEPS] * CHANNEL_COUNT
        hand_directions: list[bool] = []
        registers = (*self._arm, self._hand_direction, self._hand_power)
        for index, register in enumerate(registers):
            column, bit, idle = pattern.scalars[index]
            latched = plain[column::per_frame]
            before = register.step
            if index == 5:
                hand_directions = [word & bit != idle for word in latched]
                register.step = hand_directions[-1]
                continue
            found: list[tuple[int, int]] = []
            for frame, word in enumerate(latched):
                level = word & bit != idle
                if level and not before:
                    if index == 6:
                        negative = hand_directions[frame]
                    else:
                        negative = pattern.direction_wires[index].level(word)
                    found.append((first_period + column + frame * per_frame, -1 if negative else 1))
                before = level
            register.step = before
            if index < 5:
                register.direction = pattern.direction_wires[index].level(latched[-1])
            if found:
                pairs = np.array(found, dtype=np.int64)
                steps[min(index, 5)] = Steps(pairs[:, 0], pairs[:, 1])
        return BusActivity(
            first_period=first_period,
            end_period=first_period + len(words),
            steps=tuple(steps),
            master_reset=self._master_reset.changes_to(pattern.master_reset, first_period),
            motor_power=self._motor_power.changes_to(pattern.motor_power, first_period),
            heartbeat_edges=self._heartbeat.edges(self._wiring, words),
        )

    def _strobe_edges(
        self, terminal: Terminal, words: WordArray, first_period: int
    ) -> tuple[WordArray, IntArray, bool]:
        levels = self.wiring.wires[terminal].levels(words)
        rising = levels.copy()
        rising[1:] &= ~levels[:-1]
        if self._strobes[terminal] and levels.size:
            rising[0] = False
        where = np.flatnonzero(rising)
        last = bool(levels[-1]) if levels.size else self._strobes[terminal]
        return words[where], where + first_period, last

    def _hand_pulses(self, words: WordArray, periods: IntArray) -> Steps:
        """Power pulses of the hand, signed by the direction latched before each of them (0 opens, +1)."""
        direction_before = self._hand_direction.step
        wires = self.wiring.wires
        direction_at = wires[Terminal.HAND_DIRECTION].levels(words)
        self._hand_direction.latch(self.wiring, words, periods)
        pulses = self._hand_power.latch(self.wiring, words, periods)
        if not pulses.periods.size:
            return pulses
        latch_periods = periods[direction_at]
        latched = wires[Terminal.HAND_1].levels(words[direction_at])
        index = np.searchsorted(latch_periods, pulses.periods, side="right") - 1
        with_start = np.concatenate(([direction_before], latched))
        return Steps(pulses.periods, np.where(with_start[index + 1], -1, 1))


_STILL_LINES = (
    Terminal.STROBE_724,
    Terminal.STROBE_732,
    Terminal.STROBE_727,
    Terminal.ELBOW_SELECT,
    Terminal.WAIST_SELECT,
    Terminal.SHOULDER_SELECT,
    Terminal.LEFT_WRIST_SELECT,
    Terminal.RIGHT_WRIST_SELECT,
    Terminal.HAND_DIRECTION,
    Terminal.HAND_POWER,
    Terminal.MASTER_RESET,
    Terminal.MOTOR_POWER,
)
_STROBES = (Terminal.STROBE_724, Terminal.STROBE_732, Terminal.STROBE_727)

"""A board that runs on an event loop, with its faults and the files to be written when it ends."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from pathlib import Path

from rm501_sim_board.bench import Truth
from rm501_sim_board.emulator import Emulator, EmulatorOptions
from rm501_sim_board.fault_injection import FaultInjector
from rm501_sim_board.fault_spec import FaultSpec
from rm501_sim_board.pacing import DEFAULT_BAUD, DEFAULT_TICK_S, PacedBoard


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How to run an emulator: line speed (None: bytes take no time), tick, faults, files written at the end."""

    emulator: EmulatorOptions
    baud: int | None = DEFAULT_BAUD
    tick_s: float = DEFAULT_TICK_S
    faults: tuple[FaultSpec, ...] = ()
    vcd: Path | None = None
    trace: Path | None = None


@dataclass(frozen=True, slots=True)
class RunningBoard:
    """Handle on everything about one running board."""

    options: RunOptions
    board: PacedBoard
    faults: FaultInjector = field(repr=False)

    @classmethod
    def power_up(cls, options: RunOptions, loop: asyncio.AbstractEventLoop) -> RunningBoard:
        """Build the bench, boot the board, arrange the faults; FaultSpecError before anything runs."""
        board = PacedBoard(Emulator(options.emulator), loop, baud=options.baud, tick_s=options.tick_s)
        faults = FaultInjector(board)
        for fault in options.faults:
            faults.inject(fault)
        return cls(options, board, faults)

    @property
    def emulator(self) -> Emulator:
        """The controller and its bench."""
        return self.board.emulator

    def truth(self) -> Truth:
        """How things really stand at this moment of the loop's time."""
        self.board.run_to_now()
        return self.emulator.truth()

    def close(self) -> list[str]:
        """Bring everything up to now, stop, write the files asked for; returns what was written, for a person."""
        if self.board.closed:
            return []
        self.faults.close()
        self.board.close()
        self.emulator.truth()
        bench = self.emulator.bench
        said: list[str] = []
        if self.options.vcd is not None:
            from rm501_sim_board.vcd import write_vcd

            said.append(f"{write_vcd(bench, self.options.vcd)} frames written to {self.options.vcd}")
        if self.options.trace is not None:
            from rm501_sim_board.traces import write_trace

            said.append(f"{write_trace(bench, self.options.trace)} samples written to {self.options.trace}")
        return said

"""A whole cell on virtual time: host, link, board, driver boards and arm in one process, and what it left behind."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from rm501_host.config import Config
from rm501_host.motion import Progress
from rm501_host.program_run import RunOptions, RunResult, run_program
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.emu_transport import open_transport, running_board, shut_down
from rm501_sim_board.emulator import Emulator, Truth

BOARD = "cell"


@dataclass
class Watched:
    """What an operator would have seen."""

    phases: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    progress_frames: list[int] = field(default_factory=list)

    def phase(self, name: str) -> None:
        self.phases.append(name)

    def progress(self, progress: Progress) -> None:
        self.progress_frames.append(progress.played_frames)

    def message(self, text: str) -> None:
        self.messages.append(text)


@dataclass
class CellRun:
    """One run and everything that it left."""

    result: RunResult
    watched: Watched
    wire: list[tuple[int, str, bytes]]
    words: npt.NDArray[np.uint32]
    first_truth: Truth
    last_truth: Truth
    emulator: Emulator


def run_in_cell(program: Path, config: Config, query: str = "seed=1", *, seed: int = 501) -> CellRun:
    """Run a program on a fresh emulated board; what is refused or goes wrong is raised as the host raises it."""
    watched = Watched()
    wire: list[tuple[int, str, bytes]] = []
    nonces = random.Random(seed)

    async def main() -> CellRun:
        url = f"emu://{BOARD}?{query}"
        await (await open_transport(url)).aclose()
        emulator = running_board(BOARD).emulator
        first = emulator.truth()
        options = RunOptions(
            port_url=url,
            home=True,
            keep_pieces=True,
            nonce=lambda: nonces.getrandbits(32),
            wire_tap=lambda now_us, direction, data: wire.append((now_us, direction, data)),
        )
        result = await run_program(program, config, options, watched)
        last = emulator.truth()
        _, words = emulator.recording.words()
        shut_down(BOARD)
        return CellRun(result, watched, wire, words, first, last, emulator)

    return run_virtual(main())

"""Runs a board in real time for other processes, until it is told to end."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path

from rm501_sim_board.emulator import Emulator, EmulatorOptions
from rm501_sim_board.pacing import PacedBoard
from rm501_sim_board.serial_ports import PtyPort, TcpPort

# Real time: messages that nobody asked for leave the board within this.
_TICK_S = 0.002


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """What to run and where it listens; exactly one of `pty` and `tcp`."""

    emulator: EmulatorOptions
    pty: Path | None = None
    tcp: tuple[str, int] | None = None
    baud: int | None = None
    vcd: Path | None = None
    trace: Path | None = None
    status_s: float = 0.0


async def serve(options: ServeOptions, say: Callable[[str], None]) -> None:
    """Power up, listen, run in real time until SIGINT or SIGTERM, then write the files asked for."""
    loop = asyncio.get_running_loop()
    board = PacedBoard(Emulator(options.emulator), loop, baud=options.baud, tick_s=_TICK_S)
    end = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    async with AsyncExitStack() as ports:
        where: list[str] = []
        if options.pty is not None:
            pty = PtyPort(board, options.pty, loop)
            ports.push_async_callback(pty.aclose)
            where.append(pty.description)
        if options.tcp is not None:
            tcp = await TcpPort.listen(board, *options.tcp, loop)
            ports.push_async_callback(tcp.aclose)
            where.append(tcp.description)
        emulator = options.emulator
        say(
            f"rm501-sim-board: listening on {', '.join(where)}; preset {emulator.parameters.name}, "
            f"seed {emulator.seed}, {options.baud or 'unlimited'} baud; Ctrl-C ends"
        )
        await end.wait()
    board.close()
    say(f"rm501-sim-board: ended after {board.emulator.frame * board.emulator.clock.frame_us / 1e6:.3f} s")
    _write_files(options, board, say)


def _write_files(options: ServeOptions, board: PacedBoard, say: Callable[[str], None]) -> None:
    bench = board.emulator.bench
    bench.settle(board.emulator.frame)
    if options.vcd is not None:
        from rm501_sim_board.vcd import write_vcd

        frames = write_vcd(bench, options.vcd)
        say(f"rm501-sim-board: {frames} frames written to {options.vcd}")
    if options.trace is not None:
        from rm501_sim_board.traces import write_trace

        samples = write_trace(bench, options.trace)
        say(f"rm501-sim-board: {samples} samples written to {options.trace}")

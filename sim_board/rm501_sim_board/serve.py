"""Runs a board in real time for other processes, until it is told to end."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path

from rm501_sim_board.can_ports import BusPort, SlcanPort
from rm501_sim_board.control import ControlCommands, ControlSocket
from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.running import RunningBoard, RunOptions
from rm501_sim_board.serial_ports import PtyPort, TcpPort

# Real time: messages that nobody asked for leave the board within this.
REAL_TIME_TICK_S = 0.002


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """What to run and where it listens; exactly one of `pty`, `tcp` and `can`."""

    run: RunOptions
    pty: Path | None = None
    tcp: tuple[str, int] | None = None
    can: str | None = None
    control: str | None = None
    live: bool = False


async def serve(options: ServeOptions, say: Callable[[str], None]) -> None:
    """Power up, listen, run in real time until SIGINT or SIGTERM, then write the files asked for."""
    loop = asyncio.get_running_loop()
    end = asyncio.Event()
    _end_on_signals(loop, end)
    running = RunningBoard.power_up(options.run, loop)
    async with AsyncExitStack() as ports:
        port = await _open_port(options, running, loop)
        ports.push_async_callback(port.aclose)
        where = port.description
        if options.control is not None:
            control = await ControlSocket.listen(ControlCommands(running), options.control, loop)
            ports.push_async_callback(control.aclose)
            where += f", control on {control.description}"
        emulator = options.run.emulator
        line = "" if options.can else f", {options.run.baud or 'unlimited'} baud"
        faults = f", faults {', '.join(f.name for f in options.run.faults)}" if options.run.faults else ""
        say(f"listening on {where}; preset {emulator.parameters.name}, seed {emulator.seed}{line}{faults}; Ctrl-C ends")
        while not end.is_set():
            try:
                await asyncio.wait_for(end.wait(), 1.0 if options.live else None)
            except TimeoutError:
                say(_live_line(running))
    for text in running.close():
        say(text)
    emulator_frames = running.emulator.frame
    say(f"ended after {emulator_frames * running.emulator.clock.frame_us / 1e6:.3f} s, {emulator_frames} frames")


async def _open_port(
    options: ServeOptions, running: RunningBoard, loop: asyncio.AbstractEventLoop
) -> PtyPort | TcpPort | BusPort:
    if options.pty is not None:
        return PtyPort(running.board, options.pty, loop)
    if options.tcp is not None:
        return await TcpPort.listen(running.board, *options.tcp, loop)
    interface, separator, channel = (options.can or "").removeprefix("can:").partition(":")
    if not separator or not channel:
        raise BenchConfigError(f"--can {options.can}: write slcan:LINK or INTERFACE:CHANNEL, as in slcan:/tmp/rm501can")
    if interface == "slcan":
        return SlcanPort(running.board, Path(channel), loop)
    return BusPort(running.board, interface, channel, loop)


def _live_line(running: RunningBoard) -> str:
    truth = running.emulator.truth()
    emulator = running.emulator
    joints = " ".join(f"{angle:8.2f}" for angle in truth.joint_deg)
    inputs = ",".join(name for name, active in truth.inputs.items() if active) or "-"
    return (
        f"{emulator.frame * emulator.clock.frame_us / 1e6:9.1f} s  {emulator.board.state.name:8}  joints {joints} deg  "
        f"errors {truth.counter_error_steps}  inputs {inputs}"
    )


def _end_on_signals(loop: asyncio.AbstractEventLoop, end: asyncio.Event) -> None:
    if sys.platform == "win32":
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(end.set))
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)

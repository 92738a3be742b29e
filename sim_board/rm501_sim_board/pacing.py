"""Ties an emulator to an event loop's clock: bytes in and out at their times, frames as time goes by.

Only `loop.time()` and `loop.call_at()` are used, so the same code is paced by the wall clock or jumps on a virtual
one. A process that was late runs every frame it missed; time is never skipped and never dropped.

    host ── write ──► line to board ──► at its arrival: run the board to now, let it receive
    host ◄─ data ─── line to host  ◄── after every run: what the board has sent
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rm501_sim_board.emulator import Emulator
from rm501_sim_board.line_model import BITS_PER_BYTE, LineModel
from rm501_sim_board.randomness import stream

DEFAULT_BAUD = 250_000
# Unasked messages (status, triggers, faults) leave the board at the next tick.
DEFAULT_TICK_S = 0.010
# After bytes have reached the board its answer is fetched this many frames later.
_ANSWER_FRAMES = 2


class PacedBoard:
    """An emulator running on an event loop. At most one listener gets what the board sends."""

    def __init__(
        self,
        emulator: Emulator,
        loop: asyncio.AbstractEventLoop,
        *,
        baud: int | None = DEFAULT_BAUD,
        tick_s: float = DEFAULT_TICK_S,
    ) -> None:
        self.emulator = emulator
        self.baud = baud
        seed = emulator.options.seed
        bytes_per_second = None if baud is None else baud / BITS_PER_BYTE
        self.to_board = LineModel(bytes_per_second, stream(seed, "line to board"))
        self.to_host = LineModel(bytes_per_second, stream(seed, "line to host"))
        self.cut = False
        self._loop = loop
        self._tick_s = tick_s
        self._start_s = loop.time()
        self._start_frame = emulator.frame
        self._frame_s = emulator.clock.frame_us * 1e-6
        self._listener: Callable[[bytes], None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False
        self._wake_at(loop.time() + tick_s)

    @property
    def bytes_per_second(self) -> int | None:
        """Line speed, None when the line takes no time."""
        return None if self.baud is None else self.baud // BITS_PER_BYTE

    def attach(self, listener: Callable[[bytes], None]) -> None:
        """From now on `listener` gets what the board sends."""
        self._listener = listener

    def detach(self) -> None:
        """Nobody listens any more; what the board sends is lost, as on an open connector."""
        self._listener = None

    def write(self, data: bytes) -> None:
        """Bytes leave the host now."""
        if self._closed or not data:
            return
        arrival_s, data = self.to_board.send(data, self._loop.time())
        if data and not self.cut:
            self._loop.call_at(arrival_s, self._arrive, data)

    def frame_at(self, time_s: float) -> int:
        """The real frame that the loop's time falls into."""
        # A timer set for a frame's very start may fire a rounding error early.
        return self._start_frame + int((time_s - self._start_s) / self._frame_s + 1e-6)

    def run_to_now(self) -> None:
        """Bring the emulator up to the loop's time and send what it has to say."""
        if self._closed:
            return
        self.emulator.advance_to(self.frame_at(self._loop.time()))
        self._collect()

    def close(self) -> None:
        """Bring the emulator up to now and stop."""
        if self._closed:
            return
        self.run_to_now()
        self._closed = True
        self._listener = None
        if self._timer is not None:
            self._timer.cancel()

    def _arrive(self, data: bytes) -> None:
        if self._closed:
            return
        self.emulator.advance_to(self.frame_at(self._loop.time()))
        self.emulator.receive(data)
        self._collect()
        self._wake_at(self._loop.time() + _ANSWER_FRAMES * self._frame_s)

    def _tick(self) -> None:
        self._timer = None
        self.run_to_now()
        self._wake_at(self._loop.time() + self._tick_s)

    def _wake_at(self, time_s: float) -> None:
        if self._timer is not None:
            if self._timer.when() <= time_s:
                return
            self._timer.cancel()
        self._timer = self._loop.call_at(time_s, self._tick)

    def _collect(self) -> None:
        data = self.emulator.transmit()
        if not data:
            return
        arrival_s, data = self.to_host.send(data, self._loop.time())
        if data and not self.cut:
            self._loop.call_at(arrival_s, self._deliver, data)

    def _deliver(self, data: bytes) -> None:
        if self._listener is not None and not self._closed:
            self._listener(data)

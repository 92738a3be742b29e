"""Ties an emulator to an event loop's clock: bytes in and out at their times, frames as time goes by.

Only `loop.time()`, `loop.call_at()` and `loop.call_soon()` are used, so the same code is paced by the wall clock or
jumps on a virtual one. A process that was late runs every frame it missed; time is never skipped and never dropped.

The board is run at regular ticks, and shortly after bytes have reached it, which is when its messages leave. Times at
which it surely has nothing to say are left out, and the frames they would have made are made later in one piece; the
others stay as they were.

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
DEFAULT_TICK_S = 0.020
# No stretch of left out ticks is longer than that: whoever runs a board in real time should not have to catch up.
_LEFT_OUT_S = 0.25
# After bytes have reached the board its answer is fetched this many frames later.
_ANSWER_FRAMES = 2

Listener = Callable[[bytes], None]


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
        self.loop = loop
        self.baud = baud
        seed = emulator.options.seed
        bytes_per_second = None if baud is None else baud / BITS_PER_BYTE
        self.to_board = LineModel(bytes_per_second, stream(seed, "line to board"))
        self.to_host = LineModel(bytes_per_second, stream(seed, "line to host"))
        # Hooks of faults: what the board sends passes through here before it enters the line.
        self.alter_sent: Callable[[bytes], bytes] | None = None
        self.can_reorder_probability = 0.0
        self.packets = emulator.options.packets
        self.plugged = True
        self._tick_s = tick_s
        self._origin_s = loop.time()
        self._origin_frame = float(emulator.frame)
        self._frame_s = emulator.clock.frame_us * 1e-6
        self._drift = 1.0
        self._listener: Listener | None = None
        self._on_plug: Callable[[bool], None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False
        # A tick, past or next, from which the others follow; it may be one that was left out.
        self._grid_s = loop.time()
        emulator.bench.on_withdrawal = self._leave_no_tick_out
        self._wake_at(self._next_tick_s())

    # ------------------------------------------------------------ the port's side

    @property
    def bytes_per_second(self) -> int | None:
        """Line speed, None when the line takes no time."""
        return None if self.baud is None else self.baud // BITS_PER_BYTE

    @property
    def closed(self) -> bool:
        """Whether the board has been switched off for good."""
        return self._closed

    @property
    def attached(self) -> bool:
        """Whether somebody listens."""
        return self._listener is not None

    def attach(self, listener: Listener, on_plug: Callable[[bool], None] | None = None) -> None:
        """From now on `listener` gets what the board sends; `on_plug` hears when the plug is pulled and put back."""
        self._listener = listener
        self._on_plug = on_plug

    def detach(self) -> None:
        """Nobody listens any more; what the board sends is lost, as on an open connector."""
        self._listener = None
        self._on_plug = None

    def write(self, data: bytes) -> None:
        """Bytes leave the host now."""
        if self._closed or not data or not self.plugged:
            return
        arrival_s, data = self.to_board.send(data, self.loop.time())
        if data:
            self.loop.call_at(arrival_s, self._arrive, data)

    def close(self) -> None:
        """Bring the emulator up to now and stop."""
        if self._closed:
            return
        self.run_to_now()
        self._closed = True
        self.detach()
        if self._timer is not None:
            self._timer.cancel()

    # ------------------------------------------------------------ time

    def frame_at(self, time_s: float) -> int:
        """The real frame that the loop's time falls into, by the board's own oscillator."""
        # A timer set for a frame's very start may fire a rounding error early.
        return int(self._origin_frame + (time_s - self._origin_s) * self._drift / self._frame_s + 1e-6)

    def run_to_now(self) -> None:
        """Bring the emulator up to the loop's time and send what it has to say."""
        if not self._closed:
            self._run()
            self._leave_no_tick_out()

    def _run(self) -> None:
        self.emulator.advance_to(self.frame_at(self.loop.time()))
        self._follow_frame_length()
        self._collect()

    def set_clock(self, drift_ppm: float = 0.0, jump_s: float = 0.0) -> None:
        """Let the board's oscillator run fast by `drift_ppm` from now on, or its time jump ahead by `jump_s`."""
        self._rebase(self.loop.time())
        self._drift = 1.0 + drift_ppm * 1e-6
        self._origin_frame += max(0.0, jump_s) / self._frame_s
        self._leave_no_tick_out()

    # ------------------------------------------------------------ the fault's side

    def pull_plug(self) -> None:
        """Pull the plug between host and board; the host's end is told."""
        if self.plugged:
            self.plugged = False
            self._listener = None
            if self._on_plug is not None:
                self._on_plug(False)

    def put_plug_back(self) -> None:
        """Put the plug back; whoever wants the port opens it again."""
        if not self.plugged:
            self.plugged = True
            if self._on_plug is not None:
                self._on_plug(True)

    def noise(self, data: bytes) -> None:
        """Bytes that no host sent reach the board."""
        if not self._closed:
            self.loop.call_soon(self._arrive, data)

    # ------------------------------------------------------------ internal

    def _rebase(self, now_s: float) -> None:
        self._origin_frame += (now_s - self._origin_s) * self._drift / self._frame_s
        self._origin_s = now_s

    def _follow_frame_length(self) -> None:
        """A new configuration may have changed base period or table; the board then recounts its frames."""
        frame_s = self.emulator.clock.frame_us * 1e-6
        if frame_s != self._frame_s:
            now_s = self.loop.time()
            self._rebase(now_s)
            self._origin_frame = float(self.emulator.frame)
            self._frame_s = frame_s

    def _arrive(self, data: bytes) -> None:
        if self._closed:
            return
        self.emulator.advance_to(self.frame_at(self.loop.time()))
        self.emulator.receive(data)
        self._follow_frame_length()
        self._collect()
        self._grid_s = min(self._next_tick_s(), self.loop.time() + _ANSWER_FRAMES * self._frame_s)
        self._wake_at_first_needed(self._grid_s)

    def _tick(self) -> None:
        self._timer = None
        if self._closed:
            return
        self._run()
        self._grid_s = self.loop.time()
        self._wake_at_first_needed(self._grid_s + self._tick_s)

    def _wake_at_first_needed(self, tick_s: float) -> None:
        """Wake at the first tick from `tick_s` on at which the board may have something to say."""
        latest_s = self.loop.time() + _LEFT_OUT_S
        if tick_s < latest_s:
            quiet_until = self.emulator.quiet_until()
            while tick_s < latest_s and self.frame_at(tick_s) <= quiet_until:
                tick_s += self._tick_s
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self.loop.call_at(tick_s, self._tick)

    def _next_tick_s(self) -> float:
        """When the next tick would be, had none been left out."""
        now_s = self.loop.time()
        at_s = self._grid_s
        while at_s <= now_s:
            at_s += self._tick_s
        return at_s

    def _leave_no_tick_out(self) -> None:
        """What the board was thought to do may have changed: look at it at the next tick."""
        self._wake_at(self._next_tick_s())

    def _wake_at(self, time_s: float) -> None:
        if self._closed:
            return
        if self._timer is not None:
            if self._timer.when() <= time_s:
                return
            self._timer.cancel()
        self._timer = self.loop.call_at(time_s, self._tick)

    def _collect(self) -> None:
        if self.packets:
            for packet in self.emulator.transmit_packets():
                self._send_to_host(packet)
        elif data := self.emulator.transmit():
            self._send_to_host(data if self.alter_sent is None else self.alter_sent(data))

    def _send_to_host(self, data: bytes) -> None:
        arrival_s, data = self.to_host.send(data, self.loop.time())
        if data and self.plugged:
            self.loop.call_at(arrival_s, self._deliver, data)

    def _deliver(self, data: bytes) -> None:
        if self._listener is not None and self.plugged and not self._closed:
            self._listener(data)

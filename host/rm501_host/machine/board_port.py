"""The machine's connection to its board: opened, watched, opened again when it was lost.

Reconnecting never moves anything: a fresh session only reads. Waits between attempts grow from 0.2 s to 2 s.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from rm501_host.errors import Rm501Error
from rm501_host.session import BoardSession, open_session
from rm501_host.session.board_session import Notice, WireTap
from rm501_protocol.board_config import BoardConfig
from rm501_protocol.messages import SetStatusPeriod
from rm501_protocol.transport import Transport

STATUS_PERIOD_MS = 40
"""25 statuses a second, 2.5 of the 25 kB/s of the line; every change of state comes at once anyway."""
SHORTEST_STATUS_PERIOD_MS = 20
"""While somebody watches at 50 Hz: 5 of the 25 kB/s; the CPU that it costs is lost in the noise (benchmarks.daemon)."""
_FIRST_WAIT_S = 0.2
_LONGEST_WAIT_S = 2.0
_SILENCE_S = 3.0
"""A session that stays silent for so long after it was noticed is given up; a host that was stopped for 5 s hears
its board at once when it wakes.
"""


class BoardPort:
    """Keeps one session open. `on_up(session)`, `on_down(error)` and `on_notice(notice)` are called from the loop."""

    def __init__(
        self,
        open_transport: Callable[[], Coroutine[Any, Any, Transport]],
        board_config: BoardConfig,
        nonce: Callable[[], int],
        wire_tap: WireTap | None,
        on_up: Callable[[BoardSession], None],
        on_down: Callable[[Rm501Error], None],
        on_notice: Callable[[Notice], None],
    ) -> None:
        self._open_transport = open_transport
        self._board_config = board_config
        self._nonce = nonce
        self._wire_tap = wire_tap
        self._on_up = on_up
        self._on_down = on_down
        self._on_notice = on_notice
        self.session: BoardSession | None = None
        self._status_period_ms = STATUS_PERIOD_MS

    def set_status_period(self, wanted_ms: int) -> None:
        """Ask the board for its status every `wanted_ms`, now and after reconnecting; within 20 to 40 ms."""
        period_ms = min(max(wanted_ms, SHORTEST_STATUS_PERIOD_MS), STATUS_PERIOD_MS)
        if period_ms != self._status_period_ms:
            self._status_period_ms = period_ms
            if self.session is not None and self.session.failure is None:
                self.session.post(SetStatusPeriod(period_ms))

    async def run(self) -> None:
        """Connect, watch, connect again, until cancelled."""
        wait_s = _FIRST_WAIT_S
        while True:
            try:
                session = await open_session(self._open_transport(), self._board_config, self._nonce, self._wire_tap)
            except Rm501Error as error:
                self._on_down(error)
                await asyncio.sleep(wait_s)
                wait_s = min(2 * wait_s, _LONGEST_WAIT_S)
                continue
            wait_s = _FIRST_WAIT_S
            try:
                await self._watch(session)
            except Rm501Error as error:
                self._on_down(error)
            finally:
                self.session = None
                await session.aclose()

    async def _watch(self, session: BoardSession) -> None:
        session.add_listener(self._on_notice)
        session.post(SetStatusPeriod(self._status_period_ms))
        await session.refresh_status()
        self.session = session
        self._on_up(session)
        loop = asyncio.get_running_loop()
        silent_since_s: float | None = None
        while session.failure is None:
            # A failure wakes this wait; its timeout is only for looking at silence.
            try:
                await session.wait_for(_never, _SILENCE_S / 4, "a failure")
            except Rm501Error as error:
                if session.failure is not None:
                    raise session.failure from error
            if not session.link_silent:
                silent_since_s = None
            elif silent_since_s is None:
                silent_since_s = loop.time()
            elif loop.time() - silent_since_s >= _SILENCE_S:
                session.give_up(f"it has been silent for {session.silence_s:.0f} s")
        raise session.failure


def _never(notice: Notice) -> bool | None:
    return None

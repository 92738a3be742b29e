"""Bringing a board to rest with nothing queued: what an abort, a reset and a motion that broke off have in common."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from rm501_host.errors import StoppedError
from rm501_host.session import BoardRefusedError, BoardSession
from rm501_protocol.enums import BoardState
from rm501_protocol.messages import Hold, MotionEnded, Status, Truncate

REST_TIMEOUT_S = 15.0
"""An on-path stop from full speed takes 1.7 s on the thesis's program; this is far above any."""
_REPORT_TIMEOUT_S = 2.0
_POLL_S = 0.02
_MOVING = (BoardState.RUNNING, BoardState.HOLDING, BoardState.HELD, BoardState.STOPPING)


async def settle(
    session: BoardSession, last_end: Callable[[], MotionEnded | None], is_wanted: Callable[[], bool] = lambda: True
) -> Status:
    """Hold what moves, then drop what is queued, motors as they are: READY, IDLE, BOOT or FAULT; or until nobody wants
    it any more. `last_end`: the newest report of an end of motion. Raises StoppedError when
    it does not come to rest, and what the session raises.
    """
    try:
        async with asyncio.timeout(REST_TIMEOUT_S):
            status = await session.refresh_status()
            while is_wanted() and status.state in _MOVING:
                if status.state is BoardState.RUNNING:
                    session.post(Hold())
                elif status.state is BoardState.HELD:
                    await _drop_queue(session, last_end, status)
                await asyncio.sleep(_POLL_S)
                status = await session.refresh_status()
    except TimeoutError:
        raise StoppedError(
            f"the board did not come to rest within {REST_TIMEOUT_S:.0f} s; look at the arm and the status, then stop"
        ) from None
    return status


async def _drop_queue(session: BoardSession, last_end: Callable[[], MotionEnded | None], status: Status) -> None:
    """Drop what is queued behind a hold, once: a second Truncate would hit the motion after it. Waits for the report of
    the end, too: one that comes late would be taken for the end of the next motion.
    """
    before = last_end()
    with contextlib.suppress(BoardRefusedError):
        await session.command(Truncate(status.motion_frame), lambda now: now.state is not BoardState.HELD)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_REPORT_TIMEOUT_S):
                while last_end() is before and session.failure is None:  # noqa: ASYNC110  # a plain poll
                    await asyncio.sleep(_POLL_S / 2)

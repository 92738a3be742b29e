"""Waiting for a state in real time: for long, as a busy computer is not wrong and a test that passes does not wait."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from typing import TypeVar

PATIENCE_S = 120.0
"""Below pytest's own limit of a test, so that what is waited for is named."""
_POLL_S = 0.02

T = TypeVar("T")


async def until(is_so: Callable[[], object], patience_s: float = PATIENCE_S) -> None:
    """Return once `is_so()`; raises TimeoutError."""
    async with asyncio.timeout(patience_s):
        while not is_so():  # noqa: ASYNC110  # polled from outside
            await asyncio.sleep(_POLL_S)


async def until_answer(ask: Callable[[], Awaitable[T]], is_so: Callable[[T], object]) -> T:
    """Ask again and again until the answer `is_so`; raises TimeoutError."""
    async with asyncio.timeout(PATIENCE_S):
        while not is_so(answer := await ask()):  # noqa: ASYNC110
            await asyncio.sleep(_POLL_S)
    return answer


def blocking_until(is_so: Callable[[], object], what: str) -> None:
    """Return once `is_so()`, for tests without a loop; raises AssertionError saying `what` never came."""
    for _ in range(round(PATIENCE_S / _POLL_S)):
        if is_so():
            return
        threading.Event().wait(_POLL_S)
    raise AssertionError(f"{what}: never came")

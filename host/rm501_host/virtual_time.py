"""An event loop whose clock jumps to the next timer: the same coroutines, in virtual time, deterministic.

`VirtualLoop.time()` starts at 0 and moves only when nothing is ready to run; then it jumps to the next timer at
once. So a program of minutes runs in as long as its computing takes, and two runs see the same instants. Three
things differ from the ordinary loop:

- Work given to an executor runs at once, inside the loop: a thread would need real time while virtual time runs away.
- A loop with nothing ready, no timer and no file descriptor that could ever wake it is a deadlock, and says so.
- A file descriptor that becomes readable (a signal) is served before the clock jumps; real input and output do not
belong here.
"""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar, TypeVarTuple

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


class VirtualDeadlockError(RuntimeError):
    """Every coroutine waits for something that can never happen."""


class _JumpingSelector(selectors.DefaultSelector):
    """Polls the real descriptors and turns the time it should have waited into a jump of the virtual clock."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        events = super().select(0)
        if events or (timeout is not None and timeout <= 0):
            return events
        if timeout is None:
            raise VirtualDeadlockError("nothing is ready, no timer is set: all tasks wait for each other")
        self.now_s += timeout
        return events


class VirtualLoop(asyncio.SelectorEventLoop):
    """An asyncio loop on virtual time; see the module's text."""

    def __init__(self) -> None:
        self._virtual_clock = _JumpingSelector()
        super().__init__(self._virtual_clock)
        # asyncio runs every timer that is due within this; a nanosecond keeps separate instants separate.
        self._clock_resolution = 1e-9

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._virtual_clock.now_s

    def stand_still(self, seconds: float) -> None:
        """Let time pass while nothing runs, as for a process that is stopped and goes on."""
        self._virtual_clock.now_s += seconds

    def run_in_executor(self, executor: object, func: Callable[[*Ts], T], *args: *Ts) -> asyncio.Future[T]:
        """Run `func` at once; the clock stands still meanwhile."""
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future


def run_virtual(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end on a fresh VirtualLoop, as `asyncio.run` does on a real one."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)


class _ScaledSelector(selectors.DefaultSelector):
    """Waits a fraction of what it is asked to."""

    def __init__(self, factor: float) -> None:
        super().__init__()
        self._factor = factor

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        return super().select(None if timeout is None else timeout / self._factor)


class ScaledLoop(asyncio.SelectorEventLoop):
    """An asyncio loop whose clock runs `factor` times as fast as the wall's."""

    def __init__(self, factor: float) -> None:
        self._factor = factor
        super().__init__(_ScaledSelector(factor))

    def time(self) -> float:
        """Seconds of loop time."""
        return super().time() * self._factor

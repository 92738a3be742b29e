"""Motions as jobs: numbered, owned, one at a time, with a result that can be waited for later."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass, field
from enum import Enum

from rm501_host.errors import RefusedError, Rm501Error
from rm501_host.machine.lease import Owner
from rm501_host.machine.states import Mode

_REMEMBERED = 64
"""Finished jobs whose result can still be asked for."""


class JobKind(Enum):
    """What moves the arm."""

    HOME = "home"
    JOG = "jog"
    MOVE = "move"
    MDI = "mdi"
    PROGRAM = "program"
    HAND = "hand"
    TRAJECTORY = "trajectory"

    @property
    def mode(self) -> Mode:
        """The mode that belongs to it."""
        return {JobKind.MDI: Mode.MDI, JobKind.PROGRAM: Mode.AUTO}.get(self, Mode.MANUAL)


@dataclass(eq=False)
class Job:
    """One motion. `error` is None while it runs and when it ended well."""

    id: int
    kind: JobKind
    owner: Owner
    done: asyncio.Event = field(default_factory=asyncio.Event)
    error: Rm501Error | None = None
    result: dict[str, object] = field(default_factory=dict)

    async def wait(self) -> dict[str, object]:
        """Wait for the end; raises the error that ended it early."""
        await self.done.wait()
        if self.error is not None:
            raise self.error
        return self.result


class JobBook:
    """Numbers jobs and remembers the last ones."""

    def __init__(self) -> None:
        self._jobs: OrderedDict[int, Job] = OrderedDict()
        self._next = 1

    def new(self, kind: JobKind, owner: Owner) -> Job:
        """A new job; the oldest one that has ended is forgotten."""
        job = Job(self._next, kind, owner)
        self._next += 1
        self._jobs[job.id] = job
        while len(self._jobs) > _REMEMBERED:
            self._jobs.popitem(last=False)
        return job

    def get(self, number: int) -> Job:
        """The job of that number; raises RefusedError when it is unknown or forgotten."""
        try:
            return self._jobs[number]
        except KeyError:
            raise RefusedError(
                f"there is no motion {number}; the last {_REMEMBERED} are remembered, status has the newest number"
            ) from None

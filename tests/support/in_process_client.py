"""A `DaemonClient` on a service in the same loop, so that client code runs in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from rm501_host.client.client import DaemonClient
from rm501_host.daemon.access import Access
from rm501_host.daemon.methods import api
from rm501_host.daemon.rpc import Dispatcher
from rm501_host.daemon.service import Client, Service


class _InProcessLine:
    def __init__(self, service: Service, tasks: asyncio.TaskGroup) -> None:
        self._incoming: asyncio.Queue[bytes | None] = asyncio.Queue()
        self._service = service
        self._tasks = tasks
        self._caller = service.connect("in process", Access.FULL, self._incoming.put_nowait, lambda: 0)
        self._dispatcher: Dispatcher[Client] = Dispatcher(api)

    async def send(self, message: bytes) -> None:
        self._tasks.create_task(self._answer(message))

    async def _answer(self, message: bytes) -> None:
        answer = await self._dispatcher.answer(message, self._caller)
        if answer is not None:
            self._incoming.put_nowait(answer)

    async def receive(self) -> bytes | None:
        return await self._incoming.get()

    async def aclose(self) -> None:
        self._service.disconnect(self._caller)
        self._incoming.put_nowait(None)


@asynccontextmanager
async def client_in_process(service: Service) -> AsyncIterator[DaemonClient]:
    """A connected client of `service`."""
    async with asyncio.TaskGroup() as tasks, DaemonClient(_InProcessLine(service, tasks)) as client:
        yield client

"""One client's requests, however its bytes arrive: answered side by side, so that a long wait holds up nothing.

`STOP never waits behind a queue`: every request is its own task; beyond `MAX_IN_FLIGHT` unanswered ones a client is
told to slow down, except for methods that stop the arm.
"""

from __future__ import annotations

import asyncio

from rm501_host.daemon.rpc import Code, Dispatcher, error_response
from rm501_host.daemon.service import Client

MAX_IN_FLIGHT = 32
_STOPPING = (b'"stop"', b'"kill"', b'"hold"')


class Requests:
    """Answers the requests of one client inside a task group."""

    def __init__(self, client: Client, dispatcher: Dispatcher[Client], tasks: asyncio.TaskGroup) -> None:
        self._client = client
        self._dispatcher = dispatcher
        self._tasks = tasks
        self._in_flight: set[asyncio.Task[None]] = set()

    def take(self, body: bytes) -> None:
        """A request has arrived."""
        if len(self._in_flight) >= MAX_IN_FLIGHT and not any(word in body for word in _STOPPING):
            self._client.send(error_response(Code.RATE_LIMITED, f"more than {MAX_IN_FLIGHT} requests are unanswered"))
            return
        task = self._tasks.create_task(self._answer(body))
        self._in_flight.add(task)
        task.add_done_callback(self._in_flight.discard)

    def cancel(self) -> None:
        """The client is gone: nobody waits for answers any more."""
        for task in tuple(self._in_flight):
            task.cancel()

    async def _answer(self, body: bytes) -> None:
        answer = await self._dispatcher.answer(body, self._client)
        if answer is not None:
            self._client.send(answer)

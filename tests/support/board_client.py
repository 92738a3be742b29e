"""A small host for tests of boards: the host's end of the link on any transport, on whatever loop runs."""

from __future__ import annotations

import asyncio
from typing import TypeVar

from rm501_protocol.declaration import Message
from rm501_protocol.enums import SegmentFlag
from rm501_protocol.framing import PacketCodec
from rm501_protocol.host_link import HostLink
from rm501_protocol.link_events import Received, SessionOpened
from rm501_protocol.messages import MotorTerm, Segment, SetPower, Start, Status, StatusRequest
from rm501_protocol.transport import Transport
from tests.support.patience import PATIENCE_S

M = TypeVar("M", bound=Message)


class BoardClient:
    """Talks to one board; everything received is kept in `messages`."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        codec = PacketCodec() if transport.packets else None
        self.link = HostLink(codec=codec, bytes_per_second=transport.bytes_per_second)
        self.messages: list[Message] = []
        self.lost: Exception | None = None
        self.closed = False
        self._loop = asyncio.get_running_loop()
        self._changed = asyncio.Event()
        self._timer: asyncio.TimerHandle | None = None
        self.next_frame = 0

    def data_received(self, data: bytes) -> None:
        self.link.receive_data(data, self._now_us())
        self._pump()

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost, self.closed = exc, True
        if self._timer is not None:
            self._timer.cancel()
        self._changed.set()

    async def open(self, nonce: int = 1) -> None:
        self.transport.start(self)
        self.link.connect(nonce, self._now_us())
        self._pump()
        await self.until(lambda: self.link.is_open)

    def send(self, message: Message) -> None:
        self.link.send(message)
        self._pump()

    async def until(self, condition, timeout_s: float = PATIENCE_S) -> None:
        async with asyncio.timeout(timeout_s):
            while not condition():
                self._changed.clear()
                await self._changed.wait()

    def of(self, kind: type[M]) -> list[M]:
        return [m for m in self.messages if isinstance(m, kind)]

    async def status(self) -> Status:
        count = len(self.of(Status))
        self.send(StatusRequest())
        await self.until(lambda: len(self.of(Status)) > count)
        return self.of(Status)[-1]

    async def power_on(self) -> None:
        self.send(SetPower(True))
        async with asyncio.timeout(PATIENCE_S):
            while not (await self.status()).power:
                pass

    def jump(self, motor: int, steps: int, seconds: float) -> None:
        """Queue a move of one motor at rest at both ends: half the time speeding up, half slowing down."""
        half = max(1, round(seconds * 3125 / 2))
        # position after n frames from rest is a n (n - 1) / 2, so the peak speed is reached at n = half
        acceleration = round(steps * 2**40 / half**2)
        start = MotorTerm(motor, 0, acceleration, 0)
        end = MotorTerm(motor, (acceleration * half) >> 8, -acceleration, 0)
        for term, last in ((start, False), (end, True)):
            flags = SegmentFlag.ENDS_AT_REST if last else SegmentFlag.NONE
            self.send(Segment(self.next_frame & 0xFFFFFFFF, half, (term,), flags, 2000, 3000))
            self.next_frame += half

    def start(self) -> None:
        self.send(Start())

    def _now_us(self) -> int:
        return int(self._loop.time() * 1e6)

    def _pump(self) -> None:
        if self.closed:
            return
        now = self._now_us()
        while (event := self.link.next_event()) is not None:
            if isinstance(event, Received):
                self.messages.append(event.message)
            elif isinstance(event, SessionOpened):
                pass
        if self.transport.packets:
            for packet in self.link.packets_to_send(now):
                self.transport.write(packet)
        elif data := self.link.data_to_send(now):
            self.transport.write(data)
        if self._timer is not None:
            self._timer.cancel()
        deadline = self.link.next_deadline_us()
        if deadline is not None:
            self._timer = self._loop.call_at(max(deadline, now + 100) * 1e-6, self._wake)
        self._changed.set()

    def _wake(self) -> None:
        self.link.handle_timer(self._now_us())
        self._pump()

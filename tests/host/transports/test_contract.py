"""One suite for every transport: the same promises, whatever carries the bytes.

Each case gives a transport and its far end (`send`, `received`, `hang_up`), made from the operating system's own means.
"""

import asyncio
import os
import pty
import random
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import pytest

from rm501_host.transports import PortError, TransportClosedError, open_transport
from rm501_host.transports.serial_port import ThreadedSerialTransport
from rm501_protocol.transport import Receiver, Transport
from tests.support.patience import PATIENCE_S


@dataclass
class Collector:
    data: bytearray = field(default_factory=bytearray)
    chunks: list[bytes] = field(default_factory=list)
    lost: list[Exception | None] = field(default_factory=list)
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def data_received(self, data: bytes) -> None:
        assert data and not self.lost
        self.data += data
        self.chunks.append(data)
        self.changed.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost.append(exc)
        self.changed.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():
                self.changed.clear()
                await self.changed.wait()


@dataclass
class FarEnd:
    send: Callable[[bytes], None]
    received: bytearray
    changed: asyncio.Event
    hang_up: Callable[[], None]

    async def until(self, count: int) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.received) < count:
                self.changed.clear()
                await self.changed.wait()


@asynccontextmanager
async def over_pty() -> AsyncIterator[tuple[Transport, FarEnd]]:
    near, far = pty.openpty()
    tty.setraw(far)
    path = os.ttyname(far)
    loop = asyncio.get_running_loop()
    received, changed = bytearray(), asyncio.Event()
    closed = False

    def readable() -> None:
        try:
            received.extend(os.read(near, 65536))
        except OSError:
            loop.remove_reader(near)
        changed.set()

    def hang_up() -> None:
        nonlocal closed
        if not closed:
            closed = True
            loop.remove_reader(near)
            os.close(near)

    loop.add_reader(near, readable)
    transport = await open_transport(path)
    os.close(far)
    try:
        yield transport, FarEnd(lambda data: _write_all(near, data), received, changed, hang_up)
    finally:
        await transport.aclose()
        hang_up()


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


@asynccontextmanager
async def over_threaded_pty() -> AsyncIterator[tuple[Transport, FarEnd]]:
    import serial

    near, far = pty.openpty()
    tty.setraw(far)
    path = os.ttyname(far)
    loop = asyncio.get_running_loop()
    received, changed = bytearray(), asyncio.Event()
    closed = False

    def readable() -> None:
        try:
            received.extend(os.read(near, 65536))
        except OSError:
            loop.remove_reader(near)
        changed.set()

    def hang_up() -> None:
        nonlocal closed
        if not closed:
            closed = True
            loop.remove_reader(near)
            os.close(near)

    loop.add_reader(near, readable)
    transport = ThreadedSerialTransport(path, serial.Serial(path, 250000, exclusive=True), 250000, loop)
    os.close(far)
    try:
        yield transport, FarEnd(lambda data: _write_all(near, data), received, changed, hang_up)
    finally:
        await transport.aclose()
        hang_up()


@asynccontextmanager
async def over_tcp() -> AsyncIterator[tuple[Transport, FarEnd]]:
    received, changed = bytearray(), asyncio.Event()
    connected: asyncio.Future[asyncio.StreamWriter] = asyncio.get_running_loop().create_future()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connected.set_result(writer)
        try:
            while data := await reader.read(65536):
                received.extend(data)
                changed.set()
        except ConnectionError:
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    transport = await open_transport(f"socket://127.0.0.1:{port}")
    writer = await connected
    try:
        yield transport, FarEnd(writer.write, received, changed, writer.transport.abort)
    finally:
        await transport.aclose()
        writer.transport.abort()
        server.close()
        await server.wait_closed()


STREAMS = {"pty": over_pty, "pty read by a thread": over_threaded_pty, "tcp": over_tcp}
every_stream = pytest.mark.parametrize("case", STREAMS.values(), ids=STREAMS.keys())


@every_stream
async def test_bytes_arrive_unchanged_in_both_directions(case) -> None:
    data = random.Random(1).randbytes(20_000)  # more than any kernel buffer of a pty holds
    async with case() as (transport, far):
        collector = Collector()
        transport.start(collector)
        assert isinstance(transport, Transport) and isinstance(collector, Receiver)
        for start in range(0, len(data), 500):
            transport.write(data[start : start + 500])
            await far.until(min(len(data), start + 500))
        assert bytes(far.received) == data
        for start in range(0, len(data), 500):
            far.send(data[start : start + 500])
            end = min(len(data), start + 500)
            await collector.until(lambda end=end: len(collector.data) >= end)
        assert bytes(collector.data) == data
        assert not collector.lost


@every_stream
async def test_one_byte_at_a_time(case) -> None:
    data = bytes(range(256))
    async with case() as (transport, far):
        collector = Collector()
        transport.start(collector)
        for value in data:
            far.send(bytes((value,)))
            await collector.until(lambda value=value: len(collector.data) > value)
            transport.write(bytes((value,)))
            await far.until(value + 1)
        assert bytes(collector.data) == bytes(far.received) == data


@every_stream
async def test_what_came_before_start_is_delivered(case) -> None:
    async with case() as (transport, far):
        far.send(b"early")
        await asyncio.sleep(0.05)
        collector = Collector()
        transport.start(collector)
        await collector.until(lambda: len(collector.data) >= 5)
        assert bytes(collector.data) == b"early"


@every_stream
async def test_the_end_is_told_once_with_its_reason_when_the_far_end_hangs_up(case) -> None:
    async with case() as (transport, far):
        collector = Collector()
        transport.start(collector)
        far.hang_up()
        await collector.until(lambda: bool(collector.lost))
        assert isinstance(collector.lost[0], PortError)
        with pytest.raises(TransportClosedError):
            transport.write(b"x")
        await transport.aclose()
        assert len(collector.lost) == 1


@every_stream
async def test_closing_tells_the_receiver_none_and_may_be_repeated(case) -> None:
    async with case() as (transport, _):
        collector = Collector()
        transport.start(collector)
        await transport.aclose()
        await transport.aclose()
        assert collector.lost == [None]
        with pytest.raises(TransportClosedError):
            transport.write(b"x")


async def test_a_stuck_serial_port_ends_with_an_error_instead_of_growing_memory() -> None:
    near, far = pty.openpty()
    tty.setraw(far)
    transport = await open_transport(os.ttyname(far))
    collector = Collector()
    transport.start(collector)
    with pytest.raises(TransportClosedError):
        for _ in range(1000):
            transport.write(bytes(1000))
    assert len(collector.lost) == 1 and "takes no data" in str(collector.lost[0])
    await transport.aclose()
    os.close(near)
    os.close(far)


async def test_a_port_in_use_says_so() -> None:
    near, far = pty.openpty()
    path = os.ttyname(far)
    first = await open_transport(path)
    with pytest.raises(PortError, match="in use"):
        await open_transport(path)
    await first.aclose()
    os.close(near)
    os.close(far)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("/dev/no-such-port", "no such port"),
        ("/dev/null?baud=fast", "no baud rate"),
        ("/dev/null?parity=even", "unknown option"),
        ("socket://127.0.0.1:1", "listening"),
        ("socket://nowhere", "socket://host:port"),
        ("socket://host:port", "socket://host:port"),
        ("carrier-pigeon://loft", "unknown kind of port"),
        ("nonsense", "not a port"),
    ],
)
async def test_a_wrong_url_names_the_remedy(url: str, words: str) -> None:
    with pytest.raises(PortError, match=words) as caught:
        await open_transport(url)
    assert caught.value.url == url

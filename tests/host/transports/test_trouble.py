"""What goes wrong while a transport is open: slow readers, ports that vanish under a write, buses that fail."""

import asyncio
import os
import pty
import threading
import tty

import can
import pytest

from rm501_host.transports import PortError, TransportClosedError, open_transport
from rm501_host.transports.serial_port import SerialTransport, ThreadedSerialTransport
from rm501_host.transports.stream import WRITE_CAP_BYTES
from tests.host.transports.test_can import over_slcan, over_virtual
from tests.host.transports.test_contract import Collector, over_pty, over_tcp, over_threaded_pty
from tests.support.patience import PATIENCE_S


async def test_a_slow_reader_gets_everything_in_order() -> None:
    data = os.urandom(WRITE_CAP_BYTES // 2)
    async with over_pty() as (transport, far):
        transport.start(Collector())
        for start in range(0, len(data), 1000):
            transport.write(data[start : start + 1000])  # the pty holds a few KiB, the rest waits in the transport
        await far.until(len(data))
        assert bytes(far.received) == data
        transport.write(b"more")
        await far.until(len(data) + 4)


@pytest.mark.parametrize("case", [over_pty, over_threaded_pty])
async def test_a_port_that_vanishes_under_a_write(case) -> None:
    async with case() as (transport, far):
        collector = Collector()
        transport.start(collector)
        far.hang_up()
        with pytest.raises(TransportClosedError):
            for _ in range(100):
                transport.write(b"x" * 1000)
                await asyncio.sleep(0)
        await collector.until(lambda: bool(collector.lost))
        assert isinstance(collector.lost[0], PortError) and "reconnect" in str(collector.lost[0])


async def test_a_socket_that_takes_nothing_ends_with_an_error() -> None:
    async with over_tcp() as (transport, _):
        collector = Collector()
        transport.start(collector)
        with pytest.raises(TransportClosedError):
            for _ in range(1000):
                transport.write(bytes(WRITE_CAP_BYTES))
        assert len(collector.lost) == 1 and "takes no data" in str(collector.lost[0])


async def test_an_end_before_start_is_told_at_start() -> None:
    async with over_pty() as (transport, far):
        far.hang_up()
        async with asyncio.timeout(PATIENCE_S):
            while True:
                try:
                    transport.write(b"x")
                except TransportClosedError:
                    break
                await asyncio.sleep(0.01)
        collector = Collector()
        transport.start(collector)
        assert len(collector.lost) == 1


async def test_a_loop_that_cannot_watch_descriptors_gets_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> None:
        raise NotImplementedError

    near, far = pty.openpty()
    tty.setraw(far)
    with monkeypatch.context() as patch:
        patch.setattr(asyncio.get_running_loop(), "add_reader", refuse)
        transport = await open_transport(os.ttyname(far))
    assert isinstance(transport, ThreadedSerialTransport) and not isinstance(transport, SerialTransport)
    await transport.aclose()
    os.close(near)
    os.close(far)


async def test_lines_that_are_no_frame_are_counted_and_the_bus_goes_on() -> None:
    async with over_slcan() as (transport, board):
        collector = Collector()
        transport.start(collector)
        os.write(board.descriptor, b"tXYZ0\rt1239AB\r\a")  # type: ignore[attr-defined]
        board.send(b"\x20good")
        await collector.until(lambda: bool(collector.chunks))
        assert collector.chunks == [b"\x20good"] and transport.health.malformed >= 1


async def test_a_bus_that_fails_while_reading() -> None:
    async with over_virtual() as (transport, _):
        collector = Collector()
        transport.start(collector)
        transport._bus._open = False  # the interface is gone
        await collector.until(lambda: bool(collector.lost))
        assert isinstance(collector.lost[0], PortError) and "gone" in str(collector.lost[0])
        transport._bus._open = True


async def test_a_bus_that_fails_while_sending(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **options: object) -> None:
        raise can.CanOperationError("no buffer space")

    async with over_virtual() as (transport, _):
        collector = Collector()
        transport.start(collector)
        monkeypatch.setattr(transport._bus, "send", fail)
        transport.write(b"\x20abc")
        await collector.until(lambda: bool(collector.lost))
        assert "cannot send (no buffer space" in str(collector.lost[0])


async def test_a_bus_that_takes_nothing_and_a_stop_that_passes_what_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []
    gate = threading.Event()

    async with over_virtual() as (transport, _):
        collector = Collector()
        transport.start(collector)

        def slow(message: can.Message, timeout: float | None = None) -> None:
            gate.wait(PATIENCE_S)
            sent.append(message.arbitration_id)

        monkeypatch.setattr(transport._bus, "send", slow)
        for _ in range(10):
            transport.write(b"\x20" + bytes(50))
        transport.write(b"\x04" + bytes(12))
        gate.set()
        async with asyncio.timeout(PATIENCE_S):
            while len(sent) < 82:  # noqa: ASYNC110 - counted in a thread
                await asyncio.sleep(0.01)
        stops = [place for place, identifier in enumerate(sent) if identifier >> 8 == 0]
        assert len(stops) == 2 and max(stops) <= 2, "at once, or right behind the frame that was already on its way"
        gate.clear()
        with pytest.raises(TransportClosedError):
            for _ in range(1000):
                transport.write(b"\x20" + bytes(50))
        assert "takes no frames" in str(collector.lost[0])
        gate.set()

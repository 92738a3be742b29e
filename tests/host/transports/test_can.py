"""CAN through python-can, tried for real: slcan over a pty against an emulated adapter, and the virtual bus."""

import asyncio
import os
import pty
import random
import tty
import zlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import can
import pytest

from rm501_host.transports import PortError, TransportClosedError, open_transport
from rm501_host.transports.can_port import CanTransport
from rm501_protocol.can_transfer import CanFrame, TransferReceiver, TransferSender
from rm501_protocol.declaration import registry
from rm501_protocol.link import BoardLink, HostLink, PacketCodec, Received, SessionOpened, StopAcknowledged, StopKind
from rm501_protocol.messages import Hold, Identify, MotorTerm, Segment
from rm501_protocol.slcan import SlcanAdapter
from tests.host.transports.test_contract import Collector
from tests.protocol.examples import EXAMPLES
from tests.support.patience import PATIENCE_S


class FarBoard:
    """The board's end of a bus: assembles packets, answers through `put`."""

    def __init__(self, frame_bytes: int) -> None:
        self.receiver = TransferReceiver(1, from_board=False)
        self.sender = TransferSender(1, from_board=True, frame_bytes=frame_bytes)
        self.packets: list[bytes] = []
        self.frames: list[CanFrame] = []
        self.changed = asyncio.Event()

    def frame(self, frame: CanFrame) -> None:
        self.frames.append(frame)
        packet = self.receiver.feed(frame)
        if packet is not None:
            self.packets.append(packet)
            self.changed.set()

    def put(self, frame: CanFrame) -> None:
        raise NotImplementedError

    def send(self, packet: bytes) -> None:
        for frame in self.sender.frames(packet):
            self.put(frame)

    async def until(self, count: int) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.packets) < count:
                self.changed.clear()
                await self.changed.wait()


class SlcanBoard(FarBoard):
    def __init__(self, descriptor: int) -> None:
        super().__init__(8)
        self.descriptor = descriptor
        self.adapter = SlcanAdapter()

    def readable(self) -> None:
        for frame in self.adapter.receive(os.read(self.descriptor, 4096)):
            self.frame(frame)
        os.write(self.descriptor, self.adapter.replies())

    def put(self, frame: CanFrame) -> None:
        os.write(self.descriptor, self.adapter.transmit(frame))


@asynccontextmanager
async def over_slcan() -> AsyncIterator[tuple[CanTransport, FarBoard]]:
    near, far = pty.openpty()
    tty.setraw(far)
    board = SlcanBoard(near)
    loop = asyncio.get_running_loop()
    loop.add_reader(near, board.readable)
    transport = await open_transport(f"can:slcan:{os.ttyname(far)}?settle_s=0")
    async with asyncio.timeout(PATIENCE_S):
        while not board.adapter.is_open:  # noqa: ASYNC110 - the adapter is sans-IO, it has no event to wait for
            await asyncio.sleep(0.01)
    try:
        yield transport, board  # type: ignore[misc]
    finally:
        await transport.aclose()
        loop.remove_reader(near)
        os.close(near)
        os.close(far)


class VirtualBoard(FarBoard):
    def __init__(self, bus: can.BusABC, fd: bool) -> None:
        super().__init__(64 if fd else 8)
        self.bus = bus
        self.fd = fd

    def put(self, frame: CanFrame) -> None:
        self.bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False, is_fd=self.fd))


@asynccontextmanager
async def _virtual(fd: bool) -> AsyncIterator[tuple[CanTransport, FarBoard]]:
    name = f"rm501-test-{fd}"
    protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
    loop = asyncio.get_running_loop()
    with can.Bus(interface="virtual", channel=name, protocol=protocol) as bus:
        board = VirtualBoard(bus, fd)

        def on_message(message: can.Message) -> None:
            loop.call_soon_threadsafe(board.frame, CanFrame(message.arbitration_id, bytes(message.data)))

        notifier = can.Notifier(bus, [on_message], timeout=0.05)
        transport = await open_transport(f"can:virtual:{name}?fd={int(fd)}")
        try:
            yield transport, board  # type: ignore[misc]
        finally:
            await transport.aclose()
            notifier.stop()


def over_virtual():
    return _virtual(fd=False)


def over_virtual_fd():
    return _virtual(fd=True)


BUSES = {"slcan on a pty": over_slcan, "virtual": over_virtual, "virtual FD": over_virtual_fd}
every_bus = pytest.mark.parametrize("case", BUSES.values(), ids=BUSES.keys())


@every_bus
async def test_packets_of_every_length_arrive_unchanged_in_both_directions(case) -> None:
    rng = random.Random(3)
    packets = [bytes((0x20,)) + rng.randbytes(length - 1) for length in range(1, 255)]
    async with case() as (transport, board):
        collector = Collector()
        transport.start(collector)
        assert transport.packets and transport.bytes_per_second
        for number, packet in enumerate(packets):
            transport.write(packet)
            await board.until(number + 1)
        assert board.packets == packets
        for number, packet in enumerate(packets):
            board.send(packet)
            await collector.until(lambda number=number: len(collector.chunks) > number)
        assert collector.chunks == packets
        health = transport.health
        assert (health.state, health.dropped_transfers, health.bus_offs) == ("ACTIVE", 0, 0)


@every_bus
async def test_every_message_type_is_carried(case) -> None:
    codec = PacketCodec()
    async with case() as (transport, board):
        transport.start(Collector())
        sent = []
        for message_id in registry():
            for example in EXAMPLES[message_id]:
                packet = codec.encode(bytes((message_id, 0, 0, 0, 0, 0, 0, 0)) + example.payload)
                sent.append((packet, message_id))
                transport.write(packet)
                await board.until(len(sent))
        assert board.packets == [packet for packet, _ in sent]
        assert len({message_id for _, message_id in sent}) == len(registry())
        stops = [frame for frame in board.frames if frame.can_id >> 8 == 0]
        assert stops, "stop messages travel in class 0"


@every_bus
async def test_both_link_ends_work_over_it(case) -> None:
    async with case() as (transport, far):
        loop = asyncio.get_running_loop()
        host = HostLink(codec=PacketCodec(), bytes_per_second=transport.bytes_per_second)
        board = BoardLink(0x1234, Identify(build="test"), codec=PacketCodec())
        board.free_slots = 32
        collector = Collector()
        transport.start(collector)
        done: list[object] = []
        taken: list[object] = []
        segments = [Segment(n * 10, 10, (MotorTerm(0, n, 1),)) for n in range(20)]
        host.connect(5, round(loop.time() * 1e6))
        read = 0
        async with asyncio.timeout(PATIENCE_S):
            while not (done and isinstance(done[-1], StopAcknowledged)):
                now_us = round(loop.time() * 1e6)
                for packet in host.packets_to_send(now_us):
                    transport.write(packet)
                await asyncio.sleep(0.001)
                now_us = round(loop.time() * 1e6)
                for packet in far.packets:
                    board.receive_data(packet, now_us)
                far.packets.clear()
                while (event := board.next_event()) is not None:
                    taken.append(event)
                for packet in board.packets_to_send(now_us):
                    far.send(packet)
                for packet in collector.chunks[read:]:
                    host.receive_data(packet, now_us)
                read = len(collector.chunks)
                while (event := host.next_event()) is not None:
                    done.append(event)
                    if isinstance(event, SessionOpened):
                        for segment in segments:
                            host.send(segment)
                        host.send(Hold(), urgent=False)
                if len([event for event in taken if isinstance(event, Received)]) == 21 and not host.stopping:
                    host.stop(StopKind.STOP, now_us)
        messages = [event.message for event in taken if isinstance(event, Received)]
        assert messages == [*segments, Hold()]


async def test_error_frames_are_counted_and_bus_off_ends_the_transport() -> None:
    async with over_virtual() as (transport, board):
        collector = Collector()
        transport.start(collector)
        passive = can.Message(
            arbitration_id=0x04, data=bytes((0, 0x30, 0, 0, 0, 0, 136, 3)), is_error_frame=True, is_extended_id=False
        )
        board.bus.send(passive)  # type: ignore[attr-defined]
        async with asyncio.timeout(PATIENCE_S):
            while transport.health.error_frames == 0:  # noqa: ASYNC110 - a counter
                await asyncio.sleep(0.01)
        health = transport.health
        assert (health.state, health.transmit_errors, health.receive_errors) == ("PASSIVE", 136, 3)
        board.bus.send(  # type: ignore[attr-defined]
            can.Message(arbitration_id=0x40, data=bytes(8), is_error_frame=True, is_extended_id=False)
        )
        await collector.until(lambda: bool(collector.lost))
        assert isinstance(collector.lost[0], PortError) and "bus off" in str(collector.lost[0])
        assert transport.health.bus_offs == 1
        with pytest.raises(TransportClosedError):
            transport.write(b"x")


@every_bus
async def test_closing_tells_the_receiver_none_and_may_be_repeated(case) -> None:
    async with case() as (transport, _):
        collector = Collector()
        transport.start(collector)
        await transport.aclose()
        await transport.aclose()
        assert collector.lost == [None]
        with pytest.raises(TransportClosedError):
            transport.write(b"x")


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("can:slcan", "can:INTERFACE:CHANNEL"),
        ("can:slcan:/dev/no-such-port?settle_s=0", "check interface"),
        ("can:no-such-interface:x", "check interface"),
        ("can:virtual:x?node=200", "node must be"),
        ("can:virtual:x?speed=1", "unknown option"),
        ("can:virtual:x?node=one", "numbers"),
    ],
)
async def test_a_wrong_url_names_the_remedy(url: str, words: str) -> None:
    with pytest.raises(PortError, match=words):
        await open_transport(url)


def test_the_checksum_covers_what_the_transfer_layer_carries() -> None:
    packet = PacketCodec().encode(bytes(9))
    assert zlib.crc32(packet) == 0x2144DF1C

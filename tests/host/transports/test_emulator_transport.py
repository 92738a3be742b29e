"""The emulated board, found through its entry point, keeps the contract of a transport; the link works over it."""

import asyncio

import pytest

from rm501_host.transports import PortError, TransportClosedError, open_transport
from rm501_host.transports.open import ENTRY_POINT_GROUP
from rm501_host.virtual_time import run_virtual
from rm501_protocol.link import HostLink, SessionOpened, StopAcknowledged, StopKind
from rm501_protocol.transport import Receiver, Transport
from tests.support.patience import PATIENCE_S


class Session(Receiver):
    """A host's link on a transport, driven by the event loop."""

    def __init__(self, transport: Transport, chunk: int | None) -> None:
        self.transport = transport
        self.link = HostLink(bytes_per_second=transport.bytes_per_second)
        self.chunk = chunk
        self.lost: list[Exception | None] = []
        self.events: list[object] = []

    def pump(self) -> None:
        data = self.link.data_to_send(self._now_us())
        for start in range(0, len(data), self.chunk or max(1, len(data))):
            self.transport.write(data[start : start + (self.chunk or len(data))])
        while (event := self.link.next_event()) is not None:
            self.events.append(event)

    def data_received(self, data: bytes) -> None:
        for start in range(0, len(data), self.chunk or len(data)):
            self.link.receive_data(data[start : start + (self.chunk or len(data))], self._now_us())
        self.pump()

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost.append(exc)

    async def until(self, wanted: type) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not any(isinstance(event, wanted) for event in self.events):
                self.pump()
                await asyncio.sleep(0.005)

    @staticmethod
    def _now_us() -> int:
        return round(asyncio.get_running_loop().time() * 1e6)


@pytest.mark.parametrize("chunk", [None, 1], ids=["whole", "one byte at a time"])
def test_the_emulator_keeps_the_contract(chunk: int | None) -> None:
    async def scene() -> None:
        transport = await open_transport("emu://?seed=3")
        assert isinstance(transport, Transport) and not transport.packets
        session = Session(transport, chunk)
        transport.start(session)
        session.link.connect(11, 0)
        await session.until(SessionOpened)
        assert session.link.identify is not None and session.link.identify.queue_depth == 32
        session.link.stop(StopKind.STOP, session._now_us())
        await session.until(StopAcknowledged)
        await transport.aclose()
        await transport.aclose()
        assert session.lost == [None]
        with pytest.raises((TransportClosedError, OSError)):
            transport.write(b"x")

    run_virtual(scene())


def test_a_missing_emulator_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rm501_host.transports.open.entry_points", lambda group: ())

    async def scene() -> None:
        await open_transport("emu://")

    assert ENTRY_POINT_GROUP == "rm501.transports"
    with pytest.raises(PortError, match="unknown kind of port 'emu'"):
        run_virtual(scene())

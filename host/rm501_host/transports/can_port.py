"""CAN through python-can: ``can:INTERFACE:CHANNEL?node=1&bitrate=500000&fd=0``.

Each packet is a transfer of frames (`rm501_protocol.can_transfer`). What a bus sends goes through one thread, because
the interfaces' `send` may block; frames are taken in order of class, so a stop passes everything that waits.
Interfaces with a file descriptor are read by the event loop, the others by a thread that waits in `recv`.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import parse_qs

from rm501_protocol.can_transfer import CanFrame, TransferReceiver, TransferSender, class_of
from rm501_protocol.transport import Transport

from .errors import PortError
from .stream import StreamBase

__all__ = ["BusHealth", "CanTransport", "open_transport"]

_FRAME_BITS = 125  # classic frame of 8 bytes with typical stuffing and its gap
_SEND_TIMEOUT_S = 0.5
_WAITING_CAP = 1024
_READ_TIMEOUT_S = 0.2
_ERROR_BUS_OFF, _ERROR_CONTROLLER = 0x40, 0x04  # error classes of Linux, in the identifier of an error frame


@dataclass(frozen=True, slots=True)
class BusHealth:
    """What is known about the bus; counters of the controller are None where the interface does not report them."""

    state: str = "ACTIVE"
    """ACTIVE, PASSIVE or BUS_OFF; as far as the interface tells."""
    transmit_errors: int | None = None
    receive_errors: int | None = None
    error_frames: int = 0
    bus_offs: int = 0
    malformed: int = 0
    """Things the interface could not read as a frame."""
    dropped_transfers: int = 0
    stray_frames: int = 0


@dataclass(frozen=True, slots=True)
class _Options:
    interface: str
    channel: str
    node: int
    bitrate: int
    fd: bool
    settle_s: float


async def open_transport(url: str) -> Transport:
    """Open a bus; raises PortError."""
    options = _parse(url)
    import can

    arguments: dict[str, Any] = {"interface": options.interface, "channel": options.channel}
    if options.interface == "slcan":
        arguments |= {"bitrate": options.bitrate, "sleep_after_open": options.settle_s, "timeout": 0}
    elif options.interface == "virtual":
        arguments["protocol"] = can.CanProtocol.CAN_FD if options.fd else can.CanProtocol.CAN_20
    else:
        arguments |= {"bitrate": options.bitrate, "fd": options.fd}
    try:
        bus = await asyncio.to_thread(lambda: can.Bus(**arguments))
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise PortError(url, f"{error}; check interface and channel, and that the interface is up") from error
    return CanTransport(url, bus, options.node, options.bitrate, options.fd, asyncio.get_running_loop())


def _parse(url: str) -> _Options:
    text, _, query = url.removeprefix("can:").partition("?")
    interface, separator, channel = text.partition(":")
    given = {key: values[-1] for key, values in parse_qs(query, keep_blank_values=True).items()}
    unknown = set(given) - {"node", "bitrate", "fd", "settle_s"}
    if not separator or not interface or not channel or unknown:
        what = f"unknown option {sorted(unknown)[0]!r}; " if unknown else ""
        raise PortError(url, f"{what}write can:INTERFACE:CHANNEL, options node, bitrate, fd, settle_s")
    try:
        options = _Options(
            interface,
            channel,
            int(given.get("node", "1")),
            int(given.get("bitrate", "500000")),
            given.get("fd", "0") not in ("0", "", "false"),
            float(given.get("settle_s", "0.1")),
        )
    except ValueError as error:
        raise PortError(url, f"{error}; options are numbers") from None
    if not 0 <= options.node <= 127 or options.bitrate < 10_000 or not 0 <= options.settle_s <= 10:
        raise PortError(url, "node must be 0..127, bitrate at least 10000, settle_s 0..10")
    return options


class CanTransport(StreamBase):
    """A board on a CAN bus."""

    def __init__(self, url: str, bus: Any, node: int, bitrate: int, fd: bool, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(url, bitrate * 7 // _FRAME_BITS, packets=True)
        self._bus = bus
        self._loop = loop
        self._fd = fd
        self._sender = TransferSender(node, from_board=False, frame_bytes=64 if fd else 8)
        self._assembler = TransferReceiver(node, from_board=True)
        self._health = BusHealth()
        self._outgoing: queue.PriorityQueue[tuple[int, int, CanFrame | None]] = queue.PriorityQueue()
        self._order = 0
        self._closing = False
        self._threads = [threading.Thread(target=self._send_frames, name=f"send {url}", daemon=True)]
        self._descriptor = self._descriptor_of(bus)
        if self._descriptor < 0:
            self._threads.append(threading.Thread(target=self._read_frames, name=f"read {url}", daemon=True))
        for thread in self._threads:
            thread.start()

    def _descriptor_of(self, bus: Any) -> int:
        try:
            descriptor = int(bus.fileno())
            if descriptor >= 0:
                self._loop.add_reader(descriptor, self._readable)
        except (NotImplementedError, OSError):
            return -1
        return descriptor

    @property
    def health(self) -> BusHealth:
        """State and counters of the bus."""
        stats = self._assembler.stats
        return replace(self._health, dropped_transfers=stats.dropped_transfers, stray_frames=stats.stray_frames)

    def write(self, data: bytes) -> None:
        """Queue one packet."""
        self._require_open()
        if self._outgoing.qsize() > _WAITING_CAP:
            self._fail(PortError(self.url, "the bus takes no frames; check wiring, termination and bit rate"))
            return
        transfer_class = class_of(data)
        for frame in self._sender.frames(data):
            self._order += 1
            self._outgoing.put((transfer_class, self._order, frame))

    async def aclose(self) -> None:
        """Leave the bus."""
        await self._shut_down()
        self._end(None)

    # ------------------------------------------------------------------------------------- receive

    def _readable(self) -> None:
        for _ in range(64):  # then let the loop breathe; the descriptor is still readable if more is there
            message = self._receive(0.0)
            if message is None:
                return
            self._message(message)

    def _read_frames(self) -> None:
        while not self._closing:
            message = self._receive(_READ_TIMEOUT_S)
            if message is not None:
                self._call(self._message, message)

    def _receive(self, timeout_s: float) -> Any:
        import can

        try:
            return self._bus.recv(timeout_s)
        except ValueError:  # python-can's slcan could not read a line
            self._health = replace(self._health, malformed=self._health.malformed + 1)
        except (can.CanError, OSError) as error:
            if not self._closing:
                self._call(self._fail, PortError(self.url, f"gone ({error}); check the adapter and reconnect"))
                self._closing = True
        return None

    def _message(self, message: Any) -> None:
        if self._ended:
            return
        if message.is_error_frame:
            self._error_frame(message.arbitration_id, bytes(message.data))
        elif not message.is_extended_id and not message.is_remote_frame:
            packet = self._assembler.feed(CanFrame(message.arbitration_id, bytes(message.data)))
            if packet is not None:
                self._deliver(packet)

    def _error_frame(self, error_class: int, data: bytes) -> None:
        """Linux's error frames: class bits in the identifier, controller state in byte 1, counters in bytes 6 and 7."""
        health = replace(self._health, error_frames=self._health.error_frames + 1)
        if error_class & _ERROR_CONTROLLER and len(data) >= 2:
            health = replace(health, state="PASSIVE" if data[1] & 0x30 else "ACTIVE")
        if len(data) >= 8 and (data[6] or data[7]):
            health = replace(health, transmit_errors=data[6], receive_errors=data[7])
        if error_class & _ERROR_BUS_OFF:
            health = replace(health, state="BUS_OFF", bus_offs=health.bus_offs + 1)
        self._health = health
        if error_class & _ERROR_BUS_OFF:
            self._fail(
                PortError(self.url, "bus off: too many errors; check wiring, termination and bit rate, then reconnect")
            )

    # ------------------------------------------------------------------------------------- send

    def _send_frames(self) -> None:
        import can

        while True:
            _, _, frame = self._outgoing.get()
            if frame is None or self._closing:
                return
            message = can.Message(
                arbitration_id=frame.can_id,
                data=frame.data,
                is_extended_id=False,
                is_fd=self._fd,
                bitrate_switch=self._fd,
            )
            try:
                self._bus.send(message, timeout=_SEND_TIMEOUT_S)
            except (can.CanError, OSError) as error:
                if not self._closing:
                    self._call(self._fail, PortError(self.url, f"cannot send ({error}); check the bus and reconnect"))
                return

    # ------------------------------------------------------------------------------------- end

    def _call(self, function: Any, argument: Any) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, argument)

    def _fail(self, error: PortError) -> None:
        self._stop_reading()
        self._end(error)

    def _stop_reading(self) -> None:
        self._closing = True
        if self._descriptor >= 0:
            self._loop.remove_reader(self._descriptor)
            self._descriptor = -1
        self._outgoing.put((-1, 0, None))

    async def _shut_down(self) -> None:
        self._stop_reading()
        threads, self._threads = self._threads, []
        for thread in threads:
            await asyncio.to_thread(thread.join, 1.0)
        if threads:
            await asyncio.to_thread(self._bus.shutdown)

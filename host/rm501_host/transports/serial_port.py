"""Serial ports and ptys through pyserial, driven by the event loop: no polling, no thread where the loop can watch a
descriptor.

Where it cannot (Windows), one thread waits in a blocking read.
"""

from __future__ import annotations

import asyncio
import errno
import os
import threading
from typing import Any
from urllib.parse import parse_qs

from rm501_protocol.transport import Transport

from .errors import PortError
from .stream import WRITE_CAP_BYTES, StreamBase

__all__ = ["DEFAULT_BAUD", "SerialTransport", "ThreadedSerialTransport", "open_transport"]

DEFAULT_BAUD = 250_000
_BITS_PER_BYTE = 10  # 8N1
_CHUNK = 4096


async def open_transport(url: str) -> Transport:
    """Open a serial port or pty; raises PortError."""
    path, baud = _parse(url)
    import serial

    try:
        port = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=_exclusive())
    except (serial.SerialException, ValueError, OSError) as error:
        raise PortError(path, _remedy(error)) from error
    loop = asyncio.get_running_loop()
    try:
        return SerialTransport(path, port, baud, loop)
    except NotImplementedError:  # the loop cannot watch descriptors
        return ThreadedSerialTransport(path, port, baud, loop)


def _exclusive() -> bool | None:
    return True if os.name == "posix" else None


def _parse(url: str) -> tuple[str, int]:
    text = url.removeprefix("serial://").removeprefix("serial:")
    path, _, query = text.partition("?")
    options = parse_qs(query, keep_blank_values=True)
    unknown = set(options) - {"baud"}
    if unknown:
        raise PortError(url, f"unknown option {sorted(unknown)[0]!r}; a serial port takes baud only")
    raw = options.get("baud", [str(DEFAULT_BAUD)])[0]
    if not raw.isdigit() or not 1200 <= int(raw) <= 12_000_000:
        raise PortError(url, f"baud={raw} is no baud rate; use 1200..12000000, 250000 by default")
    return os.path.expanduser(path), int(raw)


def _remedy(error: BaseException) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return "no such port; plug the board in, or look under /dev/serial/by-id for its name"
    if number == errno.EACCES:
        return "no permission; add your user to the group of the device (often dialout) and log in again"
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error).lower():
        return "in use by another program; close that first"
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR) or "Could not configure port" in str(error):
        return "no serial port, or not at this speed; name the device of the board, such as /dev/ttyUSB0"
    return f"{error}; is it the device of the board?"


class SerialTransport(StreamBase):
    """A port whose descriptor the event loop watches. Raises NotImplementedError where the loop cannot."""

    def __init__(self, url: str, port: Any, baud: int, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(url, baud // _BITS_PER_BYTE)
        self._port = port
        self._loop = loop
        self._unsent = bytearray()
        self._descriptor: int = port.fileno()
        os.set_blocking(self._descriptor, False)
        loop.add_reader(self._descriptor, self._readable)

    def write(self, data: bytes) -> None:
        """Send at once as far as the driver takes it, the rest when it can."""
        self._require_open()
        if not self._unsent:
            data = data[self._write_now(data) :]
            if not data or self._ended:
                return
            self._loop.add_writer(self._descriptor, self._writable)
        self._unsent += data
        if len(self._unsent) > WRITE_CAP_BYTES:
            self._fail(
                PortError(self.url, f"takes no data: {len(self._unsent)} bytes wait; check the cable and the board")
            )

    async def aclose(self) -> None:
        """Close the port."""
        self._close()
        self._end(None)

    def _readable(self) -> None:
        try:
            data = os.read(self._descriptor, _CHUNK)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._fail(PortError(self.url, f"gone ({error.strerror}); plug it in again and reconnect"))
            return
        if data:
            self._deliver(data)
        else:
            self._fail(PortError(self.url, "gone (end of file); plug it in again and reconnect"))

    def _writable(self) -> None:
        del self._unsent[: self._write_now(bytes(self._unsent))]
        if not self._unsent and not self._ended:
            self._loop.remove_writer(self._descriptor)

    def _write_now(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            self._fail(PortError(self.url, f"gone ({error.strerror}); plug it in again and reconnect"))
            return 0

    def _fail(self, error: PortError) -> None:
        self._close()
        self._end(error)

    def _close(self) -> None:
        if self._descriptor >= 0:
            self._loop.remove_reader(self._descriptor)
            self._loop.remove_writer(self._descriptor)
            self._descriptor = -1
            self._unsent.clear()
            self._port.close()


class ThreadedSerialTransport(StreamBase):
    """A port read by one thread that waits in `read`; for event loops that cannot watch descriptors."""

    def __init__(self, url: str, port: Any, baud: int, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(url, baud // _BITS_PER_BYTE)
        self._port = port
        self._loop = loop
        port.timeout = None
        port.write_timeout = 1.0
        self._closing = False
        self._thread = threading.Thread(target=self._read, name=f"read {url}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Send."""
        self._require_open()
        try:
            self._port.write(data)
        except OSError as error:  # pyserial's SerialException is one
            self._closing = True
            self._port.close()
            self._end(PortError(self.url, f"gone ({error}); plug it in again and reconnect"))

    async def aclose(self) -> None:
        """Close the port and wait for its thread."""
        if not self._closing:
            self._closing = True
            if hasattr(self._port, "cancel_read"):
                self._port.cancel_read()
            await asyncio.to_thread(self._thread.join, 1.0)
            self._port.close()
        self._end(None)

    def _read(self) -> None:
        error: PortError | None = None
        while not self._closing:
            try:
                data = self._port.read(1)
                if data:
                    data += self._port.read(self._port.in_waiting)
            except (OSError, TypeError) as problem:  # TypeError: closed under the read
                error = PortError(self.url, f"gone ({problem}); plug it in again and reconnect")
                break
            if data:
                self._call(self._deliver, data)
        if error is not None and not self._closing:
            self._call(self._end, error)

    def _call(self, function: Any, argument: Any) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, argument)

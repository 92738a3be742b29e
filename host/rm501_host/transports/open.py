"""From a URL to an open transport.

/dev/...  COM3           a serial port or a pty; ?baud=250000 (the default) sets the speed
socket://host:port       TCP
can:INTERFACE:CHANNEL    python-can: can:slcan:/dev/ttyACM0, can:socketcan:can0, can:virtual:name
emu://...                the emulated board, found through the entry points `rm501.transports`
"""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

from rm501_protocol.transport import Transport

from .errors import PortError

__all__ = ["ENTRY_POINT_GROUP", "SCHEMES", "open_transport"]

ENTRY_POINT_GROUP = "rm501.transports"
SCHEMES = {
    "serial": "rm501_host.transports.serial_port",
    "socket": "rm501_host.transports.socket_port",
    "can": "rm501_host.transports.can_port",
}
"""Modules of the built-in transports, imported when they are used."""


async def open_transport(url: str) -> Transport:
    """Open `url`; raises PortError (an OSError) saying what is wrong and what to do."""
    scheme = scheme_of(url)
    module = SCHEMES.get(scheme)
    if module is not None:
        transport: Transport = await importlib.import_module(module).open_transport(url)
        return transport
    found = [entry for entry in entry_points(group=ENTRY_POINT_GROUP) if entry.name == scheme]
    if not found:
        known = sorted({*SCHEMES, *(entry.name for entry in entry_points(group=ENTRY_POINT_GROUP))})
        raise PortError(
            url,
            f"unknown kind of port {scheme!r}; use a device path, or one of {', '.join(known)} as in socket://host:port",
        )
    opened: Transport = await found[0].load()(url)
    return opened


def scheme_of(url: str) -> str:
    """The kind of port that a URL names; a path or a COM port is `serial`."""
    if url.startswith(("/", "./", "../", "~")) or url.upper().startswith("COM"):
        return "serial"
    head, separator, _ = url.partition(":")
    if not separator:
        raise PortError(url, "not a port; use /dev/ttyUSB0, socket://host:port, can:slcan:/dev/ttyACM0 or emu://")
    return head.lower()

"""One board's port, however often it is plugged in: found again by the name that it keeps.

The kernel numbers serial ports in the order in which they appear. A board that was unplugged and put back may become
/dev/ttyUSB1, and another device /dev/ttyUSB0. So the name under /dev/serial/by-id is remembered when the port is
opened, and from then on it alone is opened; opening waits for it to come back, and does so at once when it does.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from pathlib import Path

from rm501_protocol.transport import Transport

from .open import open_transport, scheme_of
from .port_watch import BY_ID, stable_path, wait_for_path

__all__ = ["SteadyPort"]

_PATIENCE_S = 10.0
"""How long one opening waits for a port that was there before; then it says what is wrong, and may be tried again."""


class SteadyPort:
    """Opens `url`, again and again. Kinds of port other than serial ones are opened as they are."""

    def __init__(self, url: str, by_id: Path = BY_ID) -> None:
        self._url = url
        self._by_id = by_id
        self._name: str | None = None

    @property
    def name(self) -> str:
        """What is opened: the port's lasting name once it is known."""
        return self._name or self._url.partition("?")[0]

    async def open(self) -> Transport:
        """Open the port; raises PortError. One that was open before is waited for, up to ten seconds."""
        if scheme_of(self._url) != "serial":
            return await open_transport(self._url)
        path, separator, query = self._url.removeprefix("serial://").removeprefix("serial:").partition("?")
        if self._name is None:
            name = _lasting_name(path, self._by_id)
        else:
            name = self._name
            with contextlib.suppress(TimeoutError):  # then opening it says what is wrong
                async with asyncio.timeout(_PATIENCE_S):
                    await wait_for_path(name)
        transport = await open_transport(f"{name}{separator}{query}")
        self._name = name
        return transport


def _lasting_name(path: str, by_id: Path) -> str:
    return stable_path(os.path.expanduser(path), by_id)

"""systemd's notify protocol: a datagram a message, to the socket that NOTIFY_SOCKET names."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Mapping


class Notifier:
    """Tells systemd how the service is; does nothing where systemd does not ask for it."""

    def __init__(self, environment: Mapping[str, str], process_id: int) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        watched = environment.get("WATCHDOG_PID", str(process_id)) == str(process_id)
        interval_us = environment.get("WATCHDOG_USEC", "0")
        self.watchdog_s = int(interval_us) / 1e6 if watched and interval_us.isdigit() else 0.0

    def send(self, message: str, *, wait: bool = True) -> None:
        """Send a message such as READY=1; a systemd that does not listen is no reason to stop. `wait`: until there is
        room for it; without, a message for which a systemd that is stuck has no room is dropped.
        """
        if not self._address or not hasattr(socket, "AF_UNIX"):
            return
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender,
        ):
            sender.setblocking(wait)
            sender.connect(self._address)
            sender.sendall(message.encode())

    async def keep_alive(self) -> None:
        """Reset the watchdog at half its interval, for as long as the event loop turns; returns where there is none."""
        while self.watchdog_s > 0:
            self.send("WATCHDOG=1", wait=False)  # the arm is not kept waiting
            await asyncio.sleep(self.watchdog_s / 2)

"""Ways to reach a board: serial ports, sockets, CAN, and whatever an entry point of `rm501.transports` adds (the
emulator).

`await open_transport(url)` opens any of them; the shape they share is `rm501_protocol.transport`.
"""

from __future__ import annotations

from .errors import PortError, TransportClosedError
from .open import SCHEMES, open_transport
from .port_watch import stable_path, wait_for_path
from .steady_port import SteadyPort

__all__ = [
    "SCHEMES",
    "PortError",
    "SteadyPort",
    "TransportClosedError",
    "open_transport",
    "stable_path",
    "wait_for_path",
]

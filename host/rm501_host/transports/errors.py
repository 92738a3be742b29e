"""Errors of the transports.

::

    OSError
    └── PortError                the port cannot be opened, or failed; the text says what to do
        └── TransportClosedError     written to after its end
"""

from __future__ import annotations

__all__ = ["PortError", "TransportClosedError"]


class PortError(OSError):
    """A port cannot be opened, or failed while open; `url` names it."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"{url}: {reason}")
        self.url = url
        self.reason = reason


class TransportClosedError(PortError):
    """Something was written to a transport that is closed."""

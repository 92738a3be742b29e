"""The errors of this package.

::

    ProtocolError
    ├── LocalProtocolError        this side did something that the protocol forbids
    │   ├── FieldRangeError       a value does not fit the field it was put in
    │   ├── ConfigError           a board configuration contradicts itself
    │   ├── LinkClosedError       a message was sent without a session
    │   └── LinkFullError         more messages wait than the link keeps
    └── RemoteProtocolError       the other side did
        └── DecodeError           bytes with a good checksum that are no message

Noise on the line is neither: it is counted and dropped, never raised.
"""

from __future__ import annotations

__all__ = [
    "ConfigError",
    "DecodeError",
    "FieldRangeError",
    "LinkClosedError",
    "LinkFullError",
    "LocalProtocolError",
    "ProtocolError",
    "RemoteProtocolError",
]


class ProtocolError(Exception):
    """Root of every error that `rm501_protocol` raises."""


class LocalProtocolError(ProtocolError):
    """This side did something that the protocol forbids."""


class RemoteProtocolError(ProtocolError):
    """The other side did something that the protocol forbids."""


class FieldRangeError(LocalProtocolError):
    """A value does not fit its field; `message`, `field`, `value` and `allowed` say which and why."""

    def __init__(self, message: str, field: str, value: object, allowed: str) -> None:
        super().__init__(f"{message}.{field} = {value!r} does not fit: {allowed}")
        self.message = message
        self.field = field
        self.value = value
        self.allowed = allowed


class ConfigError(LocalProtocolError):
    """A board configuration contradicts itself; `problems` lists every contradiction found."""

    def __init__(self, problems: tuple[str, ...]) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems


class LinkClosedError(LocalProtocolError):
    """A message was sent while no session is open."""


class LinkFullError(LocalProtocolError):
    """More messages wait than the link keeps; nothing was queued."""


class DecodeError(RemoteProtocolError):
    """Bytes with a good checksum that are no message; `message_id` and `reason` say why."""

    def __init__(self, message_id: int, reason: str) -> None:
        super().__init__(f"message 0x{message_id:02x}: {reason}")
        self.message_id = message_id
        self.reason = reason

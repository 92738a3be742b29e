"""Who may call what: levels of access, tokens, origins, rates.

Unix socket: whoever may open the file has FULL access (its mode is 0660). TCP: with a token file, FULL needs the
token; a client on this computer that has none may STOP and nothing else. Without a token file the daemon listens on
loopback addresses only and local clients have FULL access.

    AccessError(Rm501Error)      an arrangement that would be unsafe; the daemon does not start
"""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from rm501_host.errors import Rm501Error

_MIN_TOKEN_CHARACTERS = 16


class Access(IntEnum):
    """What a method needs, and what a caller has: each level includes those before it."""

    STOP = 1
    """Making the arm slower or stopping it."""
    READ = 2
    """Seeing the state."""
    FULL = 3
    """Moving the arm, changing anything."""


class AccessError(Rm501Error):
    """The daemon would be reachable without protection."""


class Caller(Protocol):
    """What the dispatcher needs to know about a client."""

    def may(self, access: Access) -> bool:
        """Whether the client may call methods of that level."""
        ...

    def rate_limited(self) -> bool:
        """Count a call; True when it comes too fast."""
        ...


class RateLimit:
    """A token bucket: `per_s` calls a second on the long run, `burst` at once. Time is passed in."""

    def __init__(self, clock_s: Callable[[], float], per_s: float = 200.0, burst: float = 400.0) -> None:
        self._clock_s = clock_s
        self._per_s = per_s
        self._burst = burst
        self._left = burst
        self._at_s = clock_s()

    def take(self) -> bool:
        """Take one; False when the bucket is empty."""
        now_s = self._clock_s()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Guard:
    """Decides about TCP clients by their Host, Origin and Authorization headers."""

    def __init__(self, host: str, token_file: Path | None, origins: tuple[str, ...] = ()) -> None:
        self._token = None if token_file is None else read_token(token_file)
        self._host = host
        self._origins = frozenset(origin.rstrip("/").lower() for origin in origins)
        if self._token is None and not is_loopback(host):
            raise AccessError(
                f"{host} is not a loopback address; give --token-file, or listen on 127.0.0.1 and use a tunnel"
            )

    def access(self, peer: str, authorization: str | None) -> Access | None:
        """The level a client gets, None to refuse it (401)."""
        local = is_loopback(peer)
        if self._token is None:
            return Access.FULL if local else None
        if authorization is None:
            return Access.STOP if local else None
        scheme, _, token = authorization.partition(" ")
        good = scheme.lower() == "bearer" and hmac.compare_digest(token.strip().encode(), self._token)
        return Access.FULL if good else None

    def foreign(self, host_header: str, origin: str | None) -> bool:
        """Whether the request comes from somebody else's web page (403): a foreign Origin, or a Host that is not this
        daemon's (a name that an attacker's server made point here).
        """
        name = _host_name(host_header)
        if name is None or not (is_loopback(name) or name == self._host or not is_loopback(self._host)):
            return True
        if origin is None:
            return False
        if origin.rstrip("/").lower() in self._origins:
            return False
        try:
            parts = urlsplit(origin)
            return parts.hostname is None or f"{parts.netloc}".lower() != host_header.lower()
        except ValueError:
            return True


def read_token(path: Path) -> bytes:
    """The token of a file; raises AccessError when it is missing, too short, or readable by everybody."""
    try:
        mode = path.stat().st_mode
        token = path.read_bytes().strip()
    except OSError as error:
        raise AccessError(f"{path}: the token cannot be read: {error.strerror}; create it with mode 0600") from error
    if mode & 0o077:
        raise AccessError(f"{path}: others may read the token; chmod 600 it")
    if len(token) < _MIN_TOKEN_CHARACTERS:
        raise AccessError(f"{path}: the token is shorter than {_MIN_TOKEN_CHARACTERS} characters; use a random one")
    return token


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this computer."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.split("%")[0]).is_loopback
    except ValueError:
        return False


def _host_name(header: str) -> str | None:
    try:
        return urlsplit(f"//{header}").hostname
    except ValueError:
        return None

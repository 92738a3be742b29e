"""What byte-stream transports share: the receiver, the end that is told once, writing after the end."""

from __future__ import annotations

from rm501_protocol.transport import Receiver

from .errors import TransportClosedError

__all__ = ["WRITE_CAP_BYTES", "StreamBase"]

WRITE_CAP_BYTES = 65_536
"""Unsent bytes above which the other end counts as stuck: the link keeps far less in flight."""


class StreamBase:
    """Receiver bookkeeping; the subclass moves bytes."""

    def __init__(self, url: str, bytes_per_second: int | None, *, packets: bool = False) -> None:
        self.url = url
        self._bytes_per_second = bytes_per_second
        self._packets = packets
        self._receiver: Receiver | None = None
        self._early: list[bytes] = []
        self._ended = False
        self._end_error: Exception | None = None

    @property
    def packets(self) -> bool:
        """Whether the transport keeps packets apart."""
        return self._packets

    @property
    def bytes_per_second(self) -> int | None:
        """Line speed, None when it is no bottleneck."""
        return self._bytes_per_second

    def start(self, receiver: Receiver) -> None:
        """Deliver to `receiver`, beginning with what arrived since the port was opened."""
        self._receiver = receiver
        early, self._early = self._early, []
        for data in early:
            receiver.data_received(data)
        if self._ended:
            receiver.connection_lost(self._end_error)

    def _deliver(self, data: bytes) -> None:
        if self._ended:
            return
        if self._receiver is None:
            self._early.append(data)
            del self._early[:-16]  # nobody listens yet: noise at best
        else:
            self._receiver.data_received(data)

    def _end(self, error: Exception | None) -> None:
        """Tell the receiver, once."""
        if self._ended:
            return
        self._ended = True
        self._end_error = error
        if self._receiver is not None:
            self._receiver.connection_lost(error)

    def _require_open(self) -> None:
        if self._ended:
            raise TransportClosedError(self.url, "closed; open it again")

"""The sending half of the sequenced channel: what is in flight, what waits, when to send again (go-back-N).

Packets in flight keep their sequence until acknowledged. `_cursor` says how many of them count as on the line: a nak
or a timeout sets it back to 0 and they go out again from the oldest, with the same sequence and payload. A packet
gets its sequence only when it is first sent, so what waits can still be dropped or overtaken by something urgent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from .declaration import Message
from .framing import FRAME_OVERHEAD
from .header import ahead
from .round_trip import RoundTrip
from .segment_message import Segment

__all__ = ["PENDING_CAP", "WINDOW", "Outgoing", "SendWindow"]

WINDOW = 8
"""Packets in flight at most."""
PENDING_CAP = 64
"""Messages that wait for the window: two segment queues' worth, far more than a session keeps ready."""


class Outgoing:
    """One sequenced message on its way."""

    __slots__ = ("message", "payload", "sent_us", "sequence", "tries")

    def __init__(self, message: Message, payload: bytes) -> None:
        self.message = message
        self.payload = payload
        self.sequence = 0
        self.sent_us = 0
        self.tries = 0


class SendWindow:
    """Packets in flight and messages that wait."""

    __slots__ = (
        "_cursor",
        "_in_flight",
        "_in_flight_bytes",
        "_nak_answered",
        "_next",
        "_normal",
        "_segments_in_flight",
        "_urgent",
        "credit",
        "deadline_us",
        "round_trip",
    )

    def __init__(self) -> None:
        self.round_trip = RoundTrip()
        self._urgent: deque[Outgoing] = deque()
        self._normal: deque[Outgoing] = deque()
        self.restart()

    def restart(self) -> None:
        """Forget everything in flight and count from sequence 0; what waits stays."""
        self._in_flight: deque[Outgoing] = deque()
        self._cursor = 0
        self._in_flight_bytes = 0
        self._next = 0
        self._segments_in_flight = 0
        self._nak_answered = -1
        self.credit: int | None = None
        """Free segment slots at the other end after everything acknowledged; None: segments are not limited."""
        self.deadline_us: int | None = None
        """When the oldest packet in flight times out."""

    # ------------------------------------------------------------------------------------- queue

    @property
    def pending(self) -> int:
        """Messages that wait."""
        return len(self._urgent) + len(self._normal)

    @property
    def unacknowledged(self) -> int:
        """Packets in flight."""
        return len(self._in_flight)

    def holds(self, message: Message) -> bool:
        """Whether this very message waits or is in flight."""
        return any(item.message is message for queue in (self._in_flight, self._urgent, self._normal) for item in queue)

    @property
    def next_sequence(self) -> int:
        """Sequence of the next new packet."""
        return self._next

    @property
    def segment_credit(self) -> int:
        """Free segment slots at the other end beyond what is in flight; 0 as long as it has not said anything."""
        return 0 if self.credit is None else self.credit - self._segments_in_flight

    def put(self, item: Outgoing, urgent: bool) -> bool:
        """Queue a message; False when PENDING_CAP is reached."""
        if self.pending >= PENDING_CAP:
            return False
        (self._urgent if urgent else self._normal).append(item)
        return True

    def drop_pending(self, unwanted: Callable[[Message], bool]) -> tuple[Message, ...]:
        """Take back messages that were never sent; returns them."""
        dropped = []
        for queue in (self._urgent, self._normal):
            kept = [item for item in queue if not unwanted(item.message)]
            dropped += [item.message for item in queue if unwanted(item.message)]
            queue.clear()
            queue.extend(kept)
        return tuple(dropped)

    def drop_all(self) -> tuple[Message, ...]:
        """Drop what is in flight and what waits, restart; returns it, oldest first."""
        dropped = [item.message for item in (*self._in_flight, *self._urgent, *self._normal)]
        self._urgent.clear()
        self._normal.clear()
        self.restart()
        return tuple(dropped)

    # ------------------------------------------------------------------------------------- sending

    def peek(self, in_flight_cap: int) -> Outgoing | None:
        """The next packet to put on the line, None when there is none or the window, the cap in bytes or the credit
        forbids it.
        """
        if self._cursor < len(self._in_flight):
            item = self._in_flight[self._cursor]
        elif len(self._in_flight) >= WINDOW:
            return None
        elif self._urgent:
            item = self._urgent[0]
        elif self._normal:
            item = self._normal[0]
            if isinstance(item.message, Segment) and self.credit is not None and self.segment_credit <= 0:
                return None
        else:
            return None
        if self._cursor and self._in_flight_bytes + len(item.payload) + FRAME_OVERHEAD > in_flight_cap:
            return None
        return item

    def sent(self, item: Outgoing, now_us: int, line_free_us: int) -> None:
        """`item`, got from `peek`, goes out now and will have left the line at `line_free_us`."""
        if self._cursor == len(self._in_flight):
            (self._urgent if self._urgent else self._normal).popleft()
            item.sequence = self._next
            self._next = (self._next + 1) & 0xFF
            self._in_flight.append(item)
            self._segments_in_flight += isinstance(item.message, Segment)
        item.sent_us = now_us
        item.tries += 1
        if self._cursor == 0:
            self.deadline_us = max(now_us, line_free_us) + self.round_trip.rto_us
        self._cursor += 1
        self._in_flight_bytes += len(item.payload) + FRAME_OVERHEAD

    def acknowledge(self, ack: int, credit: int | None, now_us: int) -> int:
        """Take a cumulative acknowledgement; returns how many packets it frees, -1 for one that is out of date."""
        count = ahead(ack, (self._next - len(self._in_flight)) & 0xFF)
        if count > len(self._in_flight):
            return -1
        self.credit = credit
        if count == 0:
            return 0
        for place in range(count):
            item = self._in_flight.popleft()
            if place < self._cursor:
                self._in_flight_bytes -= len(item.payload) + FRAME_OVERHEAD
            self._segments_in_flight -= isinstance(item.message, Segment)
            if place == count - 1 and item.tries == 1:
                self.round_trip.sample(now_us - item.sent_us)
        self._cursor = max(0, self._cursor - count)
        self._nak_answered = -1
        self.round_trip.progress()
        self.deadline_us = now_us + self.round_trip.rto_us if self._cursor else None
        return count

    def nak(self, ack: int) -> bool:
        """The other end misses `ack`: send again from there, once per gap; returns whether anything is sent again."""
        if not self._in_flight or ack != self._in_flight[0].sequence or self._nak_answered == ack:
            return False
        self._nak_answered = ack
        self._go_back()
        return True

    def time_out(self, now_us: int) -> bool:
        """Send everything in flight again when the oldest has timed out; returns whether it has."""
        if self.deadline_us is None or now_us < self.deadline_us:
            return False
        self.round_trip.back_off()
        self._nak_answered = -1
        self._go_back()
        return True

    def _go_back(self) -> None:
        self._cursor = 0
        self._in_flight_bytes = 0
        self.deadline_us = None

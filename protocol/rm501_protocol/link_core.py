"""What both ends of a link share: packets in and out, sequence, acknowledgement, pacing to the line's speed.

Theory of operation. Each direction has one sequenced channel (go-back-N, window 8) beside unsequenced messages. Every
packet carries an acknowledgement, so a separate Ack is only sent when nothing else is. A packet is taken when its
sequence is the one expected, acknowledged again when it is older, and answered with one nak per gap when it is newer.
The channel from host to board counts from 0 in every (epoch, stop generation); the channel from board to host in
every epoch.

The link keeps the queue in front of the line to itself: at most `LINE_AHEAD_US` of line time are handed out beyond
what has left, and as much may be unacknowledged, so that a stop, which goes first, never waits behind more than that.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import ClassVar

from .declaration import Direction, Message, decode_payload, encode_payload, registry
from .errors import DecodeError
from .framing import FRAME_OVERHEAD, StreamCodec
from .header import (
    FLAG_FROM_BOARD,
    FLAG_NAK,
    FLAG_OPEN,
    FLAG_SEQUENCED,
    HEADER,
    HEADER_SIZE,
    Header,
    ahead,
    parse_header,
)
from .link_events import Event, Received, Undecodable
from .messages import Ack, Status
from .send_window import Outgoing, SendWindow
from .transport import Codec

__all__ = ["EVENT_CAP", "LINE_AHEAD_US", "LinkCore", "LinkStats"]

LINE_AHEAD_US = 5_000
"""Line time handed out and in flight at most: what a stop may have to wait for."""
EVENT_CAP = 64
"""Events kept for the user; above it sequenced packets are left to be sent again, others dropped and counted."""
_UNSEQUENCED_CAP = 16
_NO_CAP = 1 << 30
_KNOWN = registry()


@dataclass(slots=True)
class LinkStats:
    """Counters since the link was made."""

    packets_out: int = 0
    bytes_out: int = 0
    packets_in: int = 0
    bytes_in: int = 0
    bad_frames: int = 0
    """Dropped below the link: stuffing, checksum or length."""
    bad_packets: int = 0
    """Intact, yet no packet for this end: header, direction, unknown or malformed unsequenced message."""
    retransmits: int = 0
    timeouts: int = 0
    naks_out: int = 0
    naks_in: int = 0
    duplicates: int = 0
    gaps: int = 0
    stale_epoch: int = 0
    stale_generation: int = 0
    refused_hellos: int = 0
    """Hellos of another major version."""
    overruns: int = 0
    """Messages dropped because the user did not fetch events, or reports that found no room."""


class LinkCore(ABC):
    """Shared half of `HostLink` and `BoardLink`; not used by itself."""

    _FLAGS: ClassVar[int]
    _PEER_FLAG: ClassVar[int]
    _INCOMING: ClassVar[Direction]

    def __init__(self, codec: Codec | None, bytes_per_second: int | None) -> None:
        self._codec: Codec = StreamCodec() if codec is None else codec
        self._bytes_per_second = bytes_per_second
        self._line_free_us = 0
        self._blocked_until_us: int | None = None
        self._window = SendWindow()
        self._unsequenced: deque[Message] = deque()
        self._events: deque[Event] = deque()
        self._expected = 0
        self._nak_due = False
        self._nak_sent = False
        self._ack_due = False
        self._open = False
        self._epoch = 0
        self._generation = 0
        self._last_heard_us: int | None = None
        self.stats = LinkStats()

    # ------------------------------------------------------------------------------------- public

    @property
    def is_open(self) -> bool:
        """Whether a session is open."""
        return self._open

    @property
    def epoch(self) -> int:
        """Epoch of the session; without one, of the last that was seen."""
        return self._epoch

    @property
    def generation(self) -> int:
        """Stop generation in force."""
        return self._generation

    @property
    def last_heard_us(self) -> int | None:
        """When the last good packet of this session arrived."""
        return self._last_heard_us

    @property
    def pending(self) -> int:
        """Sequenced messages that wait to be sent."""
        return self._window.pending

    @property
    def unacknowledged(self) -> int:
        """Sequenced packets in flight."""
        return self._window.unacknowledged

    def on_its_way(self, message: Message) -> bool:
        """Whether this very message, a sequenced one, waits or is in flight: not acknowledged, not dropped."""
        return self._window.holds(message)

    @property
    def round_trip_us(self) -> int:
        """Smoothed round trip time, 0 before the first measurement."""
        return self._window.round_trip.srtt_us

    def receive_data(self, data: bytes, now_us: int) -> None:
        """Take bytes from the transport (with a packet codec: exactly one packet). Never raises, whatever they are."""
        self.stats.bytes_in += len(data)
        packets = self._codec.feed(data)
        self.stats.bad_frames = self._codec.bad_frames
        for packet in packets:
            header = parse_header(packet)
            if header is None or header.flags & FLAG_FROM_BOARD != self._PEER_FLAG:
                self.stats.bad_packets += 1
                continue
            self.stats.packets_in += 1
            self._packet(header, packet[HEADER_SIZE:], now_us)

    def next_event(self) -> Event | None:
        """The oldest event not yet fetched, None when there is none."""
        return self._events.popleft() if self._events else None

    def data_to_send(self, now_us: int) -> bytes:
        """Bytes to write now. Call it after every other call and at `next_deadline_us`."""
        return b"".join(self.packets_to_send(now_us))

    def packets_to_send(self, now_us: int) -> list[bytes]:
        """As `data_to_send`, one item a packet, for transports that keep packets apart."""
        self.handle_timer(now_us)
        out: list[bytes] = []
        self._send_first(out, now_us)
        self._blocked_until_us = None
        cap = _NO_CAP
        if self._bytes_per_second is not None:
            cap = self._bytes_per_second * LINE_AHEAD_US // 1_000_000
        while True:
            if self._unsequenced:
                message = self._unsequenced[0]
                payload = encode_payload(self._stamped(message, now_us))
                if self._blocked(len(payload), now_us):
                    break
                self._unsequenced.popleft()
                self._emit(out, message.ID, self._flags(message), self._window.next_sequence, payload, now_us)
                continue
            item = self._window.peek(cap) if self._may_send_sequenced() else None
            if item is not None:
                if self._blocked(len(item.payload), now_us):
                    break
                first = item.tries == 0
                self._window.sent(item, now_us, self._line_after(len(item.payload), now_us))
                self.stats.retransmits += not first
                flags = self._flags() | FLAG_SEQUENCED
                self._emit(out, item.message.ID, flags, item.sequence, item.payload, now_us)
                continue
            if self._ack_due:
                if self._blocked(0, now_us):
                    break
                self._emit(out, Ack.ID, self._flags(), self._window.next_sequence, b"", now_us)
            break
        return out

    def next_deadline_us(self) -> int | None:
        """When `data_to_send` must be called at the latest, None when only for a reason from outside."""
        times = [time_us for time_us in (self._window.deadline_us, self._blocked_until_us) if time_us is not None]
        return min(times, default=None)

    def handle_timer(self, now_us: int) -> None:
        """Let timeouts pass; `data_to_send` does it too."""
        if self._window.time_out(now_us):
            self.stats.timeouts += 1

    # ------------------------------------------------------------------------------------- for the two ends

    @abstractmethod
    def _send_first(self, out: list[bytes], now_us: int) -> None:
        """Append what goes ahead of everything and past the pacing."""
        ...

    def _may_send_sequenced(self) -> bool:
        return self._open

    @abstractmethod
    def _stamped(self, message: Message, now_us: int) -> Message:
        """`message` with stamps that belong to the moment of sending."""
        ...

    def _flags(self, message: Message | None = None) -> int:
        """Flags of a packet: who sends it, and whether it belongs to an open session."""
        return self._FLAGS | FLAG_OPEN if self._open else self._FLAGS

    def _free_slots(self) -> int:
        return 0

    @abstractmethod
    def _packet(self, header: Header, payload: bytes, now_us: int) -> None:
        """Take a packet with a sound header that comes from the other side."""
        ...

    def _put_unsequenced(self, message: Message) -> None:
        if isinstance(message, Status):
            for waiting in self._unsequenced:
                if isinstance(waiting, Status):
                    self._unsequenced.remove(waiting)
                    break
        if len(self._unsequenced) >= _UNSEQUENCED_CAP:
            self._unsequenced.popleft()
            self.stats.overruns += 1
        self._unsequenced.append(message)

    def _put_sequenced(self, message: Message, urgent: bool | None) -> bool:
        item = Outgoing(message, encode_payload(message))
        return self._window.put(item, message.URGENT if urgent is None else urgent)

    def _put_event(self, event: Event) -> None:
        if len(self._events) >= 2 * EVENT_CAP:
            self.stats.overruns += 1
            return
        self._events.append(event)

    def _heard(self, now_us: int) -> None:
        self._last_heard_us = now_us

    def _restart_channels(self) -> None:
        self._window.restart()
        self._expected = 0
        self._nak_due = self._nak_sent = self._ack_due = False

    def _take_acknowledgement(self, header: Header, credit: int | None, now_us: int) -> None:
        if self._window.acknowledge(header.ack, credit, now_us) >= 0 and header.flags & FLAG_NAK:
            self.stats.naks_in += 1
            self._window.nak(header.ack)

    def _deliver(self, header: Header, payload: bytes) -> None:
        """Sort a packet of the present session into the sequence and give it to the user."""
        if not header.flags & FLAG_SEQUENCED:
            self._deliver_unsequenced(header, payload)
            return
        distance = ahead(header.sequence, self._expected)
        self._ack_due = True
        if distance >= 128:
            self.stats.duplicates += 1
            return
        if distance:
            self.stats.gaps += 1
            if not self._nak_sent:
                self._nak_sent = self._nak_due = True
            return
        if len(self._events) >= EVENT_CAP:
            self.stats.overruns += 1
            return
        self._expected = (self._expected + 1) & 0xFF
        self._nak_sent = self._nak_due = False
        try:
            message = self._decoded(header.message_id, payload, sequenced=True)
        except DecodeError as error:
            self._put_event(Undecodable(header.message_id, header.sequence, str(error)))
        else:
            self._put_event(Received(message, header.sequence))

    def _deliver_unsequenced(self, header: Header, payload: bytes) -> None:
        if header.message_id == Ack.ID:
            return
        if len(self._events) >= EVENT_CAP:
            self.stats.overruns += 1
            return
        message = self._unsequenced_message(header, payload)
        if message is not None:
            self._put_event(Received(message, None))

    def _unsequenced_message(self, header: Header, payload: bytes) -> Message | None:
        try:
            return self._decoded(header.message_id, payload, sequenced=False)
        except DecodeError:
            self.stats.bad_packets += 1
            return None

    def _decoded(self, message_id: int, payload: bytes, *, sequenced: bool) -> Message:
        cls = _KNOWN.get(message_id)
        if cls is not None and (sequenced != cls.SEQUENCED or cls.DIRECTION not in (self._INCOMING, Direction.BOTH)):
            raise DecodeError(message_id, f"{cls.__name__} may not come this way")
        return decode_payload(message_id, payload)

    # ------------------------------------------------------------------------------------- line

    def _emit(self, out: list[bytes], message_id: int, flags: int, sequence: int, payload: bytes, now_us: int) -> None:
        if self._nak_due:
            flags |= FLAG_NAK
            self.stats.naks_out += 1
            self._nak_due = False
        self._ack_due = False
        header = HEADER.pack(
            message_id, flags, sequence, self._expected, self._epoch, self._generation, self._free_slots()
        )
        self._line_free_us = self._line_after(len(payload), now_us)
        data = self._codec.encode(header + payload)
        self.stats.packets_out += 1
        self.stats.bytes_out += len(data)
        out.append(data)

    def _line_after(self, payload_size: int, now_us: int) -> int:
        """When the line will be free if a packet of this size is handed out now."""
        if self._bytes_per_second is None:
            return now_us
        duration_us = (payload_size + FRAME_OVERHEAD) * 1_000_000 // self._bytes_per_second
        return max(self._line_free_us, now_us) + duration_us

    def _blocked(self, payload_size: int, now_us: int) -> bool:
        """Whether a packet of this size must wait for the line; notes until when."""
        if self._line_free_us <= now_us:
            return False
        after_us = self._line_after(payload_size, now_us)
        if after_us - now_us <= LINE_AHEAD_US:
            return False
        self._blocked_until_us = min(self._line_free_us, after_us - LINE_AHEAD_US)
        return True

"""The board's end of a link. Integers only: firmware uses it as it is."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import ClassVar

from .declaration import Direction, Message
from .errors import DecodeError
from .header import FLAG_FROM_BOARD, FLAG_OPEN, FLAG_SEQUENCED, Header, ahead
from .link_core import LinkCore
from .link_events import Event, Received, SessionOpened, StopKind, StopReceived, Undecodable
from .link_states import BOARD_TRANSITIONS, BoardInput, BoardSessionState
from .messages import ClockQuery, ClockReply, Hello, Identify, Kill, Segment, Stop, StopReply
from .transport import Codec

__all__ = ["BoardLink"]

_NONCE_MEMORY = 8
"""Handshakes remembered, so that a late copy of an old Hello opens nothing."""


class BoardLink(LinkCore):
    """State machine of the board's end.

    `boot_id` is random at each boot (u32). `identity` is what Hello is answered with; the firmware replaces it when
    its configuration changes. A host of another major version than the identity's gets no session. `free_slots` is
    the firmware's count of free segment slots, set before `data_to_send`.
    ClockQuery is answered here, with the microseconds passed in.
    """

    _FLAGS: ClassVar[int] = FLAG_FROM_BOARD
    _PEER_FLAG: ClassVar[int] = 0
    _INCOMING: ClassVar[Direction] = Direction.TO_BOARD

    def __init__(
        self,
        boot_id: int,
        identity: Identify,
        *,
        codec: Codec | None = None,
        bytes_per_second: int | None = None,
    ) -> None:
        super().__init__(codec, bytes_per_second)
        self.identity = replace(identity, boot_id=boot_id & 0xFFFFFFFF)
        self.free_slots = 0
        self._epoch = boot_id & 0xFFFF
        self._state = BoardSessionState.CLOSED
        self._nonces: deque[int] = deque(maxlen=_NONCE_MEMORY)
        self._session_nonce: int | None = None
        self._stops: deque[StopReceived] = deque()
        self._executed_stop: int | None = None
        self._undelivered_segments = 0

    def send(self, message: Message, *, urgent: bool | None = None) -> bool:
        """Queue a message for the host; False, and counted in `stats.overruns`, when a sequenced one finds no room or
        no session.
        """
        if not message.SEQUENCED:
            self._put_unsequenced(message)
            return True
        if self._open and self._put_sequenced(message, urgent):
            return True
        self.stats.overruns += 1
        return False

    def next_event(self) -> Event | None:
        """Stops first, then the oldest event."""
        if self._stops:
            return self._stops.popleft()
        event = super().next_event()
        if isinstance(event, Received) and isinstance(event.message, Segment):
            self._undelivered_segments -= 1
        return event

    def advance_generation(self) -> int:
        """Refuse from now on what the host has in flight, because the board stopped by itself; returns the new
        generation.
        """
        self._new_generation((self._generation + 1) & 0xFF)
        return self._generation

    # ------------------------------------------------------------------------------------- packets

    def _send_first(self, out: list[bytes], now_us: int) -> None:
        """Nothing of the board's goes past the pacing."""

    def _free_slots(self) -> int:
        return max(0, min(255, self.free_slots - self._undelivered_segments))

    def _put_event(self, event: Event) -> None:
        if isinstance(event, Received) and isinstance(event.message, Segment):
            self._undelivered_segments += 1
        super()._put_event(event)

    def _flags(self, message: Message | None = None) -> int:
        if isinstance(message, Identify) and message.nonce != self._session_nonce:
            return self._FLAGS  # the answer to a host that is refused belongs to no session
        return super()._flags()

    def _stamped(self, message: Message, now_us: int) -> Message:
        if isinstance(message, ClockReply):
            return replace(message, sent_ticks=now_us & 0xFFFFFFFF)
        return message

    def _packet(self, header: Header, payload: bytes, now_us: int) -> None:
        if header.message_id in (Stop.ID, Kill.ID):
            self._stop(header, payload, now_us)
        elif header.message_id == Hello.ID:
            self._hello(header, payload, now_us)
        elif not self._open or not header.flags & FLAG_OPEN or header.epoch != self._epoch:
            self.stats.stale_epoch += 1
            self._ack_due = True  # the host learns from the header that its session is over
        elif header.generation != self._generation:
            self.stats.stale_generation += 1
            self._heard(now_us)
            self._ack_due = True
            if not header.flags & FLAG_SEQUENCED:
                self._in_session(header, payload, now_us)
        else:
            self._heard(now_us)
            self._in_session(header, payload, now_us)

    def _in_session(self, header: Header, payload: bytes, now_us: int) -> None:
        self._take_acknowledgement(header, None, now_us)
        if header.message_id != ClockQuery.ID or header.flags & FLAG_SEQUENCED:
            self._deliver(header, payload)
            return
        query = self._unsequenced_message(header, payload)
        if isinstance(query, ClockQuery):
            self._put_unsequenced(ClockReply(query.host_us, now_us & 0xFFFFFFFF, 0))

    def _hello(self, header: Header, payload: bytes, now_us: int) -> None:
        hello = self._unsequenced_message(header, payload)
        if not isinstance(hello, Hello) or header.flags & FLAG_SEQUENCED:
            return
        if hello.major != self.identity.major:
            self._state = BOARD_TRANSITIONS[self._state, BoardInput.OTHER_MAJOR]
            self.stats.refused_hellos += 1
            self._put_unsequenced(replace(self.identity, nonce=hello.nonce))
            return
        if self._open and hello.nonce == self._session_nonce:
            self._put_unsequenced(replace(self.identity, nonce=hello.nonce))
            return
        if hello.nonce in self._nonces:
            self.stats.stale_epoch += 1
            return
        self._nonces.append(hello.nonce)
        self._session_nonce = hello.nonce
        self._forget_received()
        self._unsequenced.clear()
        self._window.drop_all()
        self._restart_channels()
        self._epoch = (self._epoch + 1) & 0xFFFF
        self._state = BOARD_TRANSITIONS[self._state, BoardInput.NEW_HELLO]
        self._open = self._state is BoardSessionState.OPEN
        self._heard(now_us)
        self._put_event(SessionOpened(self._epoch, hello=hello))
        self._put_unsequenced(replace(self.identity, nonce=hello.nonce))

    def _stop(self, header: Header, payload: bytes, now_us: int) -> None:
        """Every intact Stop or Kill is answered; see `docs/protocol.md`, "Stops", for which are executed.

        In the session: a generation ahead of ours, or equal to ours if the board came to it by itself. Without the
        session's epoch there is no telling old from new, so it is executed always: stopping twice is harmless, not
        stopping is not.
        """
        try:
            message = self._decoded(header.message_id, payload, sequenced=False)
        except DecodeError:
            self.stats.bad_packets += 1
            return
        assert isinstance(message, Stop | Kill)
        kind = StopKind.STOP if isinstance(message, Stop) else StopKind.KILL
        requested = message.generation
        executed = requested == self._executed_stop == self._generation
        if self._open and header.flags & FLAG_OPEN and header.epoch == self._epoch:
            self._heard(now_us)
            lead = ahead(requested, self._generation)
            if lead < 128 and not executed:
                self._new_generation(requested)
                self._execute(kind)
                executed = True
        else:
            self._new_generation((self._generation + 1) & 0xFF)
            self._execute(kind)
            executed = True
        self._unsequenced.appendleft(StopReply(requested, self._generation, executed))
        while len(self._unsequenced) > 16:
            self._unsequenced.pop()

    def _execute(self, kind: StopKind) -> None:
        self._executed_stop = self._generation
        for waiting in tuple(self._stops):
            if waiting.kind is kind:  # not fetched yet: one of a kind is enough
                self._stops.remove(waiting)
        self._stops.append(StopReceived(kind, self._generation))

    def _new_generation(self, generation: int) -> None:
        self._generation = generation
        self._forget_received()
        self._expected = 0
        self._nak_due = self._nak_sent = False
        self._ack_due = True

    def _forget_received(self) -> None:
        """Drop sequenced messages that the user has not fetched: they belong to what is over."""
        kept = [
            event
            for event in self._events
            if not (isinstance(event, SessionOpened | Undecodable))
            and not (isinstance(event, Received) and event.sequence is not None)
        ]
        self._events.clear()
        self._events.extend(kept)
        self._undelivered_segments = 0

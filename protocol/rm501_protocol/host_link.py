"""The host's end of a link."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import ClassVar

from .clock import ClockEstimator
from .declaration import Direction, Message
from .errors import LinkClosedError, LinkFullError
from .framing import FRAME_OVERHEAD
from .header import FLAG_FROM_BOARD, FLAG_OPEN, FLAG_SEQUENCED, Header, ahead
from .link_core import LinkCore
from .link_events import (
    GenerationAdvanced,
    LinkHeard,
    LinkNoisy,
    LinkSilent,
    LossReason,
    SessionLost,
    SessionOpened,
    SessionRefused,
    StopAcknowledged,
    StopKind,
)
from .link_states import HOST_TRANSITIONS, STOP_TRANSITIONS, HostInput, HostState, StopInput, StopState
from .messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    ClockQuery,
    ClockReply,
    Hello,
    Identify,
    Kill,
    Stop,
    StopReply,
)
from .send_window import PENDING_CAP
from .transport import Codec

__all__ = ["CLOCK_PERIOD_US", "HELLO_PERIOD_US", "SILENCE_US", "STOP_PERIOD_US", "HostLink"]

CLOCK_PERIOD_US = 100_000
"""Clock queries at 10 Hz; they also keep the link from being silent."""
HELLO_PERIOD_US = 100_000
STOP_PERIOD_US = 5_000
SILENCE_US = 1_000_000
NOISE_FRAMES = 500
"""Frames over which the share of broken ones is judged."""
_EPOCH_MEMORY = 8
"""Former epochs remembered, so that a late packet of one does not look like a new board."""
_VERSION_END = 6
"""Bytes of Identify that mean the same in every major version: nonce u32, major u8, minor u8."""


class HostLink(LinkCore):
    """State machine of the host's end: `connect` asks for a session, `send` and `stop` use it.

    `bytes_per_second` is the line's speed, None when it is no bottleneck. `clock` collects the clock samples.
    """

    _FLAGS: ClassVar[int] = 0
    _PEER_FLAG: ClassVar[int] = FLAG_FROM_BOARD
    _INCOMING: ClassVar[Direction] = Direction.TO_HOST

    def __init__(
        self,
        *,
        codec: Codec | None = None,
        bytes_per_second: int | None = None,
        clock: ClockEstimator | None = None,
    ) -> None:
        super().__init__(codec, bytes_per_second)
        self.clock = ClockEstimator() if clock is None else clock
        self.identify: Identify | None = None
        """The board's identity in this session."""
        self.free_slots = 0
        """Free segment slots of the board when it last said so."""
        self._state = HostState.CLOSED
        self._stop_state = StopState.NONE
        self._nonce: int | None = None
        self._hello_due_us: int | None = None
        self._old_epochs: deque[int] = deque(maxlen=_EPOCH_MEMORY)
        self._stop: tuple[StopKind, int] | None = None
        self._stop_due_us = 0
        self._stop_fresh = False
        self._clock_due_us: int | None = None
        self._query_line_us = 0
        self._silent = False
        self._judged_frames = 0
        self._judged_bad = 0

    # ------------------------------------------------------------------------------------- public

    def connect(self, nonce: int, now_us: int) -> tuple[Message, ...]:
        """Ask for a new session until SessionOpened or SessionRefused; `nonce` is random (u32).

        Returns what the old session had not seen acknowledged.
        """
        dropped = self._end_session()
        self._enter(HostInput.CONNECT)
        self._nonce = nonce & 0xFFFFFFFF
        self._hello_due_us = now_us
        return dropped

    def send(self, message: Message, *, urgent: bool | None = None) -> None:
        """Queue a message for the board; `urgent` overrides the message's own declaration.

        Raises FieldRangeError (a field does not fit), LinkClosedError (no session), LinkFullError (PENDING_CAP
        messages wait).
        """
        if not self._open:
            raise LinkClosedError(f"no session: {type(message).__name__} was not sent; connect first")
        if not message.SEQUENCED:
            self._put_unsequenced(message)
        elif not self._put_sequenced(message, urgent):
            raise LinkFullError(f"{PENDING_CAP} messages wait already: {type(message).__name__} was not sent")

    def take_back(self, unwanted: Callable[[Message], bool]) -> tuple[Message, ...]:
        """Drop messages that wait and were never sent (before a Truncate, say); returns them."""
        return self._window.drop_pending(unwanted)

    def stop(self, kind: StopKind, now_us: int) -> tuple[Message, ...]:
        """Stop or kill at once, ahead of everything; returns what the board may not have executed yet and now never
        will.

        Works with and without a session. A Kill replaces a Stop under way; a Stop never replaces a Kill.
        """
        if self._stop is not None and self._stop[0] is StopKind.KILL:
            kind = StopKind.KILL
        newest = self._generation if self._stop is None else self._stop[1]
        self._stop_state = STOP_TRANSITIONS[self._stop_state, StopInput.ASKED]
        self._stop = (kind, (newest + 1) & 0xFF)
        self._stop_due_us = now_us
        self._stop_fresh = True
        return self._window.drop_all()

    @property
    def state(self) -> HostState:
        """State of the session."""
        return self._state

    @property
    def stopping(self) -> bool:
        """Whether a stop is under way that the board has not acknowledged."""
        return self._stop_state is StopState.ASKED

    @property
    def segment_credit(self) -> int:
        """Segments that could be sent now without overfilling the board's queue."""
        return self._window.segment_credit

    def receive_data(self, data: bytes, now_us: int) -> None:
        """Take bytes from the transport (with a packet codec: exactly one packet). Never raises, whatever they are."""
        super().receive_data(data, now_us)
        frames = self.stats.packets_in + self.stats.bad_packets + self.stats.bad_frames - self._judged_frames
        if frames >= NOISE_FRAMES:
            bad = self.stats.bad_frames - self._judged_bad
            self._judged_frames += frames
            self._judged_bad += bad
            if 100 * bad > frames:
                self._put_event(LinkNoisy(bad, frames))

    def next_deadline_us(self) -> int | None:
        """When `data_to_send` must be called at the latest."""
        times = [super().next_deadline_us(), self._hello_due_us, self._clock_due_us]
        if self._stop is not None:
            times.append(self._stop_due_us)
        if self._open and not self._silent and self._last_heard_us is not None:
            times.append(self._last_heard_us + SILENCE_US)
        return min((time_us for time_us in times if time_us is not None), default=None)

    def handle_timer(self, now_us: int) -> None:
        """Let timeouts pass; `data_to_send` does it too."""
        super().handle_timer(now_us)
        if self._hello_due_us is not None and now_us >= self._hello_due_us and self._nonce is not None:
            self._hello_due_us = now_us + HELLO_PERIOD_US
            self._put_unsequenced(Hello(self._nonce, PROTOCOL_MAJOR, PROTOCOL_MINOR))
        if self._clock_due_us is not None and now_us >= self._clock_due_us:
            self._clock_due_us = max(self._clock_due_us + CLOCK_PERIOD_US, now_us + CLOCK_PERIOD_US // 2)
            self._put_unsequenced(ClockQuery(0))
        if self._open and not self._silent and self._last_heard_us is not None:
            silent_us = now_us - self._last_heard_us
            if silent_us >= SILENCE_US:
                self._silent = True
                self._put_event(LinkSilent(silent_us))

    # ------------------------------------------------------------------------------------- packets

    def _may_send_sequenced(self) -> bool:
        return self._open and self._stop_state is StopState.NONE

    def _stamped(self, message: Message, now_us: int) -> Message:
        if not isinstance(message, ClockQuery):
            return message
        waits_us = max(0, self._line_free_us - now_us)
        self._query_line_us = waits_us + self._line_us(FRAME_OVERHEAD + 4)
        return ClockQuery(now_us & 0xFFFFFFFF)

    def _line_us(self, size: int) -> int:
        """How long `size` bytes are on the line."""
        return 0 if self._bytes_per_second is None else size * 1_000_000 // self._bytes_per_second

    def _send_first(self, out: list[bytes], now_us: int) -> None:
        if self._stop is None or now_us < self._stop_due_us:
            return
        kind, generation = self._stop
        message_id = Stop.ID if kind is StopKind.STOP else Kill.ID
        for _ in range(2 if self._stop_fresh else 1):
            self._emit(out, message_id, self._flags(), 0, bytes((generation,)), now_us)
            # a delimiter in front: what a broken frame before it left behind does not swallow the stop
            out[-1] = self._codec.delimiter + out[-1]
        self._stop_fresh = False
        self._stop_due_us = now_us + STOP_PERIOD_US

    def _packet(self, header: Header, payload: bytes, now_us: int) -> None:
        if header.message_id == Identify.ID and not header.flags & FLAG_SEQUENCED:
            self._identify(header, payload, now_us)
            return
        if header.message_id == StopReply.ID and not header.flags & FLAG_SEQUENCED:
            self._stop_reply(header, payload)
        if not self._open:
            self._remember_epoch(header.epoch)
            return
        if header.epoch != self._epoch or not header.flags & FLAG_OPEN:
            self._foreign(header)
            return
        lead = ahead(header.generation, self._generation)
        if lead < 128:  # a packet of an older generation comes late: it does not say that the board hears us now
            if self._silent and self._last_heard_us is not None:
                self._silent = False
                self._put_event(LinkHeard(now_us - self._last_heard_us))
            self._heard(now_us)
        if 0 < lead < 128:
            self._generation = header.generation
            if self._stop is None:  # else `stop` has dropped what there was, and what waits is for after it
                self._put_event(GenerationAdvanced(header.generation, self._window.drop_all()))
            lead = 0
        if lead == 0:
            self.free_slots = header.free_slots
            self._take_acknowledgement(header, header.free_slots, now_us)
        if header.message_id == ClockReply.ID and not header.flags & FLAG_SEQUENCED:
            self._clock_reply(header, payload, now_us)
        elif header.message_id != StopReply.ID:
            self._deliver(header, payload)

    def _identify(self, header: Header, payload: bytes, now_us: int) -> None:
        if len(payload) >= _VERSION_END and payload[_VERSION_END - 2] != PROTOCOL_MAJOR:
            payload = payload[:_VERSION_END]
        identify = self._unsequenced_message(header, payload)
        if not isinstance(identify, Identify) or identify.nonce != self._nonce:
            return
        if self._open:
            if header.epoch == self._epoch:
                self._heard(now_us)
            return
        if identify.major != PROTOCOL_MAJOR or not header.flags & FLAG_OPEN:
            self._end_session()
            self._enter(HostInput.REFUSED)
            self._put_event(SessionRefused(identify))
            return
        self._hello_due_us = None
        self._restart_channels()
        self._epoch = header.epoch
        self._remember_epoch((header.epoch - 1) & 0xFFFF)  # what the board sent before this handshake may come late
        if header.epoch in self._old_epochs:
            self._old_epochs.remove(header.epoch)
        self._generation = header.generation
        self._window.credit = self.free_slots = header.free_slots
        self._enter(HostInput.IDENTIFIED)
        self._silent = False
        if self.identify is None or self.identify.boot_id != identify.boot_id:
            self.clock.restart((identify.clock_hz or 1_000_000) / 1e6)
        self.identify = identify
        self._clock_due_us = now_us
        self._heard(now_us)
        self._put_event(SessionOpened(self._epoch, identify=identify))

    def _foreign(self, header: Header) -> None:
        """A packet of another epoch, or of a board without a session."""
        self.stats.stale_epoch += 1
        if header.epoch in self._old_epochs:
            return
        restarted = not header.flags & FLAG_OPEN
        dropped = self._end_session()
        self._enter(HostInput.FOREIGN)
        reason = LossReason.BOARD_RESTARTED if restarted else LossReason.EPOCH_CHANGED
        self._put_event(SessionLost(reason, dropped))

    def _stop_reply(self, header: Header, payload: bytes) -> None:
        reply = self._unsequenced_message(header, payload)
        if self._stop is None or not isinstance(reply, StopReply) or reply.requested != self._stop[1]:
            return
        if self._open and header.epoch != self._epoch:
            return
        if not reply.executed:  # the board had gone further by itself: ask again, beyond that
            self._stop_state = STOP_TRANSITIONS[self._stop_state, StopInput.NOT_EXECUTED]
            self._stop = (self._stop[0], (reply.generation + 1) & 0xFF)
            self._stop_due_us = 0
            return
        self._stop_state = STOP_TRANSITIONS[self._stop_state, StopInput.EXECUTED]
        kind, self._stop = self._stop[0], None
        self._generation = reply.generation
        self._window.restart()
        self._window.credit = header.free_slots
        self._put_event(StopAcknowledged(kind, reply.generation))

    def _clock_reply(self, header: Header, payload: bytes, now_us: int) -> None:
        reply = self._unsequenced_message(header, payload)
        if isinstance(reply, ClockReply):
            sent_us = now_us - ((now_us - reply.host_us) & 0xFFFFFFFF)
            line_in_us = self._line_us(FRAME_OVERHEAD + len(payload))
            self.clock.add(sent_us, reply.received_ticks, reply.sent_ticks, now_us, self._query_line_us, line_in_us)

    def _enter(self, happened: HostInput) -> None:
        self._state = HOST_TRANSITIONS[self._state, happened]
        self._open = self._state is HostState.OPEN

    def _remember_epoch(self, epoch: int) -> None:
        if epoch not in self._old_epochs:
            self._old_epochs.append(epoch)

    def _end_session(self) -> tuple[Message, ...]:
        if self._open:
            self._remember_epoch(self._epoch)
        self._nonce = None
        self._hello_due_us = None
        self._clock_due_us = None
        self._unsequenced.clear()
        dropped = self._window.drop_all()
        self._restart_channels()
        return dropped

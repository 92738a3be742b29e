"""Two link ends over a channel that loses, doubles, delays, corrupts and reorders, with resets and stops, driven by
Hypothesis.

Whatever happens: every message that the far user gets was sent, in this session and generation, once, in order;
nothing sent before a stop comes out after it; and when the channel turns good, everything sent since the last
interruption arrives.
"""

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from rm501_protocol.declaration import Message
from rm501_protocol.framing import MAX_FRAME
from rm501_protocol.link import (
    BoardLink,
    GenerationAdvanced,
    HostLink,
    Received,
    SessionLost,
    SessionOpened,
    StopAcknowledged,
    StopKind,
    StopReceived,
    StreamCodec,
)
from rm501_protocol.link_core import EVENT_CAP
from rm501_protocol.messages import Identify, MotorTerm, Segment, Truncated


def _tag(message: Message) -> int:
    if isinstance(message, Segment):
        return message.start_frames
    assert isinstance(message, Truncated)
    return message.end_frame


class LinkMachine(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.now_us = 0
        self.boots = 0
        self.nonce = 0
        self.next_tag = 1
        self.to_board: list[bytes] = []
        self.to_host: list[bytes] = []
        # host to board
        self.sent_down: list[int] = []  # tags sent by the host since the last interruption, in order
        self.got_down: list[int] = []  # tags the board's user got since its last interruption
        self.forbidden: set[int] = set()  # sent before a stop that the board has executed, or in a dead session
        self.ever_down: set[int] = set()
        # board to host
        self.sent_up: dict[int, list[int]] = {}  # by epoch
        self.got_up: list[int] = []
        self.ever_up: set[int] = set()
        self.host_open = False
        self.acknowledged_stops = 0
        self.asked_stops = 0

    @initialize(boot=st.sampled_from((0, 0xFFFF, 0xFFFFFFFF)))
    def start(self, boot: int) -> None:
        self.codec = StreamCodec()
        self.host = HostLink()
        self.board = BoardLink(boot, Identify())
        self.board.free_slots = 255
        self.connect()

    # ------------------------------------------------------------------------------------------------------ the users

    @rule()
    def connect(self) -> None:
        self.nonce += 1
        self.host.connect(self.nonce, self.now_us)
        self.host_open = False
        self.sent_down = []

    @precondition(lambda self: self.host_open)
    @rule(count=st.integers(1, 12), urgent=st.booleans())
    def host_sends(self, count: int, urgent: bool) -> None:
        for _ in range(count):
            if self.host.pending >= 40:
                break
            self.host.send(Segment(self.next_tag, 1, (MotorTerm(0, self.next_tag),)), urgent=False)
            self.sent_down.append(self.next_tag)
            self.ever_down.add(self.next_tag)
            self.next_tag += 1

    @rule(count=st.integers(1, 6))
    def board_reports(self, count: int) -> None:
        for _ in range(count):
            if self.board.pending < 40 and self.board.send(Truncated(self.next_tag)):
                self.sent_up.setdefault(self.board.epoch, []).append(self.next_tag)
                self.ever_up.add(self.next_tag)
                self.next_tag += 1

    @rule(kind=st.sampled_from(StopKind))
    def host_stops(self, kind: StopKind) -> None:
        self.host.stop(kind, self.now_us)
        self.asked_stops += 1
        self.before_stop = set(self.ever_down)
        self.sent_down = []

    @rule()
    def board_stops_by_itself(self) -> None:
        self.board.advance_generation()
        # all of it was sent before the host could know, but for what waits until a stop of its own is acknowledged
        self.forbidden |= self.ever_down - (set(self.sent_down) if self.host.stopping else set())
        self.got_down = []

    @rule()
    def board_reboots(self) -> None:
        self.boots += 1
        self.board = BoardLink(0x10000 + self.boots * 777, Identify())
        self.board.free_slots = 255
        self.got_down = []
        self.forbidden |= self.ever_down

    # ---------------------------------------------------------------------------------------------------- the channel

    def _flush(self) -> None:
        self.to_board += self.host.packets_to_send(self.now_us)
        self.to_host += self.board.packets_to_send(self.now_us)

    @rule(data=st.data(), steps=st.integers(1, 10))
    def bad_channel(self, data: st.DataObject, steps: int) -> None:
        """Packets lost, doubled, corrupted, cut and late, and out of order by one place."""
        for _ in range(steps):
            self._flush()
            for queue, deliver in ((self.to_board, self._board_gets), (self.to_host, self._host_gets)):
                if not queue:
                    continue
                fate = data.draw(
                    st.sampled_from(("good", "good", "good", "lost", "twice", "bad", "cut", "late", "swap"))
                )
                packet = queue.pop(1 if fate == "swap" and len(queue) > 1 else 0)
                if fate in ("good", "swap"):
                    deliver(packet)
                elif fate == "twice":
                    deliver(packet)
                    queue.insert(min(2, len(queue)), packet)
                elif fate == "bad":
                    place = data.draw(st.integers(0, len(packet) - 1))
                    bit = 1 << data.draw(st.integers(0, 7))
                    deliver(packet[:place] + bytes((packet[place] ^ bit,)) + packet[place + 1 :])
                elif fate == "cut":
                    deliver(packet[: data.draw(st.integers(0, len(packet)))])
                elif fate == "late":
                    queue.append(packet)
            self.now_us += data.draw(st.integers(0, 40_000))

    @rule(duration_ms=st.integers(1, 400))
    def silence(self, duration_ms: int) -> None:
        """Time passes, timers fire, nothing arrives."""
        for _ in range(4):
            self._flush()
            self.now_us += duration_ms * 250

    @precondition(lambda self: self.host_open)
    @rule(kind=st.sampled_from(StopKind))
    def a_stop_overtakes_what_is_in_transit(self, kind: StopKind) -> None:
        """As on CAN, where stops have a class of their own."""
        self._flush()
        in_transit, self.to_board = self.to_board, []
        self.host_stops(kind)
        self._flush()
        self.to_board += in_transit

    @rule()
    def everything_in_transit_is_lost(self) -> None:
        self.to_board.clear()
        self.to_host.clear()

    @rule()
    def good_channel(self) -> None:
        """The channel heals: whatever may still arrive does."""
        for _ in range(60):
            self._flush()
            moving_down, self.to_board = self.to_board, []
            moving_up, self.to_host = self.to_host, []
            for packet in moving_down:
                self._board_gets(packet)
            for packet in moving_up:
                self._host_gets(packet)
            self.now_us += 20_000
        assert self.host.is_open or not self.host_open
        if self.host.is_open and not self.host.stopping and self.board.is_open:
            assert self.host.pending == self.host.unacknowledged == 0
            assert self.got_down[len(self.got_down) - len(self.sent_down) :] == self.sent_down
            assert self.got_up == self.sent_up.get(self.host.epoch, [])
        assert not self.host.stopping
        assert self.acknowledged_stops <= self.asked_stops

    # -------------------------------------------------------------------------------------------------------- events

    def _board_gets(self, packet: bytes) -> None:
        self.board.receive_data(packet, self.now_us)
        while (event := self.board.next_event()) is not None:
            if isinstance(event, SessionOpened):
                self.got_down = []
                self.forbidden |= self.ever_down
            elif isinstance(event, StopReceived):
                self.forbidden |= self.before_stop
                self.got_down = []
            elif isinstance(event, Received) and isinstance(event.message, Segment):
                tag = _tag(event.message)
                assert tag in self.ever_down, "never sent"
                assert tag not in self.forbidden, "sent before a stop, or in another session"
                assert not self.got_down or tag > self.got_down[-1], "doubled or out of order"
                self.got_down.append(tag)

    def _host_gets(self, packet: bytes) -> None:
        self.host.receive_data(packet, self.now_us)
        while (event := self.host.next_event()) is not None:
            if isinstance(event, SessionOpened):
                self.host_open = True
                self.got_up = []
            elif isinstance(event, SessionLost):
                self.host_open = False
                self.sent_down = []
            elif isinstance(event, GenerationAdvanced):
                self.sent_down = []
            elif isinstance(event, StopAcknowledged):
                self.acknowledged_stops += 1
            elif isinstance(event, Received) and isinstance(event.message, Truncated):
                tag = _tag(event.message)
                assert tag in self.ever_up
                assert not self.got_up or tag > self.got_up[-1], "doubled or out of order"
                self.got_up.append(tag)

    @invariant()
    def memory_is_bounded(self) -> None:
        for end in (self.host, self.board) if hasattr(self, "host") else ():
            assert len(end._events) <= 2 * EVENT_CAP
            assert len(end._unsequenced) <= 17
            assert end.unacknowledged <= 8
            assert end._codec.buffered <= MAX_FRAME

    @invariant()
    def what_was_received_is_a_prefix_of_what_was_sent(self) -> None:
        if self.host_open:
            sent = self.sent_up.get(self.host.epoch, [])
            assert self.got_up == sent[: len(self.got_up)]


TestLink = LinkMachine.TestCase
TestLink.settings = settings(
    max_examples=150,
    stateful_step_count=40,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)

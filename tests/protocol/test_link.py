"""Link rules one at a time: each test is a short scene between two ends."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from benchmarks.soak import main as soak
from rm501_protocol.declaration import Message, encode_payload
from rm501_protocol.errors import FieldRangeError, LinkClosedError, LinkFullError
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_NAK, FLAG_OPEN, FLAG_SEQUENCED, HEADER, parse_header
from rm501_protocol.host_link import CLOCK_PERIOD_US, HELLO_PERIOD_US, NOISE_FRAMES, SILENCE_US, STOP_PERIOD_US
from rm501_protocol.link import (
    BoardLink,
    Event,
    GenerationAdvanced,
    HostLink,
    LinkHeard,
    LinkNoisy,
    LinkSilent,
    LossReason,
    PacketCodec,
    Received,
    SessionLost,
    SessionOpened,
    StopAcknowledged,
    StopKind,
    StopReceived,
    StreamCodec,
    Undecodable,
)
from rm501_protocol.link_core import EVENT_CAP
from rm501_protocol.link_states import BOARD_TRANSITIONS, HOST_TRANSITIONS, BoardInput, BoardSessionState, HostState
from rm501_protocol.messages import (
    Ack,
    BoardState,
    ClockQuery,
    ClockReply,
    FaultCode,
    HandState,
    Hello,
    Hold,
    HoldCause,
    Identify,
    MotorTerm,
    Reset,
    Resume,
    Segment,
    SetOverride,
    SetPower,
    Status,
    StatusRequest,
    StopReply,
    Truncated,
)
from rm501_protocol.round_trip import RTO_FIRST_US, RTO_MAX_US, RoundTrip
from rm501_protocol.send_window import PENDING_CAP, WINDOW


def segment(number: int) -> Segment:
    return Segment(number * 10, 10, (MotorTerm(0, number),))


class Scene:
    """A host, a board, and packets that a test may carry, lose or keep."""

    def __init__(self, *, bytes_per_second: int | None = None, boot_id: int = 0x1000, free_slots: int = 32) -> None:
        self.now_us = 0
        self.host = HostLink(bytes_per_second=bytes_per_second)
        self.board = BoardLink(boot_id, Identify(build="b"), bytes_per_second=bytes_per_second)
        self.board.free_slots = free_slots
        self.host_events: list[Event] = []
        self.board_events: list[Event] = []
        self.nonce = 0

    def from_host(self) -> list[bytes]:
        return self.host.packets_to_send(self.now_us)

    def from_board(self) -> list[bytes]:
        return self.board.packets_to_send(self.now_us)

    def to_board(self, packets: list[bytes]) -> None:
        for packet in packets:
            self.board.receive_data(packet, self.now_us)
        while (event := self.board.next_event()) is not None:
            self.board_events.append(event)

    def to_host(self, packets: list[bytes]) -> None:
        for packet in packets:
            self.host.receive_data(packet, self.now_us)
        while (event := self.host.next_event()) is not None:
            self.host_events.append(event)

    def exchange(self, rounds: int = 4, step_us: int = 1000) -> None:
        for _ in range(rounds):
            self.to_board(self.from_host())
            self.to_host(self.from_board())
            self.now_us += step_us

    def connect(self) -> "Scene":
        self.nonce += 1
        self.host.connect(self.nonce, self.now_us)
        self.exchange()
        assert self.host.is_open and self.board.is_open
        self.host_events.clear()
        self.board_events.clear()
        return self

    @property
    def at_board(self) -> list[Message]:
        return [event.message for event in self.board_events if isinstance(event, Received)]

    @property
    def at_host(self) -> list[Message]:
        return [event.message for event in self.host_events if isinstance(event, Received)]

    def raw(self, message: Message, sequence: int = 0, *, from_board: bool, **changes: int) -> bytes:
        end = self.board if from_board else self.host
        flags = FLAG_OPEN | (FLAG_FROM_BOARD if from_board else 0) | (FLAG_SEQUENCED if message.SEQUENCED else 0)
        fields = {"flags": flags, "ack": 0, "epoch": end.epoch, "generation": end.generation, "free": 0} | changes
        header = HEADER.pack(
            message.ID, fields["flags"], sequence, fields["ack"], fields["epoch"], fields["generation"], fields["free"]
        )
        return StreamCodec().encode(header + encode_payload(message))


def header_of(packet: bytes):
    header = parse_header(StreamCodec().feed(packet)[0])
    assert header is not None
    return header


# ------------------------------------------------------------------------------------------------------------- session


def test_a_handshake_tells_both_ends_who_the_other_is() -> None:
    scene = Scene()
    assert scene.host.state is HostState.CLOSED
    scene.host.connect(77, 0)
    assert scene.host.state is HostState.OPENING and scene.host.next_deadline_us() == 0
    scene.exchange()
    opened = scene.host_events[0]
    assert isinstance(opened, SessionOpened) and opened.identify is not None
    assert (opened.identify.nonce, opened.identify.build, opened.identify.boot_id) == (77, "b", 0x1000)
    assert opened.epoch == 0x1001 == scene.host.epoch == scene.board.epoch
    greeted = scene.board_events[0]
    assert isinstance(greeted, SessionOpened) and greeted.hello == Hello(77)
    assert scene.host.identify == opened.identify and scene.host.free_slots == 32


def test_hello_is_repeated_until_answered_and_a_copy_opens_nothing_new() -> None:
    scene = Scene()
    scene.host.connect(1, 0)
    assert len(scene.from_host()) == 1
    assert scene.host.next_deadline_us() == HELLO_PERIOD_US
    scene.now_us = HELLO_PERIOD_US
    hello = scene.from_host()
    scene.to_board(hello * 3)
    assert [type(event) for event in scene.board_events] == [SessionOpened]
    answers = scene.from_board()
    assert [header_of(packet).message_id for packet in answers] == [Identify.ID] * 3
    scene.to_host(answers)
    assert [type(event) for event in scene.host_events] == [SessionOpened]
    scene.exchange()
    scene.host.connect(2, scene.now_us)
    scene.exchange()
    scene.to_board(hello)
    assert scene.board.epoch == scene.host.epoch == 0x1002, "an old Hello, late, opens nothing"


def test_nothing_sequenced_is_sent_without_a_session() -> None:
    scene = Scene()
    with pytest.raises(LinkClosedError, match="connect first"):
        scene.host.send(Hold())
    assert scene.board.send(Truncated(1)) is False and scene.board.stats.overruns == 1
    with pytest.raises(FieldRangeError):
        scene.connect().host.send(SetOverride(-1))


def test_a_board_that_restarted_ends_the_session_and_nothing_is_replayed() -> None:
    scene = Scene().connect()
    scene.host.send(segment(1))
    scene.from_host()  # lost
    scene.host.send(segment(2))
    scene.board = BoardLink(0x2000, Identify())
    scene.board.free_slots = 32
    scene.now_us += RTO_MAX_US
    scene.exchange()
    lost = scene.host_events[0]
    assert isinstance(lost, SessionLost) and lost.reason is LossReason.BOARD_RESTARTED
    assert lost.dropped == (segment(1), segment(2)) and scene.at_board == []
    assert scene.host.state is HostState.CLOSED
    scene.connect()
    scene.host.send(segment(3))
    scene.exchange()
    assert scene.at_board == [segment(3)]


def test_another_host_that_takes_over_ends_the_session() -> None:
    scene = Scene().connect()
    other = HostLink()
    other.connect(0xABCDEF, scene.now_us)
    scene.to_board(other.packets_to_send(scene.now_us))
    scene.exchange(3, CLOCK_PERIOD_US)
    lost = scene.host_events[0]
    assert isinstance(lost, SessionLost) and lost.reason is LossReason.EPOCH_CHANGED


def test_late_packets_of_a_former_session_change_nothing() -> None:
    scene = Scene()
    scene.host.connect(50, 0)
    scene.to_host([scene.raw(Status(*_status_fields()), from_board=True, flags=FLAG_FROM_BOARD)])
    scene.exchange()
    old = scene.raw(Truncated(9), from_board=True)
    old_command = scene.raw(Hold(), from_board=False)
    before_any = scene.raw(Ack(), from_board=True, epoch=0x1000, flags=FLAG_FROM_BOARD)
    scene.connect()
    scene.to_host([old, before_any])
    scene.to_board([old_command])
    assert scene.host_events == [] and scene.board_events == [] and scene.host.is_open
    assert scene.host.stats.stale_epoch == 2 and scene.board.stats.stale_epoch == 1


def _status_fields() -> tuple:
    return (0,) * 6 + (
        BoardState.READY,
        HoldCause.NONE,
        FaultCode.NONE,
        0,
        32,
        0,
        (),
        0,
        False,
        HandState.UNKNOWN,
        0,
        0,
    )


def test_what_the_board_sent_before_the_handshake_may_come_after_it() -> None:
    scene = Scene()
    scene.board.send(Status(*_status_fields()))
    early = scene.from_board()
    scene.connect()
    scene.to_host(early)
    assert scene.host.is_open and scene.host_events == []


def test_every_transition_of_the_tables_is_reachable_and_no_other_is_listed() -> None:
    assert set(HOST_TRANSITIONS.values()) == set(HostState)
    assert BOARD_TRANSITIONS[BoardSessionState.CLOSED, BoardInput.NEW_HELLO] is BoardSessionState.OPEN
    scene = Scene()
    scene.host.connect(1, 0)
    scene.host.connect(2, 0)  # OPENING to OPENING
    scene.exchange()
    scene.host.send(Hold(), urgent=False)
    assert scene.host.connect(3, scene.now_us) == (Hold(),)  # OPEN to OPENING, what was in flight is handed back
    scene.exchange()
    assert scene.host.is_open


# ------------------------------------------------------------------------------------------------------------ sequence


def test_messages_arrive_in_order_also_beyond_the_wrap_of_the_sequence() -> None:
    scene = Scene(free_slots=255).connect()
    for first in range(0, 600, 20):
        for number in range(first, first + 20):
            scene.host.send(segment(number))
            assert scene.board.send(Truncated(number))
        scene.exchange(6)
    assert scene.at_board == [segment(number) for number in range(600)]
    assert scene.at_host == [Truncated(number) for number in range(600)]
    assert scene.host.stats.retransmits == scene.board.stats.retransmits == 0


def test_a_gap_is_answered_by_one_nak_and_everything_from_it_is_sent_again() -> None:
    scene = Scene().connect()
    for number in range(5):
        scene.host.send(segment(number))
    packets = scene.from_host()
    scene.to_board(packets[:1] + packets[2:3])
    first = scene.from_board()
    scene.to_board(packets[3:])
    second = scene.from_board()
    assert [header_of(packet).flags & FLAG_NAK for packet in first + second] == [FLAG_NAK, 0]
    scene.to_host(first + second + first)
    again = scene.from_host()
    assert [header_of(packet).sequence for packet in again] == [1, 2, 3, 4]
    scene.to_board(again)
    assert scene.at_board == [segment(number) for number in range(5)]
    assert (scene.host.stats.naks_in, scene.board.stats.naks_out, scene.board.stats.gaps) == (2, 1, 3)


def test_a_repeated_packet_is_acknowledged_again_and_not_taken_again() -> None:
    scene = Scene().connect()
    scene.host.send(SetPower(True))
    packets = scene.from_host()
    scene.to_board(packets)
    lost = scene.from_board()
    assert len(lost) == 1
    scene.to_board(packets)
    again = scene.from_board()
    assert header_of(again[0]).ack == 1 and scene.at_board == [SetPower(True)]
    scene.to_host(again)
    assert scene.host.unacknowledged == 0 and scene.board.stats.duplicates == 1


def test_a_lost_packet_is_sent_again_at_its_timeout_doubling_to_the_limit() -> None:
    scene = Scene().connect()
    scene.exchange(30, 1000)
    scene.host.send(Hold())
    sent_us = []
    payloads = set()
    while len(sent_us) < 8:
        for packet in scene.from_host():
            if header_of(packet).message_id == Hold.ID:
                sent_us.append(scene.now_us)
                payloads.add((header_of(packet).sequence, packet[9:-6]))
        scene.to_host([scene.raw(Ack(), from_board=True)])  # the board lives, this packet just never gets through
        deadline = scene.host.next_deadline_us()
        assert deadline is not None
        scene.now_us = max(scene.now_us, deadline)
    gaps = [later - earlier for earlier, later in pairwise(sent_us)]
    assert gaps[0] <= RTO_FIRST_US and gaps[-1] == RTO_MAX_US
    assert all(later in (min(2 * earlier, RTO_MAX_US), earlier) for earlier, later in pairwise(gaps))
    assert scene.host.stats.timeouts == 7 and {sequence for sequence, _ in payloads} == {0}


def test_the_window_holds() -> None:
    scene = Scene().connect()
    for number in range(20):
        scene.host.send(segment(number))
    assert len(scene.from_host()) == WINDOW == scene.host.unacknowledged and scene.host.pending == 12


def test_credit_is_never_overdrawn() -> None:
    scene = Scene(free_slots=3).connect()
    for number in range(10):
        scene.host.send(segment(number))
    scene.host.send(Hold())
    assert scene.host.segment_credit == 3
    packets = scene.from_host()
    assert [header_of(packet).message_id for packet in packets] == [Hold.ID] + [Segment.ID] * 3
    scene.to_board(packets)
    scene.board.free_slots = 0
    scene.exchange(3)
    assert scene.from_host() == [] and scene.host.pending == 7
    scene.board.free_slots = 2
    scene.board.send(Truncated(0))
    scene.exchange(1)
    assert [header_of(packet).message_id for packet in scene.from_host()] == [Segment.ID] * 2


def test_free_slots_do_not_count_segments_that_the_firmware_has_not_fetched() -> None:
    scene = Scene(free_slots=5).connect()
    for number in range(3):
        scene.host.send(segment(number))
    for packet in scene.from_host():
        scene.board.receive_data(packet, scene.now_us)
    assert header_of(scene.from_board()[0]).free_slots == 2
    scene.to_board([])
    scene.board.free_slots = 2
    scene.board.send(Truncated(1))
    assert header_of(scene.from_board()[0]).free_slots == 2


def test_urgent_messages_pass_what_was_never_sent() -> None:
    scene = Scene(free_slots=0).connect()
    scene.host.send(segment(0))
    scene.host.send(Reset())
    scene.host.send(Resume())
    scene.host.send(Hold())
    scene.host.send(SetPower(True), urgent=True)
    scene.exchange()
    assert scene.at_board == [Resume(), Hold(), SetPower(True)], "Reset keeps its place behind the segment"
    assert scene.host.take_back(lambda message: isinstance(message, Segment)) == (segment(0),)
    scene.exchange()
    assert scene.at_board[-1] == Reset()


def test_more_than_the_cap_is_refused_aloud() -> None:
    scene = Scene(free_slots=0).connect()
    for number in range(PENDING_CAP):
        scene.host.send(segment(number))
    with pytest.raises(LinkFullError, match="was not sent"):
        scene.host.send(Hold())
    for number in range(PENDING_CAP + WINDOW + 5):
        scene.board.send(Truncated(number))
        if number < WINDOW:
            scene.from_board()
    assert scene.board.stats.overruns == 5


def test_a_slow_user_loses_nothing_sequenced_and_memory_is_bounded() -> None:
    scene = Scene(free_slots=255).connect()
    sent = 0
    for _ in range(400):
        while scene.host.pending < 10 and sent < 200:
            scene.host.send(segment(sent))
            sent += 1
        for packet in scene.from_host():
            scene.board.receive_data(packet, scene.now_us)
            scene.board.receive_data(scene.raw(StatusRequest(), from_board=False), scene.now_us)
        for packet in scene.from_board():
            scene.host.receive_data(packet, scene.now_us)
        event = scene.board.next_event()
        if event is not None:
            scene.board_events.append(event)
        scene.now_us += 20_000
    assert scene.board.stats.overruns > 0
    scene.exchange(60, 20_000)
    assert [m for m in scene.at_board if isinstance(m, Segment)] == [segment(number) for number in range(200)]


def test_events_above_twice_the_cap_are_counted_and_dropped() -> None:
    scene = Scene().connect()
    for _ in range(3 * EVENT_CAP):
        scene.board.advance_generation()
        for packet in scene.from_board():
            scene.host.receive_data(packet, scene.now_us)
    assert scene.host.stats.overruns == EVENT_CAP


def test_what_means_nothing_does_not_stop_the_channel() -> None:
    scene = Scene().connect()
    unknown = HEADER.pack(0x7F, FLAG_OPEN | FLAG_SEQUENCED, 0, 0, scene.host.epoch, 0, 0) + b"abc"
    wrong_way = scene.raw(Truncated(1), 1, from_board=False)
    scene.to_board([StreamCodec().encode(unknown), wrong_way, scene.raw(Hold(), 2, from_board=False)])
    assert [type(event) for event in scene.board_events] == [Undecodable, Undecodable, Received]
    first, second, _ = scene.board_events
    assert isinstance(first, Undecodable) and (first.message_id, first.sequence) == (0x7F, 0)
    assert isinstance(second, Undecodable) and "may not come this way" in second.reason
    bad = scene.board.stats.bad_packets
    for message_id in (0x7F, Truncated.ID, Hold.ID):  # not flagged as sequenced
        packet = HEADER.pack(message_id, FLAG_OPEN, 0, 0, scene.host.epoch, 0, 0) + b"abcd"
        scene.to_board([StreamCodec().encode(packet)])
    assert scene.board.stats.bad_packets == bad + 3


def test_echoes_and_foreign_headers_are_dropped() -> None:
    scene = Scene().connect()
    scene.host.send(Hold())
    echo = scene.from_host()
    scene.to_host([*echo, StreamCodec().encode(b"\x01\xf0" + bytes(6)), StreamCodec().encode(b"\x01\x02")])
    assert scene.host.stats.bad_packets == 3 and scene.host_events == []


def test_acknowledgements_out_of_date_are_ignored() -> None:
    scene = Scene().connect()
    for number in range(4):
        scene.host.send(segment(number))
    scene.to_board(scene.from_host())
    scene.to_host(scene.from_board())
    credit = scene.host.segment_credit
    scene.to_host([scene.raw(Ack(), from_board=True, ack=1, free=200, flags=FLAG_OPEN | FLAG_FROM_BOARD | FLAG_NAK)])
    assert scene.host.segment_credit == credit and scene.from_host() == []


# --------------------------------------------------------------------------------------------------------------- stops


@pytest.mark.parametrize("kind", StopKind)
def test_a_stop_goes_first_and_nothing_sent_before_it_runs_after_it(kind: StopKind) -> None:
    scene = Scene().connect()
    for number in range(12):
        scene.host.send(segment(number))
    in_flight = scene.from_host()
    dropped = scene.host.stop(kind, scene.now_us)
    assert dropped == tuple(segment(number) for number in range(12))
    scene.host.send(Reset())
    stops = scene.from_host()
    assert len(stops) == 2 and all(packet.startswith(b"\x00") for packet in stops)
    assert scene.host.next_deadline_us() == scene.now_us + STOP_PERIOD_US and scene.host.stopping
    scene.to_board([*stops, *in_flight])
    assert scene.board_events == [StopReceived(kind, 1)], "two copies, executed once; what was in flight is refused"
    assert scene.board.stats.stale_generation == 8
    scene.to_host(scene.from_board())
    assert scene.host_events == [StopAcknowledged(kind, 1)] and not scene.host.stopping
    scene.exchange()
    assert scene.at_board == [Reset()], "what was queued after the stop goes to the new generation"


def test_messages_received_but_not_fetched_before_a_stop_are_gone() -> None:
    scene = Scene().connect()
    scene.host.send(segment(0))
    for packet in scene.from_host():
        scene.board.receive_data(packet, scene.now_us)
    scene.host.stop(StopKind.STOP, scene.now_us)
    scene.to_board(scene.from_host())
    assert scene.board_events == [StopReceived(StopKind.STOP, 1)]
    assert header_of(scene.from_board()[0]).free_slots == 32


def test_a_stop_is_repeated_until_answered_and_a_kill_replaces_it() -> None:
    scene = Scene().connect()
    scene.host.stop(StopKind.STOP, scene.now_us)
    scene.from_host()
    scene.now_us += STOP_PERIOD_US - 1
    assert scene.from_host() == []
    scene.now_us += 1
    assert len(scene.from_host()) == 1
    scene.host.stop(StopKind.KILL, scene.now_us)
    scene.host.stop(StopKind.STOP, scene.now_us)
    scene.exchange()
    assert scene.board_events == [StopReceived(StopKind.KILL, 3)], "a stop never weakens a kill under way"
    assert scene.host_events == [StopAcknowledged(StopKind.KILL, 3)]


def test_stops_not_fetched_yet_are_one_of_a_kind() -> None:
    scene = Scene().connect()
    for generation, message in ((1, "Stop"), (2, "Kill"), (3, "Stop"), (4, "Kill")):
        packet = HEADER.pack(4 if message == "Stop" else 5, FLAG_OPEN, 0, 0, scene.host.epoch, 0, 0)
        scene.board.receive_data(StreamCodec().encode(packet + bytes((generation,))), 0)
    scene.to_board([])
    assert scene.board_events == [StopReceived(StopKind.STOP, 3), StopReceived(StopKind.KILL, 4)]


def test_a_stop_works_without_a_session_and_every_time() -> None:
    scene = Scene()
    scene.host.stop(StopKind.STOP, 0)
    scene.to_board(scene.from_host())
    assert [type(event) for event in scene.board_events] == [StopReceived]
    scene.to_host(scene.from_board())
    assert isinstance(scene.host_events[0], StopAcknowledged)
    scene.host.stop(StopKind.KILL, scene.now_us)
    scene.to_board(scene.from_host())
    scene.to_host(scene.from_board())
    assert [event.kind for event in scene.board_events if isinstance(event, StopReceived)][-1] is StopKind.KILL


def test_a_stop_of_a_lost_session_is_executed_rather_than_doubted() -> None:
    scene = Scene().connect()
    scene.host.send(segment(0))
    scene.exchange()
    other = HostLink()
    other.connect(999, scene.now_us)
    scene.to_board(other.packets_to_send(scene.now_us))
    scene.board_events.clear()
    scene.host.stop(StopKind.STOP, scene.now_us)
    scene.to_board(scene.from_host())
    assert any(isinstance(event, StopReceived) for event in scene.board_events)


def test_a_stop_older_than_the_boards_own_is_asked_again_beyond_it() -> None:
    scene = Scene().connect()
    assert scene.board.advance_generation() == 1
    assert scene.board.advance_generation() == 2
    scene.host.stop(StopKind.STOP, scene.now_us)  # asks for 1
    scene.exchange(8)
    assert [event for event in scene.board_events if isinstance(event, StopReceived)] == [
        StopReceived(StopKind.STOP, 3)
    ]
    assert scene.host_events[-1] == StopAcknowledged(StopKind.STOP, 3)


def test_a_stop_that_meets_the_boards_own_is_executed_all_the_same() -> None:
    scene = Scene().connect()
    scene.board.advance_generation()
    scene.host.stop(StopKind.STOP, scene.now_us)
    scene.exchange()
    assert scene.board_events == [StopReceived(StopKind.STOP, 1)]
    assert scene.host_events == [StopAcknowledged(StopKind.STOP, 1)]


def test_a_board_that_stops_by_itself_refuses_what_was_in_flight() -> None:
    scene = Scene().connect()
    scene.host.send(segment(0))
    late = scene.from_host()
    scene.board.advance_generation()
    scene.to_board(late)
    assert scene.at_board == [] and scene.board.stats.stale_generation == 1
    scene.exchange()
    assert scene.host_events == [GenerationAdvanced(1, (segment(0),))]
    scene.host.send(segment(5))
    scene.exchange()
    assert scene.at_board == [segment(5)]
    scene.host.send(StatusRequest())
    query = scene.from_host()
    scene.board.advance_generation()
    scene.to_board(query)
    assert scene.at_board[-1] == StatusRequest(), "what has no sequence has no generation either"
    old = scene.raw(Truncated(3), 0, from_board=True, generation=0)
    scene.to_host([old])
    assert scene.at_host == [Truncated(3)], "the board's reports outlive a stop"


def test_generations_wrap() -> None:
    scene = Scene().connect()
    for _ in range(300):
        scene.host.stop(StopKind.STOP, scene.now_us)
        scene.exchange(2)
    assert scene.host.generation == scene.board.generation == 300 % 256
    assert len(scene.board_events) == 300


@pytest.mark.parametrize(
    "reply",
    [StopReply(9, 1, True), StopReply(1, 1, True)],
    ids=["an answer to another request", "an answer nobody asked for"],
)
def test_answers_to_other_stops_are_ignored(reply: StopReply) -> None:
    scene = Scene().connect()
    if reply.requested == 9:
        scene.host.stop(StopKind.STOP, scene.now_us)
        scene.to_host([scene.raw(reply, from_board=True)])
        assert scene.host.stopping
        scene.to_host([scene.raw(StopReply(1, 1, True), from_board=True, epoch=5)])
        assert scene.host.stopping, "from another session"
    else:
        scene.to_host([scene.raw(reply, from_board=True)])
        assert scene.host_events == []


def test_a_flood_of_broken_or_repeated_stops_is_bounded() -> None:
    scene = Scene().connect()
    bare = HEADER.pack(4, FLAG_OPEN, 0, 0, scene.host.epoch, 0, 0)
    for _ in range(100):
        scene.board.receive_data(StreamCodec().encode(bare), 0)
        scene.board.receive_data(StreamCodec().encode(bare + b"\x01"), 0)
    assert scene.board.stats.bad_packets == 100
    assert len(scene.from_board()) <= 16


# --------------------------------------------------------------------------------------------------- pacing and silence


def test_at_most_5_ms_of_line_time_is_unacknowledged_and_handed_out() -> None:
    scene = Scene(bytes_per_second=25_000).connect()
    scene.now_us += 50_000
    scene.exchange(2, 20_000)
    for number in range(8):
        scene.host.send(Segment(number, 1, tuple(MotorTerm(motor, 1) for motor in range(3))))

    def segments_sent() -> list[bytes]:
        return [packet for packet in scene.from_host() if header_of(packet).message_id == Segment.ID]

    first = segments_sent()
    assert sum(map(len, first)) <= 125 and len(first) == 2
    scene.now_us += 8_000
    assert segments_sent() == [], "nothing more until something is acknowledged"
    scene.to_board(first)
    scene.to_host(scene.from_board())
    assert len(segments_sent()) == 2


def test_what_the_line_cannot_take_waits_for_it() -> None:
    scene = Scene(bytes_per_second=1000).connect()
    scene.exchange(5, 200_000)
    scene.from_host()
    scene.from_board()
    scene.now_us += 300_000
    scene.host.send(StatusRequest())
    scene.host.send(StatusRequest())
    assert len(scene.from_host()) == 1
    deadline = scene.host.next_deadline_us()
    assert deadline is not None and 0 < deadline - scene.now_us <= 20_000
    scene.now_us = deadline
    assert len(scene.from_host()) >= 1
    for number in range(4):
        scene.board.send(Status(*_status_fields()[:-1], number))
        scene.board.send(Truncated(number))
    sent = scene.from_board()
    assert len(sent) == 1 and header_of(sent[0]).message_id == Status.ID, "of waiting Status only the newest is kept"
    scene.to_board([scene.raw(Hold(), 0, from_board=False)])
    assert scene.from_board() == [], "an acknowledgement waits for the line too"
    scene.board.free_slots = 1
    deadline = scene.board.next_deadline_us()
    assert deadline is not None
    scene.now_us = deadline
    assert len(scene.from_board()) >= 1


def test_an_acknowledgement_alone_waits_for_the_line() -> None:
    scene = Scene(bytes_per_second=1000).connect()
    scene.exchange(5, 200_000)
    scene.board.send(Status(*_status_fields()))
    assert len(scene.from_board()) == 1
    scene.to_board([scene.raw(Hold(), 0, from_board=False)])
    assert scene.from_board() == []
    deadline = scene.board.next_deadline_us()
    assert deadline is not None
    scene.now_us = deadline
    assert [header_of(packet).message_id for packet in scene.from_board()] == [Ack.ID]


def test_a_resend_waits_for_the_line() -> None:
    scene = Scene(bytes_per_second=1000).connect()
    scene.exchange(5, 200_000)
    scene.board.send(Truncated(1))
    scene.from_board()
    deadline = scene.board.next_deadline_us()
    assert deadline is not None
    scene.now_us = deadline
    scene.board.send(Status(*_status_fields()))
    assert [header_of(packet).message_id for packet in scene.from_board()] == [Status.ID]
    scene.now_us = scene.board.next_deadline_us() or 0
    assert [header_of(packet).message_id for packet in scene.from_board()] == [Truncated.ID]


def test_an_acknowledgement_that_comes_after_the_timeout_still_counts() -> None:
    scene = Scene().connect()
    for number in range(3):
        scene.host.send(segment(number))
    scene.to_board(scene.from_host())
    late = scene.from_board()
    scene.now_us += RTO_MAX_US
    scene.host.handle_timer(scene.now_us)
    scene.to_host(late)
    assert scene.host.unacknowledged == 0
    assert [header_of(packet).message_id for packet in scene.from_host()] == [ClockQuery.ID], "nothing is sent again"


def test_what_waits_without_a_sequence_is_bounded_and_only_the_newest_status_kept() -> None:
    scene = Scene(bytes_per_second=1000).connect()
    for _ in range(40):
        scene.host.send(StatusRequest())
    assert scene.host.stats.overruns == 25, "16 are kept of 40 and of the clock query that waited"
    for number in range(5):
        scene.to_board([scene.raw(ClockQuery(number), from_board=False)])
        scene.board.send(Status(*_status_fields()[:-1], number))
    kept = []
    while len(kept) < 6:
        kept += [header_of(packet).message_id for packet in scene.from_board()]
        scene.now_us += 100_000
    assert kept.count(Status.ID) == 1 and kept.count(ClockReply.ID) == 5


def test_more_than_one_broken_frame_in_a_hundred_is_reported() -> None:
    for every, noisy in ((101, False), (50, True)):
        scene = Scene().connect()
        good = scene.raw(Ack(), from_board=True)
        for number in range(NOISE_FRAMES + 1):
            scene.to_host([good if number % every else good[:-3] + b"\x01\x00"])
        reports = [event for event in scene.host_events if isinstance(event, LinkNoisy)]
        assert bool(reports) == noisy
        if noisy:
            assert (reports[0].bad_frames, reports[0].frames) == (10, NOISE_FRAMES)


def test_silence_is_reported_once_and_its_end_too() -> None:
    scene = Scene().connect()
    heard = scene.host.last_heard_us
    assert heard is not None
    scene.now_us = heard + SILENCE_US
    assert scene.host.next_deadline_us() is not None
    scene.from_host()
    scene.now_us += SILENCE_US
    scene.from_host()
    scene.to_host([])
    assert scene.host_events == [LinkSilent(SILENCE_US)]
    scene.exchange(4, CLOCK_PERIOD_US)
    assert [type(event) for event in scene.host_events[1:]] == [LinkHeard] and scene.host.is_open


def test_the_clock_is_asked_at_10_hz_and_answered_by_the_link() -> None:
    scene = Scene().connect()
    for _ in range(100):
        scene.exchange(1, 10_000)
    assert 10 <= scene.host.clock.quality.samples <= 12
    assert abs(scene.host.clock.board_us(500_000) - 500_000) < 20_000
    assert ClockQuery not in {type(message) for message in scene.at_board}
    assert scene.host.round_trip_us >= 0 and CLOCK_PERIOD_US == 100_000
    late = scene.raw(StatusRequest(), from_board=False)
    scene.to_board([late.replace(late, scene.raw(ClockQuery(1), from_board=False, flags=FLAG_OPEN | FLAG_SEQUENCED))])
    assert any(isinstance(event, Undecodable) for event in scene.board_events)


def test_the_clock_starts_anew_with_a_restarted_board_and_goes_on_in_a_new_session() -> None:
    scene = Scene().connect()
    scene.exchange(10, 100_000)
    samples = scene.host.clock.quality.samples
    scene.connect()
    assert scene.host.clock.quality.samples >= samples
    scene.board = BoardLink(0x2000, Identify(clock_hz=2_000_000))
    scene.exchange(3, 100_000)
    scene.connect()
    assert scene.host.clock.quality.samples <= 2
    scene.host.clock.restart()
    scene.host.clock.add(0, 4_000_000, 4_000_000, 0)
    assert scene.host.clock.board_us(0) == 2_000_000, "ticks of half a microsecond"
    scene.board = BoardLink(0x3000, Identify(clock_hz=0))
    scene.exchange(3, 100_000)
    scene.connect().exchange(3, 100_000)
    assert scene.host.clock.ready, "a clock without a rate is taken for microseconds, not divided by"


def test_a_link_over_packets_needs_no_framing() -> None:
    host, board = HostLink(codec=PacketCodec()), BoardLink(1, Identify(), codec=PacketCodec())
    host.connect(1, 0)
    for packet in host.packets_to_send(0):
        board.receive_data(packet, 0)
    for packet in board.packets_to_send(0):
        host.receive_data(packet, 0)
    assert host.is_open
    host.stop(StopKind.STOP, 0)
    for packet in host.packets_to_send(0):
        board.receive_data(packet, 0)
    assert isinstance(board.next_event(), SessionOpened | StopReceived)
    host.receive_data(board.data_to_send(0), 0)  # several packets at once are not one packet
    assert host.stats.bad_frames == 1


@pytest.mark.parametrize(
    "mangle",
    [lambda packet: packet[:-1], lambda packet: packet + b"\x01", lambda packet: b"\x01" + packet],
    ids=["cut", "longer", "shifted"],
)
def test_one_byte_at_a_time_and_mangled(mangle: Callable[[bytes], bytes]) -> None:
    scene = Scene().connect()
    scene.host.send(segment(3))
    packet = scene.from_host()[0]
    for value in mangle(packet) + b"\x00" + packet:
        scene.to_board([bytes((value,))])
    assert scene.at_board == [segment(3)]


def test_a_broken_identify_or_hello_is_counted() -> None:
    scene = Scene()
    scene.host.connect(5, 0)
    scene.to_host([StreamCodec().encode(HEADER.pack(Identify.ID, FLAG_FROM_BOARD, 0, 0, 1, 0, 0) + b"\x01")])
    scene.to_board([StreamCodec().encode(HEADER.pack(Hello.ID, 0, 0, 0, 0, 0, 0) + b"\x01")])
    scene.to_host([scene.raw(Identify(nonce=6), from_board=True)])
    assert not scene.host.is_open and not scene.board.is_open
    assert scene.host.stats.bad_packets == scene.board.stats.bad_packets == 1
    scene.connect()
    nonce_again = scene.raw(Identify(nonce=scene.nonce), from_board=True, epoch=77)
    scene.to_host([nonce_again, scene.raw(Identify(nonce=scene.nonce), from_board=True)])
    assert scene.host.is_open and scene.host_events == []
    for message_id in (8, 6):
        scene.to_host([StreamCodec().encode(HEADER.pack(message_id, 3, 0, 0, scene.host.epoch, 0, 0) + b"\x01")])
    scene.to_board([StreamCodec().encode(HEADER.pack(ClockQuery.ID, 2, 0, 0, scene.host.epoch, 0, 0) + b"\x01")])
    assert scene.host.stats.bad_packets == 3 and scene.board.stats.bad_packets == 2


def test_round_trip_times_follow_rfc_6298() -> None:
    trip = RoundTrip()
    assert trip.rto_us == 30_000
    trip.sample(8000)
    assert (trip.srtt_us, trip.rttvar_us, trip.rto_us) == (8000, 4000, 24_000)
    trip.sample(16_000)
    assert (trip.srtt_us, trip.rttvar_us) == (9000, 5000)
    for expected in (58_000, 116_000, 232_000, 250_000, 250_000):
        trip.back_off()
        assert trip.rto_us == expected
    trip.progress()
    assert trip.rto_us == 29_000
    for _ in range(100):
        trip.sample(0)
    assert trip.rto_us == 12_000 and trip.srtt_us >= 1


def test_a_short_soak_finds_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert soak(["--hours", "0.05", "--stops", "150", "--jobs", "1", "--byte-error", "1e-3", "--baud", "115200"]) == 0
    assert "soak: ok, 0 wrong" in capsys.readouterr().out

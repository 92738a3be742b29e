"""Stops and stop generations: each test is a short scene between two ends."""

import pytest

from rm501_protocol.header import FLAG_OPEN, HEADER
from rm501_protocol.host_link import STOP_PERIOD_US
from rm501_protocol.link import (
    GenerationAdvanced,
    HostLink,
    StopAcknowledged,
    StopKind,
    StopReceived,
    StreamCodec,
)
from rm501_protocol.messages import (
    Reset,
    StatusRequest,
    StopReply,
    Truncated,
)
from tests.protocol.scene import Scene, header_of, segment


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

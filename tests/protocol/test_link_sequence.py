"""Sequence, acknowledgement, credit and bounds: each test is a short scene between two ends."""

from itertools import pairwise

import pytest

from rm501_protocol.errors import LinkFullError
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_NAK, FLAG_OPEN, FLAG_SEQUENCED, HEADER
from rm501_protocol.link import (
    Received,
    StreamCodec,
    Undecodable,
)
from rm501_protocol.link_core import EVENT_CAP
from rm501_protocol.messages import (
    Ack,
    Hold,
    Reset,
    Resume,
    Segment,
    SetPower,
    StatusRequest,
    Truncated,
)
from rm501_protocol.round_trip import RTO_FIRST_US, RTO_MAX_US
from rm501_protocol.send_window import PENDING_CAP, WINDOW
from tests.protocol.scene import Scene, header_of, segment


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

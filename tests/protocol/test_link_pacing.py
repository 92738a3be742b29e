"""Pacing to the line, silence, noise, clock, framing: each test is a short scene between two ends."""

from collections.abc import Callable

import pytest

from benchmarks.soak import main as soak
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_OPEN, FLAG_SEQUENCED, HEADER
from rm501_protocol.host_link import CLOCK_PERIOD_US, NOISE_FRAMES, SILENCE_US
from rm501_protocol.link import (
    BoardLink,
    HostLink,
    LinkHeard,
    LinkNoisy,
    LinkSilent,
    PacketCodec,
    SessionOpened,
    StopKind,
    StopReceived,
    StreamCodec,
    Undecodable,
)
from rm501_protocol.messages import (
    Ack,
    ClockQuery,
    ClockReply,
    Hello,
    Hold,
    Identify,
    MotorTerm,
    Segment,
    Status,
    StatusRequest,
    Truncated,
)
from rm501_protocol.round_trip import RTO_MAX_US, RoundTrip
from tests.protocol.scene import Scene, header_of, segment, status_fields


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
        scene.board.send(Status(*status_fields()[:-1], number))
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
    scene.board.send(Status(*status_fields()))
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
    scene.board.send(Status(*status_fields()))
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
        scene.board.send(Status(*status_fields()[:-1], number))
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

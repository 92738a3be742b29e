"""Two ends of different versions: neither opens a session with another major version, and a stop works all the same."""

import pytest

from rm501_protocol.declaration import decode_payload, encode_payload
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_OPEN, HEADER
from rm501_protocol.host_link import HELLO_PERIOD_US
from rm501_protocol.link import (
    BoardLink,
    HostLink,
    Received,
    SessionOpened,
    SessionRefused,
    StopKind,
    StopReceived,
    StreamCodec,
)
from rm501_protocol.link_states import BoardSessionState, HostState
from rm501_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, Hello, Hold, Identify
from tests.protocol.scene import Scene, header_of, segment

NEWER = PROTOCOL_MAJOR + 1


def of_version(board_major: int, board_minor: int = 0) -> Scene:
    """A host of this version and a board of another."""
    scene = Scene()
    scene.board = BoardLink(0x1000, Identify(major=board_major, minor=board_minor, build="b"))
    scene.board.free_slots = 32
    return scene


def hello_of(major: int | None, nonce: int = 9) -> bytes:
    """A Hello of another host; None: one from before hosts told their version."""
    payload = encode_payload(Hello(nonce, major or 0, 0))
    header = HEADER.pack(Hello.ID, 0, 0, 0, 0, 0, 0)
    return StreamCodec().encode(header + (payload[:4] if major is None else payload))


@pytest.mark.parametrize("host_major", (0, NEWER, 255))
def test_a_board_opens_no_session_for_another_major_version(host_major: int) -> None:
    scene = Scene()
    scene.to_board([hello_of(host_major)])
    (answer,) = scene.from_board()
    header = header_of(answer)
    assert header.message_id == Identify.ID and header.flags == FLAG_FROM_BOARD and header.epoch == 0x1000
    told = decode_payload(Identify.ID, StreamCodec().feed(answer)[0][HEADER.size :])
    assert isinstance(told, Identify)
    assert (told.nonce, told.major, told.minor, told.build) == (9, PROTOCOL_MAJOR, PROTOCOL_MINOR, "b")
    assert not scene.board.is_open and scene.board.epoch == 0x1000 and scene.board_events == []
    assert scene.board.stats.refused_hellos == 1
    # whatever such a host sends all the same comes to nothing
    scene.to_board([scene.raw(Hold(), from_board=False, epoch=epoch) for epoch in (0, 0x1000, 0x1001)])
    assert scene.board_events == []


def test_a_refused_host_does_not_disturb_the_session_that_is_there() -> None:
    scene = Scene().connect()
    scene.host.send(segment(1))
    scene.to_board([hello_of(NEWER)] * 3)
    answers = scene.from_board()
    assert [header_of(packet).flags & FLAG_OPEN for packet in answers] == [0, 0, 0]
    scene.exchange()
    assert scene.at_board == [segment(1)] and scene.board.epoch == scene.host.epoch and scene.host.is_open
    scene.to_host(answers)  # meant for somebody else
    assert scene.host.is_open and scene.host_events == []


def test_a_host_hears_that_the_board_speaks_another_major_version_and_falls_silent() -> None:
    scene = of_version(NEWER, 3)
    scene.host.connect(5, 0)
    scene.exchange()
    (refused,) = scene.host_events
    assert isinstance(refused, SessionRefused) and (refused.identify.major, refused.identify.minor) == (NEWER, 3)
    assert scene.host.state is HostState.CLOSED and scene.board.is_open is False
    scene.now_us += 10 * HELLO_PERIOD_US
    assert scene.from_host() == [] and scene.host.next_deadline_us() is None


def test_a_host_refuses_a_board_of_another_version_that_does_not_check() -> None:
    scene = Scene()
    scene.host.connect(5, 0)
    scene.to_host([scene.raw(Identify(nonce=5, major=NEWER), from_board=True, epoch=7)])
    assert [type(event) for event in scene.host_events] == [SessionRefused]
    assert scene.host.state is HostState.CLOSED


def test_of_another_major_version_only_the_first_six_bytes_have_to_mean_something() -> None:
    scene = Scene()
    scene.host.connect(5, 0)
    header = HEADER.pack(Identify.ID, FLAG_FROM_BOARD, 0, 0, 7, 0, 0)
    start = encode_payload(Identify(nonce=5, major=NEWER, minor=1))[:6]
    scene.to_host([StreamCodec().encode(header + start + b"\xff" * 40)])
    (refused,) = scene.host_events
    assert isinstance(refused, SessionRefused) and refused.identify == Identify(nonce=5, major=NEWER, minor=1)


def test_a_peer_that_says_no_version_speaks_1_0_also_to_one_that_does_not() -> None:
    scene = of_version(1)
    scene.to_board([hello_of(None)])
    (opened,) = scene.board_events
    assert isinstance(opened, SessionOpened) and opened.hello == Hello(9, 1, 0)
    scene = of_version(2)
    scene.to_board([hello_of(None)])
    assert scene.board_events == [] and scene.board.stats.refused_hellos == 1
    assert decode_payload(Identify.ID, b"\x05\x00\x00\x00") == Identify(nonce=5, major=1, minor=0)


def test_the_host_of_a_later_version_says_so_and_takes_no_answer_of_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rm501_protocol.host_link.PROTOCOL_MAJOR", NEWER)
    scene = Scene()
    scene.host.connect(5, 0)
    (hello,) = scene.from_host()
    payload = StreamCodec().feed(hello)[0][HEADER.size :]
    assert decode_payload(Hello.ID, payload) == Hello(5, NEWER, PROTOCOL_MINOR)
    scene.to_board([hello])
    scene.to_host(scene.from_board())
    (refused,) = scene.host_events
    assert isinstance(refused, SessionRefused) and refused.identify.major == PROTOCOL_MAJOR
    assert scene.board_events == []
    scene.host.connect(6, scene.now_us)
    scene.to_host([scene.raw(Identify(), from_board=True)])  # says no version: 1.0
    assert [type(event) for event in scene.host_events] == [SessionRefused]


def test_minor_versions_go_on_with_each_other() -> None:
    scene = of_version(PROTOCOL_MAJOR, 200).connect()
    scene.host.send(Hold())
    scene.exchange()
    assert scene.at_board == [Hold()]


@pytest.mark.parametrize("kind", StopKind)
def test_a_refused_host_can_stop_the_board(kind: StopKind) -> None:
    scene = of_version(NEWER)
    scene.host.connect(5, 0)
    scene.exchange()
    scene.host.stop(kind, scene.now_us)
    scene.exchange()
    assert StopReceived(kind, scene.board.generation) in scene.board_events
    assert scene.host.stopping is False


def test_an_identify_without_a_session_opens_none() -> None:
    scene = Scene()
    scene.host.connect(5, 0)
    scene.to_host([scene.raw(Identify(nonce=5), from_board=True, flags=FLAG_FROM_BOARD)])
    (refused,) = scene.host_events
    assert isinstance(refused, SessionRefused) and scene.host.state is HostState.CLOSED
    scene.connect()
    scene.host.send(segment(1))
    scene.exchange()
    assert scene.board_events == [Received(segment(1), 0)]


def test_every_hello_and_refusal_leads_where_the_table_says() -> None:
    host, board = HostLink(), BoardLink(1, Identify())
    host.connect(1, 0)
    assert host.state is HostState.OPENING
    for hello, state in (
        (hello_of(NEWER), BoardSessionState.CLOSED),
        (hello_of(1), BoardSessionState.OPEN),
        (hello_of(NEWER), BoardSessionState.OPEN),
    ):
        board.receive_data(hello, 0)
        assert board.is_open is (state is BoardSessionState.OPEN)

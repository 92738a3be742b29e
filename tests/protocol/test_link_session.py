"""Handshakes, restarts, takeovers: each test is a short scene between two ends."""

import pytest

from rm501_protocol.errors import FieldRangeError, LinkClosedError
from rm501_protocol.header import FLAG_FROM_BOARD
from rm501_protocol.host_link import CLOCK_PERIOD_US, HELLO_PERIOD_US
from rm501_protocol.link import (
    BoardLink,
    HostLink,
    LossReason,
    SessionLost,
    SessionOpened,
)
from rm501_protocol.link_states import BOARD_TRANSITIONS, HOST_TRANSITIONS, BoardInput, BoardSessionState, HostState
from rm501_protocol.messages import (
    Ack,
    Hello,
    Hold,
    Identify,
    SetOverride,
    Status,
    Truncated,
)
from rm501_protocol.round_trip import RTO_MAX_US
from tests.protocol.scene import Scene, header_of, segment, status_fields


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
    scene.to_host([scene.raw(Status(*status_fields()), from_board=True, flags=FLAG_FROM_BOARD)])
    scene.exchange()
    old = scene.raw(Truncated(9), from_board=True)
    old_command = scene.raw(Hold(), from_board=False)
    before_any = scene.raw(Ack(), from_board=True, epoch=0x1000, flags=FLAG_FROM_BOARD)
    scene.connect()
    scene.to_host([old, before_any])
    scene.to_board([old_command])
    assert scene.host_events == [] and scene.board_events == [] and scene.host.is_open
    assert scene.host.stats.stale_epoch == 2 and scene.board.stats.stale_epoch == 1


def test_what_the_board_sent_before_the_handshake_may_come_after_it() -> None:
    scene = Scene()
    scene.board.send(Status(*status_fields()))
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

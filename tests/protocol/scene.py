"""A host, a board, and packets that a test may carry, lose or keep."""

from rm501_protocol.declaration import Message, encode_payload
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_OPEN, FLAG_SEQUENCED, HEADER, parse_header
from rm501_protocol.link import (
    BoardLink,
    Event,
    HostLink,
    Received,
    StreamCodec,
)
from rm501_protocol.messages import (
    BoardState,
    FaultCode,
    HandState,
    HoldCause,
    Identify,
    MotorTerm,
    Segment,
)


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


def status_fields() -> tuple:
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

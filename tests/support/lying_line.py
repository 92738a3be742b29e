"""Between an honest board and its host: a line that changes what the board says, with good checksums.

`LyingLine` wraps the transport of an emulated board. Packets from the board are taken apart, altered, said twice,
kept back or made up, and put together again, so that every one of them looks sound to the link. What the host says
arrives unchanged: the board does what the host wants, whatever the host is told. Everything follows from the seed.

`Lie` names what may be said; a line tells the lies of its list, each packet one with the given probability, from
`begin` to `end`.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import replace
from enum import Enum

from rm501_protocol.declaration import Message, decode_payload, encode_payload
from rm501_protocol.enums import BoardState, EndCause, HoldCause
from rm501_protocol.errors import DecodeError
from rm501_protocol.faults import FaultCode
from rm501_protocol.framing import StreamCodec
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_NAK, FLAG_OPEN, FLAG_SEQUENCED, HEADER, Header, parse_header
from rm501_protocol.messages import (
    Ack,
    ClockReply,
    FaultReport,
    Identify,
    MotionEnded,
    Refused,
    Status,
    StopReply,
    TriggerReport,
    Truncated,
)
from rm501_protocol.transport import Receiver, Transport


class Lie(Enum):
    """One kind of untruth."""

    ACK = "acknowledges something else"
    NAK = "asks for everything again"
    CREDIT = "claims other free slots"
    SEQUENCE = "numbers its packet wrongly"
    EPOCH = "names another epoch"
    NO_SESSION = "denies the session"
    GENERATION = "has stopped, so it says"
    CLOCK = "its clock jumps"
    FRAMES = "its frame counters jump"
    POSITION = "its positions jump"
    STATE = "is in another state"
    TRUST = "trusts other motors"
    TRUNCATED = "the payload is cut"
    GARBLED = "a byte of the payload is wrong"
    REPEAT = "says it again"
    SWALLOW = "says nothing"
    LATE = "says it later"
    IDENTITY = "is another board now"
    MADE_UP = "reports what never happened"


class LyingLine:
    """A transport whose far end cannot be believed."""

    def __init__(self, honest: Transport, seed: int, lies: Iterable[Lie], probability: float) -> None:
        self._honest = honest
        self._rng = random.Random(seed)
        self._lies = tuple(lies)
        self._probability = probability
        self._codec = StreamCodec()
        self._receiver: Receiver | None = None
        self._late: list[bytes] = []
        self.is_lying = False
        self.told: dict[Lie, int] = {}

    @property
    def packets(self) -> bool:
        """As the honest line."""
        return self._honest.packets

    @property
    def bytes_per_second(self) -> int | None:
        """As the honest line."""
        return self._honest.bytes_per_second

    def start(self, receiver: Receiver) -> None:
        """Deliver to `receiver` what is left of the truth."""
        self._receiver = receiver
        self._honest.start(self)

    def write(self, data: bytes) -> None:
        """The host is heard as it is."""
        self._honest.write(data)

    async def aclose(self) -> None:
        """Close the honest line."""
        await self._honest.aclose()

    def connection_lost(self, exc: Exception | None) -> None:
        """The honest line is gone."""
        assert self._receiver is not None
        self._receiver.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Bytes of the board."""
        assert self._receiver is not None
        for packet in self._codec.feed(data):
            for told in self._told(packet):
                self._receiver.data_received(StreamCodec().encode(told))

    def _told(self, packet: bytes) -> list[bytes]:
        header = parse_header(packet)
        if not self.is_lying or header is None or self._rng.random() >= self._probability:
            return [packet]
        lie = self._rng.choice(self._lies)
        told = self._lie(lie, header, packet)
        if told != [packet]:
            self.told[lie] = self.told.get(lie, 0) + 1
        return told

    def _lie(self, lie: Lie, header: Header, packet: bytes) -> list[bytes]:
        rng = self._rng
        payload = packet[HEADER.size :]
        fields = dict(zip(Header._fields, header, strict=True))
        if lie is Lie.ACK:
            fields["ack"] = (header.ack + rng.choice((-3, -1, 1, 2, 8, 100))) & 0xFF
        elif lie is Lie.NAK:
            fields["flags"] = header.flags | FLAG_NAK
        elif lie is Lie.CREDIT:
            fields["free_slots"] = rng.choice((0, 1, 33, 255))
        elif lie is Lie.SEQUENCE:
            fields["sequence"] = (header.sequence + rng.choice((-1, 1, 100))) & 0xFF
        elif lie is Lie.EPOCH:
            fields["epoch"] = (header.epoch + rng.choice((-1, 1, 1000))) & 0xFFFF
        elif lie is Lie.NO_SESSION:
            fields["flags"] = header.flags & ~FLAG_OPEN
        elif lie is Lie.GENERATION:
            fields["generation"] = (header.generation + rng.choice((-1, 1, 2, 127, 128))) & 0xFF
        elif lie is Lie.TRUNCATED:
            payload = payload[: rng.randrange(len(payload) + 1)]
        elif lie is Lie.GARBLED and payload:
            altered = bytearray(payload)
            altered[rng.randrange(len(altered))] = rng.randrange(256)
            payload = bytes(altered)
        elif lie is Lie.REPEAT:
            return [packet] * rng.randrange(2, 6)
        elif lie is Lie.SWALLOW:
            return []
        elif lie is Lie.LATE:
            self._late.append(packet)
            return [self._late.pop(0)] if len(self._late) > rng.randrange(1, 20) else []
        elif lie is Lie.IDENTITY:
            identity = Identify(nonce=rng.choice((0, rng.getrandbits(32))), boot_id=rng.getrandbits(32))
            return [packet, _packet(header, identity)]
        elif lie is Lie.MADE_UP:
            return [packet, self._made_up(header)]
        else:
            payload = self._altered(lie, header, payload)
        return [HEADER.pack(*fields.values()) + payload]

    def _altered(self, lie: Lie, header: Header, payload: bytes) -> bytes:
        """The payload of a message that says something else than it did."""
        try:
            message = decode_payload(header.message_id, payload)
        except DecodeError:
            return payload
        changed = _ALTERED[lie](self._rng, message)
        return payload if changed is None else encode_payload(changed)

    def _made_up(self, header: Header) -> bytes:
        """A report that no board sent; sequenced ones claim to be the next, so that the host takes them."""
        rng = self._rng
        frame = rng.getrandbits(32)
        message: Message = rng.choice(
            (
                MotionEnded(rng.choice(list(EndCause)), frame, frame, tuple(rng.getrandbits(60) for _ in range(6))),
                FaultReport(rng.choice(list(FaultCode)), 255, -1, 0, frame, frame, frame),
                Refused(rng.randrange(256), 0, rng.choice(range(1, 35))),  # type: ignore[arg-type]  # a reason's number
                TriggerReport(rng.randrange(9), frame, frame, frame, (1, 2, 3)),
                Truncated(frame),
                StopReply(header.generation, rng.randrange(256), bool(rng.randrange(2))),
                ClockReply(frame, frame, frame),
                Ack(),
            )
        )
        return _packet(header, message)


def _packet(header: Header, message: Message) -> bytes:
    flags = FLAG_FROM_BOARD | FLAG_OPEN | (FLAG_SEQUENCED if message.SEQUENCED else 0)
    return HEADER.pack(
        message.ID, flags, header.sequence, header.ack, header.epoch, header.generation, header.free_slots
    ) + encode_payload(message)


def _clock(rng: random.Random, message: Message) -> Message | None:
    jump = rng.choice((-1 << 31, -1_000_000, 5000, 1 << 30))
    if isinstance(message, ClockReply):
        return replace(message, received_ticks=(message.received_ticks + jump) & 0xFFFFFFFF)
    if isinstance(message, Status):
        return replace(message, clock_ticks=(message.clock_ticks + jump) & 0xFFFFFFFF)
    return None


def _frames(rng: random.Random, message: Message) -> Message | None:
    if isinstance(message, Status | MotionEnded):
        name = rng.choice(("real_frame", "motion_frame"))
        jump = rng.choice((-100_000, -1, 1, 3000, 1 << 30, -1 << 31))
        return replace(message, **{name: (getattr(message, name) + jump) & 0xFFFFFFFF})
    if isinstance(message, Truncated):
        return Truncated((message.end_frame + rng.choice((-100, 1, 1 << 30))) & 0xFFFFFFFF)
    return None


def _position(rng: random.Random, message: Message) -> Message | None:
    if isinstance(message, Status | TriggerReport):
        steps = list(message.positions_steps)
        steps[rng.randrange(len(steps))] += rng.choice((-4000, -1, 3, 1000))
        return replace(message, positions_steps=tuple(steps))
    if isinstance(message, MotionEnded):
        places = list(message.positions_q48)
        places[rng.randrange(len(places))] += rng.choice((-1, 1 << 47, 500 << 48))
        return replace(message, positions_q48=tuple(places))
    return None


def _state(rng: random.Random, message: Message) -> Message | None:
    if not isinstance(message, Status):
        return None
    return replace(
        message,
        state=rng.choice(list(BoardState)),
        hold_cause=rng.choice((message.hold_cause, *HoldCause)),
        queue_used=rng.choice((0, message.queue_used, 255)),
        power=bool(rng.randrange(2)),
    )


def _trust(rng: random.Random, message: Message) -> Message | None:
    return replace(message, trusted_mask=rng.randrange(64)) if isinstance(message, Status) else None


_ALTERED: dict[Lie, Callable[[random.Random, Message], Message | None]] = {
    Lie.CLOCK: _clock,
    Lie.FRAMES: _frames,
    Lie.POSITION: _position,
    Lie.STATE: _state,
    Lie.TRUST: _trust,
    Lie.GARBLED: lambda rng, message: None,
}

"""At least one example of every message, with edge values; used wherever a test needs every message."""

from dataclasses import dataclass
from enum import IntEnum, IntFlag

from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.declaration import CustomPayload, Field, Message, encode_payload, fields_of, registry
from rm501_protocol.messages import MotorTerm, Segment, SegmentFlag, hand_event, output_event
from rm501_protocol.wire_types import Record, Scalar, Text, Vector, WireType


@dataclass(frozen=True)
class Example:
    message: Message

    @property
    def payload(self) -> bytes:
        return encode_payload(self.message)


def _value(wire: WireType, largest: bool) -> object:
    if isinstance(wire, Scalar):
        return wire.maximum if largest else wire.minimum
    if isinstance(wire, Text):
        return "x" * wire.cap if largest else ""
    if isinstance(wire, Vector):
        return tuple(_value(wire.element, largest) for _ in range(wire.cap if largest else 0))
    assert isinstance(wire, Record)
    return wire.cls(*(_value(scalar, largest) for _, scalar in wire.fields))


def _extreme(field: Field, largest: bool) -> object:
    if field.enum is None:
        return _value(field.wire, largest)
    if issubclass(field.enum, IntFlag):
        return field.enum(0)
    assert issubclass(field.enum, IntEnum)
    members = sorted(field.enum)
    return members[-1] if largest else members[0]


SEGMENTS = (
    Segment(0, 1),
    Segment(
        0xFFFFFFFF,
        65535,
        tuple(MotorTerm(motor, -(1 << 31), (1 << 31) - 1) for motor in range(8)),
        SegmentFlag.ENDS_AT_REST | SegmentFlag.START_AT_REAL_FRAME | SegmentFlag.JOG,
        0,
        0xFFFF,
        tuple(hand_event(n, -32768) for n in range(8)),
        0xFFFFFFFF,
    ),
    Segment(
        1000,
        100,
        (MotorTerm(0, 5, -6, 7), MotorTerm(4, -5, 6, -7)),
        SegmentFlag.CUBIC,
        1234,
        4321,
        (hand_event(0, 800), output_event(99, 0x81, 0x80)),
    ),
)


def _examples(cls: type[Message]) -> tuple[Example, ...]:
    if cls is Segment:
        return tuple(Example(segment) for segment in SEGMENTS)
    assert not issubclass(cls, CustomPayload)
    found = [Example(cls(*(_extreme(field, largest) for field in fields_of(cls)))) for largest in (False, True)]
    found += [Example(page) for page in RM501_BOARD.pages() if type(page) is cls]
    return tuple(found)


EXAMPLES: dict[int, tuple[Example, ...]] = {message_id: _examples(cls) for message_id, cls in registry().items()}

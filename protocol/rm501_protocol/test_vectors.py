"""Examples of every message, and the test vectors for other implementations that are made of them.

`vectors.json` beside this module is the written form: bytes and fields, good and bad. It is data of the package:
`load_vectors` reads it; ``python -m rm501_protocol.test_vectors`` prints it anew.
"""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from .board_config import RM501_BOARD
from .can_transfer import TransferSender
from .declaration import Direction, Message, encode_payload, fields_of, registry
from .framing import MAX_PACKET, PacketCodec, StreamCodec
from .header import FLAG_FROM_BOARD, FLAG_OPEN, FLAG_SEQUENCED, HEADER
from .messages import MotorTerm, Segment, SegmentFlag, hand_event, output_event
from .segment import motor_extremes, motor_state_at
from .wire_types import Record, Scalar, Text, Vector, WireType

__all__ = ["example_packets", "examples_of", "load_vectors", "make_vectors", "to_plain"]

_SEGMENTS = (
    Segment(0, 1),
    Segment(
        0xFFFFFFFF,
        65535,
        tuple(MotorTerm(motor, -(1 << 31), (1 << 31) - 1) for motor in range(8)),
        SegmentFlag.ENDS_AT_REST | SegmentFlag.START_AT_REAL_FRAME | SegmentFlag.JOG,
        0,
        0xFFFF,
        tuple(hand_event(0, -32768) for _ in range(8)),
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


def examples_of(cls: type[Message]) -> tuple[Message, ...]:
    """Examples of one message: every field at its smallest and at its largest, and the pages of the RM-501."""
    if cls is Segment:
        return _SEGMENTS
    found = [cls(*(_extreme(field.wire, field.enum, largest) for field in fields_of(cls))) for largest in (False, True)]
    found += [page for page in RM501_BOARD.pages() if type(page) is cls]
    return tuple(dict.fromkeys(found))


def _extreme(wire: WireType, enum: Any, largest: bool) -> Any:
    if enum is not None:
        members = sorted(enum)
        return members[-1 if largest else 0]
    if isinstance(wire, Scalar):
        return wire.maximum if largest else wire.minimum
    if isinstance(wire, Text):
        return "x" * wire.cap if largest else ""
    if isinstance(wire, Vector):
        return tuple(_extreme(wire.element, None, largest) for _ in range(wire.cap if largest else 0))
    assert isinstance(wire, Record)
    return wire.cls(*(_extreme(scalar, None, largest) for _, scalar in wire.fields))


def _packet(message: Message, sequence: int) -> bytes:
    flags = FLAG_OPEN
    flags |= FLAG_SEQUENCED if message.SEQUENCED else 0
    flags |= FLAG_FROM_BOARD if message.DIRECTION is Direction.TO_HOST else 0
    return HEADER.pack(message.ID, flags, sequence, 200, 0xBEEF, 3, 17) + encode_payload(message)


def example_packets() -> list[bytes]:
    """One packet (without checksum) for every example of every message."""
    packets = []
    for cls in registry().values():
        packets += [_packet(message, number) for number, message in enumerate(examples_of(cls))]
    return packets


def to_plain(value: Any) -> Any:
    """A message or field as JSON can hold it: enums as numbers, records as objects."""
    if isinstance(value, tuple):
        return [to_plain(item) for item in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: to_plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return value if isinstance(value, str | bool) else int(value)


def make_vectors() -> dict[str, Any]:
    """The vectors, as JSON holds them."""
    stream, packets = StreamCodec(), PacketCodec()
    good = []
    for cls in registry().values():
        for number, message in enumerate(examples_of(cls)):
            packet = _packet(message, number)
            checked = packets.encode(packet)
            frames = TransferSender(5, from_board=message.DIRECTION is Direction.TO_HOST).frames(checked)
            good.append(
                {
                    "message": cls.__name__,
                    "id": cls.ID,
                    "sequenced": cls.SEQUENCED,
                    "direction": cls.DIRECTION.value,
                    "fields": to_plain(message),
                    "payload": encode_payload(message).hex(),
                    "packet": packet.hex(),
                    "serial": stream.encode(packet).hex(),
                    "can": [{"id": frame.can_id, "data": frame.data.hex()} for frame in frames],
                }
            )
    return {"version": 1, "good": good, "bad": _bad_vectors(), "segment_arithmetic": _arithmetic()}


def _bad_vectors() -> list[dict[str, str]]:
    """Bytes on a serial line of which nothing may be accepted."""
    stream = StreamCodec()
    packet = _packet(_SEGMENTS[2], 9)
    frame = stream.encode(packet)
    checked = PacketCodec().encode(packet)
    too_long = stream.encode(bytes(MAX_PACKET - 3))
    wrong_crc = bytearray(checked)
    wrong_crc[-1] ^= 0x80
    from cobs import cobs

    cases = {
        "one bit flipped in the payload": bytes((*frame[:12], frame[12] ^ 1, *frame[13:])),
        "one bit flipped in the checksum": cobs.encode(bytes(wrong_crc)) + b"\x00",
        "last byte missing": frame[:-2] + b"\x00",
        "first byte missing": frame[1:],
        "delimiter missing, next frame joined": frame[:-1] + frame,
        "a zero inside": frame[:20] + b"\x00" + frame[20:],
        "stuffing points beyond the end": b"\xff" + frame[1:],
        "longer than any frame": too_long,
        "never-ending": bytes(range(1, 256)) * 4 + b"\x00",
        "checksum only": cobs.encode(PacketCodec().encode(b"")) + b"\x00",
        "checksum big endian": cobs.encode(packet + checked[-4:][::-1]) + b"\x00",
        "empty": b"\x00\x00\x00",
    }
    return [{"case": case, "serial": data.hex()} for case, data in cases.items()]


def _arithmetic() -> list[dict[str, Any]]:
    """Segment arithmetic: state after n frames from position p, and the extremes of v and a up to there."""
    found = []
    for start, term, frames in (
        (0, MotorTerm(0, 1, 0), 65535),
        (-1, MotorTerm(0, (1 << 31) - 1, -(1 << 31)), 65535),
        (123456789 << 40, MotorTerm(0, -(1 << 31), (1 << 31) - 1, -(1 << 31)), 32767),
        (-(1 << 79), MotorTerm(0, 987654321, -123456, 654321), 1),
        (5, MotorTerm(0, -77, 1000000, -9999), 3000),
    ):
        state = motor_state_at(start, term, frames)
        found.append(
            {
                "p": str(start),
                "v": term.v,
                "a": term.a,
                "j": term.j,
                "frames": frames,
                "p_end": str(state.p_q48),
                "v_end": str(state.v_q48),
                "a_end": str(state.a_q48),
                "extremes": [str(value) for value in motor_extremes(term, frames)],
            }
        )
    return found


def load_vectors() -> dict[str, Any]:
    """The vectors shipped with the package."""
    loaded: dict[str, Any] = json.loads(files(__package__).joinpath("vectors.json").read_text(encoding="utf-8"))
    return loaded


if __name__ == "__main__":  # pragma: no cover - the command line
    print(json.dumps(make_vectors(), indent=1))  # noqa: T201

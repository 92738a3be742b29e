"""Messages as declared: both ways over every example, ranges, growth at the end, vectors, documentation."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rm501_protocol import messages
from rm501_protocol.config_pages import MotorLimits
from rm501_protocol.declaration import (
    CustomPayload,
    Direction,
    Message,
    decode_fieldwise,
    decode_payload,
    encode_payload,
    fields_of,
    message,
    misfits,
    registry,
)
from rm501_protocol.documentation import SECTIONS, renew
from rm501_protocol.errors import DecodeError, FieldRangeError
from rm501_protocol.framing import PacketCodec, StreamCodec
from rm501_protocol.messages import (
    BoardState,
    ConfigHand,
    Hello,
    Identify,
    MotorTerm,
    RefusalReason,
    Refused,
    Segment,
    SegmentEvent,
    SegmentFlag,
    SetPositions,
    SetPower,
    Status,
    hand_event,
    output_event,
)
from rm501_protocol.segment import motor_extremes, motor_state_at
from rm501_protocol.segment_message import EventKind
from rm501_protocol.test_vectors import load_vectors, make_vectors
from rm501_protocol.wire_types import S8, S16, S80, U8, Bool, Record, Scalar, Text, Vector, WireType
from tests.protocol.examples import EXAMPLES

ROOT = Path(__file__).parents[2]
every_example = pytest.mark.parametrize(
    "value",
    [example.message for examples in EXAMPLES.values() for example in examples],
    ids=lambda value: type(value).__name__,
)


@every_example
def test_decoding_gives_back_what_was_encoded(value: Message) -> None:
    assert decode_payload(value.ID, encode_payload(value)) == value


@every_example
def test_bytes_beyond_the_known_fields_are_ignored(value: Message) -> None:
    assert decode_payload(value.ID, encode_payload(value) + b"\x01\x02\x03") == value


@every_example
def test_every_shorter_payload_is_a_decode_error_or_an_older_message(value: Message) -> None:
    payload = encode_payload(value)
    for length in range(len(payload)):
        try:
            older = decode_payload(value.ID, payload[:length])
        except DecodeError as error:
            assert error.message_id == value.ID
        else:
            # only fields with a default may be missing, and every field that is there is unchanged
            assert older != value or dataclasses.asdict(older) == dataclasses.asdict(value)
            defaults = {field.name for field in fields_of(type(value)) if field.has_default}
            for field in fields_of(type(value)):
                if field.name not in defaults:
                    assert getattr(older, field.name) == getattr(value, field.name)


def test_a_payload_of_an_older_peer_takes_defaults_for_the_fields_it_lacks() -> None:
    assert decode_payload(Hello.ID, b"\x01\x00\x00\x00") == Hello(1)
    assert decode_payload(Identify.ID, b"") == Identify()
    assert decode_payload(ConfigHand.ID, b"\x05\xe2\x04") == ConfigHand(5, 1250)
    status = Status(
        *(0,) * 6,
        BoardState.HELD,
        messages.HoldCause.USER,
        messages.FaultCode.NONE,
        1,
        2,
        3,
        (4,),
        5,
        True,
        messages.HandState.OPEN,
        6,
        7,
    )
    whole = encode_payload(status)
    optional = sum(
        field.wire.SIZE for field in fields_of(Status) if field.has_default and isinstance(field.wire, Scalar)
    )
    assert decode_payload(Status.ID, whole[:-optional]) == status
    with pytest.raises(DecodeError, match="ends early"):
        decode_payload(Status.ID, whole[: -optional - 1])


@pytest.mark.parametrize(
    ("value", "field"),
    [
        (Hello(1 << 32), "nonce"),
        (Hello(-1), "nonce"),
        (SetPositions(256, ()), "motor_mask"),
        (SetPositions(1, (1 << 31,)), "positions_steps"),
        (SetPositions(1, (0,) * 9), "positions_steps"),
        (SetPower(2), "on"),
        (Identify(build="é" * 40), "build"),
        (messages.MotionEnded(messages.EndCause.STOP, 0, 0, (1 << 80,)), "positions_q48"),
        (messages.ConfigMotors((MotorLimits(70000, 1),)), "motors"),
        (Segment(-1, 1), "start"),
        (Segment(0, 70000), "start"),
        (Segment(0, 1, (MotorTerm(1, 0), MotorTerm(0, 0))), "motors"),
        (Segment(0, 1, (MotorTerm(8, 0),)), "motors"),
        (Segment(0, 1, (MotorTerm(0, 1 << 31),)), "motors"),
        (Segment(0, 1, (MotorTerm(0, 0, 0, 5),)), "motors"),
        (Segment(0, 1, events=(hand_event(0, 1),) * 9), "events"),
        (Segment(0, 1, events=(hand_event(0, 40000),)), "events"),
        (Segment(0, 1, flags=SegmentFlag.START_AT_REAL_FRAME, real_frame=-1), "start"),
    ],
)
def test_a_value_that_does_not_fit_is_named(value: Message, field: str) -> None:
    with pytest.raises(FieldRangeError) as caught:
        encode_payload(value)
    assert field in caught.value.field
    assert type(value).__name__ in str(caught.value) and caught.value.allowed


@pytest.mark.parametrize(
    ("message_id", "payload", "words"),
    [
        (0x7F, b"", "unknown message"),
        (SetPower.ID, b"\x02", "neither 0 nor 1"),
        (SetPower.ID, b"", "ends early"),
        (Refused.ID, encode_payload(Refused(1, 2, RefusalReason.GAP))[:2] + b"\xff" + bytes(9), "255"),
        (Refused.ID, encode_payload(Refused(1, 2, RefusalReason.GAP))[:2] + b"\xff", "255"),
        (SetPositions.ID, b"\x01", "ends early"),
        (SetPositions.ID, b"\x01\x09", "at most 8"),
        (SetPositions.ID, b"\x01\x02\x00\x00\x00\x00\x00", "ends early"),
        (messages.MotionEnded.ID, b"\x01" + bytes(8) + b"\x01" + bytes(9), "ends early"),
        (messages.MotionEnded.ID, b"\x01" + bytes(8), "ends early"),
        (messages.ConfigInputs.ID, b"\x01\x00\x00\x05", "neither 0 nor 1|ends early"),
        (Identify.ID, encode_payload(Identify(build="ab"))[:-1], "longer than"),
        (Identify.ID, encode_payload(Identify(build="ab"))[:-2] + b"\xff\xff", "UTF-8"),
        (Identify.ID, encode_payload(Identify())[:-1] + b"\x40" + bytes(64), "longer than"),
        (Segment.ID, bytes(5), "ends early"),
        (Segment.ID, bytes(6) + b"\x80" + bytes(20), "unknown flags"),
        (Segment.ID, encode_payload(Segment(0, 1))[:-1] + b"\x09", "at most 8"),
        (Segment.ID, encode_payload(Segment(0, 1))[:-1] + b"\x01\x00\x00\x09\x00\x00", "9 is not a valid"),
    ],
)
def test_bytes_that_mean_nothing_are_a_decode_error(message_id: int, payload: bytes, words: str) -> None:
    with pytest.raises(DecodeError, match=words):
        decode_payload(message_id, payload)


s32 = st.integers(-(1 << 31), (1 << 31) - 1)


@given(
    st.integers(0, 0xFFFFFFFF),
    st.integers(0, 0xFFFF),
    st.dictionaries(st.integers(0, 7), st.tuples(s32, s32, s32)),
    st.booleans(),
    st.lists(st.tuples(st.integers(0, 0xFFFF), st.booleans(), st.integers(-32768, 32767)), max_size=8),
    st.one_of(st.none(), st.integers(0, 0xFFFFFFFF)),
)
def test_any_segment_survives_the_wire(start, length, terms, cubic, events, real_frame) -> None:
    flags = SegmentFlag.CUBIC if cubic else SegmentFlag.NONE
    if real_frame is not None:
        flags |= SegmentFlag.START_AT_REAL_FRAME
    segment = Segment(
        start,
        length,
        tuple(MotorTerm(motor, v, a, j if cubic else 0) for motor, (v, a, j) in sorted(terms.items())),
        flags,
        length,
        0xFFFF - length,
        tuple(
            hand_event(at, value) if hand else output_event(at, value & 0xFF, value >> 8 & 0xFF)
            for at, hand, value in events
        ),
        real_frame or 0,
    )
    assert decode_payload(Segment.ID, encode_payload(segment)) == segment
    assert segment.end_frames == (start + length) % (1 << 32)
    assert [motor for motor in range(8) if segment.motor_mask >> motor & 1] == [term.motor for term in segment.motors]


def test_an_output_event_sets_only_what_its_mask_names() -> None:
    event = output_event(3, 0x0F, 0xFF)
    assert (event.kind, event.mask, event.levels) == (EventKind.OUTPUT, 0x0F, 0x0F)
    assert event == SegmentEvent(3, EventKind.OUTPUT, 0x0F0F)


def test_ids_are_pinned() -> None:
    """Numbers on the wire never change; a new message is added here."""
    pinned = json.loads((Path(__file__).parent / "message_ids.json").read_text())
    assert {cls.__name__: message_id for message_id, cls in registry().items()} == pinned


def test_a_taken_or_impossible_id_is_refused() -> None:
    for message_id in (0, 128, Hello.ID):
        with pytest.raises(ValueError, match="out of range or taken"):
            message(message_id, Direction.BOTH, sequenced=False)(Hello)


def test_a_field_without_a_wire_type_is_refused() -> None:
    @dataclasses.dataclass(frozen=True)
    class Nameless(Message):
        field: Annotated[int, "no wire type"]

    with pytest.raises(TypeError, match="declares no wire type"):
        fields_of(Nameless)


def test_wire_types_know_their_ranges_and_names() -> None:
    assert [(kind().minimum, kind().maximum) for kind in (U8, S8, S16, Bool)] == [
        (0, 255),
        (-128, 127),
        (-32768, 32767),
        (0, 1),
    ]
    assert S80().maximum == (1 << 79) - 1
    out = bytearray()
    S80().encode(-1, out)
    assert bytes(out) == b"\xff" * 10
    assert Vector(S80(), 3).wire_name == "u8 count, then count x s80 (at most 3)"
    assert Record(Hello, (("nonce", U8()),)).wire_name == "(nonce u8)"
    assert Text(5).wire_name == "u8 length, then UTF-8 (at most 5 bytes)"
    with pytest.raises(ValueError, match="ends early"):
        Text(5).decode(b"", 0)
    for wire in (U8(), Bool()):
        with pytest.raises(ValueError):
            wire.encode(300, bytearray())
        with pytest.raises(ValueError, match="ends early"):
            wire.decode(b"", 0)


def test_every_message_fits_a_frame() -> None:
    for examples in EXAMPLES.values():
        for example in examples:
            assert 8 + len(example.payload) + 4 <= 254


def test_shipped_vectors_are_those_of_the_declarations() -> None:
    assert load_vectors() == make_vectors(), "python -m rm501_protocol.test_vectors > .../vectors.json"


def test_good_vectors_run_both_ways() -> None:
    names = set()
    for vector in load_vectors()["good"]:
        packet = bytes.fromhex(vector["packet"])
        assert StreamCodec().feed(bytes.fromhex(vector["serial"])) == [packet]
        assert StreamCodec().encode(packet).hex() == vector["serial"]
        assert PacketCodec().feed(PacketCodec().encode(packet)) == [packet]
        decoded = decode_payload(packet[0], packet[8:])
        assert type(decoded).__name__ == vector["message"]
        assert encode_payload(decoded).hex() == vector["payload"]
        names.add(vector["message"])
    assert names == {cls.__name__ for cls in registry().values()}


def test_of_the_bad_vectors_nothing_is_accepted() -> None:
    for vector in load_vectors()["bad"]:
        codec = StreamCodec()
        assert codec.feed(bytes.fromhex(vector["serial"])) == [], vector["case"]
        good = PacketCodec().encode(b"\x01" + bytes(7))
        assert codec.feed(b"\x00" + StreamCodec().encode(good[:-4])) == [good[:-4]], "in step again at the next zero"


def test_segment_arithmetic_vectors() -> None:
    for case in load_vectors()["segment_arithmetic"]:
        term = MotorTerm(0, case["v"], case["a"], case["j"])
        state = motor_state_at(int(case["p"]), term, case["frames"])
        assert [str(state.p_q48), str(state.v_q48), str(state.a_q48)] == [case["p_end"], case["v_end"], case["a_end"]]
        assert [str(value) for value in motor_extremes(term, case["frames"])] == case["extremes"]


def test_the_document_is_the_one_that_the_declarations_give() -> None:
    text = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    assert renew(text) == text, "python -m rm501_protocol.documentation docs/protocol.md"
    for section in SECTIONS:
        assert f"<!-- generated: {section} -->" in text
    for cls in registry().values():
        assert f" {cls.__name__} (" in text


@every_example
def test_both_decoders_agree_and_nothing_of_an_example_is_a_misfit(value: Message) -> None:
    if isinstance(value, CustomPayload):
        return
    assert decode_fieldwise(type(value), encode_payload(value)) == value
    assert list(misfits(value)) == []


def test_every_misfit_is_listed() -> None:
    found = list(misfits(Hello("x", 300, 1)))  # type: ignore[arg-type]
    assert [error.field for error in found] == ["nonce", "major"]
    with pytest.raises(FieldRangeError, match="an integer"):
        encode_payload(SetPositions(1.5, ()))  # type: ignore[arg-type]


def test_bases_are_not_usable_by_themselves() -> None:
    for use in (
        lambda: WireType().encode(1, bytearray()),
        lambda: WireType().decode(b"", 0),
        lambda: CustomPayload().encode_into(bytearray()),
        lambda: CustomPayload.decode_from(b""),
    ):
        with pytest.raises(NotImplementedError):
            use()

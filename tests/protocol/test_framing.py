"""Frames and CAN transfers against damage, and the benchmark that does more of it."""

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.fuzz_frames import main as fuzz_frames
from rm501_protocol.can_transfer import (
    CLASS_CLOCK,
    CLASS_NORMAL,
    CLASS_STOP,
    CanFrame,
    TransferReceiver,
    TransferSender,
    can_id,
    class_of,
)
from rm501_protocol.framing import MAX_FRAME, MAX_PACKET, PacketCodec, StreamCodec
from rm501_protocol.header import ahead, parse_header
from rm501_protocol.slcan import LINE_CAP, SlcanAdapter, SlcanDecoder, encode_frame, parse_frame

packets = st.binary(min_size=1, max_size=MAX_PACKET - 4)


@given(st.lists(packets), st.integers(1, 300))
def test_a_stream_gives_back_its_packets_however_it_is_cut(sent: list[bytes], chunk: int) -> None:
    codec = StreamCodec()
    stream = b"".join(codec.encode(packet) for packet in sent)
    received = []
    for start in range(0, len(stream), chunk):
        received += codec.feed(stream[start : start + chunk])
        assert codec.buffered <= MAX_FRAME
    assert received == sent and codec.bad_frames == 0
    assert (codec.delimiter, PacketCodec().delimiter) == (b"\x00", b"")


@given(packets)
def test_a_frame_is_one_byte_longer_than_its_packet_and_its_delimiter_the_only_zero(packet: bytes) -> None:
    frame = StreamCodec().encode(packet)
    assert len(frame) == len(packet) + 4 + 1 + 1 and frame.count(0) == 1 and frame[-1] == 0


@given(st.binary(max_size=600), packets)
def test_after_any_noise_the_next_delimiter_brings_it_back_in_step(noise: bytes, packet: bytes) -> None:
    codec = StreamCodec()
    codec.feed(noise + b"\x00")
    assert codec.feed(codec.encode(packet)) == [packet]


def test_a_never_ending_frame_is_dropped_without_growing() -> None:
    codec = StreamCodec()
    for _ in range(1000):
        assert codec.feed(b"\x55" * 66) == []
        assert codec.buffered <= MAX_FRAME
    assert codec.feed(b"\x00") == [] and codec.bad_frames == 1
    assert codec.feed(codec.encode(b"x")) == [b"x"]
    assert codec.feed(b"\x55" * 300 + b"\x00" + codec.encode(b"y")) == [b"y"] and codec.bad_frames == 2


def test_packets_on_a_packet_transport() -> None:
    codec = PacketCodec()
    assert codec.feed(codec.encode(b"abc")) == [b"abc"]
    for bad in (b"", b"abc", codec.encode(b""), codec.encode(b"abc")[:-1], codec.encode(bytes(251))):
        assert codec.feed(bad) == []
    assert codec.bad_frames == 5


def test_headers() -> None:
    assert parse_header(bytes(7)) is None
    assert parse_header(b"\x01\x10" + bytes(6)) is None
    assert parse_header(b"\x01\x0f\x02\x03\x05\x04\x06\x07tail") == (1, 15, 2, 3, 0x0405, 6, 7)
    assert (ahead(3, 250), ahead(250, 3), ahead(5, 5)) == (9, 247, 0)


def test_the_fuzzer_finds_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz_frames(["--n", "3e4", "--seed", "5"]) == 0
    assert "0 wrong accepts, 0 exceptions" in capsys.readouterr().out


# ------------------------------------------------------------------------------------------------------------------ CAN

SIZES = (8, 12, 16, 20, 24, 32, 48, 64)
contents = st.binary(min_size=1, max_size=MAX_PACKET)


@given(st.lists(contents, max_size=10), st.sampled_from(SIZES))
def test_transfers_give_back_their_packets(sent: list[bytes], size: int) -> None:
    sender = TransferSender(9, from_board=True, frame_bytes=size)
    receiver = TransferReceiver(9, from_board=True)
    received = []
    for packet in sent:
        for frame in sender.frames(packet):
            assert len(frame.data) in (*range(1, 9), 12, 16, 20, 24, 32, 48, 64) and len(frame.data) <= size
            completed = receiver.feed(frame)
            if completed is not None:
                received.append(completed)
    assert received == sent
    assert receiver.stats.dropped_transfers == receiver.stats.stray_frames == 0


@given(st.lists(contents, min_size=1, max_size=6), st.sampled_from((8, 64)), st.data())
def test_lost_repeated_and_reordered_frames_drop_their_transfer_whole(sent, size, data) -> None:
    """Whatever the damage, only whole packets come out, each one that was sent and in order; untouched ones arrive."""
    sender = TransferSender(9, from_board=False, frame_bytes=size)
    receiver = TransferReceiver(9, from_board=False)
    groups = [sender.frames(bytes((0x7F,)) + packet[1:]) for packet in sent]
    sent = [bytes((0x7F,)) + packet[1:] for packet in sent]
    damaged = data.draw(st.integers(0, len(groups) - 1))
    frames = list(groups[damaged])
    kind = data.draw(st.sampled_from(("lost", "repeated", "swapped")))
    place = data.draw(st.integers(0, len(frames) - 1))
    single = len(frames) == 1
    if kind == "lost":
        del frames[place]
    elif kind == "repeated":
        frames.insert(place, frames[place])
    elif not single:
        other = data.draw(st.integers(0, len(frames) - 1).filter(lambda n: n != place))
        frames[place], frames[other] = frames[other], frames[place]
    groups[damaged] = frames
    received = [packet for group in groups for frame in group if (packet := receiver.feed(frame)) is not None]
    untouched = [packet for number, packet in enumerate(sent) if number != damaged]
    if kind == "swapped" and single:
        assert received == sent
    elif single and kind == "repeated":  # a whole transfer twice: the link's sequence sorts that out
        assert received == sent[:damaged] + [sent[damaged]] * 2 + sent[damaged + 1 :]
    elif kind == "repeated" and place == len(frames) - 2:  # the last frame twice: complete, then a stray
        assert received == sent and receiver.stats.stray_frames == 1
    else:
        assert received == untouched


def test_every_single_loss_in_a_run_of_transfers() -> None:
    sender = TransferSender(1, from_board=False)
    sent = [bytes((0x20, number)) + bytes(40) for number in range(40)]
    frames = [(number, frame) for number, packet in enumerate(sent) for frame in sender.frames(packet)]
    for lost in range(len(frames)):
        receiver = TransferReceiver(1, from_board=False)
        got = [packet for place, (_, frame) in enumerate(frames) if place != lost and (packet := receiver.feed(frame))]
        assert got == [packet for number, packet in enumerate(sent) if number != frames[lost][0]]


def test_frames_of_two_classes_may_be_interleaved_in_any_way() -> None:
    stop = TransferSender(1, from_board=False).frames(bytes((4, 0, 0, 0, 0, 0, 0, 0, 1)) + bytes(4))
    segment = TransferSender(1, from_board=False).frames(bytes((0x20,)) + bytes(20))
    for places in itertools.combinations(range(len(stop) + len(segment)), len(stop)):
        receiver = TransferReceiver(1, from_board=False)
        first, second = iter(stop), iter(segment)
        got = [receiver.feed(next(first if n in places else second)) for n in range(len(stop) + len(segment))]
        assert len([packet for packet in got if packet]) == 2


def test_classes_and_identifiers() -> None:
    assert [class_of(bytes((message_id,))) for message_id in (4, 5, 6, 7, 8, 0x20)] == [
        CLASS_STOP,
        CLASS_STOP,
        CLASS_STOP,
        CLASS_CLOCK,
        CLASS_CLOCK,
        CLASS_NORMAL,
    ]
    assert can_id(CLASS_NORMAL, True, 5) == 0x485 and can_id(CLASS_STOP, False, 127) == 0x07F
    for wrong in ((8, False, 1), (0, False, 128), (-1, True, 0)):
        with pytest.raises(ValueError):
            can_id(*wrong)
    for size in (4, 7, 9, 65):
        with pytest.raises(ValueError, match="frame_bytes"):
            TransferSender(1, from_board=False, frame_bytes=size)
    for packet in (b"", bytes(255)):
        with pytest.raises(ValueError, match=r"1\.\.254"):
            TransferSender(1, from_board=False).frames(packet)


def test_strange_frames_are_counted_and_never_raise() -> None:
    receiver = TransferReceiver(1, from_board=True)
    good = TransferSender(1, from_board=True).frames(bytes(20))
    for frame in (
        CanFrame(good[0].can_id ^ 0x80, good[0].data),  # the other direction
        CanFrame(good[0].can_id + 1, good[0].data),  # another node
        CanFrame(good[0].can_id | 0x800, good[0].data),
        CanFrame(good[0].can_id, b""),
        CanFrame(good[0].can_id, b"\xe0"),
        CanFrame(good[0].can_id, bytes(65)),
        good[1],  # without a start
        CanFrame(good[0].can_id, b"\x05\x80"),  # start with the wrong toggle
    ):
        assert receiver.feed(frame) is None
    assert receiver.stats.stray_frames == 8
    assert receiver.feed(CanFrame(good[0].can_id, b"\x00\xe0")) is None  # length 0
    assert receiver.feed(CanFrame(good[0].can_id, b"\xff\xe0")) is None  # longer than any packet
    assert receiver.feed(CanFrame(good[0].can_id, b"\x01\x09\x07\xe0")) is None  # padding that is no padding
    assert receiver.stats.dropped_transfers == 3
    toggle = 0x20
    assert receiver.feed(CanFrame(good[0].can_id, bytes(63) + bytes((0x80 | toggle,)))) is None
    for _ in range(20):
        toggle ^= 0x20
        receiver.feed(CanFrame(good[0].can_id, bytes(63) + bytes((toggle,))))
    assert receiver.stats.dropped_transfers == 4, "a transfer without end is dropped at its cap"
    rng = random.Random(4)
    for _ in range(5000):
        receiver.feed(CanFrame(rng.choice((0x081, 0x181, 0x481)), rng.randbytes(rng.randrange(9))))


@given(st.integers(0, 0x7FF), st.sampled_from((0, 1, 7, 8, 12, 64)), st.booleans())
def test_slcan_lines_both_ways(identifier: int, size: int, stamped: bool) -> None:
    frame = CanFrame(identifier, bytes(range(size)))
    line = encode_frame(frame)
    assert line.endswith(b"\r") and len(line) <= LINE_CAP
    assert parse_frame(line[:-1] + (b"1F2E" if stamped else b"")) == frame


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"t",
        b"t1",
        b"t1231",
        b"t12310",
        b"t1231012",
        b"tXYZ0",
        b"T000001230",
        b"t8000",
        b"t1239" + b"00" * 12,
        b"z",
        b"t123 0",
    ],
)
def test_lines_that_are_no_frame(line: bytes) -> None:
    assert parse_frame(line) is None


def test_frames_that_slcan_cannot_say() -> None:
    for frame in (CanFrame(0x800, b""), CanFrame(1, bytes(9))):
        with pytest.raises(ValueError):
            encode_frame(frame)


def test_an_adapter_answers_as_a_real_one() -> None:
    adapter = SlcanAdapter()
    assert adapter.receive(b"t0010\r") == [] and adapter.replies() == b"\a", "closed: refused"
    assert adapter.transmit(CanFrame(1, b"")) == b""
    assert adapter.receive(b"C\rS6\rV\rN\rF\r\rQ\rO\r") == [] and adapter.is_open
    assert adapter.replies() == b"\r\rV1013\rN0501\rF00\r\r\a\r"
    assert adapter.receive(b"t00") == [] and adapter.receive(b"12AB") == []
    assert adapter.receive(b"CD\r") == [CanFrame(1, b"\xab\xcd")] and adapter.replies() == b"z\r"
    assert adapter.transmit(CanFrame(0x481, b"\x01")) == b"t481101\r"
    assert adapter.receive(b"C\r") == [] and not adapter.is_open


def test_the_line_decoder_is_bounded() -> None:
    decoder = SlcanDecoder()
    assert decoder.feed(b"x" * 100_000 + b"\r" + b"O\rab\aV") == [b"O", b"ab", b"\a"]
    assert decoder.bad_lines == 1
    assert decoder.feed(b"\a\r\a") == [b"V", b"\a", b"", b"\a"]

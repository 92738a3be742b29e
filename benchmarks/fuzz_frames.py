"""Broken frames against the decoders: none may be accepted altered, none may raise, memory stays bounded.

python -m benchmarks.fuzz_frames [--n 1e5] [--seed 1]

Random part: frames of every message are flipped, truncated, spliced, joined, repeated, given bytes too many or too
few, or are noise. A packet that comes out and is not one of those put in is a wrong accept. One frame in 16 has its
damage under a good checksum and goes through a whole link end, where it must be refused or understood, without an
exception. Exhaustive part: every single bit of a frame of every message, delimiter included, and every pair of bits
of the short ones.
"""

from __future__ import annotations

import argparse
import itertools
import random
import resource
import sys
import time
import zlib

from rm501_protocol.declaration import registry
from rm501_protocol.framing import MAX_FRAME, StreamCodec
from rm501_protocol.header import HEADER
from rm501_protocol.link import BoardLink, HostLink
from rm501_protocol.link_core import EVENT_CAP
from rm501_protocol.messages import Hello, Identify
from rm501_protocol.test_vectors import example_packets

SHORT_FRAME_BYTES = 20


def _rss_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


class Mutator:
    """Damaged stretches of a byte stream, made from good frames."""

    def __init__(self, frames: list[bytes], rng: random.Random) -> None:
        self._frames = frames
        self._random = rng.random
        self._bits = rng.getrandbits
        self._bytes = rng.randbytes

    def _below(self, limit: int) -> int:
        return int(self._random() * limit)

    def _frame(self) -> bytes:
        return self._frames[self._below(len(self._frames))]

    def flip_bits(self) -> bytes:
        """One to four bits of a frame flipped."""
        data = bytearray(self._frame())
        for _ in range(1 + self._below(4)):
            data[self._below(len(data))] ^= 1 << self._below(8)
        return bytes(data)

    def change_byte(self) -> bytes:
        """One byte replaced."""
        data = bytearray(self._frame())
        data[self._below(len(data))] = self._bits(8)
        return bytes(data)

    def burst(self) -> bytes:
        """Up to eight neighbouring bytes replaced."""
        data = bytearray(self._frame())
        start = self._below(len(data))
        noise = self._bytes(1 + self._below(8))
        data[start : start + len(noise)] = noise
        return bytes(data)

    def truncate(self) -> bytes:
        """The end missing."""
        data = self._frame()
        return data[: self._below(len(data))]

    def behead(self) -> bytes:
        """The beginning missing."""
        data = self._frame()
        return data[self._below(len(data)) :]

    def drop_byte(self) -> bytes:
        """One byte missing."""
        data = self._frame()
        place = self._below(len(data))
        return data[:place] + data[place + 1 :]

    def insert_byte(self) -> bytes:
        """One byte too many."""
        data = self._frame()
        place = self._below(len(data) + 1)
        return data[:place] + bytes((self._bits(8),)) + data[place:]

    def repeat_byte(self) -> bytes:
        """One byte twice."""
        data = self._frame()
        place = self._below(len(data))
        return data[: place + 1] + data[place:]

    def join(self) -> bytes:
        """Two frames without the delimiter between them."""
        return self._frame()[:-1] + self._frame()

    def splice(self) -> bytes:
        """The head of one frame with the tail of another."""
        head, tail = self._frame(), self._frame()
        return head[: self._below(len(head))] + tail[self._below(len(tail)) :]

    def swap(self) -> bytes:
        """Two bytes exchanged."""
        data = bytearray(self._frame())
        a, b = self._below(len(data)), self._below(len(data))
        data[a], data[b] = data[b], data[a]
        return bytes(data)

    def noise(self) -> bytes:
        """Bytes that never were a frame."""
        return self._bytes(1 + self._below(40)) + b"\x00"

    def endless(self) -> bytes:
        """Far too much without a delimiter."""
        return bytes(1 + self._below(255) for _ in range(300 + self._below(300)))


class Judge:
    """Feeds stretches to one decoder and to link ends, and counts."""

    def __init__(self, packets: list[bytes]) -> None:
        self._good = set(packets)
        self._codec = StreamCodec()
        self._host = HostLink()
        self._board = BoardLink(7, Identify())
        self.wrong = 0
        self.exceptions = 0
        self.unbounded = 0
        self.accepted = 0

    def stretch(self, data: bytes) -> None:
        """Feed the decoder."""
        try:
            for packet in self._codec.feed(data):
                self.accepted += 1
                self.wrong += packet not in self._good
        except Exception:
            self.exceptions += 1
        self.unbounded += self._codec.buffered > MAX_FRAME

    def settle(self) -> None:
        """Close whatever is unfinished, so that the next case stands alone."""
        self.stretch(b"\x00")

    def through_the_links(self, packet: bytes, now_us: int) -> None:
        """Give a packet with a good checksum to both ends."""
        framed = StreamCodec().encode(packet)
        for end in (self._host, self._board):
            try:
                end.receive_data(framed, now_us)
                end.data_to_send(now_us)
                if now_us & 15 == 0:
                    while end.next_event() is not None:
                        pass
            except Exception:
                self.exceptions += 1
            self.unbounded += len(end._events) > 2 * EVENT_CAP

    def open_session(self) -> None:
        """Let both ends shake hands, so that packets get past the epoch."""
        self._host.connect(1, 0)
        self._host.data_to_send(0)
        self._board.receive_data(
            StreamCodec().encode(HEADER.pack(Hello.ID, 0, 0, 0, 0, 0, 0) + bytes((1, 0, 0, 0, 1, 0))), 0
        )
        self._host.receive_data(self._board.data_to_send(0), 0)
        while self._board.next_event() is not None:
            pass


def damaged_packet(packets: list[bytes], rng: random.Random, epoch: int) -> bytes:
    """A packet with nonsense in it that will get a good checksum; half of them belong to the session."""
    data = bytearray(packets[rng.randrange(len(packets))])
    if rng.random() < 0.5:
        HEADER.pack_into(data, 0, data[0], data[1], rng.randrange(256), rng.randrange(256), epoch, rng.randrange(3), 9)
    for _ in range(rng.randrange(4)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    if rng.random() < 0.3:
        del data[rng.randrange(len(data)) :]
    return bytes(data)[:250]


def random_part(count: int, seed: int) -> tuple[Judge, float, int]:
    """The judge, seconds taken, growth of peak memory in KiB."""
    rng = random.Random(seed)
    packets = example_packets()
    codec = StreamCodec()
    judge = Judge(packets)
    judge.open_session()
    mutator = Mutator([codec.encode(packet) for packet in packets], rng)
    kinds = [
        mutator.flip_bits,
        mutator.change_byte,
        mutator.burst,
        mutator.truncate,
        mutator.behead,
        mutator.drop_byte,
        mutator.insert_byte,
        mutator.repeat_byte,
        mutator.join,
        mutator.splice,
        mutator.swap,
        mutator.noise,
        mutator.flip_bits,
        mutator.splice,
        mutator.truncate,
    ]
    epoch = judge._board.epoch
    before_kib = 0
    started = time.perf_counter()
    for number in range(count):
        if number == min(count // 10, 100_000):
            before_kib = _rss_kib()
        if number & 15 == 15:
            judge.through_the_links(damaged_packet(packets, rng, epoch), number)
        elif number & 1023 == 1022:
            judge.stretch(mutator.endless())
        else:
            judge.stretch(kinds[number % 15]())
            if number & 3:  # now and then the damage runs on into the next frame
                judge.settle()
    return judge, time.perf_counter() - started, _rss_kib() - before_kib


def exhaustive_part() -> tuple[int, int, int]:
    """(single-bit cases, two-bit cases, wrong accepts)."""
    packets = example_packets()
    codec = StreamCodec()
    neighbour = codec.encode(packets[0])
    ones = twos = wrong = 0
    for packet in packets:
        frame = codec.encode(packet)
        stream = b"\x00" + frame
        allowed = {packets[0]}
        for bit in range(8 * len(stream)):
            ones += 1
            wrong += _accepts_other(stream, (bit,), neighbour, allowed | ({packet} if bit < 8 else set()))
        if len(frame) <= SHORT_FRAME_BYTES:
            for pair in itertools.combinations(range(8, 8 * len(stream)), 2):
                twos += 1
                wrong += _accepts_other(stream, pair, neighbour, allowed)
    return ones, twos, wrong


def _accepts_other(stream: bytes, bits: tuple[int, ...], neighbour: bytes, allowed: set[bytes]) -> bool:
    data = bytearray(stream)
    for bit in bits:
        data[bit >> 3] ^= 1 << (bit & 7)
    return any(packet not in allowed for packet in StreamCodec().feed(bytes(data) + neighbour))


def main(arguments: list[str] | None = None) -> int:
    """Run it; 1 when a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=float, default=1e5, help="random frames (default 1e5)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    assert zlib.crc32(b"123456789") == 0xCBF43926

    judge, seconds, grown_kib = random_part(int(options.n), options.seed)
    ones, twos, wrong = exhaustive_part()
    print(f"{'case':<34}{'frames':>12}{'wrong accepts':>15}{'exceptions':>12}")
    print(f"{'random damage':<34}{int(options.n):>12}{judge.wrong:>15}{judge.exceptions:>12}")
    print(f"{'every 1-bit flip of every message':<34}{ones:>12}{wrong:>15}{0:>12}")
    print(f"{'every 2-bit flip of short ones':<34}{twos:>12}{'(above)':>15}{0:>12}")
    print(f"messages {len(registry())}, undamaged frames accepted on the way {judge.accepted}")
    print(f"buffers above their caps {judge.unbounded}, peak memory grown by {grown_kib} KiB")
    failed = judge.wrong or judge.exceptions or wrong or judge.unbounded or grown_kib > 20_000
    rate = options.n / seconds
    verdict = "FAILED" if failed else "ok"
    accepts = judge.wrong + wrong
    print(f"fuzz_frames: {verdict}, {accepts} wrong accepts, {judge.exceptions} exceptions, {rate:.0f} frames/s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

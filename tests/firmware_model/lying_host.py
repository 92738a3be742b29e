"""A host that lies: packets with a good checksum and anything in them, at a board that moves.

Half of what it sends is what an honest host might send just now (legal segments in order, Start, Hold, Resume, ...), so
that the board gets into every state; the rest is made up: fields at their limits or random, wrong sequences,
acknowledgements, epochs, generations and flags, payloads cut short or too long, stops of any generation, handshakes of
any version, and noise. The inputs of the board change at random as well.

`LyingHost.step` sends a few and runs the board; it looks at what must hold whatever a host says:

- no exception; what the link keeps for its user and for the line stays bounded
- no fault that only an error of the firmware can cause
- a position becomes trusted by SetPositions only
- in a state in which nothing moves no step is made, but for those that are late
- every motor stays within its rate, and within 0.54 step of its position
"""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np

from rm501_firmware_model import Board
from rm501_firmware_model.pins import inactive_inputs
from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.declaration import Direction, Message, encode_payload, fields_of, registry
from rm501_protocol.enums import BoardState, EventKind
from rm501_protocol.faults import FaultCode
from rm501_protocol.framing import MAX_PACKET, StreamCodec
from rm501_protocol.header import FLAG_FROM_BOARD, FLAG_NAK, FLAG_OPEN, FLAG_SEQUENCED, HEADER
from rm501_protocol.link_core import EVENT_CAP
from rm501_protocol.messages import (
    ArmTrigger,
    ConfigCommit,
    Hello,
    Kill,
    Lease,
    Reset,
    Resume,
    ResumeCause,
    SetOverride,
    SetPositions,
    SetPower,
    Start,
    StatusRequest,
    Stop,
    Truncate,
)
from rm501_protocol.segment import FRACTION_BITS, ONE_STEP
from rm501_protocol.segment_message import MotorTerm, Segment, SegmentEvent, hand_event
from rm501_protocol.wire_types import Scalar, Text, Vector, WireType
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import RecordingPins
from tests.firmware_model.waves import motor_waves, timing_violations

IMPOSSIBLE_FAULTS = (
    FaultCode.POSITION_RANGE,
    FaultCode.STEP_LATE,
    FaultCode.MOTION_UNDERRUN,
    FaultCode.ILLEGAL_TRANSITION,
    FaultCode.INTERNAL,
)
STILL = (BoardState.BOOT, BoardState.IDLE, BoardState.READY, BoardState.HELD, BoardState.FAULT)
MOST_LAG = ONE_STEP * 54 // 100


def output_event_of(offset_frames: int, value: int) -> SegmentEvent:
    """An OUTPUT event of any mask and levels."""
    return SegmentEvent(offset_frames, EventKind.OUTPUT, value)


_TO_BOARD = [cls for cls in registry().values() if cls.DIRECTION in (Direction.TO_BOARD, Direction.BOTH)]


class LyingHost:
    """One board and the lies that it is told; everything follows from the seed."""

    def __init__(self, seed: int, board: type[Board], config: BoardConfig = RM501_BOARD) -> None:
        self.rng = random.Random(seed)
        self.config = config
        self.pins = RecordingPins(config)
        self.board = board(config, self.pins, boot_epoch=0xF00D, bytes_per_second=None)
        self.codec = StreamCodec()
        self.said = bytearray()
        self.motion: LegalMotion | None = None
        self.plan: list[Segment] = []
        self.states: set[BoardState] = set()
        self.problems: list[str] = []
        self.sent = 0
        self._positions_of: set[int] = set()
        self._hello(self.rng.getrandbits(32))

    @property
    def core(self):  # type: ignore[no-untyped-def]  # the board's tick state, read only
        return self.board._core

    # --------------------------------------------------------------------------------------------------- the wire

    def _hello(self, nonce: int) -> None:
        self._packet(Hello(nonce, 1, 0), flags=0)

    def _packet(self, message: Message, **wrong: int) -> None:
        """Send a message as the session's next, but for what is `wrong`."""
        flags = FLAG_OPEN | (FLAG_SEQUENCED if message.SEQUENCED else 0)
        link = self.board.link
        fields = {
            "id": message.ID,
            "flags": flags,
            "sequence": link._expected,
            "ack": link._window.next_sequence,
            "epoch": link.epoch,
            "generation": link.generation,
        } | wrong
        header = HEADER.pack(
            fields["id"],
            fields["flags"],
            fields["sequence"],
            fields["ack"],
            fields["epoch"],
            fields["generation"],
            self.rng.randrange(256),
        )
        self._send(header + encode_payload(message))

    def _send(self, packet: bytes) -> None:
        self.sent += 1
        if packet[0] == SetPositions.ID and len(packet) > HEADER.size:
            self._positions_of |= {motor for motor in range(8) if packet[HEADER.size] >> motor & 1}
        self.board.receive(self.codec.encode(packet[:MAX_PACKET]))

    # --------------------------------------------------------------------------------------------------- what it says

    def honest(self) -> None:
        """What a host might say now, to get the board moving."""
        rng, state = self.rng, self.board.state
        if not self.board.link.is_open or rng.random() < 0.01:
            self._hello(rng.getrandbits(32))
        elif state == BoardState.FAULT:
            self.pins.inputs = inactive_inputs(self.config)  # somebody has removed the cause
            self.run(40)
            self._packet(Reset(FaultCode(self.core.fault), rng.random() < 0.5))
        elif state == BoardState.IDLE:
            if rng.random() < 0.05:
                self._configure()
            self._packet(Reset() if self.core.stop_latched else SetPower(True))
        elif state == BoardState.HELD:
            self._packet(rng.choice((Resume(), SetOverride(1 << 24), Resume(ResumeCause.REFILLED))))
        elif rng.random() < 0.1 and not self.core.queue.count:
            count = self.core.layout.motor_count
            places = tuple(rng.randrange(-2000, 2000) for _ in range(count))
            self._packet(SetPositions(rng.randrange(1 << count), places))
            self.motion = None
        else:
            self._next_segment()

    def _configure(self) -> None:
        """Pages of the configuration, some of them of another one, and the hash of one of the two."""
        link = replace(self.config.link, link_timeout_ms=self.rng.choice((1, 100, 65535)), idle_power_off_ms=300)
        other = replace(self.config, link=link)
        for mine, theirs in zip(self.config.pages(), other.pages(), strict=True):
            self._packet(self.rng.choice((mine, mine, theirs)))
        self._packet(ConfigCommit(self.rng.choice((self.config, other)).hash))

    def _next_segment(self) -> None:
        core = self.core
        if self.motion is None or not self.plan or self.plan[0].start_frames != core.checker.end_frame:
            if core.queue.count:
                return
            self.motion = LegalMotion(self.rng, self.config, core.checker.end_frame)
            self.plan = list(self.motion.run(self.rng.randint(1, 12)))
        self._packet(self.plan.pop(0))
        if self.rng.random() < 0.3 or not self.plan:
            self._packet(Start())

    def lie(self) -> None:
        """Something that no honest host says."""
        rng = self.rng
        message = self.made_up()
        kind = rng.randrange(10)
        if kind == 0:
            self._packet(message, sequence=rng.randrange(256))
        elif kind == 1:
            self._packet(message, ack=rng.randrange(256))
        elif kind == 2:
            self._packet(message, epoch=rng.choice((0, 0xF00D, 0xF00E, rng.randrange(1 << 16))))
        elif kind == 3:
            self._packet(message, generation=(self.board.link.generation + rng.choice((-1, 1, 127, 128))) & 0xFF)
        elif kind == 4:
            flags = rng.choice((0, FLAG_OPEN, FLAG_OPEN | FLAG_NAK, FLAG_FROM_BOARD, rng.randrange(256)))
            self._packet(message, flags=flags, id=rng.choice((message.ID, rng.randrange(256))))
        elif kind == 5:
            self._garbled(message)
        elif kind == 6 and rng.random() < 0.3:
            self._packet(Stop(0), flags=FLAG_OPEN)
            self._packet(rng.choice((Stop, Kill))(rng.randrange(256)), epoch=rng.randrange(1 << 16))
        elif kind == 7 and rng.random() < 0.3:
            self._packet(Hello(rng.choice((0, 1, rng.getrandbits(32))), rng.choice((0, 1, 1, 2)), 9), flags=0)
        elif kind == 8:
            self.board.receive(rng.randbytes(rng.randrange(1, 60)))
        else:
            self._packet(message)

    def _garbled(self, message: Message) -> None:
        """The right header, and a payload that is cut, lengthened or altered."""
        rng = self.rng
        link = self.board.link
        flags = FLAG_OPEN | (FLAG_SEQUENCED if message.SEQUENCED else 0)
        payload = bytearray(encode_payload(message))
        for _ in range(rng.randrange(4)):
            if payload:
                payload[rng.randrange(len(payload))] = rng.randrange(256)
        if rng.random() < 0.5:
            del payload[rng.randrange(len(payload) + 1) :]
        else:
            payload += rng.randbytes(rng.randrange(20))
        self._send(HEADER.pack(message.ID, flags, link._expected, 0, link.epoch, link.generation, 0) + bytes(payload))

    def made_up(self) -> Message:
        """A message with any content that can be sent."""
        rng, core = self.rng, self.core
        cls = rng.choice(_TO_BOARD)
        if cls is Segment or rng.random() < 0.2:
            return self._made_up_segment()
        if cls is Truncate:
            return Truncate((core.motion.motion_frame + rng.randint(-300, 3000)) & 0xFFFFFFFF)
        if cls is ArmTrigger:
            return ArmTrigger(rng.randrange(9), rng.randrange(12), rng.choice((1, 2)), rng.choice((1, 2)), True)  # type: ignore[arg-type]
        if cls is Lease:
            return Lease(rng.choice((0, 1, 50, 65535)))
        if cls is Kill or cls is Stop:
            return StatusRequest()
        if cls is Start and rng.random() < 0.5:
            return Start(True, (core.real_frame + rng.choice((-5, 0, 20, 400, 1 << 30))) & 0xFFFFFFFF)
        return cls(*(self._value(field.wire, field.enum) for field in fields_of(cls)))

    def _value(self, wire: WireType, enum: object) -> object:
        rng = self.rng
        if enum is not None:
            return rng.choice(list(enum))  # type: ignore[call-overload]  # an enum class
        if isinstance(wire, Scalar):
            extremes = (wire.minimum, wire.maximum, 0, 1, rng.randint(wire.minimum, wire.maximum))
            return bool(rng.randrange(2)) if wire.maximum == 1 else rng.choice(extremes)
        if isinstance(wire, Text):
            return "x" * rng.randrange(5)
        if isinstance(wire, Vector):
            return tuple(self._value(wire.element, None) for _ in range(min(wire.cap, rng.choice((0, 1, 6, 64)))))
        return wire.cls(*(self._value(scalar, None) for _, scalar in wire.fields))  # type: ignore[attr-defined]

    def _made_up_segment(self) -> Segment:
        rng, core = self.rng, self.core
        far = rng.choice((1000, 1 << 20, (1 << 31) - 1))
        motors = sorted(rng.sample(range(8), rng.randrange(6)))
        cubic = rng.random() < 0.5
        terms = tuple(
            MotorTerm(motor, *(rng.randint(-far, far) for _ in range(2)), rng.randint(-far, far) if cubic else 0)
            for motor in motors
        )
        flags = rng.randrange(16) & ~1 | (1 if cubic and terms else 0)
        start = core.checker.end_frame if rng.random() < 0.9 else rng.getrandbits(32)
        events = tuple(
            rng.choice((hand_event, output_event_of))(rng.randrange(100), rng.choice((0, 1, 300, 0x7FFF)))
            for _ in range(rng.randrange(3))
        )
        length = rng.choice((0, 1, 10, 400, 32767, 65535))
        slopes = rng.choice(((0, 0), (400, 800), (800, 400), (65535, 65535)))
        real_frame = (core.real_frame + rng.choice((-10, 0, 50, 5000))) & 0xFFFFFFFF
        return Segment(start, length, terms, flags, *slopes, events, real_frame if flags & 8 else 0)  # type: ignore[arg-type]

    # --------------------------------------------------------------------------------------------------- the judge

    def step(self) -> None:
        """A few messages, then some frames."""
        rng, core = self.rng, self.core
        before = core.trusted
        self._positions_of.clear()
        for _ in range(rng.randrange(1, 5)):
            if rng.random() < 0.5:
                self.honest()
            else:
                self.lie()
        if rng.random() < 0.08:
            self.pins.toggle(rng.randrange(len(self.config.inputs.inputs)))
        if rng.random() < 0.01:
            self.pins.inputs ^= rng.getrandbits(32)
        still = self.core.layout is core.layout
        for _ in range(rng.randrange(1, 6)):
            self.run(rng.choice((1, 2, 13, 40, 200)))
            self.said += self.board.transmit()
        self._judge(before if still else 0)

    def run(self, frames: int) -> None:
        """Run the board; look at steps in states of rest."""
        core = self.core
        state, counts, settling = self.board.state, tuple(core.stepgen.count), core.settling
        self.board.run_until(self.board.frame + frames)
        if state in STILL and self.board.state == state and not settling and not core.motion.moving:
            moved = tuple(core.stepgen.count) != counts
            if moved and not core.settling:
                self.problems.append(f"steps in {state.name}")
        self.states.add(self.board.state)

    def _judge(self, trusted_before: int) -> None:
        core = self.core
        if core.fault in IMPOSSIBLE_FAULTS:
            self.problems.append(f"fault {FaultCode(core.fault).name} {core.fault_source} {core.fault_value}")
        gained = core.trusted & ~trusted_before
        if any(gained >> motor & 1 and motor not in self._positions_of for motor in range(8)):
            self.problems.append(f"trusts {gained:#x} by itself")
        link = self.board.link
        if len(link._events) > 2 * EVENT_CAP or len(link._unsequenced) > 16 or link.pending > 64:
            self.problems.append("the link keeps too much")
        for motor in core.layout.moved:
            lag = core.stepgen.position[motor] - (core.stepgen.count[motor] << FRACTION_BITS)
            if abs(lag) > MOST_LAG and self.board.state != BoardState.FAULT:
                self.problems.append(f"motor {motor} lags {lag / ONE_STEP:.3f} steps")

    def judge_pins(self) -> None:
        """Timing and rate of every step, from the port words alone; for a configuration that did not change."""
        if self.core.layout.config_hash != self.config.hash:
            return
        words = self.pins.words()
        for motor, wave in motor_waves(words, self.config).items():
            self.problems += [f"motor {motor}: {text}" for text in timing_violations(wave, self.config)]
            rises = wave.rises()
            if len(rises) > 1 and int(np.diff(rises).min()) < 2:
                self.problems.append(f"motor {motor}: steps in neighbouring frames")

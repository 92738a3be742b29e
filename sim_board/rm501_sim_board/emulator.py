"""One emulated controller: the firmware's model on one side of the pins, the bench on the other.

Time is real frames since power-up; whoever drives the emulator (a pacer on an event loop, a test) says up to which
frame to run. A reset of the microcontroller, or its absence for a while, happens here: the bench lives on, the pins
float to their inactive level, and the board boots with a new identity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rm501_firmware_model import Board, FastBoard
from rm501_protocol.board_config import OUTPUT_LINES, RM501_BOARD
from rm501_protocol.framing import PacketCodec
from rm501_sim_board.bench import Bench, Truth
from rm501_sim_board.plant import FrameClock
from rm501_sim_board.presets import BenchParameters
from rm501_sim_board.randomness import stream
from rm501_sim_board.recording import DEFAULT_KEEP_WORDS, Recording
from rm501_sim_board.wiring import WordArray

_BOARDS: dict[str, type[Board]] = {"fast": FastBoard, "reference": Board}

# Ports with pull-ups: every pin high while the microcontroller is in reset.
FLOATING_WORD = sum(1 << line.bit for line in OUTPUT_LINES if line.inverted)


@dataclass(frozen=True, slots=True)
class EmulatorOptions:
    """How to build an emulator: the bench, the seed, the firmware's implementation, how many port words to keep."""

    parameters: BenchParameters
    seed: int = 0
    firmware: str = "fast"
    keep_words: int = DEFAULT_KEEP_WORDS
    packets: bool = False


class _PinsSinceBoot:
    """The bench as a board sees it whose frames count from its own boot."""

    __slots__ = ("_bench", "first_frame")

    def __init__(self, bench: Bench, first_frame: int) -> None:
        self._bench = bench
        self.first_frame = first_frame

    def write_frame(self, frame: int, words: Sequence[int]) -> None:
        """Port words of one frame."""
        self._bench.write_frame(self.first_frame + frame, words)

    def write_block(self, first_frame: int, words: WordArray) -> None:
        """Port words of whole frames."""
        self._bench.write_block(self.first_frame + first_frame, words)

    def read_inputs(self, frame: int) -> int:
        """The input word at the start of `frame`."""
        return self._bench.read_inputs(self.first_frame + frame)

    def inputs_stable_until(self, frame: int) -> int:
        """First frame at which the inputs may differ from those at `frame`."""
        return self._bench.inputs_stable_until(self.first_frame + frame) - self.first_frame


class Emulator:
    """A controller board on its bench."""

    def __init__(self, options: EmulatorOptions) -> None:
        self.options = options
        self.clock = FrameClock(RM501_BOARD.timing.base_period_us, RM501_BOARD.frame_periods)
        self.bench = Bench(options.parameters, seed=options.seed, clock=self.clock, keep_words=options.keep_words)
        self.resets = 0
        self._config = RM501_BOARD
        self._boots = stream(options.seed, "boot identity")
        self._first_frame = 0  # of the bench, when the board's count was 0
        self._boot_frame = 0
        self._asked_frame = 0
        self.board = self._boot(0)

    @property
    def frame(self) -> int:
        """Real frames since power-up of the bench up to which everything has happened."""
        return self._first_frame + self.board.frame

    @property
    def recording(self) -> Recording:
        """Port words and counted steps since power-up, up to the present frame."""
        self.bench.settle(self.frame)
        return self.bench.recording

    @property
    def in_reset(self) -> bool:
        """Whether the microcontroller is off or held in reset at the frame last asked for."""
        return self._asked_frame < self._boot_frame

    def truth(self) -> Truth:
        """The world as it stands now."""
        return self.bench.truth(self.frame)

    def receive(self, data: bytes) -> None:
        """Bytes arrive at the board, at the present frame; a board in reset hears nothing."""
        if not self.in_reset:
            self.board.receive(data)
            if self.board.frame_us != self.clock.frame_us or self.board.config is not self._config:
                self._follow_configuration()

    def transmit(self) -> bytes:
        """Bytes that the board has sent since the last call."""
        return b"" if self.in_reset else self.board.transmit()

    def transmit_packets(self) -> list[bytes]:
        """The same, one item a packet, for boards built for packets."""
        return [] if self.in_reset else self.board.transmit_packets()

    def quiet_until(self) -> int:
        """First frame that may give the board something to say, unless bytes arrive or the bench is changed by hand."""
        return self.frame if self.in_reset else self._first_frame + self.board.quiet_until()

    def advance_to(self, frame: int) -> None:
        """Run the board to real `frame`; nothing happens when it is there already."""
        self._asked_frame = max(frame, self._asked_frame)
        if frame > self.frame:
            self.board.run_until(frame - self._first_frame)

    def reset_microcontroller(self, dark_frames: int = 1) -> None:
        """Brown-out: the pins float for `dark_frames`, then the board boots with a new identity and an empty memory."""
        now = self.frame
        self.resets += 1
        words = np.full(dark_frames * self.clock.periods_per_frame, FLOATING_WORD, dtype=np.uint32)
        self.bench.write_block(now, words)
        self.board = self._boot(now + dark_frames)

    def boot_with_counters(self, real_frame: int, motion_frame: int, dark_frames: int = 1) -> None:
        """Boot with frame counters (u32) that stand as if the board had run for days; at power-up, else by a reset."""
        if self.frame == 0:
            self.board = self._boot(0, real_frame, motion_frame)
        else:
            self.reset_microcontroller(dark_frames)
            self.board = self._boot(self._boot_frame, real_frame, motion_frame)

    def _follow_configuration(self) -> None:
        """A configuration was committed: with another frame length the board has recounted its frames."""
        self._config = self.board.config
        clock = FrameClock(self._config.timing.base_period_us, self._config.frame_periods)
        if clock != self.clock:
            self._first_frame = -(-self._first_frame * self.clock.frame_us // clock.frame_us)
            self._asked_frame = self._boot_frame = self._first_frame + self.board.frame
            self.clock = clock
            self.pins.first_frame = self._first_frame
            self.bench.reclock(clock, self.frame)

    def _boot(self, at_frame: int, real_frame: int = 0, motion_frame: int = 0) -> Board:
        # A new board knows nothing of an earlier one's configuration.
        default = FrameClock(RM501_BOARD.timing.base_period_us, RM501_BOARD.frame_periods)
        if self.clock != default:
            at_frame = -(-at_frame * self.clock.frame_us // default.frame_us)
            self.clock = default
            self.bench.reclock(default, at_frame)
        self._boot_frame = at_frame
        self._first_frame = at_frame - real_frame
        self.pins = _PinsSinceBoot(self.bench, self._first_frame)
        epoch = int(self._boots.integers(1, 1 << 32))
        codec = PacketCodec() if self.options.packets else None
        return _BOARDS[self.options.firmware](
            RM501_BOARD,
            self.pins,
            epoch,
            codec=codec,
            first_frame=real_frame,
            first_motion_frame=motion_frame,
        )

"""A board, its host's link and recording pins in one process, on frames as the only clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rm501_firmware_model import Board
from rm501_firmware_model.pins import inactive_inputs
from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.declaration import Message
from rm501_protocol.enums import BoardState, SegmentFlag
from rm501_protocol.host_link import HostLink
from rm501_protocol.link_events import Event, Received, StopKind
from rm501_protocol.messages import (
    MotionEnded,
    Refused,
    SetPower,
    SetStatusPeriod,
    Start,
    Status,
    StatusRequest,
)
from rm501_protocol.segment_message import MotorTerm, Segment, SegmentEvent

ONE = 1 << 24
_T = TypeVar("_T", bound=Message)


class RecordingPins:
    """Keeps every port word; inputs are set by the test, constant until it changes them or as `script` (frame ->
    word) says.
    """

    def __init__(self, config: BoardConfig = RM501_BOARD) -> None:
        self.config = config
        self.inputs = inactive_inputs(config)
        self.script: dict[int, int] = {}
        self.blocks: list[NDArray[np.uint32]] = []
        self.frames = 0
        self.recording = True
        self._pending: list[list[int]] = []

    def toggle(self, number: int) -> None:
        """Change the level of one input from the next frame on."""
        self.inputs ^= 1 << self.config.inputs.inputs[number].bit

    def toggle_at(self, frame: int, number: int) -> None:
        """Change the level of one input at a frame."""
        self.script[frame] = self.script.get(frame, 0) ^ 1 << self.config.inputs.inputs[number].bit

    def read_inputs(self, frame: int) -> int:
        for at in sorted(self.script):
            if at > frame:
                break
            self.inputs ^= self.script.pop(at)
        return self.inputs

    def inputs_stable_until(self, frame: int) -> int:
        later = [at for at in self.script if at > frame]
        return min(later) if later else frame + (1 << 40)

    def write_frame(self, frame: int, words: Sequence[int]) -> None:
        assert frame == self.frames
        self.frames += 1
        if self.recording:
            self._pending.append(list(words))

    def write_block(self, first_frame: int, words: NDArray[np.uint32]) -> None:
        assert first_frame == self.frames
        self.frames += len(words)
        if self.recording:
            self._flush()
            self.blocks.append(words)

    def _flush(self) -> None:
        if self._pending:
            self.blocks.append(np.array(self._pending, dtype=np.uint32))
            self._pending = []

    def words(self) -> NDArray[np.uint32]:
        """All words so far, shape (frames, periods)."""
        self._flush()
        return np.concatenate(self.blocks)


class Rig:
    """A board with a host at the other end of a line without delay or loss."""

    def __init__(
        self,
        config: BoardConfig = RM501_BOARD,
        *,
        board: type[Board] = Board,
        connect: bool = True,
        power: bool = True,
        configured: bool = True,
        pins: RecordingPins | None = None,
        boot_epoch: int = 77,
    ) -> None:
        self.pins = RecordingPins(config) if pins is None else pins
        self.board = board(config, self.pins, boot_epoch, configured=configured, bytes_per_second=None)
        self.host = HostLink()
        self.events: list[Event] = []
        self.messages: list[Message] = []
        self.cut = False
        self.start_frames = 0
        self.sent_bytes = bytearray()
        if connect:
            self.connect()
            self.send(SetStatusPeriod(0))
            if power and configured:
                self.send(SetPower(True))
                self.run(1)

    @property
    def core(self) -> Any:
        """The board's tick state, for oracles that need more than the pins; never written by tests."""
        return self.board._core

    @property
    def state(self) -> BoardState:
        return self.board.state

    def connect(self, nonce: int = 1234) -> None:
        self.host.connect(nonce, self.now_us)
        for _ in range(4):
            self.exchange()
        assert self.host.is_open

    @property
    def now_us(self) -> int:
        return self.board.frame * self.board.frame_us

    def exchange(self) -> None:
        """Carry everything both ends want to say, unless the line is cut."""
        for _ in range(20):
            out = self.host.data_to_send(self.now_us)
            if out and not self.cut:
                self.board.receive(out)
            back = self.board.transmit()
            self.sent_bytes += back
            if back and not self.cut:
                self.host.receive_data(back, self.now_us)
            while (event := self.host.next_event()) is not None:
                self.events.append(event)
                if isinstance(event, Received):
                    self.messages.append(event.message)
            if not out and not back:
                return

    def send(self, *messages: Message) -> None:
        for message in messages:
            self.host.send(message)
        self.exchange()

    def stop(self, kind: StopKind = StopKind.STOP) -> None:
        self.host.stop(kind, self.now_us)
        self.exchange()

    def run(self, frames: int, step: int = 64) -> None:
        """Run the board, exchanging every `step` frames."""
        end = self.board.frame + frames
        while self.board.frame < end:
            self.board.run_until(min(end, self.board.frame + step))
            self.exchange()

    def run_to(self, state: BoardState, limit: int = 100_000, step: int = 1) -> None:
        end = self.board.frame + limit
        while self.state != state:
            assert self.board.frame < end, f"still {self.state.name}, not {state.name}"
            self.run(step, step)

    def got(self, kind: type[_T]) -> list[_T]:
        """Every message of a kind so far."""
        return [message for message in self.messages if isinstance(message, kind)]

    def take(self, kind: type[_T]) -> _T:
        """The only message of a kind since the last take; forgets all messages."""
        found = self.got(kind)
        assert len(found) == 1, f"{len(found)} {kind.__name__} in {self.messages}"
        self.messages.clear()
        return found[0]

    def refusal(self, *messages: Message) -> Refused:
        """Send messages of which exactly one is refused."""
        self.messages.clear()
        self.send(*messages)
        return self.take(Refused)

    def status(self) -> Status:
        self.messages.clear()
        self.send(StatusRequest())
        return self.got(Status)[-1]

    def ended(self) -> MotionEnded:
        return self.take(MotionEnded)

    # ------------------------------------------------------------------------------------------------------- motion

    def segment(
        self,
        length: int,
        *terms: MotorTerm,
        flags: SegmentFlag = SegmentFlag.NONE,
        hold: int = 400,
        stop: int = 800,
        events: tuple[SegmentEvent, ...] = (),
        real_frame: int = 0,
    ) -> Segment:
        """A segment that starts where the last one made here ended."""
        made = Segment(self.start_frames, length, terms, flags, hold, stop, events, real_frame)
        self.start_frames = made.end_frames
        return made

    def go(self, *segments: Segment) -> None:
        """Queue segments and start."""
        self.send(*segments, Start())
        assert not self.got(Refused), self.got(Refused)


def rest_to_rest(motor: int, length: int, v_peak: int) -> list[tuple[int, int, int]]:
    """Terms (length, v, a) of a trapezoid: ramp up over `length`, cruise, ramp down, at rest at both ends; v_peak in
    2^-32 step/frame.
    """
    a = (v_peak << 8) // length
    top = (a * length) >> 8
    return [(length, 0, a), (length, top, 0), (length, top, -a)]

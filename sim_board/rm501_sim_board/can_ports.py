"""The board on a CAN bus: behind an slcan adapter on a pseudo terminal, or on any bus that python-can opens.

Packets travel as transfers of frames (`rm501_protocol.can_transfer`); faults of the bus act on frames.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rm501_protocol.can_transfer import CanFrame, TransferReceiver, TransferSender
from rm501_protocol.slcan import SlcanAdapter
from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.pacing import PacedBoard
from rm501_sim_board.randomness import stream
from rm501_sim_board.serial_ports import PtyPort

DEFAULT_NODE = 1
# How often a bus without a file descriptor is looked at.
_POLL_S = 0.001
_FRAMES_PER_POLL = 256


class CanNode:
    """A board in packet mode as one node of a bus; `send_frame` puts a frame on the bus."""

    def __init__(self, board: PacedBoard, node: int, frame_bytes: int, send_frame: Callable[[CanFrame], None]) -> None:
        if not board.packets:
            raise BenchConfigError("a board on CAN must be built for packets")
        self._board = board
        self._sender = TransferSender(node, from_board=True, frame_bytes=frame_bytes)
        self._assembler = TransferReceiver(node, from_board=False)
        self._send_frame = send_frame
        self._rng = stream(board.emulator.options.seed, "can frames")

    def receive(self, frames: Iterable[CanFrame]) -> None:
        """Frames from the bus."""
        for frame in self._disordered(list(frames)):
            packet = self._assembler.feed(frame)
            if packet is not None:
                self._board.write(packet)

    def send(self, packet: bytes) -> None:
        """A packet of the board goes onto the bus."""
        for frame in self._disordered(self._sender.frames(packet)):
            self._send_frame(frame)

    def _disordered(self, frames: list[CanFrame]) -> list[CanFrame]:
        """Swap neighbours with the probability that the fault `reorder` asks for."""
        probability = self._board.can_reorder_probability
        if probability:
            for place in range(len(frames) - 1):
                if self._rng.random() < probability:
                    frames[place], frames[place + 1] = frames[place + 1], frames[place]
        return frames


class SlcanPort(PtyPort):
    """An slcan adapter with the board behind it, on a pseudo terminal under `link`."""

    def __init__(
        self, board: PacedBoard, link: Path, loop: asyncio.AbstractEventLoop, node: int = DEFAULT_NODE
    ) -> None:
        self._adapter = SlcanAdapter()
        self._node = CanNode(board, node, 8, self._put_frame)
        super().__init__(board, link, loop)

    @property
    def description(self) -> str:
        """Where it listens, for a person."""
        return f"can:slcan:{self._link} ({self.device})"

    def _received(self, data: bytes) -> None:
        frames = self._adapter.receive(data)
        replies = self._adapter.replies()
        if replies:
            self._put(replies)
        self._node.receive(frames)

    def _send(self, data: bytes) -> None:
        self._node.send(data)

    def _put_frame(self, frame: CanFrame) -> None:
        self._put(self._adapter.transmit(frame))


class BusPort:
    """The board on a bus of python-can (`virtual` in this process, `socketcan` on a machine that has one)."""

    def __init__(
        self, board: PacedBoard, interface: str, channel: str, loop: asyncio.AbstractEventLoop, node: int = DEFAULT_NODE
    ) -> None:
        import can

        try:
            self._bus: Any = can.Bus(interface=interface, channel=channel)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise BenchConfigError(f"can:{interface}:{channel}: {error}; check that the interface exists") from error
        self._message = can.Message
        self._where = f"can:{interface}:{channel}"
        self._loop = loop
        self._node = CanNode(board, node, 8, self._put_frame)
        self._board = board
        board.attach(self._node.send)
        self._timer = loop.call_later(_POLL_S, self._poll)

    @property
    def description(self) -> str:
        """Where it listens, for a person."""
        return self._where

    async def aclose(self) -> None:
        """Leave the bus."""
        self._timer.cancel()
        self._board.detach()
        self._bus.shutdown()

    def _put_frame(self, frame: CanFrame) -> None:
        self._bus.send(self._message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

    def _poll(self) -> None:
        frames: list[CanFrame] = []
        while len(frames) < _FRAMES_PER_POLL and (message := self._bus.recv(0)) is not None:
            if not (message.is_error_frame or message.is_extended_id or message.is_remote_frame):
                frames.append(CanFrame(message.arbitration_id, bytes(message.data)))
        self._node.receive(frames)
        self._timer = self._loop.call_later(_POLL_S, self._poll)

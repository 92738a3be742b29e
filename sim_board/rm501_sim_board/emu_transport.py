"""`emu://`: an emulated board in this process, on whatever event loop runs.

    emu://                                  preset ideal, seed 0
    emu://?preset=real&seed=7               the same with dynamics
    emu://bench1?vcd=run.vcd&trace=run.npz  a named board; files are written when it closes

A named board lives on when its transport closes (a pulled plug) and is found again by its name, until
`shut_down(name)` or the end of the loop. Unnamed boards end with their transport.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

from rm501_protocol.transport import Receiver
from rm501_sim_board.emulator import Emulator, EmulatorOptions
from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.pacing import DEFAULT_BAUD, DEFAULT_TICK_S, PacedBoard
from rm501_sim_board.presets import preset
from rm501_sim_board.recording import DEFAULT_KEEP_WORDS

_KEYS = ("preset", "seed", "baud", "record", "vcd", "trace", "firmware", "tick_ms")
_running: dict[tuple[int, str], PacedBoard] = {}


@dataclass(frozen=True, slots=True)
class EmuUrl:
    """An `emu://` URL taken apart."""

    name: str
    options: EmulatorOptions
    baud: int | None
    tick_s: float
    vcd: Path | None
    trace: Path | None


def parse_url(url: str) -> EmuUrl:
    """Take an `emu://` URL apart; raises BenchConfigError naming the parameter that is wrong."""
    parts = urlsplit(url)
    if parts.scheme != "emu":
        raise BenchConfigError(f"{url!r}: not an emu:// URL")
    query: dict[str, str] = {}
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key not in _KEYS:
            raise BenchConfigError(f"{url!r}: unknown parameter {key!r}; use {', '.join(_KEYS)}")
        query[key] = value
    firmware = query.get("firmware", "fast")
    if firmware not in ("fast", "reference"):
        raise BenchConfigError(f"{url!r}: firmware is fast or reference, not {firmware!r}")
    baud = _integer(url, query, "baud", DEFAULT_BAUD, 0)
    options = EmulatorOptions(
        parameters=preset(query.get("preset", "ideal")),
        seed=_integer(url, query, "seed", 0, 0),
        firmware=firmware,
        keep_words=_integer(url, query, "record", DEFAULT_KEEP_WORDS, 0),
    )
    return EmuUrl(
        name=parts.netloc,
        options=options,
        baud=baud or None,
        tick_s=_integer(url, query, "tick_ms", round(DEFAULT_TICK_S * 1000), 1) / 1000,
        vcd=Path(query["vcd"]) if query.get("vcd") else None,
        trace=Path(query["trace"]) if query.get("trace") else None,
    )


class EmuTransport:
    """The host's end of an emulated serial line. `emulator` is the handle to everything behind it."""

    def __init__(self, url: EmuUrl, board: PacedBoard) -> None:
        self.board = board
        self._url = url
        self._receiver: Receiver | None = None
        self._early: list[bytes] = []
        self._closed = False
        board.attach(self._deliver)

    @property
    def emulator(self) -> Emulator:
        """The emulated controller and its bench."""
        return self.board.emulator

    @property
    def packets(self) -> bool:
        """A stream of bytes."""
        return False

    @property
    def bytes_per_second(self) -> int | None:
        """Line speed."""
        return self.board.bytes_per_second

    def start(self, receiver: Receiver) -> None:
        """Deliver to `receiver` from now on."""
        self._receiver = receiver
        early, self._early = self._early, []
        for data in early:
            receiver.data_received(data)

    def write(self, data: bytes) -> None:
        """Send bytes to the board."""
        if self._closed:
            raise ConnectionResetError("the emulated line is closed")
        self.board.write(data)

    def lose_connection(self, exc: Exception | None = None) -> None:
        """Pull the plug: the host is told at once, the board hears nothing more."""
        if self._closed:
            return
        self._end(exc or ConnectionResetError("the emulated line was unplugged"))

    async def aclose(self) -> None:
        """Close the line; an unnamed board ends with it and its files are written."""
        if not self._closed:
            self._end(None)

    def _end(self, exc: Exception | None) -> None:
        self._closed = True
        self.board.detach()
        if not self._url.name:
            self.board.close()
            write_files(self._url, self.board)
        if self._receiver is not None:
            self._receiver.connection_lost(exc)

    def _deliver(self, data: bytes) -> None:
        if self._closed:
            return
        if self._receiver is None:
            self._early.append(data)
        else:
            self._receiver.data_received(data)


async def open_transport(url: str) -> EmuTransport:
    """Open `emu://...`: power up a board, or find a named one again. OSError tells what is wrong with the URL."""
    try:
        parsed = parse_url(url)
    except BenchConfigError as error:
        raise OSError(str(error)) from error
    loop = asyncio.get_running_loop()
    key = (id(loop), parsed.name)
    board = _running.get(key) if parsed.name else None
    if board is None:
        board = PacedBoard(Emulator(parsed.options), loop, baud=parsed.baud, tick_s=parsed.tick_s)
        if parsed.name:
            _running[key] = board
    return EmuTransport(parsed, board)


def running_board(name: str) -> PacedBoard:
    """The named board on the running loop; KeyError when there is none."""
    return _running[id(asyncio.get_running_loop()), name]


def shut_down(name: str) -> PacedBoard:
    """Switch a named board off and forget it."""
    board = _running.pop((id(asyncio.get_running_loop()), name))
    board.close()
    return board


def write_files(url: EmuUrl, board: PacedBoard) -> None:
    """Write the VCD and the trace that the URL asks for."""
    if url.vcd is not None:
        from rm501_sim_board.vcd import write_vcd

        write_vcd(board.emulator.bench, url.vcd)
    if url.trace is not None:
        from rm501_sim_board.traces import write_trace

        write_trace(board.emulator.bench, url.trace)


def _integer(url: str, query: dict[str, str], key: str, default: int, least: int) -> int:
    text = query.get(key)
    if text is None:
        return default
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise BenchConfigError(f"{url!r}: {key}={text!r} must be a whole number, at least {least}")
    return value

"""`emu://`: an emulated board in this process, on whatever event loop runs.

    emu://                                    preset ideal, seed 0
    emu://?preset=real&seed=7                 the same with dynamics
    emu://?fault=stall:motor=elbow@2.5s       faults, any number of them
    emu://?pose=-140,95,-85,10,-60            joint angles at power-up, DH deg
    emu://bench1?vcd=run.vcd&trace=run.npz    a named board; files are written when it ends

A board ends with its transport. A named one lives on and is found again by its name until `shut_down(name)`; one whose
plug was pulled (fault `unplug`) is found again by its URL.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit
from weakref import WeakKeyDictionary

from rm501_protocol.transport import Receiver
from rm501_sim_board.bench import Truth
from rm501_sim_board.emulator import Emulator, EmulatorOptions
from rm501_sim_board.errors import BenchConfigError, SimBoardError
from rm501_sim_board.fault_injection import FaultInjector, check_fault
from rm501_sim_board.fault_spec import FaultSpec, parse_fault
from rm501_sim_board.pacing import DEFAULT_BAUD, DEFAULT_TICK_S, PacedBoard
from rm501_sim_board.presets import at_pose, preset
from rm501_sim_board.recording import DEFAULT_KEEP_WORDS
from rm501_sim_board.running import RunningBoard, RunOptions

_KEYS = ("preset", "seed", "baud", "record", "vcd", "trace", "firmware", "tick_ms", "fault", "pose")
_boards: WeakKeyDictionary[asyncio.AbstractEventLoop, dict[str, RunningBoard]] = WeakKeyDictionary()


def parse_url(url: str) -> tuple[str, RunOptions]:
    """Name (may be empty) and options of an `emu://` URL; BenchConfigError names the parameter that is wrong."""
    parts = urlsplit(url)
    if parts.scheme != "emu":
        raise BenchConfigError(f"{url!r}: not an emu:// URL")
    query: dict[str, str] = {}
    faults: list[FaultSpec] = []
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key not in _KEYS:
            raise BenchConfigError(f"{url!r}: unknown parameter {key!r}; use {', '.join(_KEYS)}")
        if key == "fault":
            faults.append(parse_fault(value))
            check_fault(faults[-1])
        else:
            query[key] = value
    firmware = query.get("firmware", "fast")
    if firmware not in ("fast", "reference"):
        raise BenchConfigError(f"{url!r}: firmware is fast or reference, not {firmware!r}")
    emulator = EmulatorOptions(
        parameters=at_pose(preset(query.get("preset", "ideal")), query.get("pose")),
        seed=_integer(url, query, "seed", 0, 0),
        firmware=firmware,
        keep_words=_integer(url, query, "record", DEFAULT_KEEP_WORDS, 0),
    )
    options = RunOptions(
        emulator=emulator,
        baud=_integer(url, query, "baud", DEFAULT_BAUD, 0) or None,
        tick_s=_integer(url, query, "tick_ms", round(DEFAULT_TICK_S * 1000), 1) / 1000,
        faults=tuple(faults),
        vcd=Path(query["vcd"]) if query.get("vcd") else None,
        trace=Path(query["trace"]) if query.get("trace") else None,
    )
    return parts.netloc, options


class EmuTransport:
    """The host's end of an emulated serial line. `emulator` and `faults` are the handles to what is behind it."""

    def __init__(self, running: RunningBoard, key: str, lasting: bool) -> None:
        self.running = running
        self._key = key
        self._lasting = lasting
        self._receiver: Receiver | None = None
        self._early: list[bytes] = []
        self._closed = False
        running.board.attach(self._deliver, self._plug)

    @property
    def emulator(self) -> Emulator:
        """The emulated controller and its bench."""
        return self.running.emulator

    @property
    def board(self) -> PacedBoard:
        """The board as it runs on the loop, with its line."""
        return self.running.board

    @property
    def faults(self) -> FaultInjector:
        """Makes faults happen."""
        return self.running.faults

    def truth(self) -> Truth:
        """How things really stand at this moment of the loop's time."""
        return self.running.truth()

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
        """Send bytes to the board; ConnectionError after the end."""
        if self._closed:
            raise ConnectionResetError("the emulated line is closed; open the port again")
        self.board.write(data)

    async def aclose(self) -> None:
        """Close the line; a board without a name ends with it and its files are written."""
        if self._closed:
            return
        self._closed = True
        self.board.detach()
        if not self._lasting:
            _boards_here().pop(self._key, None)
            self.running.close()
        if self._receiver is not None:
            self._receiver.connection_lost(None)

    def _plug(self, plugged: bool) -> None:
        if plugged or self._closed:
            return
        # The board runs on without its cable; the same URL finds it again.
        self._closed = True
        if self._receiver is not None:
            self._receiver.connection_lost(ConnectionResetError("the emulated line was unplugged"))

    def _deliver(self, data: bytes) -> None:
        if self._closed:
            return
        if self._receiver is None:
            self._early.append(data)
        else:
            self._receiver.data_received(data)


async def open_transport(url: str) -> EmuTransport:
    """Open `emu://...`: power up a board, or find one again. OSError tells what is wrong, and what to do."""
    try:
        name, options = parse_url(url)
    except SimBoardError as error:
        raise OSError(str(error)) from error
    boards = _boards_here()
    key = name or url
    running = boards.get(key)
    if running is not None and (name or not running.board.plugged or not running.board.attached):
        if not running.board.plugged:
            raise OSError(f"{url}: the emulated line is unplugged; put the plug back")
    else:
        try:
            running = RunningBoard.power_up(options, asyncio.get_running_loop())
        except SimBoardError as error:
            raise OSError(f"{url}: {error}") from error
        boards[key] = running
    return EmuTransport(running, key, bool(name))


def running_board(name: str) -> RunningBoard:
    """The board of that name (or URL) on the running loop; KeyError when there is none."""
    return _boards_here()[name]


def shut_down(name: str) -> RunningBoard:
    """Switch a named board off, write its files and forget it."""
    running = _boards_here().pop(name)
    running.close()
    return running


def _boards_here() -> dict[str, RunningBoard]:
    return _boards.setdefault(asyncio.get_running_loop(), {})


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

"""The control socket: one JSON object a line in, one out. For people with `nc`, scripts and tests of other processes.

    {"do": "truth"}                                   where everything really is
    {"do": "status"}                                  frames, time, faults, bytes
    {"do": "press", "button": "hold"}                 also estop, cycle-start; "release" lets go
    {"do": "input", "line": "SWITCH_ROLL", "active": true}     force an input; null lets it go
    {"do": "fault", "spec": "stall:motor=elbow/0.5s"} any fault, from now; "clear" with "name" ends it
    {"do": "object", "width_mm": 30, "mass_kg": 0.4}  something between the fingers; 0 mm takes it away
    {"do": "hashes"}                                  fingerprints of pins, step sequence and true motion
    {"do": "vcd", "file": "run.vcd"}                  write what has been recorded; "trace" likewise, as npz

Answers carry "ok"; when it is false, "error" says why and nothing was done.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from rm501_protocol.board_config import InputId
from rm501_sim_board.errors import BenchConfigError, SimBoardError
from rm501_sim_board.running import RunningBoard

_LINE_CAP_BYTES = 65536

Answer = dict[str, object]


class ControlRequestError(SimBoardError):
    """A request on the control socket that cannot be done."""


class ControlCommands:
    """Does what control requests ask of one running board."""

    def __init__(self, running: RunningBoard) -> None:
        self._running = running
        self._commands: dict[str, Callable[[Answer], Answer]] = {
            "truth": self._truth,
            "status": self._status,
            "press": self._press,
            "release": self._release,
            "input": self._input,
            "fault": self._fault,
            "clear": self._clear,
            "object": self._object,
            "hashes": self._hashes,
            "vcd": self._vcd,
            "trace": self._trace,
        }

    def answer(self, line: bytes) -> bytes:
        """One request line to one answer line."""
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise ControlRequestError("a request is a JSON object")
            command = self._commands.get(str(request.get("do")))
            if command is None:
                raise ControlRequestError(f"do is one of {', '.join(self._commands)}")
            self._running.board.run_to_now()
            answer: Answer = {"ok": True, **command(request)}
        except (SimBoardError, ValueError, OSError) as error:
            answer = {"ok": False, "error": str(error)}
        return json.dumps(answer).encode() + b"\n"

    def _truth(self, request: Answer) -> Answer:
        return asdict(self._running.emulator.truth())

    def _status(self, request: Answer) -> Answer:
        board, emulator = self._running.board, self._running.emulator
        return {
            "frame": emulator.frame,
            "seconds": emulator.frame * emulator.clock.frame_us / 1e6,
            "state": emulator.board.state.name,
            "preset": emulator.options.parameters.name,
            "seed": emulator.options.seed,
            "resets": emulator.resets,
            "plugged": board.plugged,
            "bytes_to_board": board.to_board.bytes_sent,
            "bytes_to_host": board.to_host.bytes_sent,
            "faults": list(self._running.faults.active),
        }

    def _press(self, request: Answer) -> Answer:
        self._running.emulator.bench.press(_button(request))
        return {}

    def _release(self, request: Answer) -> Answer:
        self._running.emulator.bench.release(_button(request))
        return {}

    def _input(self, request: Answer) -> Answer:
        active = request.get("active")
        if active is not None and not isinstance(active, bool):
            raise ControlRequestError("active is true, false or null")
        self._running.emulator.bench.force_input(_line(str(request.get("line"))), active)
        return {}

    def _fault(self, request: Answer) -> Answer:
        self._running.faults.inject(str(request.get("spec")))
        return {"faults": list(self._running.faults.active)}

    def _clear(self, request: Answer) -> Answer:
        return {"cleared": self._running.faults.clear(str(request.get("name")))}

    def _object(self, request: Answer) -> Answer:
        hand = self._running.emulator.bench.hand
        hand.offer_object(_number(request, "width_mm"), _number(request, "mass_kg", 0.0))
        return {"opening_mm": hand.opening_mm, "gripping": hand.gripping}

    def _hashes(self, request: Answer) -> Answer:
        from rm501_sim_board.traces import truth_trace

        emulator = self._running.emulator
        emulator.truth()
        return {
            "pins": emulator.recording.pin_hash,
            "steps": emulator.recording.step_sequence_hash(),
            "truth": truth_trace(emulator.bench).fingerprint(),
        }

    def _vcd(self, request: Answer) -> Answer:
        from rm501_sim_board.vcd import write_vcd

        self._running.emulator.truth()
        return {"frames": write_vcd(self._running.emulator.bench, _file(request))}

    def _trace(self, request: Answer) -> Answer:
        from rm501_sim_board.traces import write_trace

        self._running.emulator.truth()
        return {"samples": write_trace(self._running.emulator.bench, _file(request))}


class ControlSocket:
    """Listens on a unix socket path or a HOST:PORT and answers requests; any number of clients."""

    def __init__(self, commands: ControlCommands) -> None:
        self._commands = commands
        self._server: asyncio.Server | None = None
        self._path: Path | None = None
        self.description = ""

    @classmethod
    async def listen(cls, commands: ControlCommands, where: str, loop: asyncio.AbstractEventLoop) -> ControlSocket:
        """Open the socket; `where` is HOST:PORT, or a path on systems with unix sockets."""
        self = cls(commands)
        host, separator, port = where.rpartition(":")
        try:
            if separator and port.isdigit():
                self._server = await loop.create_server(lambda: _Client(commands), host or "127.0.0.1", int(port))
                name = self._server.sockets[0].getsockname()
                self.description = f"{name[0]}:{name[1]}"
            elif sys.platform == "win32":
                raise BenchConfigError("unix sockets do not exist on Windows; use --control HOST:PORT")
            else:
                self._path = Path(where)
                if self._path.is_socket():
                    self._path.unlink()
                self._server = await loop.create_unix_server(lambda: _Client(commands), where)
                self.description = where
        except OSError as error:
            raise BenchConfigError(f"cannot open the control socket {where}: {error.strerror or error}") from error
        return self

    async def aclose(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)


class _Client(asyncio.Protocol):
    def __init__(self, commands: ControlCommands) -> None:
        self._commands = commands
        self._buffer = bytearray()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            if line.strip() and self._transport is not None:
                self._transport.write(self._commands.answer(line))
        if len(self._buffer) > _LINE_CAP_BYTES and self._transport is not None:
            self._transport.write(b'{"ok": false, "error": "a line of more than 64 KiB"}\n')
            self._transport.close()


def _line(name: str) -> InputId:
    try:
        return InputId[name.upper().replace("-", "_").replace(" ", "_")]
    except KeyError:
        raise ControlRequestError(f"{name!r} is no input; use one of {', '.join(i.name for i in InputId)}") from None


def _button(request: Answer) -> InputId:
    return _line(str(request.get("button")))


def _number(request: Answer, key: str, default: float | None = None) -> float:
    value = request.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ControlRequestError(f"{key} must be a number")
    return float(value)


def _file(request: Answer) -> Path:
    name = request.get("file")
    if not isinstance(name, str) or not name:
        raise ControlRequestError("file must name a file")
    return Path(name)

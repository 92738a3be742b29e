"""Lines of a program by number, from text or from a file of any size, in bounded memory.

A file is read in chunks; only the byte offset of every chunk and a few decoded chunks are kept, so a loop can jump back
and a file of 1 GB still streams. Decoding keeps every byte (UTF-8 with surrogate escapes)
but a byte order mark at the start.
"""

from __future__ import annotations

import codecs
from bisect import bisect_right
from collections import OrderedDict
from pathlib import Path
from typing import BinaryIO, Protocol

from rm501_host.gcode.errors import GcodeFileError, GcodeLimitError

CHUNK_BYTES = 1 << 16
"""Read size: 64 KiB holds a usual loop and is read within 1 ms."""
KEPT_CHUNKS = 8
MAX_LINE_BYTES = 1 << 16
"""No line of a program is longer: what looks like one is not a text file."""


class ProgramLines(Protocol):
    """What the interpreter reads: a name and lines by index from 0."""

    name: str

    def block(self, index: int) -> tuple[int, list[str]]:
        """The lines around `index`: (index of the first, lines); an empty list behind the end."""


class TextLines:
    """A program held in memory."""

    def __init__(self, text: str, name: str = "<text>") -> None:
        self.name = name
        lines = text.removeprefix("\ufeff").split("\n")
        if lines and lines[-1] == "":
            lines.pop()
        self._lines = [line[:-1] if line.endswith("\r") else line for line in lines]

    def block(self, index: int) -> tuple[int, list[str]]:
        """All lines, or none behind the end."""
        return (0, self._lines) if index < len(self._lines) else (index, [])


class FileLines:
    """A program in a seekable binary file; `close` when done."""

    def __init__(self, stream: BinaryIO, name: str) -> None:
        self.name = name
        self._stream = stream
        self._starts = [0]
        self._offsets = [0]
        self._chunks: OrderedDict[int, list[str]] = OrderedDict()
        self._complete = False

    @classmethod
    def open(cls, path: Path, name: str | None = None) -> FileLines:
        """Open a file. Raises GcodeFileError (the operating system's reason as its cause)."""
        try:
            return cls(path.open("rb"), name or str(path))
        except OSError as error:
            reason = error.strerror or str(error)
            raise GcodeFileError(f"cannot read {path}: {reason}", "Check the name and the permissions.") from error

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def block(self, index: int) -> tuple[int, list[str]]:
        """The chunk that holds line `index`. Raises GcodeFileError when reading fails."""
        while True:
            number = bisect_right(self._starts, index) - 1
            lines = self._chunk(number)
            if index < self._starts[number] + len(lines):
                return self._starts[number], lines
            if number == len(self._starts) - 1:
                return index, []

    def _chunk(self, number: int) -> list[str]:
        cached = self._chunks.get(number)
        if cached is not None:
            self._chunks.move_to_end(number)
            return cached
        try:
            self._stream.seek(self._offsets[number])
            data = self._stream.read(CHUNK_BYTES)
            at_end = len(data) < CHUNK_BYTES
            if not at_end:
                cut = data.rfind(b"\n") + 1
                if cut == 0:
                    raise GcodeLimitError(
                        f"a line is longer than {MAX_LINE_BYTES} bytes", "This does not look like a program."
                    )
                data = data[:cut]
        except OSError as error:
            reason = error.strerror or str(error)
            raise GcodeFileError(f"cannot read {self.name}: {reason}", "Check the medium.") from error
        taken = len(data)
        if number == 0:
            data = self._without_mark(data)
        parts = data.split(b"\n")
        if parts and parts[-1] == b"":
            parts.pop()
        lines = [p.rstrip(b"\r").decode("utf-8", "surrogateescape") for p in parts]
        if number == len(self._starts) - 1 and not at_end:
            self._starts.append(self._starts[number] + len(lines))
            self._offsets.append(self._offsets[number] + taken)
        self._chunks[number] = lines
        while len(self._chunks) > KEPT_CHUNKS:
            self._chunks.popitem(last=False)
        return lines

    def _without_mark(self, data: bytes) -> bytes:
        """The start of a file without the byte order mark that some editors put before UTF-8."""
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise GcodeFileError(f"{self.name} is UTF-16 text", "Save it as UTF-8, or as plain ASCII.")
        return data.removeprefix(codecs.BOM_UTF8)

"""The structured log: one JSON object a line, rotated by size, with a ring in memory beside it.

The disk may be full or gone; motion must not notice. A failed write is counted, the record stays in the ring, and
the file is tried again after `retry_s`. When it works again, what was missed is written first as far as the ring has
it, and a gap says how many records are lost. A line is written whole or not at all.
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import msgspec

_LOGGER = logging.getLogger(__name__)

RING_RECORDS = 2000
"""Records kept in memory: more than a minute of the busiest log seen, about 1 MB."""


@dataclass(frozen=True, slots=True)
class LogRecord:
    """One event: when (seconds of the event loop and UTC text), what kind, and its data."""

    time_s: float
    utc: str
    kind: str
    data: dict[str, object] = field(default_factory=dict)

    def encode(self) -> bytes:
        """The record as one line of JSON."""
        record = {"time_s": round(self.time_s, 6), "utc": self.utc, "kind": self.kind, **self.data}
        return msgspec.json.encode(record, enc_hook=str) + b"\n"


class JsonLog:
    """A rotating log file with a memory ring.

    `clock_s` is the event loop's time, `utc` gives the present instant as text; both are passed in. With `path` None
    the ring is all there is.
    """

    def __init__(
        self,
        path: Path | None,
        clock_s: Callable[[], float],
        utc: Callable[[], str],
        *,
        max_bytes: int = 5_000_000,
        files: int = 4,
        retry_s: float = 10.0,
        opener: Callable[[Path], BinaryIO] | None = None,
    ) -> None:
        self.path = path
        self.ring: deque[LogRecord] = deque(maxlen=RING_RECORDS)
        self.unwritten = 0
        self._clock_s = clock_s
        self._utc = utc
        self._max_bytes = max_bytes
        self._files = files
        self._retry_s = retry_s
        self._retry_at_s = 0.0
        self._open: Callable[[Path], BinaryIO] = opener or _open_append
        self._file: BinaryIO | None = None
        self._size = 0
        self.last_error: str | None = None

    def write(self, kind: str, **data: object) -> LogRecord:
        """Add a record; never raises because of the disk."""
        record = LogRecord(self._clock_s(), self._utc(), kind, data)
        self.ring.append(record)
        if self.path is None:
            return record
        if self.last_error is not None and record.time_s < self._retry_at_s:
            self.unwritten += 1
            return record
        try:
            self._append(record)
        except OSError as error:
            self._failed(error)
        return record

    def close(self) -> None:
        """Close the file; writing opens it again."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _append(self, record: LogRecord) -> None:
        assert self.path is not None
        line = record.encode()
        if self._file is not None and self._size + len(line) > self._max_bytes:
            self._rotate()
        if self._file is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            torn = _ends_in_a_line(self.path)
            self._file = self._open(self.path)
            self._size = self._file.seek(0, os.SEEK_END)
            if torn:
                line = b"\n" + line
        if self.unwritten:
            line = self._late(record) + line
        written = 0
        while written < len(line):
            written += self._file.write(line[written:])
        self._file.flush()
        self._size += len(line)
        self.unwritten = 0
        self.last_error = None

    def _late(self, record: LogRecord) -> bytes:
        """What could not be written so far, as far as the ring still has it; the rest as a gap with its size."""
        kept = list(self.ring)[:-1][-self.unwritten :]
        notes = [LogRecord(record.time_s, record.utc, "log_late", {"records": len(kept)})]
        if self.unwritten > len(kept):
            notes.append(
                LogRecord(record.time_s, record.utc, "log_gap", {"records_missing": self.unwritten - len(kept)})
            )
        return b"".join(entry.encode() for entry in (*notes, *kept))

    def _rotate(self) -> None:
        assert self.path is not None
        self.close()
        for number in range(self._files - 1, 0, -1):
            older = self.path.with_name(f"{self.path.name}.{number}")
            newer = self.path if number == 1 else self.path.with_name(f"{self.path.name}.{number - 1}")
            if newer.exists():
                newer.replace(older)

    def _failed(self, error: OSError) -> None:
        reason = error.strerror or str(error)
        if self.last_error is None:
            _LOGGER.warning("log %s cannot be written (%s); records stay in memory", self.path, reason)
        self.last_error = reason
        self.unwritten += 1
        self._retry_at_s = self._clock_s() + self._retry_s
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.truncate(self._size)  # a part of a line may have found room
        with contextlib.suppress(OSError):
            self.close()
        self._file = None


def _open_append(path: Path) -> BinaryIO:
    return path.open("ab", buffering=0)


def _ends_in_a_line(path: Path) -> bool:
    """Whether the file ends in the middle of a line: its writer was killed."""
    try:
        with path.open("rb") as file:
            if file.seek(0, os.SEEK_END) == 0:
                return False
            file.seek(-1, os.SEEK_END)
            return file.read(1) != b"\n"
    except FileNotFoundError:
        return False

"""A ring of the last 60 s of wire bytes, status and log, written out as one file when something goes wrong.

Memory is bounded by time and by bytes: at 250000 baud both ways 60 s are 3 MB, so the cap never bites on the serial
line. A dump is JSON lines, gzip-compressed, named after the loop's time and the reason; only the newest `keep` stay.
"""

from __future__ import annotations

import gzip
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from rm501_host.storage.atomic import StorageError, write_atomic

Kind = Literal["sent", "received", "status", "log"]
_ENTRY_OVERHEAD_BYTES = 120
"""What an entry costs in memory beside its payload, measured with tracemalloc and rounded up."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that happened: wire bytes as they passed, or the JSON of a status or log record."""

    time_s: float
    kind: Kind
    payload: bytes


class BlackBox:
    """The ring. `clock_s` is the event loop's time."""

    def __init__(
        self,
        folder: Path | None,
        clock_s: Callable[[], float],
        *,
        span_s: float = 60.0,
        max_bytes: int = 8_000_000,
        keep: int = 10,
    ) -> None:
        self.folder = folder
        self.warning: str | None = None
        self._clock_s = clock_s
        self._span_s = span_s
        self._max_bytes = max_bytes
        self._keep = keep
        self._entries: deque[Entry] = deque()
        self._bytes = 0

    @property
    def size_bytes(self) -> int:
        """Memory held, about."""
        return self._bytes

    def entries(self) -> tuple[Entry, ...]:
        """What the ring holds now, oldest first."""
        self._drop_old()
        return tuple(self._entries)

    def add(self, kind: Kind, payload: bytes) -> None:
        """Remember `payload`; forgets what is older than the span."""
        self._entries.append(Entry(self._clock_s(), kind, payload))
        self._bytes += len(payload) + _ENTRY_OVERHEAD_BYTES
        self._drop_old()

    def dump(self, reason: str) -> Path | None:
        """Write the ring to a file and return its path; None without a folder or when the disk refuses (`warning`)."""
        if self.folder is None:
            return None
        word = re.sub(r"[^a-z0-9]+", "-", reason.lower()).strip("-")[:40] or "fault"
        path = self.folder / f"blackbox-{self._next_number():06d}-{word}.jsonl.gz"
        lines = [msgspec.json.encode({"reason": reason, "time_s": self._clock_s(), "span_s": self._span_s})]
        for entry in self.entries():
            payload = entry.payload.hex() if entry.kind in ("sent", "received") else msgspec.Raw(entry.payload)
            lines.append(
                msgspec.json.encode({"time_s": round(entry.time_s, 6), "kind": entry.kind, "payload": payload})
            )
        try:
            write_atomic(path, gzip.compress(b"\n".join(lines) + b"\n", compresslevel=1, mtime=0))
            self._prune()
        except (StorageError, OSError) as error:
            self.warning = str(error)
            return None
        self.warning = None
        return path

    def _drop_old(self) -> None:
        oldest_s = self._clock_s() - self._span_s
        while self._entries and (self._entries[0].time_s < oldest_s or self._bytes > self._max_bytes):
            gone = self._entries.popleft()
            self._bytes -= len(gone.payload) + _ENTRY_OVERHEAD_BYTES

    def _dumps(self) -> list[Path]:
        assert self.folder is not None
        return sorted(self.folder.glob("blackbox-*.jsonl.gz"))

    def _next_number(self) -> int:
        """One more than the newest dump: the order survives restarts without a wall clock."""
        numbers = [int(match.group(1)) for path in self._dumps() if (match := re.match(r"blackbox-(\d+)-", path.name))]
        return max(numbers, default=0) + 1

    def _prune(self) -> None:
        for path in self._dumps()[: -self._keep]:
            path.unlink()


def read_dump(path: Path) -> list[dict[str, object]]:
    """The lines of a dump as objects: a header, then the entries, oldest first."""
    return [
        msgspec.json.decode(line, type=dict[str, object]) for line in gzip.decompress(path.read_bytes()).splitlines()
    ]

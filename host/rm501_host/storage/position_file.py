"""The position file: what the last process knew about the arm, marked dirty while anything moves.

A clean file says where the arm stood when it came to rest, on which boot of the board, under which configuration. It
never makes a joint homed by itself: the board's own trust and its boot id decide; no readable file, another boot or
another configuration means that nothing is trusted, and stays so in the files that follow (`vetoed`) until it homes.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from rm501_host.storage.atomic import StorageError, write_atomic


class PositionRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The file's content. `dirty`: motion was under way when it was written; positions are then where it began.

    `vetoed`: joints (0 to 4) that the board may trust and the host does not until they have homed. `leads_deg`: how
    much of the positions is play taken up, at the seven places of play (`planner.limits`).
    """

    version: int = 1
    dirty: bool
    boot_id: int
    config_hash: int
    positions_steps: tuple[int, ...]
    homed: tuple[bool, ...]
    hand: str
    utc: str
    vetoed: tuple[int, ...] = ()
    leads_deg: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class PositionFile:
    """Reads and writes the position file; writes only what has changed."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.warning: str | None = None
        self._last: bytes | None = None

    def read(self) -> PositionRecord | None:
        """The record, or None when there is none or it cannot be understood (`warning` then says why)."""
        self.warning = None
        if self.path is None:
            return None
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            self.warning = f"{self.path}: cannot be read: {error.strerror}; nothing in it is trusted"
            return None
        try:
            return msgspec.json.decode(data, type=PositionRecord)
        except msgspec.DecodeError as error:
            self.warning = f"{self.path}: is damaged ({error}); nothing in it is trusted"
            return None

    def write(self, record: PositionRecord) -> bool:
        """Write the record; False when the disk refuses, with `warning` saying why. Motion never waits for it."""
        if self.path is None:
            return True
        data = msgspec.json.encode(record) + b"\n"
        if data == self._last:
            return True
        try:
            write_atomic(self.path, data)
        except StorageError as error:
            self.warning = str(error)
            return False
        self.warning = None
        self._last = data
        return True

"""The folder that programs live in: names that stay inside it, uploads that are whole or nothing.

ProgramNameError(RefusedError)      a name that could lead elsewhere, or no such program
"""

from __future__ import annotations

import re
from pathlib import Path

from rm501_host.errors import RefusedError
from rm501_host.storage import write_atomic

MAX_PROGRAM_BYTES = 50_000_000
"""An upload is gathered in memory before it is written; larger files are put into the folder by hand."""
_NAME = re.compile(r"^[A-Za-z0-9_][A-Za-z0-9_. -]{0,98}\.(?:ngc|nc|gcode|tap)$")
_LISTED = 1000


class ProgramNameError(RefusedError):
    """There is no such program, or its name is none."""


class ProgramFiles:
    """Programs by name in one folder (no subfolders)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._uploads: dict[tuple[int, str], bytearray] = {}

    def path(self, name: str) -> Path:
        """The file of a program; raises ProgramNameError unless it is a file of the folder itself."""
        path = self._inside(name)
        if not path.is_file():
            known = ", ".join(self.names()[:10]) or "none"
            raise ProgramNameError(f"there is no program {name!r}; upload it first; known: {known}")
        if path.resolve().parent != self.folder.resolve():
            raise ProgramNameError(f"{name!r} leads out of the program folder; copy the file into it")
        return path

    def names(self) -> list[str]:
        """Names of all programs, sorted."""
        try:
            found = sorted(path.name for path in self.folder.iterdir() if _NAME.match(path.name) and path.is_file())
        except OSError:
            return []
        return found[:_LISTED]

    def upload(self, client: int, name: str, offset: int, text: str, *, last: bool) -> int:
        """Take a piece of a program; with `last` the file appears, whole. Returns the bytes taken so far."""
        path = self._inside(name)
        key = (client, name)
        data = self._uploads.setdefault(key, bytearray()) if offset else bytearray()
        self._uploads[key] = data
        if offset != len(data):
            self._uploads.pop(key, None)
            raise RefusedError(f"{name}: piece at {offset}, but {len(data)} bytes came before; start again at 0")
        data += text.encode("utf-8", "surrogateescape")
        total = len(data)
        if sum(map(len, self._uploads.values())) > MAX_PROGRAM_BYTES:
            self._uploads.pop(key, None)
            raise RefusedError(f"{name}: larger than {MAX_PROGRAM_BYTES} bytes; copy it into {self.folder} by hand")
        if last:
            del self._uploads[key]
            write_atomic(path, bytes(data))
        return total

    def forget(self, client: int) -> None:
        """A client is gone: drop what it had begun to upload."""
        for key in [key for key in self._uploads if key[0] == client]:
            del self._uploads[key]

    def _inside(self, name: str) -> Path:
        if not _NAME.match(name) or ".." in name:
            raise ProgramNameError(
                f"{name[:80]!r} is no program name; use letters, digits, _ - . and space, ending in .ngc"
            )
        return self.folder / name

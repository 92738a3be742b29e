"""(LOGOPEN, name), (LOGAPPEND, name), (LOG, text), (LOGCLOSE), (PRINT, text): files in one folder, never outside it.

A program is read far ahead of the motion, so its log comments travel with its moves (`LogNote`) and are carried out
when their turn comes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, TextIO

from rm501_host.gcode import canon as c
from rm501_host.gcode.errors import GcodeFileError
from rm501_host.moves import Source


@dataclass(frozen=True, slots=True)
class LogNote:
    """A log comment on its way with the moves."""

    call: c.CanonCall
    source: Source


class ProgramLog:
    """Takes the calls that `ResolveOptions.on_log` gets; `print_line` takes the texts of (PRINT, ...). Close it."""

    def __init__(self, folder: Path, print_line: Callable[[str], None]) -> None:
        self._folder = folder
        self._print_line = print_line
        self._file: TextIO | None = None

    def __call__(self, call: c.CanonCall) -> None:
        """Carry out one call. Raises GcodeFileError, with the block's place."""
        try:
            self._take(call)
        except OSError as error:
            self._fail(call, f"cannot write the log: {error.strerror or error}", "Check the folder for logs.", error)

    def _take(self, call: c.CanonCall) -> None:
        if isinstance(call, c.PrintText):
            self._print_line(call.text)
        elif isinstance(call, c.LogCall) and call.action is c.LogAction.TEXT:
            if self._file is not None:  # as the peer: without an open log the text is dropped
                self._file.write(call.text.strip() + "\n")
                self._file.flush()
        elif isinstance(call, c.LogCall):
            self.close()
            name = call.text.strip()
            if not name or Path(name).name != name or name in (".", ".."):
                self._fail(call, f"{name!r} is not a plain file name", f"Logs are written into {self._folder}.", None)
            path = self._folder / name
            if call.action is c.LogAction.OPEN:
                self._file = path.open("w", encoding="utf-8", errors="replace")
            else:
                self._file = path.open("a", encoding="utf-8", errors="replace")
        elif isinstance(call, c.SignalCall):
            self.close()

    def _fail(self, call: c.CanonCall, message: str, remedy: str, cause: OSError | None) -> NoReturn:
        problem = GcodeFileError(message, remedy)
        problem.location = call.at
        raise problem from cause

    def close(self) -> None:
        """Close the open log, if any."""
        if self._file is not None:
            self._file.close()
            self._file = None

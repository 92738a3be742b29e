"""(LOGOPEN, name), (LOGAPPEND, name), (LOG, text), (LOGCLOSE), (PRINT, text): files in one folder, never outside it.

A program is read far ahead of the motion, so its log comments travel with its moves (`LogNote`) and are carried out
when their turn comes. Their names are looked at when they are read: `run` keeps logs beside the program, so a name has
to look like a log's (`LOG_SUFFIXES`), or a slip of the pen would replace a program or a table that lies there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from rm501_host.gcode import canon as c
from rm501_host.gcode.errors import GcodeFileError
from rm501_host.moves import Source

LOG_SUFFIXES = (".txt", ".log", ".csv", ".tsv", ".dat")
"""What the name of a log may end in; unlike the peer, which takes any name."""


@dataclass(frozen=True, slots=True)
class LogNote:
    """A log comment on its way with the moves."""

    call: c.CanonCall
    source: Source


def require_log_name(call: c.CanonCall) -> None:
    """Look at the name in a (LOGOPEN, ...) or (LOGAPPEND, ...); other calls pass.

    Raises GcodeFileError, with the block's place, unless it is a plain file name that ends in one of `LOG_SUFFIXES`.
    """
    if not isinstance(call, c.LogCall) or call.action not in (c.LogAction.OPEN, c.LogAction.APPEND):
        return
    name = call.text.strip()
    if not name or Path(name).name != name or name in (".", ".."):
        raise _problem(
            call, f"{name!r} is not a plain file name", "Logs are written into one folder: leave folders out."
        )
    if Path(name).suffix.lower() not in LOG_SUFFIXES:
        raise _problem(
            call,
            f"{name!r} is not the name of a log: it could replace a program or a table",
            f"End it in {', '.join(LOG_SUFFIXES[:-1])} or {LOG_SUFFIXES[-1]}.",
        )


def _problem(call: c.CanonCall, message: str, remedy: str) -> GcodeFileError:
    problem = GcodeFileError(message, remedy)
    problem.location = call.at
    return problem


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
            raise _problem(
                call, f"cannot write the log: {error.strerror or error}", "Check the folder for logs."
            ) from error

    def _take(self, call: c.CanonCall) -> None:
        if isinstance(call, c.PrintText):
            self._print_line(call.text)
        elif isinstance(call, c.LogCall) and call.action is c.LogAction.TEXT:
            if self._file is not None:  # as the peer: without an open log the text is dropped
                self._file.write(call.text.strip() + "\n")
                self._file.flush()
        elif isinstance(call, c.LogCall):
            self.close()
            require_log_name(call)
            path = self._folder / call.text.strip()
            if path.is_symlink() or (path.exists() and not path.is_file()):
                raise _problem(call, f"{path.name!r} is a link or a device", "Choose another name.")
            if call.action is c.LogAction.OPEN:
                self._file = path.open("w", encoding="utf-8", errors="replace")
            else:
                self._file = path.open("a", encoding="utf-8", errors="replace")
        elif isinstance(call, c.SignalCall):
            self.close()

    def close(self) -> None:
        """Close the open log, if any."""
        if self._file is not None:
            self._file.close()
            self._file = None

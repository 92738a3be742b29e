"""Exit codes of `rm501-host`: a contract that scripts rely on."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """What the process returns."""

    OK = 0
    USAGE = 2
    CONFIG = 3
    NO_BOARD = 4
    REFUSED = 5
    STOPPED = 6
    INTERRUPTED = 130

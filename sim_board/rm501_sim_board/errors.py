"""What can be wrong with a request to the emulator.

SimBoardError
├── BenchConfigError   a parameter, preset, wiring or URL that makes no sense
├── FaultSpecError     a fault that cannot be parsed or does not exist
└── RecordingError     something asked of a recording that was not kept
"""

from __future__ import annotations


class SimBoardError(Exception):
    """Root of the emulator's own errors: local misuse, never a fault of the emulated machine."""


class BenchConfigError(SimBoardError):
    """A parameter, preset, wiring or URL that makes no sense; the text names the place and the remedy."""


class FaultSpecError(SimBoardError):
    """A fault specification that cannot be understood."""


class RecordingError(SimBoardError):
    """A trace or a pin record was asked for that was not kept."""

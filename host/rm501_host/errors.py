"""The root of all errors of the host; each part draws its own branch in its module.

Rm501Error
├── ConfigError      config.loader: exit code 3
├── NoBoardError     session: the port cannot be opened, or nobody answers there: exit code 4
├── StoppedError     session: a stop, a fault, a lost link ended the motion: exit code 6
└── all others       refused before anything moved: exit code 5
    ├── GcodeError       gcode
    ├── PlanError        planner: unreachable, out of limits, singular
    └── RefusedError     session: the board refused, not homed, configuration differs
        └── ProgramRefusedError  a program that runs came to what may not be played: the arm stands at rest before it
"""


class Rm501Error(Exception):
    """Anything that the host refuses or reports; its text names the place and the remedy."""


class NoBoardError(Rm501Error):
    """There is no board to talk to at the port."""


class StoppedError(Rm501Error):
    """Motion ended before its time; the text says why, what is still trusted and what to do."""


class RefusedError(Rm501Error):
    """Asked for something that cannot be done now; nothing moved."""


class ProgramRefusedError(RefusedError):
    """A program that was running came to a place that may not be played; the arm has come to rest before it."""

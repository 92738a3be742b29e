"""The root of all errors of the host; each part draws its own branch in its module.

Rm501Error
├── ConfigError      config.loader
├── GcodeError       gcode
├── PlanError        planner: unreachable, out of limits, singular
└── SessionError     session: no board, refused, fault
"""


class Rm501Error(Exception):
    """Anything that the host refuses or reports; its text names the place and the remedy."""

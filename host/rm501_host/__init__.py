"""The host of rm501: reads programs, solves the kinematics, plans, streams motion.

    from rm501_host import Arm, load_config     kinematics of a configured arm
    from rm501_host import Robot                a running arm, in plain blocking calls

Names are imported when they are first used: `import rm501_host` itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rm501_host.config import Config, load_config
    from rm501_host.errors import Rm501Error
    from rm501_host.kinematics import Arm
    from rm501_host.robot import Robot

__all__ = ["Arm", "Config", "Rm501Error", "Robot", "load_config"]

_WHERE = {
    "Arm": "rm501_host.kinematics",
    "Config": "rm501_host.config",
    "Rm501Error": "rm501_host.errors",
    "Robot": "rm501_host.robot",
    "load_config": "rm501_host.config",
}


def __getattr__(name: str) -> object:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_WHERE[name]), name)

"""Limits that an operator lowers while the daemon runs; the configuration file stays the upper bound of each.

They hold for planning from the next motion on: joint velocities and accelerations, and the tool's speed. Motors,
ranges, and how steeply a hold or a stop ramps down stay as the file has them, so a lower limit never makes a stop
longer. A restart forgets them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec

from rm501_host.config import JOINT_NAMES, Config
from rm501_host.errors import RefusedError

LEAST_SHARE = 0.01
"""Of the file's value: below a hundredth nothing useful moves; hold or stop the arm instead."""
LEAST_TOOL_MM_S = 1.0


class LimitValues(msgspec.Struct, frozen=True, kw_only=True):
    """Per joint in order: deg/s, deg/s2; the tool's speed in mm/s, None where it is not limited."""

    velocity_deg_s: tuple[float, ...]
    acceleration_deg_s2: tuple[float, ...]
    tcp_speed_mm_s: float | None

    @classmethod
    def of(cls, config: Config) -> LimitValues:
        """Those of a configuration."""
        joints = config.joints.ordered
        return cls(
            velocity_deg_s=tuple(joint.max_velocity_deg_s for joint in joints),
            acceleration_deg_s2=tuple(joint.max_acceleration_deg_s2 for joint in joints),
            tcp_speed_mm_s=config.planner.tcp_max_speed_mm_s,
        )


class RuntimeLimits:
    """The configuration of the file, and the one in force: the same with lower limits."""

    def __init__(self, file: Config) -> None:
        self.file = file
        self.config = file

    @property
    def in_force(self) -> LimitValues:
        """What holds for the next motion."""
        return LimitValues.of(self.config)

    @property
    def hard(self) -> LimitValues:
        """What the file allows at most."""
        return LimitValues.of(self.file)

    @property
    def are_reduced(self) -> bool:
        """Whether any is lower than the file's."""
        return self.in_force != self.hard

    def set(
        self,
        velocity_deg_s: Mapping[str, float] | None = None,
        acceleration_deg_s2: Mapping[str, float] | None = None,
        tcp_speed_mm_s: float | None = None,
    ) -> None:
        """Change the limits of the joints named, and the tool's speed; the others stay. All or nothing.

        Raises RefusedError for a joint that does not exist and for a value that is not finite, above the file's or
        below a hundredth of it.
        """
        joints: dict[str, Any] = {}
        for key, wanted in (
            ("max_velocity_deg_s", velocity_deg_s or {}),
            ("max_acceleration_deg_s2", acceleration_deg_s2 or {}),
        ):
            for name, value in wanted.items():
                if name not in JOINT_NAMES:
                    raise RefusedError(f"there is no joint {name!r}; the joints are {', '.join(JOINT_NAMES)}")
                hard = float(getattr(getattr(self.file.joints, name), key))
                _check(f"joints.{name}.{key}", value, LEAST_SHARE * hard, hard)
                section = joints.get(name, getattr(self.config.joints, name))
                joints[name] = msgspec.structs.replace(section, **{key: float(value)})
        planner = self.config.planner
        if tcp_speed_mm_s is not None:
            hard = math.inf if self.file.planner.tcp_max_speed_mm_s is None else self.file.planner.tcp_max_speed_mm_s
            _check("planner.tcp_max_speed_mm_s", tcp_speed_mm_s, min(LEAST_TOOL_MM_S, hard), hard)
            planner = msgspec.structs.replace(planner, tcp_max_speed_mm_s=float(tcp_speed_mm_s))
        self.config = msgspec.structs.replace(
            self.config, joints=msgspec.structs.replace(self.config.joints, **joints), planner=planner
        )

    def reset(self) -> None:
        """Back to the file's."""
        self.config = self.file


def _check(key: str, value: float, least: float, most: float) -> None:
    if not math.isfinite(value) or not least <= value <= most:
        upper = "" if math.isinf(most) else f" to {most:g}"
        raise RefusedError(
            f"{key} {value:g} is not within {least:g}{upper}: the configuration file has the most that is allowed; "
            "edit it and restart for more"
        )

"""Random configurations and altered configuration sections for the kinematics tests."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from rm501_host.config.schema import Config
from rm501_host.kinematics import Arm

CONFIGS = Path(__file__).parents[2] / "configs"


def random_joints(arm: Arm, count: int, seed: int, margin_deg: float) -> npt.NDArray[np.float64]:
    """Joint angles (count, 5) deg, uniform inside the limits drawn in by a margin (out, where negative)."""
    low, high = arm.limits_deg
    return np.random.default_rng(seed).uniform(low + margin_deg, high - margin_deg, (count, 5))


def with_section(config: Config, section: str, **changes: object) -> Config:
    """The configuration with some keys of one section changed."""
    changed = msgspec.structs.replace(getattr(config, section), **changes)
    return msgspec.structs.replace(config, **{section: changed})

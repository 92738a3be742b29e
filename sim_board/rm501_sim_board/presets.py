"""The benches one can ask for by name.

`ideal` motors follow at once, switches are perfect, the geometry is the drawing's. `real` and `harsh` add dynamics,
play, noise and a geometry that is not the drawing's. Each number's source or assumption stands here and in
`docs/sim-board.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import pi, radians

from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.geometry import END_STOPS, PARKED_POSE_DEG, ArmGeometry, DriveTrain, Joint
from rm501_sim_board.hand import HandParameters
from rm501_sim_board.loads import ArmMasses
from rm501_sim_board.plant import DEFAULT_COUNTER_LIMIT_STEPS
from rm501_sim_board.servo import ServoParameters
from rm501_sim_board.switches import SWITCHES, SwitchParameters


@dataclass(frozen=True, slots=True)
class BenchParameters:
    """Everything that the bench is made of; the defaults are the preset `ideal`. `servos` None: motors without mass."""

    name: str = "ideal"
    geometry: ArmGeometry = field(default_factory=ArmGeometry)
    drive_train: DriveTrain = field(default_factory=DriveTrain)
    switches: tuple[SwitchParameters, ...] = SWITCHES
    hand: HandParameters = field(default_factory=HandParameters)
    start_deg: tuple[float, ...] = PARKED_POSE_DEG
    counter_limit_steps: int = DEFAULT_COUNTER_LIMIT_STEPS
    servos: tuple[ServoParameters, ...] | None = None
    masses: ArmMasses = field(default_factory=ArmMasses)

    def __post_init__(self) -> None:
        for motor, servo in enumerate(self.servos or ()):
            for name in ("viscous_nm_s_rad", "inertia_kg_m2", "torque_limit_nm", "stall_torque_nm", "no_load_deg_s"):
                if not getattr(servo, name) > 0.0:
                    raise BenchConfigError(f"servo {motor}: {name} must be above 0, not {getattr(servo, name)}")


def tuned_servo(
    steps_per_deg: float,
    inertia_kg_m2: float,
    loop_hz: float,
    damping: float,
    integral_s: float,
    **rest: float,
) -> ServoParameters:
    """A loop of natural frequency `loop_hz` and damping `damping` on `inertia_kg_m2`; `integral_s` its reset time.

    P = J w^2, D = 2 z w J minus what friction gives, I = P / integral_s; all per motor step.
    """
    rad_per_step = radians(1.0 / steps_per_deg)
    omega = 2.0 * pi * loop_hz
    proportional = inertia_kg_m2 * omega**2 * rad_per_step
    derivative = (2.0 * damping * omega * inertia_kg_m2 - rest["viscous_nm_s_rad"]) * rad_per_step
    return ServoParameters(
        steps_per_deg=steps_per_deg,
        inertia_kg_m2=inertia_kg_m2,
        proportional_nm=proportional,
        integral_nm_s=proportional / integral_s if integral_s else 0.0,
        derivative_nm_s=derivative,
        integral_limit_nm=0.6 * rest["torque_limit_nm"],
        **rest,  # type: ignore[arg-type]  # the remaining fields are floats
    )


def _servo(
    steps_per_deg: float, inertia: float, loop_hz: float, coulomb: float, limit: float, viscous: float, no_load: float
) -> ServoParameters:
    return tuned_servo(
        steps_per_deg,
        inertia,
        loop_hz,
        0.6,
        0.15,
        viscous_nm_s_rad=viscous,
        coulomb_nm=coulomb,
        stiction_ratio=1.25,
        torque_limit_nm=limit,
        stall_torque_nm=2.0 * limit,
        no_load_deg_s=no_load,
        friction_scatter=0.12,
        integral_deadband_steps=3,
        drift_nm=0.08 * limit,
        backlash_deg=0.05,
        compliance_deg_nm=0.002,
    )


# Waist, shoulder, elbow, right wrist, left wrist. Inertias are rotor times gear ratio squared, friction is what makes
# an unpowered arm sink slowly rather than fall: both assumptions, chosen so that lag at full speed stays well inside
# the counter and the arm carries its 1.2 kg but not 8 kg.
REAL_SERVOS: tuple[ServoParameters, ...] = (
    _servo(40.0, 1.2, 9.0, 3.0, 35.0, 12.0, 110.0),
    _servo(40.0, 1.3, 9.0, 4.0, 45.0, 15.0, 110.0),
    _servo(40.0, 0.6, 10.0, 1.2, 18.0, 7.0, 110.0),
    _servo(26.66666, 0.08, 10.0, 0.35, 5.0, 0.9, 160.0),
    _servo(26.66666, 0.08, 10.0, 0.35, 5.0, 0.9, 160.0),
)

# Release edges away from their nominal angles, as a real arm's are before it is calibrated.
_REAL_SWITCH_ERROR_DEG = (0.315, -0.085, 0.365, 0.25, -0.33)


def _worn(error_deg: tuple[float, ...], hysteresis: float, scatter: float, bounce: int) -> tuple[SwitchParameters, ...]:
    return tuple(
        replace(
            switch,
            angle_deg=switch.angle_deg + error,
            hysteresis_deg=hysteresis,
            repeatability_deg=scatter,
            bounce_frames=bounce,
        )
        for switch, error in zip(SWITCHES, error_deg, strict=True)
    )


PRESETS: dict[str, BenchParameters] = {
    "ideal": BenchParameters(),
    "real": BenchParameters(
        name="real",
        geometry=ArmGeometry(d1_mm=230.5, a2_mm=219.2, a3_mm=150.7, d5_mm=96.0),
        switches=_worn(_REAL_SWITCH_ERROR_DEG, 0.35, 0.015, 6),
        servos=REAL_SERVOS,
    ),
    "harsh": BenchParameters(
        name="harsh",
        geometry=ArmGeometry(d1_mm=231.8, a2_mm=218.4, a3_mm=151.6, d5_mm=96.4),
        switches=_worn(tuple(2.0 * e for e in _REAL_SWITCH_ERROR_DEG), 0.6, 0.04, 40),
        servos=tuple(
            replace(
                servo,
                coulomb_nm=1.6 * servo.coulomb_nm,
                friction_scatter=0.25,
                drift_nm=1.5 * servo.drift_nm,
                backlash_deg=0.15,
                compliance_deg_nm=0.01,
                derivative_nm_s=0.6 * servo.derivative_nm_s,
            )
            for servo in REAL_SERVOS
        ),
    ),
}


def preset(name: str) -> BenchParameters:
    """The preset called `name`; BenchConfigError lists the known ones."""
    try:
        return PRESETS[name]
    except KeyError:
        raise BenchConfigError(f"preset {name!r} is not known; use one of {', '.join(PRESETS)}") from None


def at_pose(parameters: BenchParameters, text: str | None) -> BenchParameters:
    """The same bench with the arm parked at five comma-separated joint angles; None leaves it where it is."""
    if text is None:
        return parameters
    try:
        angles = tuple(float(part) for part in text.split(","))
    except ValueError:
        angles = ()
    if len(angles) != len(END_STOPS):
        raise BenchConfigError(f"pose {text!r}: give five joint angles in deg, as in -60,60,-60,45,0")
    for joint, angle, stop in zip(Joint, angles, END_STOPS, strict=True):
        if not stop.low_deg <= angle <= stop.high_deg:
            raise BenchConfigError(
                f"pose {text!r}: {joint.name.lower()} at {angle:g} deg is beyond its end stops "
                f"({stop.low_deg:g} to {stop.high_deg:g})"
            )
    return replace(parameters, start_deg=angles)

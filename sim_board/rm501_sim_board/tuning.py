"""Step responses of one axis, and what raised gains do to them: the experiment behind the thesis's Table 4.

The figures are those of any textbook: rise time from 10 to 90 % of the final value, overshoot over it, settling into
2 % of it, and what remains between the final value and the command.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace

import numpy as np

from rm501_sim_board.geometry import FloatArray
from rm501_sim_board.servo import ServoAxis, ServoParameters

_SETTLE_BAND = 0.02


@dataclass(frozen=True, slots=True)
class StepFigures:
    """What a step response is judged by; times in s, overshoot relative, steady-state error in motor steps."""

    rise_s: float
    overshoot: float
    settling_s: float
    steady_error_steps: float


def step_response(
    servo: ServoParameters,
    step_steps: int,
    *,
    gravity_nm: float = 0.0,
    link_inertia_kg_m2: float = 0.0,
    seconds: float = 1.5,
    sample_s: float = 0.00096,
) -> FloatArray:
    """Position in motor steps after each sample, for a command that jumps by `step_steps` at time 0 from rest.

    The axis starts where it stands under its load, with an empty counter and no integral: the load's effect shows in
    the response, as on a loop that was switched on at its target.
    """
    axis = ServoAxis(servo, 0.0, 10**9, sample_s)
    count = round(seconds / sample_s)
    links, encoders = array("d"), array("d")
    axis.advance(
        [step_steps] * count, gravity_nm, 0.0, link_inertia_kg_m2, 1.0, True, False, -1e12, 1e12, links, encoders
    )
    return np.array(links)


def judge(response: FloatArray, step_steps: int, sample_s: float = 0.00096) -> StepFigures:
    """The four figures of a response."""
    final = float(response[-len(response) // 10 :].mean())
    peak = float(response.max())
    above_10 = int(np.argmax(response >= 0.1 * final))
    above_90 = int(np.argmax(response >= 0.9 * final))
    outside = np.flatnonzero(np.abs(response - final) > _SETTLE_BAND * abs(final))
    settled = int(outside[-1]) + 1 if outside.size else 0
    return StepFigures(
        rise_s=(above_90 - above_10) * sample_s,
        overshoot=max(0.0, peak / final - 1.0),
        settling_s=settled * sample_s,
        steady_error_steps=abs(step_steps - final),
    )


@dataclass(frozen=True, slots=True)
class TuningRow:
    """One experiment: which gain was raised, and the figures."""

    gains: str
    figures: StepFigures


def tuning_study(
    servo: ServoParameters, step_steps: int, gravity_nm: float, link_inertia_kg_m2: float
) -> list[TuningRow]:
    """The untuned loop (weak damping, no integral), then P, I and D raised one at a time."""
    fine = replace(
        servo,
        integral_nm_s=0.0,
        integral_deadband_steps=0,
        encoder_counts_per_step=1000,
        proportional_nm=0.5 * servo.proportional_nm,
        derivative_nm_s=0.25 * servo.derivative_nm_s,
        coulomb_nm=0.05,
        backlash_deg=0.0,
        compliance_deg_nm=0.0,
        torque_limit_nm=10.0 * servo.torque_limit_nm,
        stall_torque_nm=20.0 * servo.stall_torque_nm,
        integral_limit_nm=10.0 * servo.integral_limit_nm,
        no_load_deg_s=10.0 * servo.no_load_deg_s,
    )
    variants = (
        ("P I D as found", fine),
        ("P x 1.5", replace(fine, proportional_nm=1.5 * fine.proportional_nm)),
        ("I raised", replace(fine, integral_nm_s=fine.proportional_nm / 0.12)),
        ("D x 1.5", replace(fine, derivative_nm_s=1.5 * fine.derivative_nm_s)),
    )
    return [
        TuningRow(
            name,
            judge(
                step_response(s, step_steps, gravity_nm=gravity_nm, link_inertia_kg_m2=link_inertia_kg_m2), step_steps
            ),
        )
        for name, s in variants
    ]

"""One axis of a driver board: up/down counter, position loop, DC motor, gear, friction.

The loop is sampled: every `step_s` the counter's content and the tachometer set a torque, which then holds until the
next sample. Between samples the motor obeys

    J dw/dt = T - G - B w - F sign(w)          T, G, J, B, F constant over the sample

whose solution is used as it is, w(t) = w1 + (w0 - w1) exp(-B t / J) with w1 = (T - G - F sign(w)) / B, including the
exact instant at which the motor comes to rest inside a sample. There it stays when the static friction holds, or sets
off the other way for the rest of the sample. So friction, stiction and step responses carry no integration error at
all; the only approximation is that gravity and inertia are held over a few samples (see `servo_plant`).

Positions are in motor steps, speeds in steps/s, torques in Nm at the gear's output.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from math import expm1, log1p, pi

# Below this speed, in steps/s, a motor counts as standing: rounding residues of the exact stop.
_STANDSTILL_STEPS_S = 1e-9

# Friction scatters by a factor that is never below this (nor above 2 minus this).
LEAST_FRICTION_FACTOR = 0.5


@dataclass(frozen=True, slots=True)
class ServoParameters:
    """Motor, gear and loop of one axis, at the gear's output. Gains as Nm per step of counter content.

    `no_load_deg_s` is where back-EMF leaves no torque, `torque_limit_nm` the current limit, `stall_torque_nm` what
    the supply voltage would give at standstill. `friction_scatter` is the standard deviation of the friction,
    relative, `drift_nm` that of the drive amplifier's slow offset. `backlash_deg` is the full play;
    `compliance_deg_nm` the wind-up of the link per Nm of gravity torque.
    """

    steps_per_deg: float
    inertia_kg_m2: float
    viscous_nm_s_rad: float
    coulomb_nm: float
    stiction_ratio: float
    torque_limit_nm: float
    stall_torque_nm: float
    no_load_deg_s: float
    proportional_nm: float
    integral_nm_s: float
    derivative_nm_s: float
    integral_limit_nm: float
    integral_deadband_steps: int = 1
    encoder_counts_per_step: int = 1
    friction_scatter: float = 0.0
    drift_nm: float = 0.0
    backlash_deg: float = 0.0
    compliance_deg_nm: float = 0.0


class ServoAxis:
    """State of one axis; `advance` runs it over equal samples."""

    def __init__(
        self, parameters: ServoParameters, start_steps: float, counter_limit_steps: int, step_s: float
    ) -> None:
        self.parameters = parameters
        self.counter_limit_steps = counter_limit_steps
        self.step_s = step_s
        self.position_steps = start_steps
        self.speed_steps_s = 0.0
        self.link_steps = start_steps
        self.integral_nm = 0.0
        # Counter reference: content = commanded - offset - encoder.
        self.offset_steps = 0.0
        self.overflowed = False
        rad_per_step = pi / 180.0 / parameters.steps_per_deg
        self._rad_per_step = rad_per_step
        self._viscous = parameters.viscous_nm_s_rad * rad_per_step
        self._half_backlash = 0.5 * parameters.backlash_deg * parameters.steps_per_deg
        self._compliance = parameters.compliance_deg_nm * parameters.steps_per_deg
        self._top_speed = parameters.no_load_deg_s * parameters.steps_per_deg
        self.offset_steps = -self._encoder()

    @property
    def top_speed_steps_s(self) -> float:
        """No motion of this axis is ever faster."""
        return self._top_speed

    @property
    def slack_steps(self) -> float:
        """How far the link can move while the motor stands: backlash, and a change of wind-up by 5 Nm."""
        return 2.0 * self._half_backlash + 5.0 * self._compliance

    def largest_acceleration(self, gravity_nm: float, link_inertia_kg_m2: float) -> float:
        """No torque turns this axis faster: steps/s2, with room for a load that the hand may take or let go meanwhile.

        Friction only slows down what has been reckoned with as the present speed.
        """
        p = self.parameters
        torque_nm = p.torque_limit_nm + 1.5 * abs(gravity_nm) + 3.0 * p.drift_nm
        return torque_nm / ((p.inertia_kg_m2 + 0.5 * link_inertia_kg_m2) * self._rad_per_step)

    def content(self, commanded: int) -> float:
        """Content of the up/down counter, saturated at its ends."""
        limit = self.counter_limit_steps
        return max(-limit, min(limit, commanded - self.offset_steps - self._encoder()))

    def clear_counter(self, commanded: int) -> None:
        """Master reset: the counter's content becomes 0, wherever the motor is."""
        self.offset_steps = commanded - self._encoder()
        self.integral_nm = 0.0
        self.overflowed = False

    def at_rest(self, commanded: int, gravity_nm: float, drift_nm: float, powered: bool, stalled: bool) -> bool:
        """Whether nothing at all will change while command, load and the amplifier's offset stay as they are."""
        if self.speed_steps_s != 0.0:
            return False
        content = commanded - self.offset_steps - self._encoder()
        if abs(content) > self.counter_limit_steps:
            return False
        if stalled:
            return True
        p = self.parameters
        # The least friction that its scatter allows: what rests here rests whatever is drawn.
        stiction = p.coulomb_nm * p.stiction_ratio * LEAST_FRICTION_FACTOR
        if not powered:
            return self.integral_nm == 0.0 and abs(gravity_nm) <= stiction
        if abs(content) > p.integral_deadband_steps and p.integral_nm_s:
            return False
        return abs(p.proportional_nm * content + self.integral_nm + drift_nm - gravity_nm) <= stiction

    def advance(
        self,
        commands: list[int],
        gravity_nm: float,
        drift_nm: float,
        link_inertia_kg_m2: float,
        friction_factor: float,
        powered: bool,
        stalled: bool,
        low_steps: float,
        high_steps: float,
        links_out: array[float],
        encoders_out: array[float],
    ) -> None:
        """One sample per entry of `commands` (steps commanded since power-up, at the sample's start).

        `drift_nm` is the amplifier's offset: it turns the motor while there is power; the link feels nothing of it.
        Appends the link's position and the encoder's reading after every sample. `low_steps` and `high_steps` are the
        mechanical ends of this motor's travel.
        """
        p = self.parameters
        h = self.step_s
        x, w, y = self.position_steps, self.speed_steps_s, self.link_steps
        integral, offset = self.integral_nm, self.offset_steps
        limit = self.counter_limit_steps
        inertia = (p.inertia_kg_m2 + link_inertia_kg_m2) * self._rad_per_step
        viscous = self._viscous
        tau = inertia / viscous
        # w(h) = w + (w1 - w) blend, x(h) = x + w h + (w1 - w) gap: without cancellation however small B is.
        ratio = h / tau
        blend = -expm1(-ratio)
        gap = h - blend * tau if ratio > 1e-4 else 0.5 * h * ratio * (1.0 - ratio / 3.0)
        coulomb = p.coulomb_nm * friction_factor
        stiction = coulomb * p.stiction_ratio
        gain_p, gain_d, gain_i = p.proportional_nm, p.derivative_nm_s, p.integral_nm_s * h
        deadband, integral_limit = p.integral_deadband_steps, p.integral_limit_nm
        torque_limit, stall = p.torque_limit_nm, p.stall_torque_nm
        slope = stall / self._top_speed
        counts = p.encoder_counts_per_step
        top = self._top_speed
        half, sag = self._half_backlash, -self._compliance * gravity_nm
        # The link leans on one flank of the gear when gravity beats the friction behind it.
        lean = 0.0 if abs(gravity_nm) <= 0.1 * coulomb else (-half if gravity_nm > 0.0 else half)
        if stalled:
            w = 0.0
        turning_load = gravity_nm - drift_nm if powered else gravity_nm
        for command in commands:
            encoder = (x * counts + 0.5) // 1.0 / counts
            content = command - offset - encoder
            if content > limit:
                self.overflowed = True
                offset += content - limit
                content = limit
            elif content < -limit:
                self.overflowed = True
                offset += content + limit
                content = -limit
            if powered:
                torque = gain_p * content + integral - gain_d * w
                if torque > torque_limit:
                    torque = torque_limit
                elif torque < -torque_limit:
                    torque = -torque_limit
                elif content > deadband or content < -deadband:
                    integral += gain_i * content
                    if integral > integral_limit:
                        integral = integral_limit
                    elif integral < -integral_limit:
                        integral = -integral_limit
                if torque > stall - slope * w:
                    torque = stall - slope * w
                elif torque < -stall - slope * w:
                    torque = -stall - slope * w
            else:
                torque = integral = 0.0
            drive = torque - turning_load
            if not stalled:
                left = h
                if w == 0.0:
                    moving = drive > stiction or drive < -stiction
                    sign = 1.0 if drive > 0.0 else -1.0
                else:
                    moving = True
                    sign = 1.0 if w > 0.0 else -1.0
                if moving:
                    final = (drive - sign * coulomb) / viscous
                    change = final - w
                    after = w + change * blend
                    if after * sign >= 0.0:
                        x += w * h + change * gap
                        w = after
                    else:
                        # It comes to rest inside this sample, at the exact root of w(t).
                        rest = tau * log1p(-w / final)
                        x += final * rest + w * tau
                        w = 0.0
                        left -= rest
                        if drive > stiction or drive < -stiction:
                            sign = -sign
                            final = (drive - sign * coulomb) / viscous
                            if final * sign > 0.0:
                                w = -final * expm1(-left / tau)
                                x += final * left - w * tau
                    if -_STANDSTILL_STEPS_S < w < _STANDSTILL_STEPS_S:
                        w = 0.0
                    if w > top:
                        w = top
                    elif w < -top:
                        w = -top
                    if x < low_steps:
                        x, w = low_steps, 0.0
                    elif x > high_steps:
                        x, w = high_steps, 0.0
            if lean:
                y = x + lean
            elif y < x - half:
                y = x - half
            elif y > x + half:
                y = x + half
            links_out.append(y + sag)
            encoders_out.append(encoder)
        self.position_steps, self.speed_steps_s, self.link_steps = x, w, y
        self.integral_nm, self.offset_steps = integral, offset

    def displace(self, position_steps: float) -> None:
        """Put the motor somewhere else, at rest (an end stop reached through the wrist's differential)."""
        self.position_steps = position_steps
        self.speed_steps_s = 0.0

    def rest(self, gravity_nm: float, friction_factor: float) -> float:
        """One sample or many at rest: only the link may change flanks; returns its position, wind-up included."""
        half, x = self._half_backlash, self.position_steps
        if abs(gravity_nm) > 0.1 * self.parameters.coulomb_nm * friction_factor:
            self.link_steps = x - half if gravity_nm > 0.0 else x + half
        elif self.link_steps < x - half:
            self.link_steps = x - half
        elif self.link_steps > x + half:
            self.link_steps = x + half
        return self.link_steps - self._compliance * gravity_nm

    def encoder_steps(self) -> float:
        """Reading of the encoder."""
        return self._encoder()

    def _encoder(self) -> float:
        counts = self.parameters.encoder_counts_per_step
        return (self.position_steps * counts + 0.5) // 1.0 / counts

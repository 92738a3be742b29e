"""What the motors have to carry: gravity torque and inertia by pose and payload.

Four point masses hang on the plane chain: upper arm, forearm, hand, payload at the tool tip. With V the potential
energy, dV/dq_j is the torque that joint j must hold; the drive train turns it into motor torques by virtual work,
torque_m = sum_j dV/dq_j * dq_j/dmotor_m. Inertias are those of the same masses about the joint's axis plus the motor's
own; coupling between joints (Coriolis, off-diagonal inertia) is left out: at 20 deg/s2 it is under 2 % of gravity.

Masses are assumptions that add up, with the base and the three large motors in it, to the data sheet's 27 kg.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin

GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True)
class ArmMasses:
    """Masses in kg and their distances along the link in mm."""

    upper_arm_kg: float = 5.0
    upper_arm_mm: float = 110.0
    forearm_kg: float = 2.5
    forearm_mm: float = 80.0
    hand_kg: float = 0.8
    hand_mm: float = 60.0


@dataclass(frozen=True, slots=True)
class JointLoads:
    """dV/dq of shoulder, elbow, pitch in Nm and link inertias of waist, shoulder, elbow, pitch in kg m2."""

    shoulder_nm: float
    elbow_nm: float
    pitch_nm: float
    waist_kg_m2: float
    shoulder_kg_m2: float
    elbow_kg_m2: float
    pitch_kg_m2: float


class ArmLoads:
    """Gravity and inertia of one arm; lengths in mm outside, m inside."""

    def __init__(self, masses: ArmMasses, a2_mm: float, a3_mm: float, d5_mm: float) -> None:
        self._a2, self._a3, self._d5 = a2_mm * 1e-3, a3_mm * 1e-3, d5_mm * 1e-3
        self._m2, self._l2 = masses.upper_arm_kg, masses.upper_arm_mm * 1e-3
        self._m3, self._l3 = masses.forearm_kg, masses.forearm_mm * 1e-3
        self._m5, self._l5 = masses.hand_kg, masses.hand_mm * 1e-3

    def at(self, q_deg: tuple[float, ...], payload_kg: float) -> JointLoads:
        """Loads at joint angles `q_deg` (5,) with `payload_kg` at the tool tip."""
        q2 = radians(q_deg[1])
        q23 = q2 + radians(q_deg[2])
        q234 = q23 + radians(q_deg[3])
        c2, s2, c23, s23, c234, s234 = cos(q2), sin(q2), cos(q23), sin(q23), cos(q234), sin(q234)
        m2, m3, m5, mp = self._m2, self._m3, self._m5, payload_kg
        outer = m5 + mp
        # Moments about the pitch, elbow and shoulder axes: sum of mass times horizontal distance.
        pitch = (m5 * self._l5 + mp * self._d5) * s234
        elbow = (m3 * self._l3 + outer * self._a3) * c23 + pitch
        shoulder = (m2 * self._l2 + (m3 + outer) * self._a2) * c2 + elbow
        pitch_j = m5 * self._l5**2 + mp * self._d5**2
        elbow_j = m3 * self._l3**2
        shoulder_j = m2 * self._l2**2
        waist_j = m2 * (self._l2 * c2) ** 2 + m3 * (self._a2 * c2 + self._l3 * c23) ** 2
        for mass, along in ((m5, self._l5), (mp, self._d5)):
            out, up = self._a3 * c23 + along * s234, self._a3 * s23 - along * c234
            elbow_j += mass * (out * out + up * up)
            out += self._a2 * c2
            up += self._a2 * s2
            shoulder_j += mass * (out * out + up * up)
            waist_j += mass * out * out
        out, up = self._a2 * c2 + self._l3 * c23, self._a2 * s2 + self._l3 * s23
        shoulder_j += m3 * (out * out + up * up)
        g = GRAVITY_M_S2
        return JointLoads(g * shoulder, g * elbow, g * pitch, waist_j, shoulder_j, elbow_j, pitch_j)

    def potential_energy_j(self, q_deg: tuple[float, ...], payload_kg: float) -> float:
        """Potential energy of the chain, zero with every mass in the shoulder's plane."""
        q2 = radians(q_deg[1])
        q23 = q2 + radians(q_deg[2])
        q234 = q23 + radians(q_deg[3])
        s2, s23, c234 = sin(q2), sin(q23), cos(q234)
        wrist = self._a2 * s2 + self._a3 * s23
        return GRAVITY_M_S2 * (
            self._m2 * self._l2 * s2
            + self._m3 * (self._a2 * s2 + self._l3 * s23)
            + self._m5 * (wrist - self._l5 * c234)
            + payload_kg * (wrist - self._d5 * c234)
        )

"""The arm as the machine sheet has it, written down once more: no product code, the judge of what the pins say.

Inverse kinematics for the tool straight down (pitch 0), elbow-up, waist front: enough for the thesis's program.
"""

from __future__ import annotations

import math

D1_MM, A2_MM, A3_MM, D5_MM = 230.0, 220.0, 150.0, 95.0
STEPS_PER_DEG = (40.0, 40.0, 40.0, 26.66666, 26.66666)


def motors_from_joints(joints_deg: tuple[float, ...]) -> tuple[float, ...]:
    """DH joint angles in deg to motor steps: waist, shoulder, elbow, right wrist, left wrist."""
    waist, shoulder, elbow, pitch, roll = joints_deg
    motor_deg = (waist, -shoulder, -elbow, roll - pitch, roll + pitch)
    return tuple(angle * scale for angle, scale in zip(motor_deg, STEPS_PER_DEG, strict=True))


def joints_tool_down(x_mm: float, y_mm: float, z_mm: float, roll_deg: float) -> tuple[float, ...]:
    """Joint angles in deg that hold the tip at x, y, z of the base frame with the tool straight down."""
    waist = math.atan2(y_mm, x_mm)
    reach = math.hypot(x_mm, y_mm)
    height = z_mm + D5_MM - D1_MM
    cosine = (reach**2 + height**2 - A2_MM**2 - A3_MM**2) / (2 * A2_MM * A3_MM)
    elbow = -math.acos(cosine)
    shoulder = math.atan2(height, reach) - math.atan2(A3_MM * math.sin(elbow), A2_MM + A3_MM * math.cos(elbow))
    pitch = -(shoulder + elbow)
    return (math.degrees(waist), math.degrees(shoulder), math.degrees(elbow), math.degrees(pitch), roll_deg)


def thesis_point(x_mm: float, y_mm: float, z_mm: float) -> tuple[float, ...]:
    """Joint angles at a point of the thesis's program: its frame is turned 180 deg about X, 160 mm above the base.

    Roll, pitch and yaw are 0, so the hand keeps its direction in the room: roll follows the waist.
    """
    down = joints_tool_down(x_mm, -y_mm, 160.0 - z_mm, 0.0)
    return (*down[:4], down[0])


def tip_mm(joints_deg: tuple[float, ...]) -> tuple[float, float, float]:
    """Position of the finger tips in the base frame, by the equations of the machine sheet."""
    q1, q2, q3, q4 = (math.radians(angle) for angle in joints_deg[:4])
    reach = A2_MM * math.cos(q2) + A3_MM * math.cos(q2 + q3) + D5_MM * math.sin(q2 + q3 + q4)
    height = D1_MM + A2_MM * math.sin(q2) + A3_MM * math.sin(q2 + q3) - D5_MM * math.cos(q2 + q3 + q4)
    return (math.cos(q1) * reach, math.sin(q1) * reach, height)


def joints_from_motors(steps: tuple[float, ...]) -> tuple[float, ...]:
    """Motor steps to DH joint angles in deg."""
    waist, shoulder, elbow, right, left = (count / scale for count, scale in zip(steps, STEPS_PER_DEG, strict=True))
    return (waist, -shoulder, -elbow, (left - right) / 2, (left + right) / 2)

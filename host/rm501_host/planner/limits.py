"""The limits as rows of a matrix: joints, and those motors that are not just a joint again.

Every limit of the arm is |row . dq/dt| <= velocity and |row . d2q/dt2| <= acceleration with a row over the five joint
angles. The waist, shoulder and elbow motors turn with their joints, so they only lower those joints' limits; the two
wrist motors carry sums of pitch and roll and get rows of their own (the polytope of machine.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """What the time law must respect.

    `rows` (m, 5); `velocity` (m,) and `acceleration` (m,) in deg/s and deg/s^2 of the row; `jerk_deg_s3` (5,) per
    joint; `min_deg`, `max_deg` (5,); `motor_matrix` (5, 5): motor deg from joint deg; `steps_per_deg` (5,);
    `motor_rate_steps_s`, `motor_acceleration_steps_s2` (5,). TCP limits are inf where not configured.
    """

    rows: Array
    velocity: Array
    acceleration: Array
    joint_velocity_deg_s: Array
    joint_acceleration_deg_s2: Array
    jerk_deg_s3: Array
    min_deg: Array
    max_deg: Array
    motor_matrix: Array
    steps_per_deg: Array
    motor_rate_steps_s: Array
    motor_acceleration_steps_s2: Array
    tcp_speed_mm_s: float
    tcp_acceleration_mm_s2: float

    @classmethod
    def from_config(cls, config: Config) -> Limits:
        """The limits of `[joints]`, `[motors]`, `[drive]` and `[planner]`."""
        joints = config.joints.ordered
        motors = config.motors.ordered
        matrix = np.zeros((5, 5))
        for i, sign in enumerate(config.drive.signs):
            matrix[i, i] = sign
        matrix[3:, 3:] = config.drive.wrist_matrix
        joint_velocity = np.array([j.max_velocity_deg_s for j in joints])
        joint_acceleration = np.array([j.max_acceleration_deg_s2 for j in joints])
        motor_velocity = np.array([m.max_rate_steps_s / m.steps_per_deg for m in motors])
        motor_acceleration = np.array([m.max_acceleration_deg_s2 for m in motors])
        steps_per_deg = np.array([m.steps_per_deg for m in motors])
        rows = [*np.eye(5)]
        velocity, acceleration = list(joint_velocity), list(joint_acceleration)
        for row, v, a in zip(matrix, motor_velocity, motor_acceleration, strict=True):
            used = np.flatnonzero(row)
            if len(used) == 1:
                joint, size = int(used[0]), abs(float(row[used[0]]))
                velocity[joint] = min(velocity[joint], v / size)
                acceleration[joint] = min(acceleration[joint], a / size)
            else:
                rows.append(row)
                velocity.append(v)
                acceleration.append(a)
        planner = config.planner
        return cls(
            rows=np.array(rows),
            velocity=np.array(velocity),
            acceleration=np.array(acceleration),
            joint_velocity_deg_s=joint_velocity,
            joint_acceleration_deg_s2=joint_acceleration,
            jerk_deg_s3=np.array([j.max_jerk_deg_s3 for j in joints]),
            min_deg=np.array([j.min_deg for j in joints]),
            max_deg=np.array([j.max_deg for j in joints]),
            motor_matrix=matrix,
            steps_per_deg=steps_per_deg,
            motor_rate_steps_s=np.array([m.max_rate_steps_s for m in motors]),
            motor_acceleration_steps_s2=motor_acceleration * steps_per_deg,
            tcp_speed_mm_s=planner.tcp_max_speed_mm_s or np.inf,
            tcp_acceleration_mm_s2=planner.tcp_max_acceleration_mm_s2 or np.inf,
        )

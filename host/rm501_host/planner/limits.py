"""The limits as rows of a matrix: joints, and those motors that are not just a joint again.

Every limit of the arm is |row . dq/dt| <= velocity and |row . d2q/dt2| <= acceleration with a row over the five joint
angles. The waist, shoulder and elbow motors turn with their joints, so they only lower those joints' limits; the two
wrist motors carry sums of pitch and roll and get rows of their own (the polytope of machine.md).

Joints with play take it up beside the law (`segmenter.backlash`). What that can use of a row at most is held back from
the row here: a share of its acceleration, divided among its joints with play, and the speed that this acceleration
reaches over the play, sqrt(a b). Without play nothing is held back.
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

    `velocity`, `acceleration` and `jerk_deg_s3` are what the law may use; the limits by name are the whole ones.
    `backlash_deg` (5,): play per joint; `take_up_acceleration_deg_s2` (5,): with how much it is taken up;
    `take_up_window_s` (5,): over how long that is smoothed, 0 unless jerk is limited.
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
    backlash_deg: Array
    take_up_acceleration_deg_s2: Array
    take_up_window_s: Array

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
        backlash_deg = np.array([j.backlash_deg for j in joints])
        jerk = np.array([j.max_jerk_deg_s3 for j in joints])
        share = planner.backlash_acceleration_share
        taken = _take_up_accelerations(np.array(rows), np.array(velocity), np.array(acceleration), backlash_deg, share)
        has_play = backlash_deg > 0.0
        smoothed = has_play & planner.jerk_limited
        weights = np.abs(np.array(rows))
        return cls(
            rows=np.array(rows),
            velocity=np.array(velocity) - weights @ np.sqrt(taken * backlash_deg),
            acceleration=np.array(acceleration) - weights @ taken,
            joint_velocity_deg_s=joint_velocity,
            joint_acceleration_deg_s2=joint_acceleration,
            jerk_deg_s3=np.where(smoothed, (1.0 - share) * jerk, jerk),
            min_deg=np.array([j.min_deg for j in joints]),
            max_deg=np.array([j.max_deg for j in joints]),
            motor_matrix=matrix,
            steps_per_deg=steps_per_deg,
            motor_rate_steps_s=np.array([m.max_rate_steps_s for m in motors]),
            motor_acceleration_steps_s2=motor_acceleration * steps_per_deg,
            tcp_speed_mm_s=planner.tcp_max_speed_mm_s or np.inf,
            tcp_acceleration_mm_s2=planner.tcp_max_acceleration_mm_s2 or np.inf,
            backlash_deg=backlash_deg,
            take_up_acceleration_deg_s2=taken,
            take_up_window_s=np.where(smoothed, 2.0 * taken / (share * jerk), 0.0),
        )


def _take_up_accelerations(
    rows: Array, velocity: Array, acceleration: Array, backlash_deg: Array, share: float
) -> Array:
    """Acceleration (5,) of each joint's take-up: at most `share` of every row, and so gentle that sqrt(a b), the speed
    that it reaches over the play b, is at most `share` of every row too. 0 for joints without play.
    """
    result = np.zeros(len(backlash_deg))
    has_play = backlash_deg > 0.0
    weights = np.abs(rows)
    sharers = (weights[:, has_play] > 0.0).sum(axis=1)
    for joint in np.flatnonzero(has_play):
        used = weights[:, joint] > 0.0
        per_joint = share / (weights[used, joint] * sharers[used])
        result[joint] = min(
            float((per_joint * acceleration[used]).min()),
            float((per_joint * velocity[used]).min()) ** 2 / float(backlash_deg[joint]),
        )
    return result

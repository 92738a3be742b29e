"""The limits as rows of a matrix: joints, and those motors that are not just a joint again.

Every limit of the arm is |row . dq/dt| <= velocity and |row . d2q/dt2| <= acceleration with a row over the five joint
angles. The waist, shoulder and elbow motors turn with their joints, so they only lower those joints' limits; the two
wrist motors carry sums of pitch and roll and get rows of their own (the polytope of machine.md).

Joints with play take it up beside the law (`segmenter.backlash`). What that can use of a row at most is held back from
the row here: a share of its acceleration, divided among its joints with play, and the speed that this acceleration
reaches over the play, sqrt(a b). Without play nothing is held back.
"""

from __future__ import annotations

from collections.abc import Sequence
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

    Play is in seven places: behind the five joints, and in the gear trains of the two wrist motors. `play_rows` (7, 5):
    each place's angle from the joints'; `play_columns` (5, 7): what a deg there moves of each joint; `backlash_deg`
    (7,): the play; `take_up_acceleration_deg_s2` (7,): with how much it is taken up; `take_up_window_s` (7,): over how
    long that is smoothed, 0 unless jerk is limited.
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
    play_rows: Array
    play_columns: Array
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
        jerk = np.array([j.max_jerk_deg_s3 for j in joints])
        share = planner.backlash_acceleration_share
        play_rows = np.concatenate((np.eye(5), matrix[3:]))
        play_columns = np.concatenate((np.eye(5), np.linalg.inv(matrix)[:, 3:]), axis=1)
        backlash_deg = np.array([*(j.backlash_deg for j in joints), *(m.backlash_deg for m in motors[3:])])
        weights = np.abs(np.array(rows) @ play_columns)
        taken = _take_up_accelerations(weights, np.array(velocity), np.array(acceleration), backlash_deg, share)
        windows = np.zeros(len(backlash_deg))
        reserved = np.zeros(5)
        if planner.jerk_limited and (backlash_deg > 0.0).any():
            own = np.abs(play_columns)
            jerks = _shares(own, jerk, backlash_deg > 0.0, share)
            windows = np.where(backlash_deg > 0.0, 2.0 * taken / np.where(jerks > 0.0, jerks, 1.0), 0.0)
            reserved = own @ jerks
        return cls(
            rows=np.array(rows),
            velocity=np.array(velocity) - weights @ np.sqrt(taken * backlash_deg),
            acceleration=np.array(acceleration) - weights @ taken,
            joint_velocity_deg_s=joint_velocity,
            joint_acceleration_deg_s2=joint_acceleration,
            jerk_deg_s3=jerk - reserved,
            min_deg=np.array([j.min_deg for j in joints]),
            max_deg=np.array([j.max_deg for j in joints]),
            motor_matrix=matrix,
            steps_per_deg=steps_per_deg,
            motor_rate_steps_s=np.array([m.max_rate_steps_s for m in motors]),
            motor_acceleration_steps_s2=motor_acceleration * steps_per_deg,
            tcp_speed_mm_s=planner.tcp_max_speed_mm_s or np.inf,
            tcp_acceleration_mm_s2=planner.tcp_max_acceleration_mm_s2 or np.inf,
            play_rows=play_rows,
            play_columns=play_columns,
            backlash_deg=backlash_deg,
            take_up_acceleration_deg_s2=taken,
            take_up_window_s=windows,
        )

    def without_roll(self) -> tuple[Array, Array, Array]:
        """Rows, velocities and accelerations that bind where the roll stands still: of rows that are then multiples of
        each other the tightest limits, each. Both wrist motors turn with the pitch alone then.
        """
        rows = self.rows * np.array((1.0, 1.0, 1.0, 1.0, 0.0))
        kept: list[tuple[Array, float, float]] = []
        for row, velocity, acceleration in zip(rows, self.velocity, self.acceleration, strict=True):
            size = float(row[np.argmax(np.abs(row))])
            if size == 0.0:
                continue
            unit, own = row / size, (velocity / abs(size), acceleration / abs(size))
            for number, (other, *limits) in enumerate(kept):
                if np.abs(other - unit).max() < 1e-12:
                    kept[number] = (other, min(limits[0], own[0]), min(limits[1], own[1]))
                    break
            else:
                kept.append((unit, *own))
        matrix, velocities, accelerations = zip(*kept, strict=True)
        return np.array(matrix), np.array(velocities), np.array(accelerations)

    def on_the_flank(self, leads_deg: Sequence[float], joint: int, way: float) -> tuple[float, ...]:
        """How far the motors are ahead at each place of play (7,) once a joint alone has moved far enough in the
        direction `way` (1 or -1), if that was `leads_deg` before.
        """
        turns = np.sign(self.play_rows[:, joint] * way)
        leads = np.where((turns != 0.0) & (self.backlash_deg > 0.0), 0.5 * turns * self.backlash_deg, leads_deg)
        return tuple(float(lead) for lead in leads)


def _take_up_accelerations(
    weights: Array, velocity: Array, acceleration: Array, backlash_deg: Array, share: float
) -> Array:
    """Acceleration (7,) of the take-up at each place: at most `share` of every row, and so gentle that sqrt(a b), the
    speed that it reaches over the play b, is at most `share` of every row too. 0 without play. `weights` (m, 7).
    """
    has_play = backlash_deg > 0.0
    by_acceleration = _shares(weights, acceleration, has_play, share)
    by_velocity = _shares(weights, velocity, has_play, share) ** 2 / np.where(has_play, backlash_deg, 1.0)
    return np.minimum(by_acceleration, by_velocity)


def _shares(weights: Array, limits: Array, has_play: NDArray[np.bool_], share: float) -> Array:
    """What each place of play may use (7,), so that all together use at most `share` of every limit (m,)."""
    result = np.zeros(len(has_play))
    sharers = (weights[:, has_play] > 1e-12).sum(axis=1)
    for place in np.flatnonzero(has_play):
        used = weights[:, place] > 1e-12
        result[place] = float((share * limits[used] / (weights[used, place] * sharers[used])).min())
    return result

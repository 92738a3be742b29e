"""Motors that follow every counted step at once: the plant of the preset `ideal`.

Counters, overflow, master reset, power and stalls still behave as the boards do; only dynamics are missing. Without
power the arm stays where it is and the counters go on counting.
"""

from __future__ import annotations

import numpy as np

from rm501_sim_board.driver_boards import MOTORS_OF_BOARD, Board, BusActivity, IntArray
from rm501_sim_board.geometry import ARM_MOTOR_COUNT, END_STOPS, DriveTrain, FloatArray
from rm501_sim_board.plant import (
    DEFAULT_COUNTER_LIMIT_STEPS,
    Disturbances,
    FrameClock,
    MotorTrace,
)

TRACE_FRAMES = 3


class IdealPlant:
    """Six counters and five motors without mass.

    `start_deg` is the pose at power-up, `max_steps_per_frame` bounds what the bus can command.
    """

    def __init__(
        self,
        drive_train: DriveTrain,
        clock: FrameClock,
        start_deg: tuple[float, ...],
        *,
        power_fitted: bool,
        max_steps_per_frame: float,
        counter_limit_steps: int = DEFAULT_COUNTER_LIMIT_STEPS,
    ) -> None:
        self.drive_train = drive_train
        self.disturbances = Disturbances()
        self.estop_open = False
        self._clock = clock
        self._limit = counter_limit_steps
        self._max_steps_per_frame = max_steps_per_frame
        self._power_fitted = power_fitted
        self._relay = not power_fitted
        self._to_joint = tuple(tuple(row) for row in drive_train.joints_from_steps().tolist())
        self._start_steps: FloatArray = drive_train.steps_from_joints() @ np.asarray(start_deg)
        self._joint_bounds = tuple(sum(abs(entry) for entry in row) * max_steps_per_frame for row in self._to_joint)
        self._commanded = [0] * ARM_MOTOR_COUNT
        self._accepted = [0] * ARM_MOTOR_COUNT
        self._actual = [0] * ARM_MOTOR_COUNT
        self._overflowed: set[int] = set()
        self._pending: list[BusActivity] = []
        self._joint_deg: tuple[float, ...] | None = None
        self._sample_frames: list[IntArray] = []
        self._sample_commanded: list[IntArray] = []
        self._sample_actual: list[FloatArray] = []
        self._next_sample_frame = 0

    @property
    def powered(self) -> bool:
        """Whether the motors have power."""
        return self._relay and not self.estop_open and not self.disturbances.relay_forced_open

    @property
    def commanded_steps(self) -> tuple[int, ...]:
        """Steps counted from the pins since power-up."""
        return tuple(self._commanded)

    @property
    def counter_error_steps(self) -> tuple[int, ...]:
        """Contents of the up/down counters."""
        return tuple(a - b for a, b in zip(self._accepted, self._actual, strict=True))

    @property
    def overflowed(self) -> tuple[int, ...]:
        """Motors whose counter has overflowed."""
        return tuple(sorted(self._overflowed))

    @property
    def joint_deg(self) -> tuple[float, ...]:
        """True joint angles, DH deg."""
        if self._joint_deg is None:
            steps = [
                start + actual + slip
                for start, actual, slip in zip(
                    self._start_steps, self._actual, self.disturbances.slip_steps, strict=True
                )
            ]
            self._joint_deg = tuple(
                float(sum(entry * step for entry, step in zip(row, steps, strict=True) if entry))
                for row in self._to_joint
            )
        return self._joint_deg

    def overflow_line(self, board: Board) -> bool:
        """Whether the board raises OVERFLOW."""
        return any(motor in self._overflowed for motor in MOTORS_OF_BOARD[board])

    def steady_frames(self) -> int:
        """Frames for which no overflow line can change."""
        if self._overflowed:
            return 1  # a master reset can come with the next word
        fullest = max(abs(error) for error in self.counter_error_steps)
        return max(1, int((self._limit - fullest) / self._max_steps_per_frame) - 1)

    def joint_speed_bounds_deg_per_frame(self) -> tuple[float, ...]:
        """Bound of each joint's speed, from what the bus can command."""
        return self._joint_bounds

    def feed(self, activity: BusActivity) -> None:
        """Take a decoded block."""
        self._pending.append(activity)

    def change_payload(self, period: int, payload_kg: float) -> None:
        """Motors without limits do not feel a load."""

    def advance(self, frame: int) -> None:
        """Bring the state to the start of `frame`."""
        for activity in self._pending:
            self._consume(activity)
        self._pending.clear()
        self._joint_deg = None

    def trace(self) -> MotorTrace:
        """Positions every `TRACE_FRAMES` frames since power-up."""
        if not self._sample_frames:
            empty = np.zeros((0, ARM_MOTOR_COUNT))
            return MotorTrace(np.zeros(0, dtype=np.int64), empty, empty)
        return MotorTrace(
            np.concatenate(self._sample_frames),
            np.concatenate(self._sample_commanded).astype(np.float64),
            np.concatenate(self._sample_actual) + self._start_steps,
        )

    def _consume(self, activity: BusActivity) -> None:
        plain = not (activity.master_reset.periods.size or activity.motor_power.periods.size)
        frames = self._grid(activity)
        healthy = self.powered and not self.disturbances.stalled and not self._overflowed
        if plain and healthy and not self._near_stop_after(activity):
            self._follow(activity, frames)
        else:
            self._count_one_by_one(activity, frames)

    def _near_stop_after(self, activity: BusActivity) -> bool:
        self._joint_deg = None
        travel = [len(steps.periods) for steps in activity.steps[:ARM_MOTOR_COUNT]]
        for row, joint_deg, stop in zip(self._to_joint, self.joint_deg, END_STOPS, strict=True):
            margin_deg = sum(abs(entry) * count for entry, count in zip(row, travel, strict=True))
            if joint_deg - margin_deg < stop.low_deg or joint_deg + margin_deg > stop.high_deg:
                return True
        return False

    def _grid(self, activity: BusActivity) -> IntArray:
        end_frame = activity.end_period // self._clock.periods_per_frame
        frames = np.arange(self._next_sample_frame, end_frame + 1, TRACE_FRAMES, dtype=np.int64)
        if frames.size:
            self._next_sample_frame = int(frames[-1]) + TRACE_FRAMES
        return frames

    def _follow(self, activity: BusActivity, frames: IntArray) -> None:
        """Every counted step is made; positions on the sample grid come from the running sums."""
        grid_periods = frames * self._clock.periods_per_frame
        commanded = np.empty((len(frames), ARM_MOTOR_COUNT), dtype=np.int64)
        actual = np.empty((len(frames), ARM_MOTOR_COUNT))
        for motor, steps in enumerate(activity.steps[:ARM_MOTOR_COUNT]):
            base = self._commanded[motor]
            # Whatever the counter still holds is made up for at once.
            lag = self._accepted[motor] - base
            slip = self.disturbances.slip_steps[motor]
            if not steps.periods.size:
                commanded[:, motor] = base
                actual[:, motor] = base + lag + slip
                self._actual[motor] = self._accepted[motor]
                continue
            sums = np.concatenate(([0], np.cumsum(steps.signs)))
            commanded[:, motor] = base + sums[np.searchsorted(steps.periods, grid_periods, side="left")]
            actual[:, motor] = commanded[:, motor] + lag + slip
            self._commanded[motor] = base + int(sums[-1])
            self._accepted[motor] = self._actual[motor] = self._commanded[motor] + lag
        self._keep(frames, commanded, actual)

    def _count_one_by_one(self, activity: BusActivity, frames: IntArray) -> None:
        """The careful way, event by event: power, resets, stalls, end stops and full counters."""
        events: list[tuple[int, int, int, int]] = []
        for motor, steps in enumerate(activity.steps[:ARM_MOTOR_COUNT]):
            events += [(p, 2, motor, s) for p, s in zip(steps.periods.tolist(), steps.signs.tolist(), strict=True)]
        changes = activity.motor_power
        events += [
            (p, 0, int(level), 0) for p, level in zip(changes.periods.tolist(), changes.levels.tolist(), strict=True)
        ]
        changes = activity.master_reset
        events += [
            (p, 1, int(level), 0) for p, level in zip(changes.periods.tolist(), changes.levels.tolist(), strict=True)
        ]
        grid = (frames * self._clock.periods_per_frame).tolist()
        events += [(p, -1, 0, 0) for p in grid]
        commanded_rows: list[list[int]] = []
        actual_rows: list[list[float]] = []
        self._settle()
        for _, kind, which, sign in sorted(events):
            if kind == -1:
                commanded_rows.append(list(self._commanded))
                actual_rows.append([a + s for a, s in zip(self._actual, self.disturbances.slip_steps, strict=True)])
                continue
            if kind == 0:
                self._relay = bool(which) or not self._power_fitted
            elif kind == 1:
                if which:
                    self._clear_counters()
            else:
                self._count(which, sign)
            self._settle()
        if grid:
            self._keep(frames, np.asarray(commanded_rows, dtype=np.int64), np.asarray(actual_rows))

    def _count(self, motor: int, sign: int) -> None:
        self._commanded[motor] += sign
        error = self._accepted[motor] - self._actual[motor] + sign
        if abs(error) > self._limit:
            self._overflowed.add(motor)  # the counter stays at its end, the step is lost
        else:
            self._accepted[motor] += sign

    def _settle(self) -> None:
        """Let every motor that can turn go to where its counter is empty, up to the end stops."""
        self._joint_deg = None
        if not self.powered:
            return
        for motor in range(ARM_MOTOR_COUNT):
            target = self._accepted[motor]
            if target == self._actual[motor] or motor in self.disturbances.stalled:
                continue
            step = 1 if target > self._actual[motor] else -1
            while self._actual[motor] != target:
                self._actual[motor] += step
                self._joint_deg = None
                if self._beyond_stop():
                    self._actual[motor] -= step
                    break
        self._joint_deg = None

    def _beyond_stop(self) -> bool:
        return any(
            not stop.low_deg <= angle <= stop.high_deg for angle, stop in zip(self.joint_deg, END_STOPS, strict=True)
        )

    def _clear_counters(self) -> None:
        self._accepted = list(self._actual)
        self._overflowed.clear()

    def _keep(self, frames: IntArray, commanded: IntArray, actual: FloatArray) -> None:
        if frames.size:
            self._sample_frames.append(frames)
            self._sample_commanded.append(commanded)
            self._sample_actual.append(actual)

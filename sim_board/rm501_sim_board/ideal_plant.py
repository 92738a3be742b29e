"""Motors that follow every counted step at once: the plant of the preset `ideal`.

Counters, overflow, master reset, power and stalls still behave as the boards do; only dynamics are missing. Without
power the arm stays where it is and the counters go on counting.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rm501_sim_board.driver_boards import BusActivity, IntArray
from rm501_sim_board.geometry import ARM_MOTOR_COUNT, END_STOPS, DriveTrain, FloatArray
from rm501_sim_board.plant import (
    DEFAULT_COUNTER_LIMIT_STEPS,
    TRACE_SECONDS,
    FrameClock,
    MotorTrace,
)
from rm501_sim_board.plant_base import PlantBase

TRACE_FRAMES = 3


class _Log:
    """Position of one motor over time, as changes: cheap to write, summed up when somebody asks."""

    __slots__ = ("before", "deltas", "periods")

    def __init__(self) -> None:
        self.before = 0.0
        """Sum of what was forgotten."""
        self.periods: list[IntArray] = []
        self.deltas: list[npt.NDArray[np.float64] | IntArray] = []

    def add(self, periods: IntArray, deltas: npt.NDArray[np.float64] | IntArray) -> None:
        self.periods.append(periods)
        self.deltas.append(deltas)

    def at(self, grid_periods: IntArray) -> FloatArray:
        """Position before each grid period."""
        if not self.periods:
            return np.full(len(grid_periods), self.before)
        periods, deltas = np.concatenate(self.periods), np.concatenate(self.deltas)
        sums = self.before + np.concatenate(([0.0], np.cumsum(deltas, dtype=np.float64)))
        return sums[np.searchsorted(periods, grid_periods, side="left")]

    def forget_before(self, period: int) -> None:
        """Sum up whatever happened before; positions at earlier periods cannot be asked for any more."""
        if not self.periods:
            return
        periods = np.concatenate(self.periods)
        deltas = np.concatenate(self.deltas).astype(np.float64)
        gone = int(np.searchsorted(periods, period, side="left"))
        self.before += float(deltas[:gone].sum())
        self.periods, self.deltas = [periods[gone:].copy()], [deltas[gone:].copy()]


class IdealPlant(PlantBase):
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
        super().__init__(
            drive_train,
            clock,
            power_fitted=power_fitted,
            max_steps_per_frame=max_steps_per_frame,
            counter_limit_steps=counter_limit_steps,
        )
        to_joint = drive_train.joints_from_steps().tolist()
        self._rows = tuple(tuple((m, e) for m, e in enumerate(row) if e) for row in to_joint)
        self._start_steps: list[float] = (drive_train.steps_from_joints() @ np.asarray(start_deg)).tolist()
        self.bound_steps(max_steps_per_frame)
        self._commanded = [0] * ARM_MOTOR_COUNT
        self._accepted = [0] * ARM_MOTOR_COUNT
        self._actual = [0] * ARM_MOTOR_COUNT
        self._slip_seen = [0.0] * ARM_MOTOR_COUNT
        self._overflowed: set[int] = set()
        self._pending: list[BusActivity] = []
        self._joint_deg: tuple[float, ...] | None = None
        self._travel_left = 0  # steps that surely reach no end stop
        self._first_period = 0  # of the trace
        self._period = 0
        self._command_logs = tuple(_Log() for _ in range(ARM_MOTOR_COUNT))
        self._actual_logs = tuple(_Log() for _ in range(ARM_MOTOR_COUNT))

    @property
    def _kept_periods(self) -> int:
        return TRACE_SECONDS * 1_000_000 // self._clock.base_period_us

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
            slip = self.disturbances.slip_steps
            steps = [s + a + p for s, a, p in zip(self._start_steps, self._actual, slip, strict=True)]
            angles: list[float] = []
            for row in self._rows:
                angle = 0.0
                for motor, entry in row:
                    angle += entry * steps[motor]
                angles.append(angle)
            self._joint_deg = tuple(angles)
        return self._joint_deg

    def bound_steps(self, max_steps_per_frame: float) -> None:
        """So many steps of a motor the bus can carry."""
        super().bound_steps(max_steps_per_frame)
        self._joint_bounds = tuple(sum(abs(e) for _, e in row) * max_steps_per_frame for row in self._rows)

    def steady_frames(self) -> int:
        """Frames for which no overflow line can change."""
        if self._overflowed:
            return 1  # a master reset can come with the next word
        if self._accepted != self._actual:
            fullest = max(abs(error) for error in self.counter_error_steps)
            return max(1, int((self._limit - fullest) / self._max_steps_per_frame) - 1)
        frames = self.steady_frames_without_power()
        if self.powered and not self.disturbances.stalled:
            # A motor that turns freely keeps its counter empty, up to an end stop.
            to_stop = min(
                self.frames_to_travel(joint, min(angle - stop.low_deg, stop.high_deg - angle))
                for joint, (angle, stop) in enumerate(zip(self.joint_deg, END_STOPS, strict=True))
            )
            frames = max(frames, to_stop)
        return frames

    def steady_frames_without_power(self) -> int:
        """As many as it takes to fill an empty counter."""
        return max(1, int(self._limit / self._max_steps_per_frame) - 1)

    def frames_to_travel(self, joint: int, distance_deg: float) -> int:
        """From the fastest steps that the bus can command."""
        # A rounding error of a move that just reaches the distance must not break the promise.
        return int(distance_deg / self._joint_bounds[joint] - 1e-6)

    def feed(self, activity: BusActivity) -> None:
        """Take a decoded block."""
        self._pending.append(activity)

    def change_payload(self, period: int, payload_kg: float) -> None:
        """Motors without limits do not feel a load."""

    def advance(self, frame: int) -> None:
        """Bring the state to the start of `frame`."""
        if self._slip_seen != self.disturbances.slip_steps:
            self._note_slip()
        for activity in self._pending:
            self._consume(activity)
        self._pending.clear()
        if self._period - self._first_period > 2 * self._kept_periods:
            self._first_period = self._period - self._kept_periods
            for log in (*self._command_logs, *self._actual_logs):
                log.forget_before(self._first_period)

    def reclock(self, clock: FrameClock, frame: int) -> None:
        """Frames have another length from now on; the trace starts anew."""
        self._clock = clock
        self._first_period = self._period = frame * clock.periods_per_frame
        start = np.array([self._first_period - 1], dtype=np.int64)
        self._command_logs = tuple(_Log() for _ in range(ARM_MOTOR_COUNT))
        self._actual_logs = tuple(_Log() for _ in range(ARM_MOTOR_COUNT))
        for motor in range(ARM_MOTOR_COUNT):
            self._command_logs[motor].add(start, np.array([float(self._commanded[motor])]))
            actual = self._actual[motor] + self._slip_seen[motor]
            self._actual_logs[motor].add(start, np.array([actual]))

    def trace(self) -> MotorTrace:
        """Positions every `TRACE_FRAMES` frames."""
        per_frame = self._clock.periods_per_frame
        first_period = max(self._first_period, self._period - self._kept_periods)
        first, end = -(-first_period // per_frame), self._period // per_frame
        frames = np.arange(-(-first // TRACE_FRAMES) * TRACE_FRAMES, end + 1, TRACE_FRAMES, dtype=np.int64)
        grid = frames * per_frame
        return MotorTrace(
            frames,
            np.stack([log.at(grid) for log in self._command_logs], axis=1),
            np.stack([log.at(grid) for log in self._actual_logs], axis=1) + np.asarray(self._start_steps),
        )

    def _note_slip(self) -> None:
        for motor, (seen, now) in enumerate(zip(self._slip_seen, self.disturbances.slip_steps, strict=True)):
            if seen != now:
                self._actual_logs[motor].add(np.array([self._period], dtype=np.int64), np.array([now - seen]))
        self._slip_seen = list(self.disturbances.slip_steps)
        self._joint_deg = None
        self._travel_left = 0

    def _consume(self, activity: BusActivity) -> None:
        plain = not (activity.master_reset.periods.size or activity.motor_power.periods.size)
        healthy = self.powered and not self.disturbances.stalled and not self._overflowed
        if plain and healthy and self._accepted == self._actual and self._far_from_stops(activity):
            for motor, steps in enumerate(activity.steps[:ARM_MOTOR_COUNT]):
                if steps.periods.size:
                    made = int(steps.signs.sum())
                    self._commanded[motor] += made
                    self._accepted[motor] += made
                    self._actual[motor] += made
                    self._command_logs[motor].add(steps.periods, steps.signs)
                    self._actual_logs[motor].add(steps.periods, steps.signs)
                    self._joint_deg = None
        else:
            self._count_one_by_one(activity)
        self._period = activity.end_period

    def _far_from_stops(self, activity: BusActivity) -> bool:
        """Whether the steps of the block cannot reach an end stop, wherever they lead."""
        travel = 0
        for steps in activity.steps[:ARM_MOTOR_COUNT]:
            travel += len(steps.periods)
        if travel <= self._travel_left:
            self._travel_left -= travel
            return True
        self._travel_left = min(
            int(min(angle - stop.low_deg, stop.high_deg - angle) / max(abs(e) for _, e in row)) - 1
            for angle, row, stop in zip(self.joint_deg, self._rows, END_STOPS, strict=True)
        )
        if travel <= self._travel_left:
            self._travel_left -= travel
            return True
        self._travel_left = 0
        return False

    def _count_one_by_one(self, activity: BusActivity) -> None:
        """The careful way, event by event: power, resets, stalls, end stops and full counters."""
        events: list[tuple[int, int, int, int]] = []
        for motor, steps in enumerate(activity.steps[:ARM_MOTOR_COUNT]):
            if steps.periods.size:
                self._command_logs[motor].add(steps.periods, steps.signs)
            events += [(p, 2, motor, s) for p, s in zip(steps.periods.tolist(), steps.signs.tolist(), strict=True)]
        for kind, changes in ((0, activity.motor_power), (1, activity.master_reset)):
            events += [
                (p, kind, int(level), 0)
                for p, level in zip(changes.periods.tolist(), changes.levels.tolist(), strict=True)
            ]
        made: list[list[tuple[int, int]]] = [[] for _ in range(ARM_MOTOR_COUNT)]
        self._settle(activity.first_period, made)
        for period, kind, which, sign in sorted(events):
            if kind == 0:
                self._switch_relay(bool(which))
            elif kind == 1:
                if which:
                    self._clear_counters()
            else:
                self._count(which, sign)
            self._settle(period, made)
        for log, followed in zip(self._actual_logs, made, strict=True):
            if followed:
                pairs = np.array(followed, dtype=np.int64)
                log.add(pairs[:, 0], pairs[:, 1])
        self._travel_left = 0

    def _count(self, motor: int, sign: int) -> None:
        self._commanded[motor] += sign
        error = self._accepted[motor] - self._actual[motor] + sign
        if abs(error) > self._limit:
            self._overflowed.add(motor)  # the counter stays at its end, the step is lost
        else:
            self._accepted[motor] += sign

    def _settle(self, period: int, made: list[list[tuple[int, int]]]) -> None:
        """Let every motor that can turn go to where its counter is empty, up to the end stops."""
        if not self.powered:
            return
        for motor in range(ARM_MOTOR_COUNT):
            target, start = self._accepted[motor], self._actual[motor]
            if target == start or motor in self.disturbances.stalled:
                continue
            step = 1 if target > start else -1
            while self._actual[motor] != target:
                self._actual[motor] += step
                self._joint_deg = None
                if self._beyond_stop():
                    self._actual[motor] -= step
                    break
            self._joint_deg = None
            if self._actual[motor] != start:
                made[motor].append((period, self._actual[motor] - start))

    def _beyond_stop(self) -> bool:
        return any(
            not stop.low_deg <= angle <= stop.high_deg for angle, stop in zip(self.joint_deg, END_STOPS, strict=True)
        )

    def _clear_counters(self) -> None:
        self._accepted = list(self._actual)
        self._overflowed.clear()

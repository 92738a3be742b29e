"""Five servo axes carrying the arm: the plant of the presets `real` and `harsh`.

Time runs on two fixed grids from power-up: the loops are sampled every `SAMPLE_US`, gravity, inertia and
friction are renewed every `SAMPLES_PER_LOAD` samples. Gravity is extrapolated to the middle of that interval from the
last two, so the error is of second order in its length; `docs/sim-board.md` states it, the tests check it against a
fine integration. Because both grids are absolute, the result does not depend on how the run was cut into blocks.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from enum import IntEnum
from math import sqrt

import numpy as np

from rm501_sim_board.driver_boards import BusActivity, IntArray
from rm501_sim_board.geometry import ARM_MOTOR_COUNT, END_STOPS, DriveTrain, FloatArray, Joint, Motor
from rm501_sim_board.loads import ArmLoads, JointLoads
from rm501_sim_board.plant import (
    DEFAULT_COUNTER_LIMIT_STEPS,
    NEVER_FRAMES,
    TRACE_SECONDS,
    FrameClock,
    MotorTrace,
)
from rm501_sim_board.plant_base import PlantBase
from rm501_sim_board.randomness import stream
from rm501_sim_board.servo import LEAST_FRICTION_FACTOR, ServoAxis, ServoParameters

SAMPLE_US = 960  # three frames of 320 us; with other frames, the nearest whole number of them
SAMPLES_PER_LOAD = 8  # 7.68 ms
# How near to a stop, in deg, the coupled wrist motors are watched sample by sample.
_WATCH_DEG = 1.5
_FREE_PITCH_DEG, _FREE_ROLL_DEG = (
    (END_STOPS[joint].low_deg + _WATCH_DEG, END_STOPS[joint].high_deg - _WATCH_DEG)
    for joint in (Joint.PITCH, Joint.ROLL)
)
_NOISE_CHUNK = 1024
# From one load interval to the next: friction wanders within 0.5 s, an amplifier's offset, which is its temperature's,
# within a minute.
_FRICTION_MEMORY = 0.985
_DRIFT_MEMORY = 0.999872


class _Change(IntEnum):
    """Events on the plant's own clock, in the order in which they act within a sample."""

    POWER = 0
    MASTER_RESET = 1
    PAYLOAD = 2


@dataclass(slots=True)
class _Pending:
    """Steps of one motor not yet reached by the grid."""

    periods: list[IntArray] = field(default_factory=list)
    signs: list[IntArray] = field(default_factory=list)


class _Wander:
    """A seeded first-order wander, one value per load interval, clipped at `limit` on both sides of 0."""

    def __init__(self, rng: np.random.Generator, scatter: float, memory: float, limit: float) -> None:
        self._rng = rng
        self._drive = scatter * (1.0 - memory**2) ** 0.5
        self._memory = memory
        self._limit = limit
        # It has been running for long: the first value scatters like all others.
        self._last = scatter * float(rng.standard_normal())
        self._values: list[float] = []

    def value(self, interval: int) -> float:
        values = self._values
        if interval >= len(values):
            if not self._drive:
                return 0.0
            self._draw_up_to(interval)
        return values[interval]

    def _draw_up_to(self, interval: int) -> None:
        limit, memory, drive = self._limit, self._memory, self._drive
        while interval >= len(self._values):
            for draw in self._rng.standard_normal(_NOISE_CHUNK).tolist():
                self._last = memory * self._last + drive * draw
                self._values.append(min(max(self._last, -limit), limit))


def _time_to_cover(distance: float, speed: float, acceleration: float) -> float:
    """Time in which `distance` is covered from `speed` with `acceleration`; 0 when it is not positive."""
    if distance <= 0.0:
        return 0.0
    return (sqrt(speed * speed + 2.0 * acceleration * distance) - speed) / acceleration


class ServoPlant(PlantBase):
    """Motors, gears and arm with dynamics."""

    def __init__(
        self,
        drive_train: DriveTrain,
        clock: FrameClock,
        start_deg: tuple[float, ...],
        servos: tuple[ServoParameters, ...],
        loads: ArmLoads,
        *,
        seed: int,
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
        self._loads = loads
        # The arm stands on its transport prop until power comes for the first time.
        self._propped = power_fitted
        self._to_joint = tuple(tuple(row) for row in drive_train.joints_from_steps().tolist())
        # By virtual work, what each motor takes of the torques at shoulder, elbow and pitch.
        self._torque_shares = tuple(
            tuple(self._to_joint[j][m] * per_deg for j in (Joint.SHOULDER, Joint.ELBOW, Joint.PITCH))
            for m, per_deg in enumerate(drive_train.steps_per_deg)
        )
        start_steps = (drive_train.steps_from_joints() @ np.asarray(start_deg)).tolist()
        self.axes = tuple(
            ServoAxis(p, s, counter_limit_steps, SAMPLE_US * 1e-6) for p, s in zip(servos, start_steps, strict=True)
        )
        self._friction = tuple(
            _Wander(stream(seed, f"friction {m}"), p.friction_scatter, _FRICTION_MEMORY, 1.0 - LEAST_FRICTION_FACTOR)
            for m, p in enumerate(servos)
        )
        self._drift = tuple(
            _Wander(stream(seed, f"drift {m}"), p.drift_nm, _DRIFT_MEMORY, 3.0 * p.drift_nm)
            for m, p in enumerate(servos)
        )
        self._ends = tuple(self._ends_of(motor) for motor in range(ARM_MOTOR_COUNT))
        self._links: list[float] = list(start_steps)
        self._fed = [0] * ARM_MOTOR_COUNT
        self._grid_command = [0] * ARM_MOTOR_COUNT
        self._pending = tuple(_Pending() for _ in range(ARM_MOTOR_COUNT))
        self._changes: list[tuple[int, _Change, float]] = []
        self._sample = 0
        self._gravity_nm = [0.0] * ARM_MOTOR_COUNT
        self._offset_nm = [0.0] * ARM_MOTOR_COUNT
        self._gravity_before_nm: list[float] | None = None
        self._inertia_kg_m2 = [0.0] * ARM_MOTOR_COUNT
        self._factor = [1.0] * ARM_MOTOR_COUNT
        self._near_wrist_stop = False
        self._payload_kg = 0.0
        self._link_log = tuple(array("d") for _ in range(ARM_MOTOR_COUNT))
        self._encoder_log = tuple(array("d") for _ in range(ARM_MOTOR_COUNT))
        self._command_log = tuple(array("q") for _ in range(ARM_MOTOR_COUNT))
        self._log_sample = 0
        self._set_clock(clock)

    def _set_clock(self, clock: FrameClock) -> None:
        self._clock = clock
        self._sample_frames = max(1, round(SAMPLE_US / clock.frame_us))
        for axis in self.axes:
            axis.step_s = self._sample_frames * clock.frame_us * 1e-6
        self._reach_now: list[tuple[float, float]] | None = None
        self._top_deg_s = tuple(
            sum(abs(e) * axis.top_speed_steps_s for e, axis in zip(row, self.axes, strict=True))
            for row in self._to_joint
        )
        # A link may fall from one flank of its gear to the other at any time.
        self._slack_deg = tuple(
            sum(abs(e) * axis.slack_steps for e, axis in zip(row, self.axes, strict=True)) for row in self._to_joint
        )

    # ------------------------------------------------------------ what the bench sees

    @property
    def commanded_steps(self) -> tuple[int, ...]:
        """Steps counted from the pins since power-up."""
        return tuple(self._fed)

    @property
    def counter_error_steps(self) -> tuple[int, ...]:
        """Contents of the up/down counters."""
        return tuple(round(axis.content(n)) for axis, n in zip(self.axes, self._grid_command, strict=True))

    @property
    def overflowed(self) -> tuple[int, ...]:
        """Motors whose counter has overflowed."""
        return tuple(motor for motor, axis in enumerate(self.axes) if axis.overflowed)

    @property
    def joint_deg(self) -> tuple[float, ...]:
        """True joint angles, DH deg: where the links are."""
        slip = self.disturbances.slip_steps
        a, b, c, d, e = (link + lost for link, lost in zip(self._links, slip, strict=True))
        return tuple([r[0] * a + r[1] * b + r[2] * c + r[3] * d + r[4] * e for r in self._to_joint])

    def steady_frames(self) -> int:
        """Frames for which no overflow line can change."""
        frames = 1 << 30
        frame_s = self._clock.frame_us * 1e-6
        command_steps_s = self._max_steps_per_frame / frame_s
        # Steps fed but not yet on the sample grid count against the margin too.
        room = self._limit - 1.0 - self._max_steps_per_frame * self._sample_frames
        for axis, command, (speed, push) in zip(self.axes, self._grid_command, self._reach(), strict=True):
            if axis.overflowed:
                return 1
            time_s = _time_to_cover(room - abs(axis.content(command)), command_steps_s + speed, push)
            frames = min(frames, int(time_s / frame_s))
        return max(1, frames - self._sample_frames)

    def steady_frames_without_power(self) -> int:
        """`steady_frames` reckons with the largest torques either way: power makes no difference."""
        return NEVER_FRAMES

    def frames_to_travel(self, joint: int, distance_deg: float) -> int:
        """From the present speeds and the largest torques; no motor is ever faster than without load."""
        speed = push = 0.0
        for entry, (motor_speed, motor_push) in zip(self._to_joint[joint], self._reach(), strict=True):
            speed += abs(entry) * motor_speed
            push += abs(entry) * motor_push
        distance_deg -= self._slack_deg[joint]
        time_s = max(_time_to_cover(distance_deg, speed, push), distance_deg / self._top_deg_s[joint])
        return int(time_s / (self._clock.frame_us * 1e-6)) - self._sample_frames

    def _reach(self) -> list[tuple[float, float]]:
        """Speed and largest possible acceleration of each motor, steps/s and steps/s2; renewed by `advance`."""
        if self._reach_now is None:
            self._reach_now = [
                (abs(axis.speed_steps_s), axis.largest_acceleration(gravity, inertia))
                for axis, gravity, inertia in zip(self.axes, self._gravity_nm, self._inertia_kg_m2, strict=True)
            ]
        return self._reach_now

    def reclock(self, clock: FrameClock, frame: int) -> None:
        """Frames have another length from now on; samples start anew on the grid of the new frames."""
        self._set_clock(clock)
        self._sample = self._log_sample = -(-frame // self._sample_frames)
        for motor, pending in enumerate(self._pending):
            pending.periods, pending.signs = [], []
            self._grid_command[motor] = self._fed[motor]
        for log in (*self._link_log, *self._encoder_log):
            del log[:]
        for counts in self._command_log:
            del counts[:]

    def trace(self) -> MotorTrace:
        """Link positions at the end of every sample."""
        count = len(self._link_log[0])
        first = max(0, count - self._kept_samples)
        frames = (np.arange(first, count, dtype=np.int64) + 1 + self._log_sample) * self._sample_frames
        return MotorTrace(
            frames,
            np.stack([np.array(log[first:], dtype=np.float64) for log in self._command_log], axis=1),
            np.stack([np.array(log[first:], dtype=np.float64) for log in self._link_log], axis=1),
        )

    # ------------------------------------------------------------ input

    def feed(self, activity: BusActivity) -> None:
        """Take a decoded block."""
        for motor, steps in enumerate(activity.steps[:ARM_MOTOR_COUNT]):
            if steps.periods.size:
                self._pending[motor].periods.append(steps.periods)
                self._pending[motor].signs.append(steps.signs)
                self._fed[motor] += int(steps.signs.sum())
        for changes, kind in ((activity.motor_power, _Change.POWER), (activity.master_reset, _Change.MASTER_RESET)):
            for period, level in zip(changes.periods.tolist(), changes.levels.tolist(), strict=True):
                self._changes.append((period, kind, float(level)))

    def change_payload(self, period: int, payload_kg: float) -> None:
        """The hand has taken or let go a load at a base period."""
        self._changes.append((period, _Change.PAYLOAD, payload_kg))

    # ------------------------------------------------------------ motion

    def advance(self, frame: int) -> None:
        """Run all samples that end at or before the start of `frame`."""
        first, target = self._sample, frame // self._sample_frames
        if target <= first:
            return
        self._reach_now = None
        commands = [self._commands_on_grid(motor, first, target) for motor in range(ARM_MOTOR_COUNT)]
        self._changes.sort()
        sample = first
        while sample < target:
            end = min(target, (sample // SAMPLES_PER_LOAD + 1) * SAMPLES_PER_LOAD)
            end = self._apply_changes(sample, end, commands, first)
            if sample % SAMPLES_PER_LOAD == 0:
                self._renew_loads(sample // SAMPLES_PER_LOAD)
            elif self._near_wrist_stop:
                end = sample + 1
            self._run(sample, sample + 1 if self._near_wrist_stop else end, commands, first)
            sample = self._sample
        for motor in range(ARM_MOTOR_COUNT):
            self._command_log[motor].extend(commands[motor][1:])
            self._grid_command[motor] = commands[motor][-1]
        excess = len(self._link_log[0]) - self._kept_samples
        if excess > self._kept_samples:
            for positions in (*self._link_log, *self._encoder_log):
                del positions[:excess]
            for counts in self._command_log:
                del counts[:excess]
            self._log_sample += excess

    @property
    def _kept_samples(self) -> int:
        return TRACE_SECONDS * 1_000_000 // (self._sample_frames * self._clock.frame_us)

    def _commands_on_grid(self, motor: int, first: int, target: int) -> list[int]:
        """Steps commanded at the start of samples first..target (inclusive), since power-up."""
        pending = self._pending[motor]
        base = self._grid_command[motor]
        if not pending.periods:
            return [base] * (target - first + 1)
        periods = pending.periods[0] if len(pending.periods) == 1 else np.concatenate(pending.periods)
        signs = pending.signs[0] if len(pending.signs) == 1 else np.concatenate(pending.signs)
        per_sample = self._sample_frames * self._clock.periods_per_frame
        grid = np.arange(first, target + 1, dtype=np.int64) * per_sample
        index = np.searchsorted(periods, grid, side="left")
        sums = np.concatenate(([0], np.cumsum(signs)))
        used = int(index[-1])
        pending.periods = [periods[used:]] if used < len(periods) else []
        pending.signs = [signs[used:]] if used < len(signs) else []
        out: list[int] = (sums[index] + base).tolist()
        return out

    def _apply_changes(self, sample: int, end: int, commands: list[list[int]], first: int) -> int:
        """Let events up to the start of `sample` act; returns where the next one cuts the run."""
        per_sample = self._sample_frames * self._clock.periods_per_frame
        changes = self._changes
        while changes and changes[0][0] <= sample * per_sample:
            _, kind, value = changes.pop(0)
            if kind is _Change.POWER:
                self._switch_relay(bool(value))
                self._propped = self._propped and not self._relay
            elif kind is _Change.PAYLOAD:
                self._payload_kg = value
            elif value:
                for motor, axis in enumerate(self.axes):
                    axis.clear_counter(commands[motor][sample - first])
        if changes:
            end = min(end, -(-changes[0][0] // per_sample))
        return end

    def _renew_loads(self, interval: int) -> None:
        angles = self.joint_deg
        loads = self._loads.at(angles, self._payload_kg + self.disturbances.payload_kg)
        now = self._motor_torques(loads)
        before = self._gravity_before_nm or now
        self._gravity_before_nm = now
        disturbance = self.disturbances.load_torque_nm
        self._gravity_nm = [g + 0.5 * (g - b) + d for g, b, d in zip(now, before, disturbance, strict=True)]
        self._offset_nm = [wander.value(interval) for wander in self._drift]
        wrist_j = 0.25 * loads.pitch_kg_m2
        self._inertia_kg_m2 = [loads.waist_kg_m2, loads.shoulder_kg_m2, loads.elbow_kg_m2, wrist_j, wrist_j]
        self._factor = [1.0 + wander.value(interval) for wander in self._friction]
        self._near_wrist_stop = not (
            _FREE_PITCH_DEG[0] < angles[3] < _FREE_PITCH_DEG[1] and _FREE_ROLL_DEG[0] < angles[4] < _FREE_ROLL_DEG[1]
        )

    def _motor_torques(self, loads: JointLoads) -> list[float]:
        """Torque that each motor must hold; motor angles in degrees of their own."""
        shoulder, elbow, pitch = loads.shoulder_nm, loads.elbow_nm, loads.pitch_nm
        return [s * shoulder + e * elbow + p * pitch for s, e, p in self._torque_shares]

    def _run(self, sample: int, end: int, commands: list[list[int]], first: int) -> None:
        powered, stalled = self.powered, self.disturbances.stalled
        count = end - sample
        for motor, axis in enumerate(self.axes):
            part = commands[motor][sample - first : end - first]
            gravity, drift = self._gravity_nm[motor], self._offset_nm[motor]
            held = motor in stalled or self._propped
            links, encoders = self._link_log[motor], self._encoder_log[motor]
            still = part[0]
            if part[-1] == still and part.count(still) == count and axis.at_rest(still, gravity, drift, powered, held):
                link = axis.rest(gravity, self._factor[motor])
                links.extend([link] * count)
                encoders.extend([axis.encoder_steps()] * count)
            else:
                low, high = self._ends[motor]
                axis.advance(
                    part,
                    gravity,
                    drift,
                    self._inertia_kg_m2[motor],
                    self._factor[motor],
                    powered,
                    held,
                    low,
                    high,
                    links,
                    encoders,
                )
            self._links[motor] = links[-1]
        self._sample = end
        if self._near_wrist_stop:
            self._hold_wrist_in_range()

    def _hold_wrist_in_range(self) -> None:
        """Pitch and roll stops act on both wrist motors at once: put both back onto the stop, at rest."""
        angles = self.joint_deg
        out = self.drive_train.steps_from_joints()
        for joint in (Joint.PITCH, Joint.ROLL):
            stop = END_STOPS[joint]
            beyond = angles[joint] - min(max(angles[joint], stop.low_deg), stop.high_deg)
            if beyond:
                for motor in (Motor.RIGHT_WRIST, Motor.LEFT_WRIST):
                    shift = float(out[motor, joint]) * beyond
                    axis = self.axes[motor]
                    axis.displace(axis.position_steps - shift)
                    axis.link_steps -= shift
                    self._links[motor] -= shift
                    self._link_log[motor][-1] -= shift

    def _ends_of(self, motor: int) -> tuple[float, float]:
        """Ends of a motor's travel where one joint alone sets them; the wrist's are watched apart."""
        if motor in (Motor.RIGHT_WRIST, Motor.LEFT_WRIST):
            return -1e9, 1e9
        out: FloatArray = self.drive_train.steps_from_joints()
        stop = END_STOPS[motor]
        ends = (float(out[motor, motor]) * stop.low_deg, float(out[motor, motor]) * stop.high_deg)
        return min(ends), max(ends)

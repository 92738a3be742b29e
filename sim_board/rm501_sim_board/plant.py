"""What a plant is: the motors, gears and counters behind the driver boards' registers.

A plant is fed with what the boards latched and advanced to a frame; only then may its state be read. It never looks
into the future and never depends on how its input was cut into blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from rm501_sim_board.driver_boards import Board, BusActivity
from rm501_sim_board.geometry import ARM_MOTOR_COUNT, DriveTrain, FloatArray

# The boards' up/down counters: 8 bit, two's complement. The thesis gives no width; 8 bit is the design's assumption.
DEFAULT_COUNTER_LIMIT_STEPS = 127

NEVER_FRAMES = 1 << 62

TRACE_SECONDS = 600
"""How far back a plant remembers its motion, as the bench does its port words: 75 MB of a plant with dynamics."""


@dataclass(frozen=True, slots=True)
class FrameClock:
    """Base period and frame length: how the plant turns periods into time."""

    base_period_us: int
    periods_per_frame: int

    @property
    def frame_us(self) -> int:
        """Length of a frame."""
        return self.base_period_us * self.periods_per_frame

    @property
    def frames_per_second(self) -> float:
        """Frames in a second."""
        return 1e6 / self.frame_us


@dataclass(slots=True)
class Disturbances:
    """What the world does to the motors besides the commands; faults and the control socket write here.

    `stalled` motors do not turn; `slip_steps` are losses between encoder and joint which no counter sees;
    `load_torque_nm` acts on the motor's output; `payload_kg` hangs at the tool tip, on top of the hand's grip.
    """

    stalled: set[int] = field(default_factory=set)
    slip_steps: list[float] = field(default_factory=lambda: [0.0] * ARM_MOTOR_COUNT)
    load_torque_nm: list[float] = field(default_factory=lambda: [0.0] * ARM_MOTOR_COUNT)
    payload_kg: float = 0.0
    relay_forced_open: bool = False


@dataclass(frozen=True, slots=True)
class MotorTrace:
    """Motor positions on a regular grid: `frames` (n,), `commanded_steps` and `actual_steps` (n, 5), since power-up."""

    frames: npt.NDArray[np.int64]
    commanded_steps: FloatArray
    actual_steps: FloatArray


class Plant(Protocol):
    """Motors with their counters, seen by the emulator."""

    disturbances: Disturbances
    drive_train: DriveTrain
    estop_open: bool

    def feed(self, activity: BusActivity) -> None:
        """Take what the boards latched; blocks arrive in order."""

    def change_payload(self, period: int, payload_kg: float) -> None:
        """The hand has taken or let go a load at a base period."""

    def advance(self, frame: int) -> None:
        """Bring the state to the start of real `frame`; everything up to there has been fed."""

    @property
    def joint_deg(self) -> tuple[float, ...]:
        """True joint angles, DH deg, as far as the links stand (backlash and slip included)."""

    @property
    def powered(self) -> bool:
        """Whether the motors have power (relay closed, emergency stop chain closed)."""

    @property
    def commanded_steps(self) -> tuple[int, ...]:
        """Steps counted from the pins since power-up, per arm motor, whether followed or not."""

    @property
    def counter_error_steps(self) -> tuple[int, ...]:
        """Contents of the up/down counters, per arm motor."""

    @property
    def overflowed(self) -> tuple[int, ...]:
        """Motors whose counter has overflowed since the last master reset."""

    def overflow_line(self, board: Board) -> bool:
        """Whether the board raises OVERFLOW."""

    def bound_steps(self, max_steps_per_frame: float) -> None:
        """From now on the bus can carry so many steps of a motor in a frame, and no more."""

    def steady_frames(self) -> int:
        """For how many frames no overflow line can change, whatever is commanded while the motors keep their power."""

    def steady_frames_without_power(self) -> int:
        """For how many frames, from one in which the port words switch power, that promise lasts at least."""

    def frames_to_travel(self, joint: int, distance_deg: float) -> int:
        """Frames for which `joint` surely moves less than that, whatever is commanded; may be 0."""

    def reclock(self, clock: FrameClock, frame: int) -> None:
        """Frames have another length from now on; the present one is `frame`. The trace starts anew."""

    def trace(self) -> MotorTrace:
        """Motor positions of the last `TRACE_SECONDS`, or from power-up."""

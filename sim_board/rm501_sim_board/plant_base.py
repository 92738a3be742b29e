"""What every plant has: the relay and the emergency stop chain, the counters' room, the world's disturbances."""

from __future__ import annotations

from abc import ABC, abstractmethod

from rm501_sim_board.driver_boards import MOTORS_OF_BOARD, Board
from rm501_sim_board.geometry import DriveTrain
from rm501_sim_board.plant import DEFAULT_COUNTER_LIMIT_STEPS, Disturbances, FrameClock


class PlantBase(ABC):
    """The part of a `Plant` that does not depend on how its motors move.

    `max_steps_per_frame` bounds what the bus can command of a motor. Where no relay is fitted there is always power.
    """

    def __init__(
        self,
        drive_train: DriveTrain,
        clock: FrameClock,
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
        self._power_fitted = power_fitted
        self._relay = not power_fitted
        self._max_steps_per_frame = max_steps_per_frame

    @property
    def powered(self) -> bool:
        """Whether the motors have power."""
        return self._relay and not self.estop_open and not self.disturbances.relay_forced_open

    @property
    @abstractmethod
    def overflowed(self) -> tuple[int, ...]:
        """Motors whose counter has overflowed."""

    def overflow_line(self, board: Board) -> bool:
        """Whether the board raises OVERFLOW."""
        overflowed = self.overflowed
        return any(motor in overflowed for motor in MOTORS_OF_BOARD[board])

    def bound_steps(self, max_steps_per_frame: float) -> None:
        """So many steps of a motor the bus can carry."""
        self._max_steps_per_frame = max_steps_per_frame

    def _switch_relay(self, level: bool) -> None:
        self._relay = level or not self._power_fitted

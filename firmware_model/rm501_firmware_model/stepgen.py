r"""The step generators of all motors: integers, once a frame, in step with the select/strobe scan.

Theory of operation. A motor's position is p, in 2^-48 step, and one motion frame makes ::

    p += v;  v += a;  a += j

which is Newton's forward differences and therefore exact: nothing is ever truncated. `count` is the number of steps
made. The motor is due for a step whenever floor(p + 1/2) differs from `count`, and takes it in the direction of the
difference. A level is latched by the driver board once a frame, so all timing is in frames at the latch::

    frame         0   1   2   3   4   5   6
    STEP  ________/~~~\___/~~~\___/~~~\____
    DIR   ~~~~~~~~~~~~~~~~~~~~\____________
                  |-1-|-2-|-3-|-4-|

    1 step_length   STEP stays high for so many frames
    2 step_space    STEP stays low for so many frames before it rises again
    3 dir_hold      DIR keeps its level for so many frames from the rise on, and always until STEP falls
    4 dir_setup     DIR has its level for so many frames before STEP rises

A step that may not be made yet is made later, never dropped; `rise_wait` and `dir_wait` count the frames down. DIR
follows the sign of v one frame ahead, so that a reversal costs a frame only where it falls directly behind a step.

The bound on the lag |p - count|: a step due at once leaves at most 1/2. It is late only while DIR is held behind a
step of the other direction, which with timings of one frame means two frames from the reversal of v; in them p moves
3 a + 3 d at the most, where a < 2^-9 step/frame^2 is what the wire can say and d is the largest jump of speed that
`limits` lets pass, 20 steps/s = 0.0064 step/frame by default: 0.5 + 0.0059 + 0.0192 < 0.54.

This is firmware: integers, arrays of fixed size, no allocation. The widths are declared in `memory`.
"""

from __future__ import annotations

from rm501_protocol.segment import FRACTION_BITS

from .layout import BoardLayout

__all__ = ["HALF_STEP", "StepGenerator"]

HALF_STEP = 1 << (FRACTION_BITS - 1)
LATE_STEPS = 3
"""A lag that no legal segment can reach, whatever the step timings: the rate limit is derived from them."""


class StepGenerator:
    """Positions, forward differences, step counts and STEP/DIR levels of every motor that segments move.

    `slot_words` holds, per slot of the scan, the bits of the port word that STEP and DIR lines of that slot have high
    (before inversion).
    """

    __slots__ = (
        "acceleration",
        "count",
        "dir_level",
        "dir_mask",
        "dir_wait",
        "dir_wait_frames",
        "enabled",
        "high_frames",
        "jerk",
        "late",
        "motor_slot",
        "motors",
        "position",
        "rise_wait",
        "rise_wait_frames",
        "setup_frames",
        "slot_words",
        "step_length_frames",
        "step_mask",
        "velocity",
    )

    def __init__(self, layout: BoardLayout) -> None:
        motors = layout.motor_count
        self.motors = motors
        self.position = [0] * motors  # s80, 2^-48 step
        self.velocity = [0] * motors  # s48, 2^-48 step/frame
        self.acceleration = [0] * motors  # s40, 2^-48 step/frame^2
        self.jerk = [0] * motors  # s32, 2^-48 step/frame^3
        self.count = [0] * motors  # s32, steps made
        self.dir_level = [0] * motors  # u1, 1 = negative
        self.high_frames = [0] * motors  # u8, frames that STEP stays high
        self.rise_wait = [0] * motors  # u8, frames before STEP may rise
        self.dir_wait = [0] * motors  # u8, frames before DIR may change
        self.late = 0  # u8, 1 + motor whose lag is beyond LATE_STEPS
        self.enabled = 1  # u1, 0: no more rises
        self.slot_words = layout.slot_words  # shared with the scan
        self.motor_slot = layout.motor_slot
        self.step_mask = layout.motor_step_mask
        self.dir_mask = layout.motor_dir_mask
        self.step_length_frames = layout.step_length_frames
        self.rise_wait_frames = layout.step_length_frames + layout.step_space_frames
        self.dir_wait_frames = layout.dir_wait_frames
        self.setup_frames = layout.dir_setup_frames

    def play(self) -> None:
        """Play one motion frame: advance every motor, then set the levels of this frame."""
        position = self.position
        velocity = self.velocity
        acceleration = self.acceleration
        jerk = self.jerk
        for motor in range(self.motors):
            speed = velocity[motor]
            difference = acceleration[motor]
            if speed or difference:
                position[motor] += speed
                velocity[motor] = speed + difference
            if jerk[motor]:
                acceleration[motor] = difference + jerk[motor]
        self.levels()

    def levels(self) -> None:
        """Set the STEP and DIR levels of this frame from the positions as they are."""
        position = self.position
        velocity = self.velocity
        count = self.count
        high_frames = self.high_frames
        rise_wait = self.rise_wait
        dir_wait = self.dir_wait
        for motor in range(self.motors):
            if high_frames[motor]:
                high_frames[motor] -= 1
                if high_frames[motor] == 0:
                    self.slot_words[self.motor_slot[motor]] ^= self.step_mask[motor]
            if rise_wait[motor]:
                rise_wait[motor] -= 1
            if dir_wait[motor]:
                dir_wait[motor] -= 1
            lag = ((position[motor] + HALF_STEP) >> FRACTION_BITS) - count[motor]
            if lag:
                if not -LATE_STEPS <= lag <= LATE_STEPS:
                    self.late = motor + 1
                if (lag < 0) == self.dir_level[motor]:
                    if rise_wait[motor] == 0 and self.enabled:
                        count[motor] += 1 - 2 * self.dir_level[motor]
                        high_frames[motor] = self.step_length_frames
                        rise_wait[motor] = self.rise_wait_frames
                        dir_wait[motor] = self.dir_wait_frames
                        self.slot_words[self.motor_slot[motor]] ^= self.step_mask[motor]
                elif dir_wait[motor] == 0:
                    self.turn(motor)
            elif dir_wait[motor] == 0:
                speed = velocity[motor]
                if speed and (speed < 0) != self.dir_level[motor]:
                    self.turn(motor)

    def turn(self, motor: int) -> None:
        """Change the DIR level of one motor; STEP may rise only after the setup time."""
        self.dir_level[motor] ^= 1
        self.slot_words[self.motor_slot[motor]] ^= self.dir_mask[motor]
        if self.rise_wait[motor] < self.setup_frames:
            self.rise_wait[motor] = self.setup_frames

    def busy(self) -> int:
        """Whether, without further motion, a level would still change: STEP high, or a step due."""
        for motor in range(self.motors):
            if self.high_frames[motor]:
                return 1
            if self.enabled and (self.position[motor] + HALF_STEP) >> FRACTION_BITS != self.count[motor]:
                return 1
        return 0

    def rest(self) -> None:
        """Forget all motion: positions stay where they are."""
        for motor in range(self.motors):
            self.velocity[motor] = 0
            self.acceleration[motor] = 0
            self.jerk[motor] = 0

    def silence(self) -> None:
        """No step rises from now on; the positions become the steps made."""
        self.enabled = 0
        self.rest()
        for motor in range(self.motors):
            self.position[motor] = self.count[motor] << FRACTION_BITS

    def place(self, motor: int, steps: int) -> None:
        """Declare that a motor at rest stands at `steps`."""
        self.position[motor] = steps << FRACTION_BITS
        self.count[motor] = steps

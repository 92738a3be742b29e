"""The board's configuration, resolved once into the masks and limits that the tick path uses.

A port word is made of parts that change at different speeds ::

    word of period i  =  entry_words[i]  ^  slot_words[entry_slots[i]]  ^  line_word

`entry_words` is fixed: strobe, selects and slot lines of table entry i, constant multiplexer inputs, and the
inversion of every inverted pin. `slot_words` has, per slot, the STEP and DIR levels of its motors and of the hand; a
level that changes flips its bits there. `line_word` has what does not depend on the slot: motor power, heartbeat,
master reset, digital outputs. Composing a word costs two XORs.

This runs when a configuration is put in force, never in the tick path. What divides here is a constant for the host
to a C port.
"""

from __future__ import annotations

from rm501_protocol.board_config import BoardConfig
from rm501_protocol.config_pages import InputRole, OutputSource, SlotSource
from rm501_protocol.segment import FRACTION_BITS

__all__ = ["DIGITAL_OUTPUTS", "BoardLayout"]

DIGITAL_OUTPUTS = 8
TABLE_BITS = 6
MICROSECONDS = 1_000_000


class BoardLayout:
    """What the tick path knows about the hardware; a configuration with `problems()` is not accepted."""

    __slots__ = (
        "config_hash",
        "cycle_start_mask",
        "digital_mask",
        "dir_setup_frames",
        "dir_wait_frames",
        "entry_slots",
        "entry_words",
        "estop_mask",
        "frame_us",
        "hand_dir_mask",
        "hand_dir_slot",
        "hand_grip_pulses",
        "hand_increment",
        "hand_max_pulses",
        "hand_motor",
        "hand_pulse_frames",
        "hand_pulse_mask",
        "hand_pulse_slot",
        "heartbeat_mask",
        "high_water_frames",
        "hold_mask",
        "idle_power_off_frames",
        "input_bit",
        "input_count",
        "input_debounce_frames",
        "input_inverted",
        "input_motors",
        "input_pins_mask",
        "link_timeout_frames",
        "master_reset_mask",
        "max_acceleration",
        "max_speed",
        "max_speed_jump",
        "max_step_rate",
        "motor_count",
        "motor_dir_mask",
        "motor_slot",
        "motor_step_mask",
        "moved",
        "overflow_mask",
        "periods",
        "power_mask",
        "slot_words",
        "status_frames",
        "step_length_frames",
        "step_space_frames",
        "trust_without_power",
    )

    def __init__(self, config: BoardConfig) -> None:
        self.config_hash = config.hash
        self.frame_us = config.frame_us
        self.motor_count = config.motor_count
        self.max_step_rate = config.max_step_rate
        self._read_timing(config)
        self._read_scan(config)
        self._read_lines(config)
        self._read_limits(config)
        self._read_inputs(config)
        self._read_hand(config)
        link = config.link
        self.link_timeout_frames = self.frames_of_ms(link.link_timeout_ms)
        self.idle_power_off_frames = self.frames_of_ms(link.idle_power_off_ms)
        self.status_frames = self.frames_of_ms(link.status_period_ms)
        self.high_water_frames = link.high_water_frames
        self.trust_without_power = 1 if link.trust_without_power else 0

    def frames_of_ms(self, milliseconds: int) -> int:
        """Frames that last at least so long; 0 for 0."""
        return (milliseconds * 1000 + self.frame_us - 1) // self.frame_us

    def _read_timing(self, config: BoardConfig) -> None:
        timing = config.timing
        self.step_length_frames = timing.step_length_frames
        self.step_space_frames = timing.step_space_frames
        self.dir_setup_frames = timing.dir_setup_frames
        self.dir_wait_frames = max(timing.dir_hold_frames, timing.step_length_frames)

    def _read_scan(self, config: BoardConfig) -> None:
        """Table, slots and the pins that depend on them."""
        pins = dict.fromkeys(range(256), 0)
        inverted = 0
        for pin in config.pins.outputs:
            pins[pin.source] |= 1 << pin.bit
            if pin.inverted:
                inverted |= 1 << pin.bit
        self.slot_words = [0] * len(config.slots.slots)
        self.motor_slot = [0] * self.motor_count
        self.motor_step_mask = [0] * self.motor_count
        self.motor_dir_mask = [0] * self.motor_count
        self.hand_dir_slot = 0
        self.hand_dir_mask = 0
        self.hand_pulse_slot = 0
        self.hand_pulse_mask = 0
        constant = [0] * len(config.slots.slots)
        for slot, sources in enumerate(config.slots.slots):
            lines = (
                (sources.step_1, OutputSource.STEP_1),
                (sources.dir_1, OutputSource.DIR_1),
                (sources.step_2, OutputSource.STEP_2),
                (sources.dir_2, OutputSource.DIR_2),
            )
            for source, line in lines:
                mask = pins[line]
                if source >= SlotSource.DIR:
                    self.motor_dir_mask[source - SlotSource.DIR] |= mask
                elif source >= SlotSource.STEP:
                    self.motor_slot[source - SlotSource.STEP] = slot
                    self.motor_step_mask[source - SlotSource.STEP] |= mask
                elif source == SlotSource.HAND_DIR:
                    self.hand_dir_slot, self.hand_dir_mask = slot, mask
                elif source == SlotSource.HAND_PULSE:
                    self.hand_pulse_slot, self.hand_pulse_mask = slot, mask
                elif source == SlotSource.HIGH:
                    constant[slot] |= mask
        order = config.table_order
        self.periods = len(order)
        self.entry_words = [0] * self.periods
        self.entry_slots = [0] * self.periods
        for period, address in enumerate(order):
            entry = config.table.entries[address]
            slot = entry >> 1 & 3
            word = constant[slot] | pins[OutputSource.SLOT + slot]
            for bit in range(TABLE_BITS):
                if entry >> bit & 1:
                    word |= pins[OutputSource.TABLE_BIT + bit]
            self.entry_words[period] = word ^ inverted
            self.entry_slots[period] = slot

    def _read_lines(self, config: BoardConfig) -> None:
        """Lines that do not depend on the slot; a mask of 0 is a line that is not fitted."""
        self.power_mask = 0
        self.heartbeat_mask = 0
        self.master_reset_mask = 0
        self.digital_mask = [0] * DIGITAL_OUTPUTS
        for pin in config.pins.outputs:
            mask = 1 << pin.bit
            if pin.source == OutputSource.MOTOR_POWER:
                self.power_mask |= mask
            elif pin.source == OutputSource.HEARTBEAT:
                self.heartbeat_mask |= mask
            elif pin.source == OutputSource.MASTER_RESET:
                self.master_reset_mask |= mask
            elif pin.source >= OutputSource.DIGITAL:
                self.digital_mask[pin.source - OutputSource.DIGITAL] |= mask

    def _read_limits(self, config: BoardConfig) -> None:
        """Limits per motor, in 2^-48 step per frame and per frame^2, the margin for rounding included."""
        scale = 1000 + config.motors.margin_permille
        one = 1 << FRACTION_BITS
        fastest = min(one // (self.step_length_frames + self.step_space_frames), (one >> 1) - 1)
        thousand = MICROSECONDS * 1000
        self.moved = tuple(motor for motor, limits in enumerate(config.motors.motors) if limits.max_rate_steps_s > 0)
        self.max_speed = [0] * self.motor_count
        self.max_acceleration = [0] * self.motor_count
        for motor in self.moved:
            limits = config.motors.motors[motor]
            speed = limits.max_rate_steps_s * self.frame_us * scale * one // thousand
            self.max_speed[motor] = min(speed, fastest)
            per_frame = limits.max_acceleration_steps_s2 * self.frame_us * self.frame_us * scale * one
            self.max_acceleration[motor] = per_frame // (thousand * MICROSECONDS)
        self.max_speed_jump = config.motors.velocity_step_steps_s * self.frame_us * one // MICROSECONDS

    def _read_inputs(self, config: BoardConfig) -> None:
        inputs = config.inputs.inputs
        self.input_count = len(inputs)
        self.input_bit = [pin.bit for pin in inputs]
        self.input_inverted = [1 if pin.inverted else 0 for pin in inputs]
        self.input_debounce_frames = [pin.debounce_frames for pin in inputs]
        self.input_motors = [pin.motors for pin in inputs]
        self.input_pins_mask = 0
        self.overflow_mask = 0
        self.estop_mask = 0
        self.hold_mask = 0
        self.cycle_start_mask = 0
        for number, pin in enumerate(inputs):
            self.input_pins_mask |= 1 << pin.bit
            if pin.role == InputRole.OVERFLOW:
                self.overflow_mask |= 1 << number
            elif pin.role == InputRole.ESTOP:
                self.estop_mask |= 1 << number
            elif pin.role == InputRole.HOLD:
                self.hold_mask |= 1 << number
            elif pin.role == InputRole.CYCLE_START:
                self.cycle_start_mask |= 1 << number

    def _read_hand(self, config: BoardConfig) -> None:
        hand = config.hand
        self.hand_motor = hand.motor
        self.hand_max_pulses = hand.max_pulses
        self.hand_grip_pulses = hand.grip_pulses
        # pulses per real frame in Q0.24, and frames per pulse in Q8.8, rounded down
        self.hand_increment = hand.pulse_rate_hz * self.frame_us * (1 << 24) // MICROSECONDS
        self.hand_pulse_frames = 0
        if self.hand_increment:
            self.hand_pulse_frames = (MICROSECONDS << 8) // (hand.pulse_rate_hz * self.frame_us)

    def hand_frames(self, pulses: int) -> int:
        """Real frames that a stroke of `pulses` takes."""
        return (pulses * self.hand_pulse_frames) >> 8

"""The bench: everything on the far side of the microcontroller's pins.

It takes port words and gives input words, and nothing else crosses. Work is lazy: words are kept until somebody needs
to know what they did (an input is read, the truth is asked for), then decoded in one block. The promise that
`inputs_stable_until` gives is what makes that possible: no switch, line or button can change before that frame,
whatever the motors are told.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from rm501_protocol.board_config import INPUT_LINES, OUTPUT_LINES, InputId
from rm501_sim_board.driver_boards import Board, BusActivity, DriverBoards
from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.geometry import Joint
from rm501_sim_board.hand import Hand
from rm501_sim_board.ideal_plant import IdealPlant
from rm501_sim_board.loads import ArmLoads
from rm501_sim_board.plant import NEVER_FRAMES, FrameClock, Plant
from rm501_sim_board.presets import BenchParameters
from rm501_sim_board.randomness import stream
from rm501_sim_board.recording import DEFAULT_KEEP_WORDS, Recording
from rm501_sim_board.servo_plant import ServoPlant
from rm501_sim_board.switches import Switch
from rm501_sim_board.wiring import Terminal, Wire, Wiring, WordArray

BUTTONS: tuple[InputId, ...] = (InputId.ESTOP, InputId.HOLD, InputId.CYCLE_START)
# Plain numbers: these are touched at every reading.
_SWITCH_LINES = tuple(int(InputId[f"SWITCH_{joint.name}"]) for joint in Joint)
_BUTTON_LINES = tuple(map(int, BUTTONS))
_OVERFLOW_724, _OVERFLOW_732 = int(InputId.OVERFLOW_724), int(InputId.OVERFLOW_732)
_INPUT_BITS = tuple(1 << line.bit for line in INPUT_LINES)
_INVERTED_INPUTS = sum(1 << line.bit for line in INPUT_LINES if line.inverted)


def standard_wiring() -> Wiring:
    """The cable as the pin table has it."""
    wires: dict[Terminal, Wire] = {}
    for line in OUTPUT_LINES:
        names = ("STROBE_724", "STROBE_732", "STROBE_727") if line.name == "STROBE" else (line.name,)
        for name in names:
            wires[Terminal(name)] = Wire(line.bit, line.inverted)
    return Wiring(wires)


@dataclass(frozen=True, slots=True)
class Truth:
    """How things really stand at one real frame; no board and no host can see this."""

    frame: int
    joint_deg: tuple[float, ...]
    tcp_mm: tuple[float, float, float]
    commanded_steps: tuple[int, ...]
    counter_error_steps: tuple[int, ...]
    overflowed_motors: tuple[int, ...]
    powered: bool
    hand_opening_mm: float
    gripping: bool
    payload_kg: float
    heartbeat_edges: int
    inputs: dict[str, bool]


class Bench:
    """Wiring, driver boards, motors, arm, switches and buttons around one microcontroller."""

    def __init__(
        self,
        parameters: BenchParameters,
        *,
        seed: int = 0,
        clock: FrameClock | None = None,
        wiring: Wiring | None = None,
        keep_words: int = DEFAULT_KEEP_WORDS,
        boards: DriverBoards | None = None,
    ) -> None:
        self.parameters = parameters
        self.seed = seed
        self.clock = clock or FrameClock(40, 8)
        self.boards = boards or DriverBoards(wiring or standard_wiring())
        self.recording = Recording(self.clock.periods_per_frame, keep_words)
        self.hand = Hand(parameters.hand)
        self.plant: Plant = self._build_plant()
        self.switches = tuple(
            Switch(p, stream(seed, f"switch {joint.name}"), self.clock.frames_per_second)
            for joint, p in zip(Joint, parameters.switches, strict=True)
        )
        self.heartbeat_edges = 0
        self._relay = Terminal.MOTOR_POWER not in self.boards.wiring.wires
        self._pressed: set[InputId] = set()
        self._forced: dict[InputId, bool] = {}
        self._agenda: list[tuple[int, int, Callable[[], None]]] = []
        self._agenda_count = 0
        self._pending: list[WordArray] = []
        self._loose_words: list[int] = []
        self._written_periods = 0
        self._decoded_periods = 0
        self._settled_frame = -1
        self._missed_strobes = 0.0
        self._watches: list[tuple[Joint, float, float, Callable[[], None]]] = []
        self._steady_until = 0
        self._touched = False
        self.on_withdrawal: Callable[[], None] | None = None
        """Called whenever a promise of `inputs_stable_until` is withdrawn."""
        self._active = [False] * len(INPUT_LINES)
        self._word = 0
        self._power_level = 0
        self._power_mask = self._find_power_bit()

    # ------------------------------------------------------------ the microcontroller's side

    def write_frame(self, frame: int, words: Sequence[int]) -> None:
        """Port words of one frame, one per base period; copied."""
        if frame * self.clock.periods_per_frame != self._written_periods:
            self._refuse_gap(frame)
        if words[0] & self._power_mask != self._power_level:
            self._power_switched(frame, words[0])
        self._loose_words += words
        self._written_periods += len(words)

    def write_block(self, first_frame: int, words: npt.NDArray[np.uint32]) -> None:
        """Port words of whole frames, in order; a gap is a bug in the microcontroller's model."""
        if first_frame * self.clock.periods_per_frame != self._written_periods:
            self._refuse_gap(first_frame)
        block = np.asarray(words, dtype=np.uint32).reshape(-1)
        self._watch_power(first_frame, block)
        self._gather_loose_words()
        self._pending.append(block)
        self._written_periods += len(block)

    def read_inputs(self, frame: int) -> int:
        """The input word at the start of real `frame`."""
        if frame >= self._steady_until:
            self._renew_promise(frame)
        return self._word

    def inputs_stable_until(self, frame: int) -> int:
        """Promise: the inputs keep the value they had at `frame` until the returned frame, however the motors move."""
        if frame >= self._steady_until:
            self._renew_promise(frame)
        return self._steady_until

    def _renew_promise(self, frame: int) -> None:
        self.settle(frame)
        steady = self.plant.steady_frames()
        if self._agenda:
            steady = min(steady, self._agenda[0][0] - frame)
        angles = self.plant.joint_deg
        travel = self.plant.frames_to_travel
        for joint, side, at_deg, _ in self._watches:
            steady = min(steady, max(1, travel(joint, side * (at_deg - angles[joint]))))
        for joint, switch in zip(Joint, self.switches, strict=True):
            if steady <= 1:
                break
            steady = min(steady, switch.steady_frames(frame, angles[joint], partial(travel, joint)))
        self._steady_until = frame + max(1, min(steady, NEVER_FRAMES))

    def reclock(self, clock: FrameClock, frame: int) -> None:
        """From now on frames have another length, and the present one has the number `frame`.

        What was recorded so far is let go; the fingerprint goes on.
        """
        before = self.clock
        self.settle(self._written_periods // before.periods_per_frame)
        self.clock = clock
        self._written_periods = self._decoded_periods = frame * clock.periods_per_frame
        self._settled_frame = frame
        self._steady_until = 0
        self._agenda = [
            (frame + max(0, -(-at * before.frame_us // clock.frame_us) - frame), order, action)
            for at, order, action in self._agenda
        ]
        heapq.heapify(self._agenda)
        self.boards.set_frame(clock.periods_per_frame)
        self.recording.restart(clock.periods_per_frame, self._written_periods)
        for switch in self.switches:
            switch.reclock(frame, clock.frames_per_second)
        self.plant.reclock(clock, frame)

    # ------------------------------------------------------------ the operator's side

    def press(self, button: InputId) -> None:
        """Press a button (the emergency stop latches until released)."""
        self._require_button(button)
        self._pressed.add(button)
        self.world_changed()

    def release(self, button: InputId) -> None:
        """Let a button go."""
        self._require_button(button)
        self._pressed.discard(button)
        self.world_changed()

    def force_input(self, line: InputId, active: bool | None) -> None:
        """Force an input line active or inactive at the connector; None lets it go."""
        if active is None:
            self._forced.pop(line, None)
        else:
            self._forced[line] = active
        self.world_changed()

    def rewire(self, wiring: Wiring) -> None:
        """Change the cable from now on."""
        self._decode()
        self.boards.wiring = wiring
        self._power_mask = self._find_power_bit()
        self.plant.bound_steps(self._most_steps_per_frame())
        self.world_changed()

    def miss_strobes(self, probability: float) -> None:
        """Let each strobe edge go unseen by all boards with that probability."""
        self._decode()
        self._missed_strobes = probability

    def at_frame(self, frame: int, action: Callable[[], None]) -> None:
        """Have `action` happen at the start of real `frame`, before the inputs of that frame are read."""
        heapq.heappush(self._agenda, (frame, self._agenda_count, action))
        self._agenda_count += 1
        self._withdraw_promise(min(self._steady_until, frame))

    def when_passing(self, joint: Joint, upwards: bool, angle_deg: float, action: Callable[[], None]) -> None:
        """Call `action` once, when the true angle of `joint` is first seen at or past `angle_deg`."""
        self._watches.append((joint, 1.0 if upwards else -1.0, angle_deg, action))
        self._withdraw_promise(0)

    def truth(self, frame: int | None = None) -> Truth:
        """The state of the world at the last settled frame, or at `frame` when all its port words are known."""
        if frame is not None:
            self.settle(frame)
        plant = self.plant
        x_mm, y_mm, z_mm = self.parameters.geometry.tcp_mm(plant.joint_deg).tolist()
        return Truth(
            frame=self._settled_frame,
            joint_deg=plant.joint_deg,
            tcp_mm=(x_mm, y_mm, z_mm),
            commanded_steps=(*plant.commanded_steps, self.hand.pulses_open - self.hand.pulses_closed),
            counter_error_steps=plant.counter_error_steps,
            overflowed_motors=plant.overflowed,
            powered=plant.powered,
            hand_opening_mm=self.hand.opening_mm,
            gripping=self.hand.gripping,
            payload_kg=self.hand.payload_kg + plant.disturbances.payload_kg,
            heartbeat_edges=self.heartbeat_edges,
            inputs={line.name: active for line, active in zip(INPUT_LINES, self._active, strict=True)},
        )

    def settle(self, frame: int) -> None:
        """Bring the world to the start of real `frame`."""
        if frame == self._settled_frame:
            if self._touched:
                self._sense(frame)
            return
        if frame < self._settled_frame:
            raise BenchConfigError(f"the bench is at frame {self._settled_frame}, it cannot go back to {frame}")
        self._decode()
        self.plant.advance(frame)
        self._settled_frame = frame
        while self._agenda and self._agenda[0][0] <= frame:
            heapq.heappop(self._agenda)[2]()
        if self._watches:
            self._look_at_watches()
        self._sense(frame)

    # ------------------------------------------------------------ internal

    def _look_at_watches(self) -> None:
        angles = self.plant.joint_deg
        passed = [w for w in self._watches if w[1] * (angles[w[0]] - w[2]) >= 0.0]
        if passed:
            self._watches = [w for w in self._watches if w not in passed]
            for *_, action in passed:
                action()

    def _build_plant(self) -> Plant:
        parameters = self.parameters
        power_fitted = Terminal.MOTOR_POWER in self.boards.wiring.wires
        fastest = self._most_steps_per_frame()
        if parameters.servos is None:
            return IdealPlant(
                parameters.drive_train,
                self.clock,
                parameters.start_deg,
                power_fitted=power_fitted,
                max_steps_per_frame=fastest,
                counter_limit_steps=parameters.counter_limit_steps,
            )
        geometry = parameters.geometry
        return ServoPlant(
            parameters.drive_train,
            self.clock,
            parameters.start_deg,
            parameters.servos,
            ArmLoads(parameters.masses, geometry.a2_mm, geometry.a3_mm, geometry.d5_mm),
            seed=self.seed,
            power_fitted=power_fitted,
            max_steps_per_frame=fastest,
            counter_limit_steps=parameters.counter_limit_steps,
        )

    def _most_steps_per_frame(self) -> float:
        """A step needs two latches: registers are latched once a frame, or at every strobe when selects are wrong."""
        return 0.5 if self.boards.wiring == standard_wiring() else self.clock.periods_per_frame / 4

    def _find_power_bit(self) -> int:
        wire = self.boards.wiring.wires.get(Terminal.MOTOR_POWER)
        return 0 if wire is None or wire.stuck is not None else 1 << wire.bit

    def _watch_power(self, first_frame: int, block: WordArray) -> None:
        """Look at the first word of each frame: what is shorter than a frame fills no counter."""
        levels = block[:: self.clock.periods_per_frame] & np.uint32(self._power_mask)
        changed = np.flatnonzero(levels != self._power_level)
        if changed.size:
            self._power_switched(first_frame + int(changed[0]), int(block[-1]))

    def _power_switched(self, frame: int, word: int) -> None:
        """Motors without power let their counters run full: promises reckoned with power."""
        self._power_level = word & self._power_mask
        until = frame + self.plant.steady_frames_without_power()
        if until < self._steady_until:
            self._withdraw_promise(until)

    def _refuse_gap(self, frame: int) -> None:
        raise BenchConfigError(
            f"port words for frame {frame} came after {self._written_periods} base periods; frames must follow "
            "each other"
        )

    def _gather_loose_words(self) -> None:
        if self._loose_words:
            self._pending.append(np.array(self._loose_words, dtype=np.uint32))
            self._loose_words.clear()

    def _decode(self) -> None:
        self._gather_loose_words()
        if not self._pending:
            return
        words = self._pending[0] if len(self._pending) == 1 else np.concatenate(self._pending)
        self._pending.clear()
        self.recording.add_words(words)
        if self._missed_strobes:
            words = self._without_some_strobes(words)
        activity = self.boards.decode(words, self._decoded_periods)
        self._decoded_periods = activity.end_period
        self.recording.add_activity(activity)
        self.heartbeat_edges += activity.heartbeat_edges
        self._drive_hand(activity)
        self.plant.feed(activity)

    def _without_some_strobes(self, words: WordArray) -> WordArray:
        """Hold the strobe pins inactive in a random choice of periods, drawn by period, not by block."""
        wire = standard_wiring().wires[Terminal.STROBE_724]
        periods = self._decoded_periods + np.arange(len(words), dtype=np.uint64)
        # A hash of seed and period: the same edges are missed however the run is cut.
        mixed = (periods + np.uint64(self.seed)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
        mixed *= np.uint64(0xBF58476D1CE4E5B9)
        missed = (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-53 < self._missed_strobes
        bit = np.uint32(1 << wire.bit)
        inactive = words | bit if wire.inverted else words & ~bit
        return np.where(missed, inactive, words).astype(np.uint32)

    def _drive_hand(self, activity: BusActivity) -> None:
        """Power pulses in their order of time, between changes of power; a changed load goes to the plant."""
        pulses = activity.steps[5]
        changes = activity.motor_power
        if not pulses.periods.size:
            if changes.periods.size:
                self._relay = bool(changes.levels[-1])
            return
        events = [(p, 1, s) for p, s in zip(pulses.periods.tolist(), pulses.signs.tolist(), strict=True)]
        events += [(p, 0, int(v)) for p, v in zip(changes.periods.tolist(), changes.levels.tolist(), strict=True)]
        for period, kind, value in sorted(events):
            if kind == 0:
                self._relay = bool(value)
            elif self._relay and not self.plant.estop_open:
                before = self.hand.payload_kg
                self.hand.pulse(value)
                if self.hand.payload_kg != before:
                    self.plant.change_payload(period, self.hand.payload_kg)

    def _sense(self, frame: int) -> None:
        self._touched = False
        active = self._active
        plant = self.plant
        for line, switch, angle in zip(_SWITCH_LINES, self.switches, plant.joint_deg, strict=True):
            active[line] = switch.level(frame, angle)
        if plant.overflowed:
            active[_OVERFLOW_724] = plant.overflow_line(Board.ELBOW_WAIST)
            active[_OVERFLOW_732] = plant.overflow_line(Board.SHOULDER_WRIST)
        else:
            active[_OVERFLOW_724] = active[_OVERFLOW_732] = False
        for button in _BUTTON_LINES:
            active[button] = False
        for button in self._pressed:
            active[button] = True
        for line, level in self._forced.items():
            active[line] = level
        word = _INVERTED_INPUTS
        for level, bit in zip(active, _INPUT_BITS, strict=True):
            if level:
                word ^= bit
        self._word = word
        self.recording.add_input(frame, word)

    def world_changed(self) -> None:
        """Somebody has changed the world by hand: promises given before are void from the next frame on."""
        self.plant.estop_open = InputId.ESTOP in self._pressed
        self._touched = True
        self._withdraw_promise(0)

    def _withdraw_promise(self, frame: int) -> None:
        """The inputs are promised up to `frame` only."""
        self._steady_until = frame
        if self.on_withdrawal is not None:
            self.on_withdrawal()

    @staticmethod
    def _require_button(button: InputId) -> None:
        if button not in BUTTONS:
            names = ", ".join(b.name for b in BUTTONS)
            raise BenchConfigError(f"{button.name} is no button; press one of {names}, or force the input")

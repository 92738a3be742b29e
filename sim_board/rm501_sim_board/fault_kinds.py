"""Every fault the bench can show, by name: what it does, its parameters, and the row of the fault catalogue it serves.

A fault is a function of the running board and its parameters that does the damage and returns how to undo it (None
when it is a single event). Faults of the host alone (API clients, disks, configuration files, rows 20 to 23) cannot
be made on this side of the line; `python -m benchmarks.faults` makes them there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rm501_protocol.board_config import InputId
from rm501_sim_board.errors import FaultSpecError
from rm501_sim_board.geometry import Joint, Motor
from rm501_sim_board.pacing import PacedBoard
from rm501_sim_board.packet_tampering import claim_free_slots
from rm501_sim_board.randomness import stream
from rm501_sim_board.wiring import Terminal, Wiring

Undo = Callable[[], None]
Value = float | str | bool
Apply = Callable[[PacedBoard, Mapping[str, Value]], Undo | None]

_JOINTS = tuple(j.name.lower() for j in Joint)
_MOTORS = tuple(m.name.lower().replace("_", "-") for m in Motor)
_U32_MAX = 0xFFFFFFFF
_REBOOT_MS = 20.0
_TERMINALS = tuple(t.value.lower() for t in Terminal)


_ANY = (-1e12, 1e12)
_RANGES = {
    "p": (0.0, 1.0),
    "level": (0.0, 1.0),
    "ms": (0.0, 3.6e6),
    "dark_ms": (0.0, 3.6e6),
    "glitches": (0.0, 1e5),
    "kg": (0.0, 100.0),
    "bytes": (0.0, 1e8),
    "slots": (0.0, 255.0),
    "frames": (0.0, 2.0**32 - 1),
}
"""What a number may be, by the parameter's name; the others may be negative."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a fault: a number, or one of `choices`; None as default means that it must be given."""

    name: str
    default: float | str | None
    text: str
    choices: tuple[str, ...] = ()

    def read(self, fault: str, given: str | None) -> float | str:
        """The value from its text; FaultSpecError when it does not fit."""
        if given is None:
            if self.default is None:
                raise FaultSpecError(f"fault {fault}: {self.name}=... must be given ({self.text})")
            return self.default
        if self.choices:
            value = given.lower().replace("_", "-") if self.choices is _MOTORS else given.lower()
            if value not in self.choices:
                raise FaultSpecError(f"fault {fault}: {self.name}={given!r}; use one of {', '.join(self.choices)}")
            return value
        try:
            number = float(given)
        except ValueError:
            number = float("nan")
        if not np.isfinite(number):
            raise FaultSpecError(f"fault {fault}: {self.name}={given!r} is not a number")
        low, high = _RANGES.get(self.name, _ANY)
        if not low <= number <= high:
            raise FaultSpecError(f"fault {fault}: {self.name}={given}; choose {low:.12g} to {high:.12g} ({self.text})")
        return number


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One fault: rows of the catalogue, what it does, its parameters."""

    name: str
    rows: tuple[int, ...]
    text: str
    parameters: tuple[Parameter, ...]
    apply: Apply


def _number(value: Value) -> float:
    return float(value)


def _motor(value: Value) -> int:
    return _MOTORS.index(str(value))


def _joint(value: Value) -> int:
    return _JOINTS.index(str(value))


# ------------------------------------------------------------ the line


def _damage(field_name: str) -> Apply:
    def apply(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
        lines = {"board": (board.to_board,), "host": (board.to_host,), "both": (board.to_board, board.to_host)}
        chosen = lines[str(values["to"])]
        for line in chosen:
            setattr(line.damage, field_name, _number(values["p"]))

        def undo() -> None:
            for line in chosen:
                setattr(line.damage, field_name, 0.0)

        return undo

    return apply


def _burst(board: PacedBoard, values: Mapping[str, Value]) -> None:
    until_s = board.loop.time() + _number(values["ms"]) * 1e-3
    for line in (board.to_board, board.to_host):
        line.damage.silent_until_s = max(line.damage.silent_until_s, until_s)


def _delay(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    board.to_host.damage.delay_s = _number(values["ms"]) * 1e-3

    def undo() -> None:
        board.to_host.damage.delay_s = 0.0

    return undo


def _host_stall(board: PacedBoard, values: Mapping[str, Value]) -> None:
    until_s = board.loop.time() + _number(values["ms"]) * 1e-3
    for line in (board.to_board, board.to_host):
        line.damage.frozen_until_s = max(line.damage.frozen_until_s, until_s)


def _unplug(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    board.pull_plug()
    return board.put_plug_back


def _garbage(board: PacedBoard, values: Mapping[str, Value]) -> None:
    rng = stream(board.emulator.options.seed, f"garbage {board.emulator.frame}")
    board.noise(rng.integers(0, 256, int(_number(values["bytes"])), dtype=np.uint8).tobytes())


def _endless_frame(board: PacedBoard, values: Mapping[str, Value]) -> None:
    rng = stream(board.emulator.options.seed, f"endless {board.emulator.frame}")
    board.noise(rng.integers(1, 256, int(_number(values["bytes"])), dtype=np.uint8).tobytes())


def _reorder(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    board.can_reorder_probability = _number(values["p"])

    def undo() -> None:
        board.can_reorder_probability = 0.0

    return undo


def _free_slots(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    board.alter_sent = claim_free_slots(int(_number(values["slots"])))

    def undo() -> None:
        board.alter_sent = None

    return undo


# ------------------------------------------------------------ the microcontroller


def _reset(board: PacedBoard, values: Mapping[str, Value]) -> None:
    board.run_to_now()
    frames = max(1, round(_number(values["dark_ms"]) * 1000 / board.emulator.clock.frame_us))
    board.emulator.reset_microcontroller(frames)


def _clock(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    board.run_to_now()
    board.set_clock(_number(values["ppm"]), _number(values["jump_ms"]) * 1e-3)
    return lambda: board.set_clock()


def _clock_wrap(board: PacedBoard, values: Mapping[str, Value]) -> None:
    frames = _number(values["frames"])
    motion_frames = _number(values["motion_frames"])
    if motion_frames < 0:
        motion_frames = frames
    for name, given in (("frames", frames), ("motion_frames", motion_frames)):
        if not 1 <= given <= _U32_MAX or given != int(given):
            raise FaultSpecError(f"fault clock-wrap: {name}={given:g} is not a whole number from 1 to 2^32 - 1")
    board.run_to_now()
    dark_frames = max(1, round(_REBOOT_MS * 1000 / board.emulator.clock.frame_us))
    board.emulator.boot_with_counters(
        _U32_MAX + 1 - int(frames), _U32_MAX + 1 - int(motion_frames), dark_frames=dark_frames
    )


def _identity(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    link = board.emulator.board.link
    before = link.identity
    major, config = _number(values["major"]), _number(values["config"])
    link.identity = replace(
        before,
        major=int(major) if major >= 0 else before.major,
        config_hash=int(config) if config >= 0 else before.config_hash,
    )

    def undo() -> None:
        link.identity = before

    return undo


# ------------------------------------------------------------ switches, buttons, boards


_SWITCH_OF_JOINT = {
    Joint.WAIST: InputId.SWITCH_WAIST,
    Joint.SHOULDER: InputId.SWITCH_SHOULDER,
    Joint.ELBOW: InputId.SWITCH_ELBOW,
    Joint.PITCH: InputId.SWITCH_PITCH,
    Joint.ROLL: InputId.SWITCH_ROLL,
}


def _switch_stuck(level: bool) -> Apply:
    def apply(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
        bench = board.emulator.bench
        line = _SWITCH_OF_JOINT[Joint(_joint(values["joint"]))]
        bench.force_input(line, level)
        return lambda: bench.force_input(line, None)

    return apply


def _switch_bounce(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    bench = board.emulator.bench
    switch = bench.switches[_joint(values["joint"])]
    before = switch.parameters
    frames = max(1, round(_number(values["ms"]) * 1000 / board.emulator.clock.frame_us))
    switch.parameters = replace(
        before, bounce_frames=frames, glitches_per_second=_number(values["glitches"]), hysteresis_deg=0.1
    )
    switch.restart_glitches(board.emulator.frame)
    bench.world_changed()

    def undo() -> None:
        switch.parameters = before
        switch.restart_glitches(board.emulator.frame)
        bench.world_changed()

    return undo


def _press(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    button = InputId[str(values["button"]).upper().replace("-", "_")]
    bench = board.emulator.bench
    bench.press(button)
    return lambda: bench.release(button)


def _overflow(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    line = InputId.OVERFLOW_724 if values["board"] == "724" else InputId.OVERFLOW_732
    bench = board.emulator.bench
    bench.force_input(line, True)
    return lambda: bench.force_input(line, None)


def _rewire(change: Callable[[Wiring, Mapping[str, Value]], Wiring]) -> Apply:
    def apply(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
        bench = board.emulator.bench
        before = bench.boards.wiring
        bench.rewire(change(before, values))
        return lambda: bench.rewire(before)

    return apply


def _terminal(value: Value) -> Terminal:
    return Terminal(str(value).upper())


def _strobe_missed(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    bench = board.emulator.bench
    bench.miss_strobes(_number(values["p"]))
    return lambda: bench.miss_strobes(0.0)


# ------------------------------------------------------------ motors, arm, hand


def _stall(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    bench = board.emulator.bench
    motor = _motor(values["motor"])
    bench.plant.disturbances.stalled.add(motor)
    bench.world_changed()

    def undo() -> None:
        bench.plant.disturbances.stalled.discard(motor)
        bench.world_changed()

    return undo


def _lost_steps(board: PacedBoard, values: Mapping[str, Value]) -> None:
    bench = board.emulator.bench
    bench.plant.disturbances.slip_steps[_motor(values["motor"])] -= _number(values["n"])
    bench.world_changed()


def _load(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    bench = board.emulator.bench
    torques = bench.plant.disturbances.load_torque_nm
    motor = _motor(values["motor"])
    torques[motor] += _number(values["nm"])
    bench.world_changed()

    def undo() -> None:
        torques[motor] -= _number(values["nm"])
        bench.world_changed()

    return undo


def _payload(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    bench = board.emulator.bench
    bench.plant.disturbances.payload_kg = _number(values["kg"])
    bench.world_changed()

    def undo() -> None:
        bench.plant.disturbances.payload_kg = 0.0
        bench.world_changed()

    return undo


def _hand_jam(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    hand = board.emulator.bench.hand
    hand.jammed = True

    def undo() -> None:
        hand.jammed = False

    return undo


def _arm_power(board: PacedBoard, values: Mapping[str, Value]) -> Undo:
    bench = board.emulator.bench
    bench.plant.disturbances.relay_forced_open = True
    bench.world_changed()

    def undo() -> None:
        bench.plant.disturbances.relay_forced_open = False
        bench.world_changed()

    return undo


_P = Parameter("p", 1e-4, "probability per byte")
_TO = Parameter("to", "both", "which way", ("board", "host", "both"))
_MOTOR = Parameter("motor", None, "which motor", _MOTORS[:5])
_JOINT = Parameter("joint", None, "which joint", _JOINTS)
_LINE = Parameter("line", None, "which terminal of the driver boards", _TERMINALS)

FAULT_KINDS: tuple[FaultKind, ...] = (
    FaultKind("flip", (1,), "bits of bytes flip", (_P, _TO), _damage("flip_probability")),
    FaultKind("drop", (2,), "bytes vanish", (_P, _TO), _damage("drop_probability")),
    FaultKind("insert", (2,), "bytes appear", (_P, _TO), _damage("insert_probability")),
    FaultKind("duplicate", (2,), "bytes come twice", (_P, _TO), _damage("duplicate_probability")),
    FaultKind("burst", (3,), "nothing gets through for a while", (Parameter("ms", 50.0, "how long"),), _burst),
    FaultKind("delay", (4,), "answers come late", (Parameter("ms", 200.0, "how late"),), _delay),
    FaultKind(
        "reorder", (5,), "CAN frames overtake each other", (Parameter("p", 0.1, "probability per frame"),), _reorder
    ),
    FaultKind(
        "reset",
        (6, 24),
        "the microcontroller browns out and boots again",
        (Parameter("dark_ms", _REBOOT_MS, "how long it is dark"),),
        _reset,
    ),
    FaultKind(
        "clock",
        (7,),
        "the board's oscillator is off, or its time jumps ahead",
        (Parameter("ppm", 100.0, "drift"), Parameter("jump_ms", 0.0, "jump")),
        _clock,
    ),
    FaultKind(
        "host-stall",
        (8,),
        "the line stands still, as if the host were stopped; nothing is lost",
        (Parameter("ms", 500.0, "how long"),),
        _host_stall,
    ),
    FaultKind("unplug", (9,), "the cable is pulled; /DURATION puts it back", (), _unplug),
    FaultKind("switch-stuck-active", (10,), "a limit switch is always active", (_JOINT,), _switch_stuck(True)),
    FaultKind("switch-stuck-inactive", (11,), "a limit switch never acts", (_JOINT,), _switch_stuck(False)),
    FaultKind(
        "switch-bounce",
        (12,),
        "a limit switch bounces, or shows needles",
        (_JOINT, Parameter("ms", 5.0, "how long"), Parameter("glitches", 0.0, "needles per second")),
        _switch_bounce,
    ),
    FaultKind(
        "overflow",
        (13,),
        "a driver board raises OVERFLOW",
        (Parameter("board", "724", "which board", ("724", "732")),),
        _overflow,
    ),
    FaultKind(
        "load",
        (13,),
        "a torque acts on a motor's output",
        (_MOTOR, Parameter("nm", 60.0, "torque, against positive motion")),
        _load,
    ),
    FaultKind("payload", (13,), "a mass hangs at the tool tip", (Parameter("kg", 1.2, "mass"),), _payload),
    FaultKind(
        "lost-steps",
        (14,),
        "a belt jumps between encoder and joint",
        (_MOTOR, Parameter("n", 40.0, "steps lost")),
        _lost_steps,
    ),
    FaultKind("stall", (15,), "a motor does not turn", (_MOTOR,), _stall),
    FaultKind("hand-jam", (16,), "the fingers do not move", (), _hand_jam),
    FaultKind(
        "queue-lie",
        (17,),
        "the board claims more free queue slots than it has",
        (Parameter("slots", 32.0, "claimed free slots"),),
        _free_slots,
    ),
    FaultKind("garbage", (18,), "random bytes reach the board", (Parameter("bytes", 2000.0, "how many"),), _garbage),
    FaultKind(
        "endless-frame",
        (19,),
        "bytes without a delimiter reach the board",
        (Parameter("bytes", 65536.0, "how many"),),
        _endless_frame,
    ),
    FaultKind("arm-power", (24,), "the drives lose their power", (), _arm_power),
    FaultKind(
        "swap",
        (25,),
        "two wires are exchanged",
        (_LINE, Parameter("with", None, "the other terminal", _TERMINALS)),
        _rewire(lambda wiring, v: wiring.swapped(_terminal(v["line"]), _terminal(v["with"]))),
    ),
    FaultKind(
        "line-stuck",
        (25,),
        "a line to the driver boards is stuck",
        (_LINE, Parameter("level", 0.0, "logical level, 0 or 1")),
        _rewire(lambda wiring, v: wiring.stuck(_terminal(v["line"]), bool(v["level"]))),
    ),
    FaultKind(
        "no-inverter",
        (25,),
        "an inverter is missing",
        (_LINE,),
        _rewire(lambda wiring, v: wiring.without_inverter(_terminal(v["line"]))),
    ),
    FaultKind(
        "strobe-missed",
        (25,),
        "the boards miss strobe edges",
        (Parameter("p", 0.001, "probability per edge"),),
        _strobe_missed,
    ),
    FaultKind(
        "clock-wrap",
        (26,),
        "the board boots with its counters of real frames, clock ticks and motion frames shortly before their wrap at "
        "2^32, as if it had run for 15 days; later than power-up it is reset for that",
        (
            Parameter("frames", 20_000.0, "real frames until real frame and clock wrap"),
            Parameter("motion_frames", -1.0, "motion frames until the motion frame wraps; negative: as frames"),
        ),
        _clock_wrap,
    ),
    FaultKind(
        "identity",
        (27,),
        "the board reports another protocol version or configuration",
        (Parameter("major", -1.0, "protocol version"), Parameter("config", -1.0, "configuration hash")),
        _identity,
    ),
    FaultKind(
        "press",
        (24, 28),
        "somebody presses a button",
        (Parameter("button", "estop", "which", ("estop", "hold", "cycle-start")),),
        _press,
    ),
)

BY_NAME: dict[str, FaultKind] = {kind.name: kind for kind in FAULT_KINDS}

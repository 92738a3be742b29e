"""What everybody may see of the machine, as one flat value; and the difference between two of them."""

from __future__ import annotations

import msgspec


class MachineStatus(msgspec.Struct, frozen=True, kw_only=True):
    """The status. Positions are commanded, never measured: the board has no encoders."""

    time_s: float
    """The daemon's clock."""
    task_state: str
    """ESTOP, OFF, ON."""
    run_state: str
    """IDLE, RUNNING, HOLDING, HELD, STOPPING."""
    mode: str
    """MANUAL, MDI, AUTO: what was started last."""
    cause: str
    """Why the machine is in ESTOP or OFF, or is held; empty otherwise."""
    remedy: str
    """What to do about it."""
    activity: str
    """What moves or moved last: home, jog, move, trajectory, mdi, program, hand, or nothing."""
    motion_id: int
    """Number of that motion."""
    owner: str
    """Who owns the motion, empty when the lease is free."""
    connected: bool
    link_silent: bool
    board_state: str
    hold_cause: str
    fault: str
    homed: tuple[bool, ...]
    """Per joint: its angle is known and trusted."""
    joints_deg: tuple[float, ...]
    """Joint angles; of unhomed joints they count from wherever they were at power-up."""
    position: tuple[float, ...] | None
    """X Y Z A B C in the program frame, None while a joint is not homed."""
    steps: tuple[int, ...]
    hand: str
    """As commanded; there is no sensor."""
    inputs: tuple[str, ...]
    """Names of the inputs that are active."""
    outputs: int
    power: bool
    rate: float
    """1: motion time runs as fast as real time, 0: at rest."""
    override: float
    jog_damped: bool
    """A jog passes a singularity: more slowly, and perhaps off its line."""
    limits_reduced: bool
    """Limits have been lowered by `limits.set`: the next three are what holds for the next motion."""
    velocity_limits_deg_s: tuple[float, ...]
    acceleration_limits_deg_s2: tuple[float, ...]
    tcp_limit_mm_s: float | None
    """None: the tool's speed is not limited in programs (jogs keep the teach speed)."""
    queue_used: int
    queue_lead_s: float
    """Motion time queued on the board."""
    program: str
    line: int
    """Line of the motion under way, or the last one executed."""
    block: str
    progress: float
    """Share of the program's path time that is done, 0..1."""
    time_left_s: float
    checked_to_line: int
    """How far the program has been checked; the check goes on ahead of the motion."""
    check_complete: bool
    """Whether it has been checked to its end."""
    single_block: bool
    optional_stop: bool
    waiting: str
    """What the operator is waited for: M0, M1, step, or nothing."""
    messages: tuple[str, ...]
    """Newest messages of programs."""
    warnings: tuple[str, ...]
    """Log or position file on a full disk, link getting bad."""


def status_diff(old: dict[str, object] | None, new: dict[str, object]) -> dict[str, object]:
    """The fields of `new` that differ from `old`; all of them without `old`."""
    if old is None:
        return new
    return {key: value for key, value in new.items() if old.get(key) != value}

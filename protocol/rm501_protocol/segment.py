"""The exact integer arithmetic of motion segments, the same on the host and on the board.

Scale: positions and all differences count 2^-48 step (``Q48``). On the wire v is in 2^-32 step/frame and a in 2^-40
step/frame^2, so v and a are shifted left by 16 and 8 bits; j is in 2^-48 step/frame^3 as it is. One motion frame
does::

    p += v;  v += a;  a += j

and after n frames, with no truncation anywhere,

    p(n) = p + n v + n(n-1)/2 a + n(n-1)(n-2)/6 j
    v(n) = v + n a + n(n-1)/2 j
    a(n) = a + n j

(Newton's forward differences). Both products of consecutive integers are divisible by 2 and 6, so the closed form is
exact and equal to the stepping bit for bit. Note that v(n) is the forward difference: the step from frame n to n + 1,
not the derivative at n.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from .segment_message import MotorTerm, Segment

__all__ = [
    "A_SHIFT",
    "FRACTION_BITS",
    "MAX_LENGTH_CUBIC_FRAMES",
    "MAX_LENGTH_FRAMES",
    "ONE_STEP",
    "POSITION_MAX_STEPS",
    "POSITION_MIN_STEPS",
    "V_SHIFT",
    "MotorState",
    "end_positions_q48",
    "motor_end",
    "motor_extremes",
    "motor_state_at",
    "motor_states",
    "position_q48",
    "steps_of",
    "velocity_q48",
]

FRACTION_BITS = 48
ONE_STEP = 1 << FRACTION_BITS
V_SHIFT = 16
A_SHIFT = 8
MAX_LENGTH_FRAMES = 65535
MAX_LENGTH_CUBIC_FRAMES = 32767
POSITION_MIN_STEPS = -(1 << 31)
POSITION_MAX_STEPS = (1 << 31) - 1


@dataclass(frozen=True, slots=True)
class MotorState:
    """Position, forward difference of position and of speed of one motor at one motion frame, in 2^-48 step."""

    p_q48: int
    v_q48: int
    a_q48: int


def position_q48(p_q48: int, term: MotorTerm, frames: int) -> int:
    """Position after `frames` motion frames of `term` from `p_q48`, in 2^-48 step; exact."""
    n = frames
    pairs = n * (n - 1) // 2
    return p_q48 + n * (term.v << V_SHIFT) + pairs * (term.a << A_SHIFT) + pairs * (n - 2) // 3 * term.j


def velocity_q48(term: MotorTerm, frames: int) -> int:
    """Forward difference of position at `frames`, in 2^-48 step/frame; exact."""
    n = frames
    return (term.v << V_SHIFT) + n * (term.a << A_SHIFT) + n * (n - 1) // 2 * term.j


def motor_state_at(p_q48: int, term: MotorTerm, frames: int) -> MotorState:
    """The whole state after `frames` motion frames, in closed form."""
    return MotorState(
        position_q48(p_q48, term, frames),
        velocity_q48(term, frames),
        (term.a << A_SHIFT) + frames * term.j,
    )


def motor_states(p_q48: int, term: MotorTerm, frames: int) -> Iterator[MotorState]:
    """The states at frames 0, 1, .. `frames` by stepping, as the board makes them."""
    p, v, a = p_q48, term.v << V_SHIFT, term.a << A_SHIFT
    yield MotorState(p, v, a)
    for _ in range(frames):
        p += v
        v += a
        a += term.j
        yield MotorState(p, v, a)


def motor_end(p_q48: int, term: MotorTerm, length_frames: int) -> MotorState:
    """The state at the end of a segment."""
    return motor_state_at(p_q48, term, length_frames)


def steps_of(p_q48: int) -> int:
    """The count of whole steps that belongs to a position: floor(p + 1/2)."""
    return (p_q48 + (ONE_STEP >> 1)) >> FRACTION_BITS


def end_positions_q48(positions_q48: Sequence[int], segment: Segment) -> tuple[int, ...]:
    """Positions of all motors after `segment`, motors it does not name unchanged; raises IndexError for a motor
    beyond the sequence.
    """
    ends = list(positions_q48)
    for term in segment.motors:
        ends[term.motor] = position_q48(ends[term.motor], term, segment.length_frames)
    return tuple(ends)


def _clamped(candidates: Iterable[int], last: int) -> Iterator[int]:
    for candidate in candidates:
        if 0 < candidate < last:
            yield candidate


def motor_extremes(term: MotorTerm, length_frames: int) -> tuple[int, int, int, int]:
    """Smallest and largest v and a that the stepping uses over frames 0..length-1, exact: (v_min, v_max, a_min,
    a_max), 2^-48 step/frame^n.

    v(n) is a quadratic in n whose vertex lies at 1/2 - a/j, so over the integers its extremes are at the ends or
    beside the vertex; a(n) is linear. The speeds are those of the frames played (0..length-1) and of the end of the
    segment (frame length), where the next one takes over.
    """
    a0 = term.a << A_SHIFT
    frames = [0, length_frames]
    if term.j:
        vertex = -a0 // term.j
        frames += list(_clamped((vertex - 1, vertex, vertex + 1, vertex + 2), length_frames))
    speeds = [velocity_q48(term, n) for n in frames]
    accelerations = (a0, a0 + (length_frames - 1) * term.j)
    return min(speeds), max(speeds), min(accelerations), max(accelerations)

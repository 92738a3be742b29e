"""What a board may report after what, one report at a time; and a session with a board that cannot be believed."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from rm501_host.config import load_config
from rm501_host.config.board import board_config_from
from rm501_host.session import ContradictionError, LinkLostError, open_session
from rm501_host.session.consistency import Consistency
from rm501_host.transports import open_transport
from rm501_host.virtual_time import run_virtual
from rm501_protocol.enums import BoardState, EndCause, HandState, HoldCause
from rm501_protocol.faults import FaultCode
from rm501_protocol.messages import MotionEnded, SetPositions, SetPower, SetStatusPeriod, Status
from rm501_sim_board.emu_transport import running_board, shut_down
from tests.support.lying_line import Lie, LyingLine

CONFIG = board_config_from(load_config())
WRAP = 1 << 32
FIRST = Status(
    WRAP - 100, 0, WRAP - 50, 0, 0, 1 << 24, BoardState.READY, HoldCause.NONE, FaultCode.NONE, 0, 32, 0,
    (10, 20, 30, 40, 50, 7), 31, True, HandState.UNKNOWN, 0, 0,
)  # fmt: skip


def later(real: int, motion: int, steps: int = 0, motor: int = 1) -> Status:
    """FIRST, so many frames and steps later."""
    places = list(FIRST.positions_steps)
    places[motor] += steps
    return replace(
        FIRST,
        real_frame=(FIRST.real_frame + real) % WRAP,
        motion_frame=(FIRST.motion_frame + motion) % WRAP,
        positions_steps=tuple(places),
    )


def judge(on_its_way: bool = False) -> Consistency:
    found = Consistency(CONFIG, lambda message: on_its_way)
    assert found.contradiction_in(FIRST) is None
    return found


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (later(0, 0), None),
        (later(125, 125, 64), None),
        (later(125, 125, -65), "motor 1 went -65 steps within 125 motion frames"),
        (later(125, 0, 2), None),
        (later(125, 0, 3), "motor 1 went 3 steps within 0 motion frames"),
        (later(125, 0, 800, motor=5), None),  # the hand's pulses run on real frames
        (later(125, 126), "motion time advanced by 126 frames within 125"),
        (later(125, -1), "motion time advanced by -1 frames within 125"),
        (later(-1, 0), "went back by 1"),
        (later(1 << 31, 0), "went back"),
    ],
)
def test_what_can_be_after_a_status(status: Status, words: str | None) -> None:
    found = judge().contradiction_in(status)
    assert (found is None) if words is None else (found is not None and words in found)


def test_a_late_status_is_dropped_and_a_count_that_stays_behind_is_a_contradiction() -> None:
    consistency = judge()
    assert consistency.is_outdated(later(-125, -100), 0)
    assert consistency.is_outdated(later(-1, 0), 4_000_000)
    assert not consistency.is_outdated(later(1, 0), 4_000_000)
    assert consistency.is_outdated(later(-125, -100), 10_000_000)
    assert not consistency.is_outdated(later(-125, -100), 15_000_001)


@pytest.mark.parametrize(
    ("frames", "steps", "words"),
    [
        (0, 0, None),
        (-200, 3, None),
        (50, 26, None),
        (1 << 23, 0, "it reports an end of motion"),
        (50, 40, "motor 0 went 40 steps"),
    ],
)
def test_where_an_end_of_motion_can_be(frames: int, steps: int, words: str | None) -> None:
    at = [(count << 48) for count in FIRST.positions_steps]
    at[0] += steps << 48
    frame = (FIRST.motion_frame + frames) % WRAP
    ended = MotionEnded(EndCause.TRUNCATED, frame, (FIRST.real_frame + frames) % WRAP, tuple(at))
    found = judge().contradiction_in(ended)
    assert (found is None) if words is None else (found is not None and words in found)


def test_positions_that_the_host_defines_may_jump() -> None:
    on_its_way = [True]
    consistency = Consistency(CONFIG, lambda message: on_its_way[0])
    consistency.contradiction_in(FIRST)
    consistency.positions_set(SetPositions(2, (0,) * 6))
    assert consistency.contradiction_in(later(1, 0, 5000)) is None
    on_its_way[0] = False
    assert consistency.contradiction_in(later(2, 0)) is None  # made before, sent after
    assert consistency.contradiction_in(later(3, 0, 5000)) is None
    assert consistency.contradiction_in(later(4, 0)) is not None


@pytest.mark.parametrize(
    ("lie", "error", "words"),
    [(Lie.POSITION, ContradictionError, "motor"), (Lie.GENERATION, LinkLostError, "did not send")],
)
def test_a_session_with_a_board_that_cannot_be_believed_ends_and_says_why(
    lie: Lie, error: type[Exception], words: str
) -> None:
    async def main() -> None:
        line = LyingLine(await open_transport("emu://?seed=1"), 4, (lie,), 1.0)

        async def opened() -> LyingLine:
            return line

        session = await open_session(opened(), CONFIG, lambda: 7)
        try:
            session.post(SetStatusPeriod(20))
            await asyncio.sleep(0.5)
            line.is_lying = True
            with pytest.raises(error, match=words):
                await session.wait_for(lambda notice: None, 8.0)
            assert lie is Lie.GENERATION or isinstance(session.failure, ContradictionError)
        finally:
            await session.aclose()

    run_virtual(main())


def test_a_board_that_falls_behind_its_own_stop_generation_counts_as_silent() -> None:
    """One packet claims a stop that never was: nothing that the host sends is taken any more, and that is noticed."""

    async def main() -> None:
        line = LyingLine(await open_transport("emu://?seed=1"), 1, (Lie.GENERATION,), 1.0)

        async def opened() -> LyingLine:
            return line

        session = await open_session(opened(), CONFIG, lambda: 7)
        try:
            before = session.link.generation
            line.is_lying = True
            while session.link.generation == before:  # noqa: ASYNC110  # polled from outside
                await asyncio.sleep(0.01)
            line.is_lying = False
            await asyncio.sleep(2.0)
            assert session.link_silent
        finally:
            await session.aclose()

    run_virtual(main())


@pytest.mark.parametrize("stop_after_s", [0.0, 0.06, 0.2])
def test_a_stop_that_overtakes_a_definition_of_positions_makes_no_liar_of_the_board(stop_after_s: float) -> None:
    """Nothing acknowledges it any more, and statuses from before it may be on a slow line."""

    async def main() -> None:
        session = await open_session(open_transport("emu://overtaken?seed=1"), CONFIG, lambda: 7)
        board = running_board("overtaken").board
        try:
            session.post(SetStatusPeriod(20))
            await session.command(SetPower(True), lambda status: status.power)
            board.to_host.damage.delay_s = board.to_board.damage.delay_s = 0.15
            await asyncio.sleep(1.0)
            session.post(SetPositions(1, (5000, 0, 0, 0, 0, 0)))
            await asyncio.sleep(stop_after_s)
            await session.stop()
            await asyncio.sleep(1.0)
            assert session.failure is None
            assert session.status is not None and session.status.positions_steps[0] == 5000
        finally:
            await session.aclose()
            shut_down("overtaken")

    run_virtual(main())

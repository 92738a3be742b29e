"""The session against an emulated board: handshake, what it refuses, commands, counters, the end of the link."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rm501_host.config import load_config
from rm501_host.config.board import board_config_from
from rm501_host.errors import NoBoardError, RefusedError, StoppedError
from rm501_host.machine.causes import link_lost
from rm501_host.session import BoardRefusedError, BoardSession, FrameCounter, LinkLostError, open_session
from rm501_host.transports import open_transport
from rm501_host.virtual_time import run_virtual
from rm501_protocol.board_config import BoardConfig
from rm501_protocol.enums import BoardState, HoldCause, ResumeCause, SegmentFlag
from rm501_protocol.link_events import LinkNoisy, StopKind
from rm501_protocol.messages import Hold, Resume, Segment, SetOutputs, SetPower, SetStatusPeriod, Start

T = TypeVar("T")
CONFIG = board_config_from(load_config())


def with_session(body: Callable[[BoardSession], Awaitable[T]], url: str = "emu://", config: BoardConfig = CONFIG) -> T:
    async def main() -> T:
        session = await open_session(open_transport(url), config, lambda: 7)
        try:
            return await body(session)
        finally:
            await session.aclose()

    return run_virtual(main())


def test_a_fresh_board_is_identified_and_needs_no_configuration() -> None:
    async def body(session: BoardSession) -> tuple[BoardState, int]:
        assert session.status is not None
        assert session.link.identify is not None
        return session.status.state, session.link.identify.config_hash

    state, config_hash = with_session(body)
    assert state is BoardState.IDLE
    assert config_hash == CONFIG.hash


def test_another_configuration_is_sent_and_put_in_force() -> None:
    from dataclasses import replace

    slower = replace(CONFIG, link=replace(CONFIG.link, link_timeout_ms=700))

    async def body(session: BoardSession) -> None:
        await session.refresh_status()

    with_session(body, config=slower)


def test_a_powered_board_with_another_configuration_is_refused_naming_what_differs() -> None:
    from dataclasses import replace

    other = replace(CONFIG, link=replace(CONFIG.link, link_timeout_ms=700))

    async def main() -> None:
        first = await open_session(open_transport("emu://kept"), CONFIG, lambda: 7)
        await first.command(SetPower(True), lambda status: status.power)
        await first.aclose()
        with pytest.raises(RefusedError, match=r"READY with another configuration .*instead of") as caught:
            await open_session(open_transport("emu://kept"), other, lambda: 8)
        assert f"{other.hash:08x}" in str(caught.value)

    run_virtual(main())


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("identity:major=9", r"the board speaks protocol 9\.0, this host 1\.0.*update rm501 on this computer"),
        ("identity:config=12345", ""),
    ],
)
def test_a_board_that_says_something_else_is_refused_or_configured(fault: str, word: str) -> None:
    async def body(session: BoardSession) -> None:
        await session.refresh_status()

    if word:
        with pytest.raises(RefusedError, match=word):
            with_session(body, f"emu://?fault={fault}")
    else:
        with_session(body, f"emu://?fault={fault}")


def test_nobody_there(tmp_path: object) -> None:
    async def nobody() -> None:
        await open_session(open_transport("emu://?fault=drop:p=1"), CONFIG, lambda: 7)

    with pytest.raises(NoBoardError, match="no board answers within 5 s"):
        run_virtual(nobody())


def test_a_refusal_is_raised_with_its_reason() -> None:
    async def body(session: BoardSession) -> None:
        with pytest.raises(BoardRefusedError, match="Start") as caught:
            await session.command(Start(), lambda status: status.state is BoardState.RUNNING)
        assert caught.value.refused.message_id == Start.ID
        with pytest.raises(BoardRefusedError, match="Resume"):
            await session.command(Resume(), lambda status: False)

    with_session(body)


def test_a_stop_is_acknowledged_and_ends_the_generation() -> None:
    async def body(session: BoardSession) -> tuple[int, int]:
        await session.command(SetPower(True), lambda status: status.power)
        before = session.link.generation
        await session.stop(StopKind.STOP)
        return before, session.link.generation

    before, after = with_session(body)
    assert after == (before + 1) & 0xFF


def test_a_restarted_board_ends_the_session_for_everyone_who_waits() -> None:
    async def body(session: BoardSession) -> None:
        with pytest.raises(LinkLostError, match="home the arm"):
            await session.wait_for(lambda notice: None)
        assert session.failure is not None
        with pytest.raises(LinkLostError):
            session.post(Start())

    with_session(body, "emu://?fault=reset@1s")


def test_a_pulled_plug_ends_the_session_and_says_what_the_arm_does() -> None:
    async def body(session: BoardSession) -> None:
        with pytest.raises(LinkLostError, match="holds on its path by itself") as caught:
            await session.wait_for(lambda notice: None)
        shown = link_lost(caught.value)
        assert f"{shown.text}; {shown.remedy}".count("holds on its path") == 1
        assert f"{shown.text}; {shown.remedy}".count("connection to the board") == 1

    with_session(body, "emu://?fault=unplug@1s")


def test_commands_get_through_a_line_that_loses_bytes() -> None:
    async def body(session: BoardSession) -> int:
        for on in (True, False) * 5:
            await session.command(SetPower(on), lambda status, on=on: status.power is on)  # type: ignore[misc]
            await asyncio.sleep(0.05)
        return session.link.stats.retransmits

    assert with_session(body, "emu://?seed=3&fault=drop:p=0.005") > 0


@given(st.lists(st.integers(min_value=-(1 << 30), max_value=1 << 30), min_size=1, max_size=50), st.integers(0, 1 << 40))
def test_counters_never_wrap(steps: list[int], start: int) -> None:
    counter = FrameCounter()
    first = counter.read(start & 0xFFFFFFFF)
    true = first
    for step in steps:
        true += step
        assert counter.read(true & 0xFFFFFFFF) == true


def waiting_segments(session: BoardSession, count: int, first: int = 0) -> None:
    """Segments of a second each, one after the other, at rest: more than the board has room for."""
    start = session.motion_frames.value
    for number in range(first, first + count):
        session.post(Segment(start + 3125 * number, 3125, (), flags=SegmentFlag.ENDS_AT_REST))


def test_a_hold_goes_ahead_of_segments_that_wait_for_room() -> None:
    async def body(session: BoardSession) -> tuple[float, float]:
        loop = asyncio.get_running_loop()
        await session.command(SetPower(True), lambda status: status.power)
        waiting_segments(session, 2)
        session.post(Start())
        waiting_segments(session, 58, first=2)
        await asyncio.sleep(0.5)
        assert session.link.pending > 20
        began_s = loop.time()
        status = await session.command(Hold(), lambda now: now.state is BoardState.HELD)
        held_s = loop.time() - began_s
        assert status.hold_cause is HoldCause.USER and session.link.pending > 20
        await session.command(Resume(ResumeCause.USER), lambda now: now.state is BoardState.RUNNING)
        return held_s, loop.time() - began_s

    held_s, resumed_s = with_session(body)
    assert held_s < 0.1 and resumed_s < 0.2


def test_a_command_that_cannot_be_sent_is_taken_back_and_never_obeyed_later() -> None:
    async def body(session: BoardSession) -> None:
        await session.command(SetPower(True), lambda status: status.power)
        waiting_segments(session, 40)
        await asyncio.sleep(0.5)
        waits = session.link.pending
        assert waits > 0
        with pytest.raises(StoppedError, match=f"SetOutputs was not sent: it waited 3 s behind {waits} messages"):
            await session.command(SetOutputs(1, 1), lambda status: bool(status.outputs & 1))
        assert session.link.pending == waits
        session.post(Start())
        await asyncio.sleep(30.0)
        assert (await session.refresh_status()).outputs & 1 == 0

    with_session(body)


def test_a_bad_line_is_told_with_its_figures_until_it_is_good_again() -> None:
    noises: list[LinkNoisy] = []

    async def body(session: BoardSession) -> None:
        session.add_listener(lambda notice: noises.append(notice) if isinstance(notice, LinkNoisy) else None)
        session.post(SetStatusPeriod(20))
        assert session.noise_warning is None
        await asyncio.sleep(40.0)
        assert noises
        warning = session.noise_warning
        assert warning is not None and f"{noises[-1].bad_frames} of {noises[-1].frames} frames" in warning
        assert "check the cable" in warning
        await asyncio.sleep(60.0)  # the fault ends after 50 s
        assert session.noise_warning is None

    with_session(body, "emu://?seed=3&fault=flip:p=0.0005@1s/50s")


def test_a_good_line_is_not_called_bad() -> None:
    async def body(session: BoardSession) -> str | None:
        session.post(SetStatusPeriod(20))
        await asyncio.sleep(30.0)
        return session.noise_warning

    assert with_session(body, "emu://?seed=3&fault=flip:p=0.00002") is None

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
from rm501_host.errors import NoBoardError, RefusedError
from rm501_host.session import BoardRefusedError, BoardSession, FrameCounter, LinkLostError, open_session
from rm501_host.transports import open_transport
from rm501_host.virtual_time import run_virtual
from rm501_protocol.board_config import BoardConfig
from rm501_protocol.enums import BoardState
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import Resume, SetPower, Start

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


@pytest.mark.parametrize(("fault", "word"), [("identity:major=9", "protocol 9"), ("identity:config=12345", "")])
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
        with pytest.raises(LinkLostError, match="holds on its path by itself"):
            await session.wait_for(lambda notice: None)

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

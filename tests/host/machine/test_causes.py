"""What an operator reads does not depend on the order in which chance lets things be noticed."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rm501_host.errors import StoppedError
from rm501_host.machine import MachineState, causes, operations
from rm501_host.machine.causes import Cause, Causes, Rank
from rm501_host.motion import MotionStream
from rm501_host.session import LinkLostError, SessionLostError
from rm501_host.virtual_time import run_virtual
from rm501_protocol.faults import FaultCode
from rm501_protocol.link_events import LossReason
from rm501_sim_board.emu_transport import running_board, shut_down
from tests.support.virtual_machine import ME, homed, running_service

START = (0.0, 60.0, -60.0, 60.0, 0.0)
NEXT = (60.0, 75.0, -45.0, 30.0, 20.0)

OVERFLOW = causes.board_fault(FaultCode.OVERFLOW)
SILENCE = causes.link_lost(LinkLostError("the connection is lost: it has been silent for 4 s", "silent for 4 s"))
ONE_OF_EACH = (
    causes.CONNECTING,
    causes.STARTED,
    causes.AFTER_RESET,
    causes.POWERED_OFF,
    causes.unsettled("no Status"),
    causes.OPERATOR_STOP,
    causes.silent(3.0),
    SILENCE,
    causes.link_lost(SessionLostError(LossReason.EPOCH_CHANGED)),
    causes.link_lost(SessionLostError(LossReason.BOARD_RESTARTED)),
    causes.refused_connection("another configuration"),
    OVERFLOW,
)


def shown(found: Causes) -> Cause:
    assert found.shown is not None
    return found.shown


def test_there_is_one_of_each() -> None:
    assert [cause.rank for cause in ONE_OF_EACH] == list(Rank)


@given(st.lists(st.sampled_from(ONE_OF_EACH), min_size=1), st.randoms(use_true_random=False))
def test_the_order_in_which_causes_are_noticed_does_not_matter(noticed: list[Cause], random: object) -> None:
    first, second = Causes(), Causes()
    ranks = []
    for cause in noticed:
        news = cause not in [*noticed[: noticed.index(cause)]] and cause != causes.CONNECTING
        assert first.add(cause) is (news and noticed.index(cause) == len(ranks))
        ranks.append(shown(first).rank)
        assert shown(first).rank >= cause.rank
    assert ranks == sorted(ranks), "a later one of lower rank has replaced what was shown"
    shuffled = list(noticed)
    random.shuffle(shuffled)  # type: ignore[attr-defined]  # Hypothesis's random.Random
    for cause in shuffled:
        second.add(cause)
    assert first.shown == second.shown and first.connection == second.connection
    first.clear()
    assert first.shown is None


def test_nobody_is_told_to_restore_a_connection_that_has_come_back() -> None:
    found = Causes()
    found.add(causes.silent(3.0))
    found.add(SILENCE)
    assert "restore the connection" in shown(found).remedy
    found.connected(restarted=False, fault=None)
    assert shown(found).text == SILENCE.text
    assert shown(found).remedy.startswith("the connection is back: look at the arm, reset, and home")


@pytest.mark.parametrize("restarted", [False, True])
@pytest.mark.parametrize("is_latched", [False, True])
def test_after_reconnecting_the_order_before_it_does_not_matter(restarted: bool, is_latched: bool) -> None:
    """The line falls silent in a motion, the motion breaks off, the board may have latched a fault, or restarts."""
    before = (causes.OPERATOR_STOP, causes.unsettled("no Status"), causes.silent(3.0), SILENCE, OVERFLOW)
    fault = OVERFLOW if is_latched else None
    after = set()
    for order in itertools.permutations(before):
        found = Causes()
        found.clear()
        for cause in order:
            found.add(cause)
        assert shown(found).text == f"{OVERFLOW.text}; and {SILENCE.text}"
        assert shown(found).remedy == f"{SILENCE.remedy}; then: {OVERFLOW.remedy}"
        assert found.connection == SILENCE
        found.not_connected()
        found.not_connected("the board is RUNNING with another configuration")
        assert "another configuration" in found.connection.text
        found.not_connected()
        assert found.connection == SILENCE
        found.connected(restarted=restarted, fault=fault)
        after.add(shown(found))
    line_lost = replace(SILENCE, remedy=SILENCE.back, back="")
    assert after == {OVERFLOW if is_latched else causes.BOARD_RESTARTED if restarted else line_lost}


def test_a_connection_that_was_refused_is_no_reason_once_there_is_one() -> None:
    found = Causes()
    assert found.shown == causes.CONNECTING
    found.not_connected("the board speaks protocol 2, this host 1")
    assert shown(found).rank is Rank.REFUSED_CONNECTION and found.connection == found.shown
    found.not_connected()
    assert found.shown == causes.CONNECTING
    found.connected(restarted=False, fault=None)
    assert found.shown == causes.STARTED


async def _until(is_so: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not is_so():  # noqa: ASYNC110  # polled from outside
            await asyncio.sleep(0.02)


@pytest.mark.parametrize("boot", ["same", "another"])
def test_a_motion_that_breaks_off_while_the_board_is_silent_never_hides_that_it_was_silent(
    tmp_path: Path, boot: str
) -> None:
    """The motion is aborted at any time around the silence: before it, in it, when it is given up, after it."""

    told: set[str] = set()

    async def scenario() -> None:
        async with running_service(tmp_path, "emu://silent?preset=ideal&seed=1") as service:
            machine = service.machine
            await homed(service)
            faults = running_board("silent").faults
            loop = asyncio.get_running_loop()
            for tenths in (-6, 6, 18, 30, 42) if boot == "same" else (-6, 42):
                await operations.move_joints(machine, ME, START).wait()
                await machine.set_override(0.1, ME)
                job = operations.move_joints(machine, ME, NEXT)
                await asyncio.sleep(1.0)
                loop.call_later(1.0, faults.inject, "drop:p=1/7s")
                if boot == "another":
                    loop.call_later(7.0, faults.inject, "reset")
                await asyncio.sleep(1.0 + tenths / 10)
                aborting = asyncio.gather(machine.abort(ME), return_exceptions=True)
                await _until(lambda: machine.state is MachineState.ESTOP)
                await _until(lambda: not machine.connected)
                assert machine.cause is not None and machine.cause.rank is Rank.LINK_LOST, tenths
                assert not any(machine.arm_state.homed)
                await _until(lambda: machine.connected)
                # what the motion was still waiting for runs out only now
                await asyncio.sleep(10.0)
                await aborting
                assert job.done.is_set()
                assert machine.state is MachineState.ESTOP and machine.cause is not None
                told.add(re.sub(r"for \d s", "for some s", f"{machine.cause.text}; {machine.cause.remedy}"))
                await machine.set_override(1.0, ME)
                await machine.reset(ME)
                assert machine.cause is None
                if boot == "another":
                    await operations.home(machine, ME).wait()
            shut_down("silent")

    run_virtual(scenario())
    assert len(told) == 1, told
    (text,) = told
    lost = "the connection to the board is lost: it has been silent for some s; the connection is back: look at the arm"
    assert text.startswith("the board restarted and lost its position" if boot == "another" else lost)


def test_a_line_that_comes_and_goes_while_a_motion_breaks_off_is_what_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is never silent for long enough to be given up, nor there for long enough to say where the arm is."""

    async def scenario() -> None:
        async with running_service(tmp_path, "emu://flickers?preset=ideal&seed=1") as service:
            machine = service.machine
            await homed(service)
            faults = running_board("flickers").faults
            await operations.move_joints(machine, ME, START).wait()
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(1.0)

            async def ask_in_vain(stream: MotionStream) -> None:
                faults.inject("drop:p=1/3s")
                await asyncio.sleep(2.5)
                raise StoppedError("the board did not send Status within 2 s")

            with monkeypatch.context() as patch:
                patch.setattr(MotionStream, "prepare", ask_in_vain)
                await machine.abort(ME)
            assert job.done.is_set() and machine.connected
            assert machine.state is MachineState.ESTOP and machine.cause is not None
            assert re.fullmatch(
                r"the board did not answer for \d s while a motion broke off; "
                "where that has left the arm is not known",
                machine.cause.text,
            )
            await asyncio.sleep(3.0)
            assert machine.connected
            await machine.reset(ME)
            await operations.move_joints(machine, ME, NEXT).wait()
            assert machine.arm_state.joints_deg == pytest.approx(NEXT, abs=0.03)
            shut_down("flickers")

    run_virtual(scenario())


@pytest.mark.parametrize("delay_ms", [0, 100, 900])
def test_a_stop_during_an_abort_is_shown_as_a_stop(tmp_path: Path, delay_ms: int) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            job = operations.move_joints(machine, ME, NEXT)
            await asyncio.sleep(1.0)
            aborting = asyncio.gather(machine.abort(ME), return_exceptions=True)
            await asyncio.sleep(delay_ms / 1000)
            await machine.stop(ME)
            await aborting
            await asyncio.sleep(2.0)
            assert job.done.is_set()
            assert (machine.state, machine.cause) == (MachineState.OFF, causes.OPERATOR_STOP)

    run_virtual(scenario())


def test_a_line_that_falls_silent_as_a_motion_begins_is_what_is_told(tmp_path: Path) -> None:
    """The motion is not begun, and the board is asked in vain where it stands, until after the connection is lost."""
    told: set[str] = set()

    async def scenario() -> None:
        async with running_service(tmp_path, "emu://begins-silent?preset=ideal&seed=1") as service:
            machine = service.machine
            await homed(service)
            faults = running_board("begins-silent").faults
            for phase in range(5):  # of the looks at whether the board is silent, 0.75 s apart
                await operations.move_joints(machine, ME, START).wait()
                await asyncio.sleep(0.15 * phase)
                job = operations.move_joints(machine, ME, NEXT)
                await asyncio.sleep(0.008)
                faults.inject("drop:p=1/7s")
                await _until(lambda: not machine.connected)
                await _until(lambda: machine.connected)
                await asyncio.sleep(10.0)
                assert job.done.is_set()
                assert machine.state is MachineState.ESTOP and machine.cause is not None
                told.add(re.sub(r"for \d s", "for some s", machine.cause.text))
                await machine.reset(ME)
            shut_down("begins-silent")

    run_virtual(scenario())
    assert told == {"the connection to the board is lost: it has been silent for some s"}

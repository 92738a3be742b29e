"""Faults: how they are written, that each of them strikes and ends, and that they repeat with the seed."""

from __future__ import annotations

import asyncio

import pytest

from benchmarks.fault_scenarios import flooded_queue, stop_while_held
from benchmarks.faults import LONG_TEXT, run_case
from rm501_host.virtual_time import run_virtual
from rm501_protocol.enums import BoardState
from rm501_sim_board.emu_transport import EmuTransport, open_transport
from rm501_sim_board.errors import FaultSpecError
from rm501_sim_board.fault_injection import check_fault, fault_table
from rm501_sim_board.fault_kinds import FAULT_KINDS
from rm501_sim_board.fault_spec import AtAngle, AtRandom, AtTime, parse_fault
from rm501_sim_board.geometry import Joint
from tests.support.board_client import BoardClient

BENCH_ROWS = set(range(1, 20)) | {24, 25, 26, 27, 28}

EXAMPLES = {
    "switch-stuck-active": "switch-stuck-active:joint=roll",
    "switch-stuck-inactive": "switch-stuck-inactive:joint=roll",
    "switch-bounce": "switch-bounce:joint=roll",
    "load": "load:motor=elbow",
    "lost-steps": "lost-steps:motor=elbow",
    "stall": "stall:motor=elbow",
    "swap": "swap:line=elbow_select,with=waist_select",
    "line-stuck": "line-stuck:line=dir_1",
    "no-inverter": "no-inverter:line=dir_1",
}


def test_specifications_are_understood() -> None:
    assert parse_fault("flip:p=1e-4").when == AtTime(0.0)
    assert parse_fault("stall:motor=elbow@2.5s").when == AtTime(2.5)
    assert parse_fault("stall:motor=elbow@waist>-20deg").when == AtAngle(Joint.WAIST, True, -20.0)
    assert parse_fault("burst:ms=50@0.2/s").when == AtRandom(0.2)
    spec = parse_fault("unplug@10s/0.5s")
    assert (spec.when, spec.duration_s) == (AtTime(10.0), 0.5)
    assert parse_fault("burst@0.2/s/3s").duration_s == 3.0


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "no name"),
        ("stall:motor", "KEY=VALUE"),
        ("stall:motor=elbow@soon", "2.5s"),
        ("stall:motor=elbow@nose>3", "no joint"),
        ("stall:motor=elbow@1s/x", "duration"),
        ("burst@-1/s", "never happens"),
        ("burst@x/s", "not like 2.5s"),
        ("gremlins", "not known"),
        ("stall:motor=nose", "left-wrist"),
        ("stall:engine=elbow", "no parameter 'engine'"),
        ("flip:p=often", "not a number"),
        ("flip:p=nan", "not a number"),
    ],
)
def test_nonsense_is_refused_by_name(text, word) -> None:
    with pytest.raises(FaultSpecError, match=word):
        check_fault(parse_fault(text))


def test_every_row_of_the_catalogue_that_a_bench_can_show_is_there() -> None:
    served = {row for kind in FAULT_KINDS for row in kind.rows}
    assert BENCH_ROWS - served == set()
    for kind in FAULT_KINDS:
        assert kind.name in fault_table()


@pytest.mark.parametrize("name", [kind.name for kind in FAULT_KINDS])
def test_every_fault_strikes_is_logged_and_the_board_outlives_it(name) -> None:
    async def main() -> None:
        transport = await open_transport("emu://?preset=real")
        client = BoardClient(transport)
        await client.open()
        transport.faults.inject(EXAMPLES.get(name, name) + "@0.5s/0.2s")
        await asyncio.sleep(0.6)
        assert [event.name for event in transport.faults.log if event.began] == [name]
        await asyncio.sleep(1.0)
        assert transport.faults.active == ()
        if not client.closed:
            link = BoardClient(transport)
            await link.open(nonce=3)
            assert (await link.status()).state in (BoardState.IDLE, BoardState.FAULT)
        await transport.aclose()

    run_virtual(main())


def _log(seed: int) -> list[tuple[int, str]]:
    async def main() -> list[tuple[int, str]]:
        transport: EmuTransport = await open_transport(f"emu://?seed={seed}&fault=burst:ms=5@3/s")
        await asyncio.sleep(5.0)
        await transport.aclose()
        return [(event.frame, event.name) for event in transport.faults.log]

    return run_virtual(main())


def test_random_faults_repeat_with_the_seed() -> None:
    assert _log(1) == _log(1)
    assert _log(1) != _log(2)
    assert 5 <= len(_log(1)) <= 30


def test_a_fault_strikes_when_a_joint_passes_an_angle() -> None:
    async def main() -> None:
        transport = await open_transport("emu://?fault=lost-steps:motor=waist,n=40@waist>-50")
        client = BoardClient(transport)
        await client.open()
        await client.power_on()
        client.jump(0, 800, 2.0)
        client.start()
        await asyncio.sleep(2.5)
        truth = transport.truth()
        (event,) = transport.faults.log
        at = transport.emulator.recording.positions_steps([event.frame])[0, 0]
        assert 400 <= at <= 450
        assert truth.commanded_steps[0] == 800
        assert truth.joint_deg[0] == pytest.approx(-60.0 + (800 - 40) / 40)
        await transport.aclose()

    run_virtual(main())


@pytest.mark.parametrize("firmware", ["fast", "reference"])
def test_all_counters_wrap_in_the_middle_of_a_move(firmware) -> None:
    async def main() -> None:
        url = f"emu://?firmware={firmware}&fault=clock-wrap:frames=2000,motion_frames=1500"
        transport = await open_transport(url)
        client = BoardClient(transport)
        await client.open()
        before = await client.status()
        assert before.real_frame > 0xFFFFF000
        assert before.motion_frame == (1 << 32) - 1500
        await client.power_on()
        client.next_frame = before.motion_frame
        client.jump(0, 800, 2.0)
        client.start()
        await asyncio.sleep(2.5)
        after = await client.status()
        assert after.real_frame < 10_000
        assert after.motion_frame == 6250 - 1500
        assert after.clock_ticks == after.real_frame * 320
        assert after.positions_steps[0] == transport.truth().commanded_steps[0] == 800
        await transport.aclose()

    run_virtual(main())


@pytest.mark.parametrize("given", ["frames=0", "frames=1.5", "frames=4294967296", "motion_frames=0"])
def test_a_wrap_that_is_no_number_of_frames_is_refused(given) -> None:
    async def main() -> None:
        with pytest.raises(OSError, match="clock-wrap"):
            await open_transport(f"emu://?fault=clock-wrap:{given}")

    run_virtual(main())


def test_what_finds_no_slot_is_refused_and_the_rest_plays_on() -> None:
    assert run_virtual(flooded_queue(1)) == ""


def test_nothing_that_was_held_runs_after_a_stop() -> None:
    assert run_virtual(stop_while_held(1)) == ""


def test_the_host_names_the_full_queue_when_a_board_promised_too_many_slots() -> None:
    outcome = run_case("queue-lie:slots=255", 1, LONG_TEXT)
    assert "no free slot" in outcome.text
    assert (outcome.late_steps, outcome.trusted_mask) == (0, 0b11111)


@pytest.mark.parametrize(
    "text",
    [
        "flip:p=2",
        "drop:p=-0.1",
        "garbage:bytes=-5",
        "burst:ms=-1",
        "line-stuck:line=strobe_724,level=7",
        "payload:kg=-1",
    ],
)
def test_a_number_that_cannot_be_is_refused_with_its_range(text: str) -> None:
    with pytest.raises(FaultSpecError, match="choose"):
        check_fault(parse_fault(text))

"""An arm with play on the emulated board: where its link really stands, and what is known of it after any stop."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from rm501_host.errors import StoppedError
from rm501_host.machine import operations
from rm501_host.machine.verify import verify
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.presets import PRESETS
from tests.support.loose_bench import LOOSE as LOOSE_BENCH
from tests.support.loose_bench import SWITCH_ERROR_DEG, link_deg, loose_bench, waist_errors_deg
from tests.support.play import with_backlash
from tests.support.virtual_machine import ME, homed, running_service, thesis_config

PLAY_DEG = 0.6
STIFF = thesis_config()
LOOSE = with_backlash(STIFF, (PLAY_DEG, 0.0, 0.0, 0.0, 0.0))
POSE = (0.0, 60.0, -60.0, 60.0, 0.0)
ONE_STEP_DEG = 0.025


@pytest.fixture(autouse=True)
def bench(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PRESETS, LOOSE_BENCH, loose_bench(PLAY_DEG))


def test_the_link_comes_to_the_same_place_from_both_sides() -> None:
    stiff = run_virtual(waist_errors_deg(STIFF, -120.0))
    loose = run_virtual(waist_errors_deg(LOOSE, -120.0))
    assert np.ptp(stiff) == pytest.approx(PLAY_DEG, abs=1.5 * ONE_STEP_DEG)
    assert np.ptp(loose) <= 1.5 * ONE_STEP_DEG


def test_homing_leaves_the_link_where_the_switch_says() -> None:
    """Whichever way the first search went: from above the switch, and from on it."""
    for pose in (-150.3, -100.0):
        errors = run_virtual(waist_errors_deg(LOOSE, pose))
        assert np.array(errors) == pytest.approx(SWITCH_ERROR_DEG, abs=0.09)


def test_the_play_is_known_after_an_abort_in_another_daemon_and_for_verify(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path, "emu://loose?preset=loose&seed=3", LOOSE) as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, (10.0, *POSE[1:])).wait()
            assert machine.stream is not None
            assert machine.stream.offsets.deg[0] == PLAY_DEG / 2

            # ended in the middle of a take-up
            job = operations.move_joints(machine, ME, (-20.0, *POSE[1:]))
            async with asyncio.timeout(5):
                while not -0.25 < machine.arm_state.offsets_deg[0] < 0.2:  # noqa: ASYNC110  # polled from outside
                    await asyncio.sleep(0.001)
            await machine.abort(ME)
            with pytest.raises(StoppedError):
                await job.wait()
            await asyncio.sleep(0.3)
            assert -PLAY_DEG / 2 < machine.stream.offsets.deg[0] < PLAY_DEG / 2
            assert machine.stream.offsets.deg == machine.arm_state.offsets_deg
            assert machine.arm_state.joints_deg[0] == pytest.approx(machine.planning_start_deg[0], abs=0.03)

            # back the way it came, and from the other side
            for angle, side in ((12.0, 1), (-12.0, -1)):
                await operations.move_joints(machine, ME, (angle, *POSE[1:])).wait()
                await asyncio.sleep(0.5)
                assert link_deg() - angle == pytest.approx(SWITCH_ERROR_DEG, abs=0.09)
                assert machine.arm_state.offsets_deg == (side * PLAY_DEG / 2, 0.0, 0.0, 0.0, 0.0)
                assert machine.arm_state.joints_deg[0] == pytest.approx(angle, abs=ONE_STEP_DEG)

            # another daemon finds it in the position file, and says so where it does not
            joints = machine.arm_state.joints_deg
            identify, status = machine.session.link.identify, machine.board_status
            assert identify is not None and status is not None
            fresh = type(machine.arm_state)(machine.arm, LOOSE, machine.arm_state._file, lambda: "")
            assert "not known" not in fresh.connected(identify, status)
            assert fresh.joints_deg == joints
            assert machine.arm_state.save(dirty=True)
            text = fresh.connected(identify, status)
            assert "on which side of its play each joint stands is not known (waist)" in text
            assert fresh.joints_deg[0] == pytest.approx(joints[0] - PLAY_DEG / 2)

            await operations.move_joints(machine, ME, (-140.0, *POSE[1:])).wait()
            verified = verify(machine, ME, ["waist"])
            await verified.wait()
            (result,) = verified.result["joints"]
            assert abs(result["lost_deg"]) <= 2 * ONE_STEP_DEG

    run_virtual(scenario())


PROGRAM = """G21 G90 G94 G61 F1500
G0 X230 Y-60 Z-120 A0 B0 C0
G64 P2
o100 repeat [3]
G1 X260 Y-60 Z-110
G1 X230 Y60 Z-120
G1 X260 Y60 Z-110
G1 X230 Y-60 Z-120
o100 endrepeat
M2
"""


def test_override_hold_and_running_back_keep_the_play(tmp_path: Path) -> None:
    """Cut and replanned in motion, held at any place, run back and forward again: the end is exact, on its flank."""
    config = with_backlash(STIFF, (0.4, 0.2, 0.2, 0.3, 0.3))

    async def scenario() -> None:
        async with running_service(tmp_path, config=config) as service:
            machine, programs = service.machine, service.programs
            (tmp_path / "programs").mkdir(exist_ok=True)
            (tmp_path / "programs" / "a.ngc").write_text(PROGRAM)
            await homed(service)
            ends = []
            for disturbed in (False, True):
                await operations.move_joints(machine, ME, POSE).wait()
                job = await programs.run(ME, "a.ngc")
                if disturbed:
                    await asyncio.sleep(6.0)
                    await machine.set_override(2.0, ME)
                    for wait_s in (3.3, 1.7):
                        await asyncio.sleep(wait_s)
                        assert await machine.hold(ME)
                        await asyncio.sleep(2.0)
                        assert machine.stream is not None
                        seen = np.array(machine.planning_start_deg)
                        await programs.run_back(ME, 2.0)
                        await asyncio.sleep(6.0)
                        assert float(np.abs(seen - machine.planning_start_deg).max()) > 0.5
                        await machine.resume(ME)
                await job.wait()
                await machine.set_override(1.0, ME)
                assert machine.stream is not None
                ends.append((machine.planning_start_deg, machine.stream.offsets.deg))
            np.testing.assert_allclose(ends[1][0], ends[0][0], atol=1e-4)
            assert ends[1][1] == ends[0][1]
            assert {abs(offset) for offset in ends[0][1]} <= {0.0, 0.2, 0.1, 0.15}

    run_virtual(scenario())

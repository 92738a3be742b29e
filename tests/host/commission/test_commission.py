"""What a person's answers become, verify against real lost steps, and the doctor's verdicts."""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path

import numpy as np
import pytest

from rm501_host.commission.derive import CommissionError, Seen, drive_signs, switches_swapped, wrist_matrix
from rm501_host.commission.diagnosis import judge
from rm501_host.machine import operations
from rm501_host.machine.verify import verify
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, homed, running_service

DEFAULT = ((-1.0, 1.0), (1.0, 1.0))


def test_the_wrist_matrix_is_found_whatever_the_wiring_is() -> None:
    """Oracle: an arm with a true matrix T, commanded through M, moves its joints by T^-1 M; the answers give T back."""
    true_matrices = []
    for swap, first, second in itertools.product((False, True), (-1, 1), (-1, 1)):
        rows = np.array(DEFAULT)[::-1] if swap else np.array(DEFAULT)
        true_matrices.append(np.diag((first, second)) @ rows)
    for true in true_matrices:
        moved = np.linalg.inv(true) @ np.array(DEFAULT)
        answers = [next(seen for seen in Seen if np.allclose(seen.value, moved[:, column])) for column in (0, 1)]
        assert np.allclose(wrist_matrix(DEFAULT, *answers), true)


def test_contradictions_are_refused() -> None:
    with pytest.raises(CommissionError, match="same joint"):
        wrist_matrix(DEFAULT, Seen.PITCH_PLUS, Seen.PITCH_MINUS)
    with pytest.raises(CommissionError, match="SWITCH_WAIST showed as SWITCH_ELBOW"):
        switches_swapped({"SWITCH_WAIST": "SWITCH_ELBOW", "SWITCH_ELBOW": "SWITCH_WAIST"}, False)


def test_signs_and_swapped_switches() -> None:
    assert drive_signs((1, -1, -1), (True, False, True)) == (1, 1, -1)
    right = {name: name for name in ("SWITCH_WAIST", "SWITCH_PITCH", "SWITCH_ROLL")}
    assert switches_swapped(right, True) is True
    assert switches_swapped({"SWITCH_PITCH": "SWITCH_ROLL", "SWITCH_ROLL": "SWITCH_PITCH"}, False) is True


def test_verify_finds_lost_steps_and_only_those(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(
            tmp_path, "emu://?preset=ideal&seed=1&fault=lost-steps:motor=elbow,n=40@200s"
        ) as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, (0.0, 60.0, -60.0, 60.0, 0.0)).wait()
            before = await verify(machine, ME).wait()
            assert all(not joint["suspicious"] for joint in before["joints"]), before
            assert asyncio.get_running_loop().time() < 200
            await asyncio.sleep(200)
            after = await verify(machine, ME).wait()
            lost = {joint["joint"]: joint["lost_steps"] for joint in after["joints"]}
            assert abs(lost.pop("elbow")) == pytest.approx(40, abs=4)
            assert all(abs(steps) < 8 for steps in lost.values())
            assert machine.arm_state.joints_deg == pytest.approx((0.0, 60.0, -60.0, 60.0, 0.0), abs=0.05)

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("stall", "trip", "lead", "fit"),
    [
        (0.01, 1.0, 3.0, True),
        (0.3, 1.0, 3.0, False),
        (0.01, 9.0, 3.0, False),
        (0.2, 1.0, 0.1, False),
        (0.01, 1.0, None, True),
    ],
)
def test_the_doctor(stall: float, trip: float, lead: float | None, fit: bool) -> None:
    measured = {"longest_stall_s": stall, "round_trip_p99_ms": trip, "least_queue_lead_s": lead}
    assert all(good for good, _ in judge(measured, stall_budget_s=0.5)) is fit

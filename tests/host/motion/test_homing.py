"""Homing on the emulated arm: from anywhere, with every switch fault, with dynamics and noise."""

from __future__ import annotations

import random

import pytest

from rm501_host.config import JOINT_NAMES, load_config
from rm501_host.config.board import board_config_from
from rm501_host.kinematics import Arm
from rm501_host.motion import HomedJoint, Homing, HomingError, MotionStream
from rm501_host.session import open_session
from rm501_host.transports import open_transport
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.bench import Truth
from rm501_sim_board.emu_transport import running_board

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
ONE_STEP_DEG = 0.0376
"""Of a wrist motor. The pose at power-up is no whole number of steps, and the wrist adds what two motors leave."""


def home(query: str) -> tuple[list[HomedJoint], Truth, int]:
    async def main() -> tuple[list[HomedJoint], Truth, int]:
        url = f"emu://homing?{query}"
        session = await open_session(open_transport(url), board_config_from(CONFIG), lambda: 7)
        try:
            stream = MotionStream(session, CONFIG, someone_resumes=False)
            await stream.prepare()
            homed = await Homing(stream, ARM, CONFIG).home_all()
            status = await session.refresh_status()
            return homed, running_board("homing").emulator.truth(), status.trusted_mask
        finally:
            await session.aclose()

    return run_virtual(main())


def pose_query(angles: list[float]) -> str:
    return "pose=" + ",".join(f"{angle:.3f}" for angle in angles)


@pytest.mark.parametrize("seed", range(2))
def test_from_any_pose_the_arm_ends_exactly_at_home(seed: int) -> None:
    draw = random.Random(seed)
    joints = CONFIG.joints.ordered
    homed, truth, trusted = home(pose_query([draw.uniform(j.min_deg + 1, j.max_deg - 1) for j in joints]))
    assert [result.joint for result in homed] == list(JOINT_NAMES)
    assert truth.joint_deg == pytest.approx(CONFIG.home_deg, abs=ONE_STEP_DEG)
    assert trusted == 0b11111
    assert all(result.spread_deg <= 0.04 for result in homed)


def test_a_switch_that_is_active_at_the_start_is_left_first() -> None:
    _, truth, _ = home("pose=-150.3,102.5,-90.5,0.1,-120")
    assert truth.joint_deg == pytest.approx(CONFIG.home_deg, abs=ONE_STEP_DEG)


@pytest.mark.parametrize("joint", ["waist", "shoulder", "roll"])
@pytest.mark.parametrize("kind", ["active", "inactive"])
def test_a_switch_that_is_stuck_fails_naming_joint_and_switch(joint: str, kind: str) -> None:
    with pytest.raises(HomingError) as caught:
        home(f"fault=switch-stuck-{kind}:joint={joint}")
    assert caught.value.joint == joint
    assert caught.value.input == f"SWITCH_{joint.upper()}"
    assert "not trusted" in str(caught.value)


def test_a_switch_that_closes_on_the_way_home_stops_there() -> None:
    # the waist starts 0.2 deg past its switch, it is on its way home from about 3 to 6 s after power-up
    with pytest.raises(HomingError, match=r"waist: the switch closed again on the way home .SWITCH_WAIST.") as caught:
        home("pose=-150.3,60,-60,60,0&fault=switch-stuck-active:joint=waist@4s")
    assert "ignore_limits" in str(caught.value)


def test_a_home_position_past_the_switch_is_reached_when_limits_are_ignored() -> None:
    pitch = CONFIG.joints.pitch.home
    assert pitch.ignore_limits and pitch.home_deg < pitch.switch_deg
    _, truth, _ = home("pose=10,60,-60,60,0")
    assert truth.joint_deg[3] == pytest.approx(pitch.home_deg, abs=ONE_STEP_DEG)


def test_bounce_of_twenty_milliseconds_does_not_move_home() -> None:
    _, truth, _ = home("fault=switch-bounce:joint=waist,ms=20")
    # at 5 deg/s the first contact is up to 0.1 deg of bouncing away from the last
    assert truth.joint_deg[0] == pytest.approx(0.0, abs=0.13)
    assert truth.joint_deg[1:] == pytest.approx(CONFIG.home_deg[1:], abs=ONE_STEP_DEG)


def test_an_arm_with_dynamics_and_worn_switches_homes_within_its_tolerance() -> None:
    _, truth, trusted = home("preset=real&seed=5")
    assert trusted == 0b11111
    # `real` has home offsets of its own (an uncalibrated arm): they, not the homing, are what is left
    assert truth.joint_deg == pytest.approx(CONFIG.home_deg, abs=3.0)

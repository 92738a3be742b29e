"""Commissioning an arm that is wired otherwise than configured, in virtual time: the wiring is found, the arm homes."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from rm501_host.commission.commands import laid_over, without_none
from rm501_host.commission.derive import CommissionError
from rm501_host.commission.lead import STEP_DEG, lead
from rm501_host.config import Config
from rm501_host.config.loader import load_config
from rm501_host.daemon.service import Service
from rm501_host.errors import StoppedError
from rm501_host.ini_import.toml_text import toml_text
from rm501_host.virtual_time import run_virtual
from rm501_protocol.board_config import InputId
from tests.support.commission_person import Watching
from tests.support.in_process_client import client_in_process
from tests.support.virtual_machine import homed, running_service, thesis_config

TOO_FAR_DEG = STEP_DEG + 0.06
"""A step of a wrist motor more."""


class Person:
    """Answers by what the emulated arm really does. `presses` says which switch is wired to a joint's place."""

    def __init__(self, running: Any) -> None:
        self.running = running
        self.watching: Watching | None = None
        self.farthest_deg: list[list[float]] = []
        self.said: list[str] = []
        self.presses = True

    def angles(self) -> tuple[float, ...]:
        return tuple(self.running.truth().joint_deg[:5])

    def say(self, text: str) -> None:
        self.said.append(text)
        bench = self.running.emulator.bench
        if text.startswith("Press the switch of the ") and self.presses:
            joint = text.removeprefix("Press the switch of the ").split()[0]
            bench.force_input(InputId[f"SWITCH_{joint.upper()}"], True)
        elif text.endswith("Let go."):
            for line in InputId:
                bench.force_input(line, None)

    async def wait(self, text: str) -> None:
        self.said.append(text)
        self.watching = Watching(self.angles())

    async def ask(self, question: str, answers: tuple[str, ...]) -> str:
        assert self.watching is not None
        await asyncio.sleep(2.0)  # a person takes time
        self.watching.look(self.angles())
        self.farthest_deg.append(self.watching.farthest_deg)
        asked = next(joint for joint in ("waist", "shoulder", "elbow", "pitch", "roll") if joint in question)
        answer = self.watching.answer(asked)
        assert answer in answers
        return answer

    async def watch(self) -> None:
        while True:
            await asyncio.sleep(0.1)
            if self.watching is not None:
                self.watching.look(self.angles())


async def commissioned(service: Service, running: Any, config: Config) -> tuple[dict[str, Any], Person]:
    person = Person(running)
    async with asyncio.TaskGroup() as tasks:
        watching = tasks.create_task(person.watch())
        try:
            async with client_in_process(service) as client:
                changes = await lead(client, config, person)
        finally:
            watching.cancel()
    return changes, person


def wired_otherwise(config: Config) -> Config:
    wiring = replace_struct(config.board.wiring, swap_wrist_switches=not config.board.wiring.swap_wrist_switches)
    return replace_struct(config, board=replace_struct(config.board, wiring=wiring))


def replace_struct(struct: Any, **changes: Any) -> Any:
    return (
        msgspec.structs.replace(struct, **changes) if isinstance(struct, msgspec.Struct) else replace(struct, **changes)
    )


WIRING = "fault=no-inverter:line=DIR_1&fault=swap:line=LEFT_WRIST_SELECT,with=RIGHT_WRIST_SELECT"
INSIDE = "pose=-60,60,-60,45,10"


@pytest.mark.parametrize("url", [f"emu://wired?{INSIDE}", f"emu://wired?{INSIDE}&{WIRING}"], ids=["right", "otherwise"])
def test_what_is_wired_otherwise_is_found_and_the_arm_homes_with_it(tmp_path: Path, url: str) -> None:
    from rm501_sim_board.emu_transport import running_board, shut_down

    right = thesis_config()
    otherwise = WIRING in url
    config = wired_otherwise(right) if otherwise else right
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    path = tmp_path / "found.toml"

    async def scenario() -> None:
        async with running_service(first, url, config) as service:
            running = running_board("wired")
            changes, person = await commissioned(service, running, config)
            assert len(person.farthest_deg) == 5
            assert max(max(step) for step in person.farthest_deg) <= TOO_FAR_DEG
            # one joint at a time: whatever else moved was a rounding of both wrist motors
            assert all(sorted(step)[-2] < 0.1 for step in person.farthest_deg)
            assert person.angles() == pytest.approx((-60, 60, -60, 45, 10), abs=0.06)
            found = laid_over(without_none(msgspec.to_builtins(config)), changes)
            path.write_text(toml_text(found, {}, "found"))
            await service.machine.stop()
            await asyncio.sleep(1.0)
        found_config = load_config(path)
        if not otherwise:
            assert (found_config.drive, found_config.board) == (right.drive, right.board)
        else:
            assert found_config.drive.signs == (-right.drive.signs[0], right.drive.signs[1], -right.drive.signs[2])
            assert found_config.drive.wrist_matrix == right.drive.wrist_matrix[::-1]
            assert found_config.board.wiring == right.board.wiring
        async with running_service(second, url, found_config) as service:
            await homed(service)
            assert running.truth().joint_deg[:5] == pytest.approx(right.home_deg, abs=0.3)
        shut_down("wired")

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("swap:line=ELBOW_SELECT,with=WAIST_SELECT", "another joint than the waist turned: ELBOW SELECT"),
        ("line-stuck:line=STROBE_724,level=0", "the waist did not turn"),
        ("line-stuck:line=RIGHT_WRIST_SELECT,level=0", "wrist"),
    ],
)
def test_what_no_configuration_can_put_right_is_named(tmp_path: Path, fault: str, message: str) -> None:
    from rm501_sim_board.emu_transport import running_board, shut_down

    async def scenario() -> None:
        config = thesis_config()
        async with running_service(tmp_path, f"emu://miswired?{INSIDE}&fault={fault}", config) as service:
            with pytest.raises((CommissionError, ExceptionGroup)) as caught:
                await commissioned(service, running_board("miswired"), config)
            error: BaseException = caught.value
            while isinstance(error, BaseExceptionGroup):
                error = error.exceptions[0]
            assert isinstance(error, CommissionError) and message in str(error)
        shut_down("miswired")

    run_virtual(scenario())


def test_a_switch_that_nobody_presses_and_one_that_is_pressed_before(tmp_path: Path) -> None:
    from rm501_sim_board.emu_transport import running_board, shut_down

    async def scenario() -> None:
        config = thesis_config()
        async with running_service(tmp_path, f"emu://switches?{INSIDE}", config) as service:
            running = running_board("switches")
            person = Person(running)
            person.presses = False
            async with client_in_process(service) as client:
                with pytest.raises(StoppedError, match="no switch closed within 60 s; look at SWITCH_WAIST"):
                    await lead(client, config, person)
                running.emulator.bench.force_input(InputId.SWITCH_ELBOW, True)
                await asyncio.sleep(1.0)
                with pytest.raises(CommissionError, match="SWITCH_ELBOW is active before anybody pressed it"):
                    await lead(client, config, person)
            assert running.truth().joint_deg[:5] == pytest.approx((-60, 60, -60, 45, 10), abs=0.001)
        shut_down("switches")

    run_virtual(scenario())

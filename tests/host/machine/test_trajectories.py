"""Timed joint trajectories through the machine, in virtual time, and their files."""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from rm501_host.client.client import DaemonClient, RemoteRefusedError
from rm501_host.client.trajectory_file import TrajectoryFileError, read_trajectory
from rm501_host.config.schema import BoxSection
from rm501_host.daemon.access import Access
from rm501_host.daemon.methods import api
from rm501_host.daemon.rpc import MAX_BODY_BYTES, Dispatcher
from rm501_host.daemon.service import Client, Service
from rm501_host.errors import RefusedError, StoppedError
from rm501_host.machine import MachineState, operations
from rm501_host.machine.trajectories import TimedPoints, follow
from rm501_host.planner import JointLimitError, PlanError
from rm501_host.virtual_time import run_virtual
from tests.support.virtual_machine import ME, OTHER, homed, running_service, thesis_config

START = (0.0, 60.0, -60.0, 60.0, 0.0)
VIA = (10.0, 62.0, -55.0, 55.0, 5.0)
GOAL = (20.0, 66.0, -50.0, 50.0, 10.0)
BOX = BoxSection(name="vice", min_mm=(100.0, 220.0, 0.0), max_mm=(400.0, 400.0, 900.0))


def timed(*points: tuple[float, ...], times: tuple[float, ...]) -> TimedPoints:
    return TimedPoints(tuple(points), times)


def test_trajectories_are_checked_followed_held_and_stopped(tmp_path: Path) -> None:
    config = thesis_config()
    config = msgspec.structs.replace(config, keep_out=msgspec.structs.replace(config.keep_out, boxes=(BOX,)))

    async def scenario() -> None:
        async with running_service(tmp_path, config=config) as service:
            machine = service.machine
            with pytest.raises(RefusedError, match="then reset"):
                await follow(machine, ME, timed(GOAL, times=(3.0,)))
            await machine.reset(ME)
            with pytest.raises(RefusedError, match="not homed"):
                await follow(machine, ME, timed(GOAL, times=(3.0,)))
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            loop = asyncio.get_running_loop()

            # what status shows is where a trajectory may begin, although the last move ended between two steps
            here = tuple(round(angle, 4) for angle in machine.arm_state.joints_deg)
            began_s = loop.time()
            job = await follow(machine, ME, timed(here, VIA, GOAL, times=(0.0, 3.0, 6.0)))
            assert machine.job is job and job.kind.value == "trajectory"
            result = await job.wait()
            assert result["duration_s"] == pytest.approx(6.0, abs=4e-4) and result["slowed_by"] < 1.0001
            assert 6.0 <= loop.time() - began_s < 6.5
            assert machine.planning_start_deg == pytest.approx(GOAL, abs=0.003)

            # refused, and nothing moves
            at = machine.planning_start_deg
            with pytest.raises(PlanError, match=r"x the limit of the .* stretch its times by"):
                await follow(machine, ME, timed(START, times=(0.4,)))
            with pytest.raises(JointLimitError, match="waist would leave its range"):
                await follow(machine, ME, timed((160.0, *START[1:]), times=(30.0,)))
            with pytest.raises(PlanError, match="starts 20 deg away"):
                await follow(machine, ME, timed(START, GOAL, times=(0.0, 4.0)))
            with pytest.raises(RefusedError, match="would enter 'vice' at"):
                await follow(machine, ME, timed((85.0, *GOAL[1:]), times=(20.0,)))
            with pytest.raises(RefusedError, match=r"would enter 'vice' at .* go round"):
                await operations.move_joints(machine, ME, (85.0, *GOAL[1:])).wait()
            with pytest.raises(RefusedError, match="as many rows"):
                TimedPoints((START,), (1.0, 2.0))
            machine.lease.take(OTHER)
            with pytest.raises(RefusedError, match="somebody else"):
                await follow(machine, ME, timed(START, times=(6.0,)))
            machine.lease.give_back(OTHER)
            assert machine.planning_start_deg == pytest.approx(at, abs=0.02) and machine.state is MachineState.IDLE

            # too fast: slowed down by the least, and held and resumed on the way
            job = await follow(machine, ME, timed(START, times=(0.4,)), stretch=True)
            await asyncio.sleep(1.0)
            assert await machine.hold(ME)
            while machine.state is not MachineState.HELD:  # noqa: ASYNC110  # polled from outside
                await asyncio.sleep(0.02)
            held = machine.arm_state.joints_deg
            await asyncio.sleep(2.0)
            assert machine.arm_state.joints_deg == held and held != pytest.approx(START, abs=0.1)
            await machine.resume(ME)
            result = await job.wait()
            assert result["slowed_by"] > 2.0
            assert machine.planning_start_deg == pytest.approx(START, abs=0.003)

            # stopped: at rest on its path, motors off
            job = await follow(machine, ME, timed(VIA, GOAL, times=(3.0, 6.0)))
            await asyncio.sleep(2.0)
            await machine.stop(ME)
            with pytest.raises(StoppedError):
                await job.wait()
            assert START[0] < machine.arm_state.joints_deg[0] < GOAL[0]

    run_virtual(scenario())


class InProcess:
    """A client's line straight into a dispatcher; keeps the sizes of what was sent."""

    def __init__(self, service: Service) -> None:
        self._answers: asyncio.Queue[bytes | None] = asyncio.Queue()
        self._client = service.connect("test", Access.FULL, self._answers.put_nowait, lambda: 0)
        self._dispatcher: Dispatcher[Client] = Dispatcher(api)
        self.sizes: list[int] = []

    async def send(self, message: bytes) -> None:
        self.sizes.append(len(message))
        answer = await self._dispatcher.answer(message, self._client)
        self._answers.put_nowait(answer)

    async def receive(self) -> bytes | None:
        return await self._answers.get()

    async def aclose(self) -> None:
        self._answers.put_nowait(None)


def test_a_client_sends_a_long_trajectory_in_pieces(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            machine = service.machine
            await homed(service)
            await operations.move_joints(machine, ME, START).wait()
            line = InProcess(service)
            async with DaemonClient(line) as client:
                times = np.linspace(0.0, 10.0, 1501)
                share = (1.0 - np.cos(np.pi * times / 10.0)) / 2.0
                rate = np.pi / 20.0 * np.sin(np.pi * times / 10.0)
                step = np.array(GOAL) - np.array(machine.arm_state.joints_deg)
                points = np.array(machine.arm_state.joints_deg) + share[:, None] * step
                started = await client.follow(points.tolist(), times.tolist(), (rate[:, None] * step).tolist())
                assert len(line.sizes) == 6 and max(line.sizes) < MAX_BODY_BYTES
                result = await client.wait(started)
                assert result["duration_s"] == pytest.approx(10.0, abs=4e-4)
                assert machine.planning_start_deg == pytest.approx(GOAL, abs=0.003)
                # a piece without velocities does not go on where one with them began, and nothing is left behind
                row, still = [list(GOAL)], [[0.0] * 5]
                await client.call("move.trajectory", points_deg=row, times_s=[1.0], velocities_deg_s=still, more=True)
                with pytest.raises(RemoteRefusedError, match="with all points"):
                    await client.call("move.trajectory", points_deg=row, times_s=[2.0])
                with pytest.raises(RemoteRefusedError, match="must rise"):
                    await client.follow([list(START), list(GOAL)], [2.0, 1.0])
                with pytest.raises(RemoteRefusedError, match=r"5"):
                    await client.follow([[1.0, 2.0]], [2.0])

            with pytest.raises(PlanError, match="ends at rest"):
                await follow(machine, ME, TimedPoints((START,), (9.0,), ((1.0, 0.0, 0.0, 0.0, 0.0),)))

    run_virtual(scenario())


def test_files_in_every_form_say_the_same(tmp_path: Path) -> None:
    points, times = [list(START), list(VIA)], [0.0, 3.0]
    rates = [[0.0] * 5, [1.0, 2.0, 3.0, 4.0, 5.0]]
    rows = [",".join(str(value) for value in (t, *p, *v)) for t, p, v in zip(times, points, rates, strict=True)]
    names = "waist,shoulder,elbow,pitch,roll"
    (tmp_path / "a.csv").write_text(
        f"t_s,{names},{','.join(n + '_vel' for n in names.split(','))}\n" + "\n".join(rows) + "\n"
    )
    (tmp_path / "a.json").write_text(json.dumps({"times_s": times, "points_deg": points, "velocities_deg_s": rates}))
    order = [4, 2, 0, 1, 3]
    ros = {
        "joint_names": [names.split(",")[k] for k in order],
        "points": [
            {
                "positions": [math.radians(p[k]) for k in order],
                "velocities": [math.radians(v[k]) for k in order],
                "time_from_start": {"sec": int(t), "nanosec": 0},
            }
            for t, p, v in zip(times, points, rates, strict=True)
        ],
    }
    (tmp_path / "ros.json").write_text(json.dumps(ros))
    for name in ("a.csv", "a.json", "ros.json"):
        found = read_trajectory(tmp_path / name)
        assert found.times_s == times
        assert np.array(found.points_deg) == pytest.approx(np.array(points), abs=1e-12)
        assert np.array(found.velocities_deg_s) == pytest.approx(np.array(rates), abs=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.csv", "t_s,waist\n0,1\n", "line 1: the columns are t_s,waist,shoulder"),
        ("a.csv", "t_s,waist,shoulder,elbow,pitch,roll\n0,1,2,3,4\n", "line 2: 5 values instead of 6"),
        ("a.csv", "t_s,waist,shoulder,elbow,pitch,roll\n0,1,2,x,4,5\n", "line 2: could not convert"),
        ("a.csv", "", "line 1: the columns"),
        ("a.json", "[]", "an object is expected"),
        ("a.json", '{"times_s": [0]}', "'points_deg' is missing"),
        ("a.json", '{"times_s": [1], "points_deg": [[1, 2]]}', r"points_deg\[0\]: five joints"),
        ("a.json", '{"joint_names": ["a"], "points": []}', "this arm's are waist"),
        ("a.json", '{"times_s": [], "points_deg": []}', "there are no points"),
        ("a.json", "{", "see rm501-host follow --help"),
    ],
)
def test_files_that_are_no_trajectory_name_the_place(tmp_path: Path, name: str, text: str, why: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(TrajectoryFileError, match=why):
        read_trajectory(tmp_path / name)

"""A day at the arm, from switching on to shutting down, against the real processes: every status asserted.

Real time, a pty, the emulated board with its dynamics. About two minutes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rm501_host.client import DaemonClient, RemoteError
from rm501_host.client.commands import upload
from tests.operator.processes import REPOSITORY, client_of, start_board, start_daemon
from tests.support.patience import PATIENCE_S

STOOD_STILL = "stood still for more than a second before the motion began"
POINTS = {
    "pick": [0.0, 60.0, -60.0, 30.0, 0.0],
    "over": [0.0, 70.0, -60.0, 30.0, 0.0],
    "place": [20.0, 60.0, -60.0, 30.0, 0.0],
}


def check(status: dict[str, Any], **expected: object) -> None:
    assert {key: status[key] for key in expected} == expected


async def passing(client: DaemonClient, **expected: object) -> dict[str, Any]:
    """Wait for a status with these values; where the computer is too busy to stay ahead, the next may be another."""
    try:
        return await client.status_where(
            lambda now: all(now[key] == value for key, value in expected.items()), PATIENCE_S
        )
    except TimeoutError:
        raise AssertionError(f"{expected} never came: {client.status}") from None


async def state(client: DaemonClient, **expected: object) -> dict[str, Any]:
    """Wait for a status with these values, which then stay, and assert them on a fresh one too."""
    await passing(client, **expected)
    fresh: dict[str, Any] = await client.call("status")
    check(fresh, **expected)
    return fresh


async def move(client: DaemonClient, method: str, **params: object) -> None:
    """Move and wait for the end; again where this computer stood still as it began, for then it rightly does not."""
    while True:
        try:
            await client.motion(method, **params)
            return
        except RemoteError as error:
            if STOOD_STILL not in str(error):
                raise


async def watched_home(client: DaemonClient) -> None:
    """Home, and see who does it; again where this computer stood still."""
    while True:
        home = await client.call("home")
        await passing(client, activity="home", owner="operator", motion_id=home["motion"])
        try:
            await client.wait(home)
            return
        except RemoteError as error:
            if STOOD_STILL not in str(error):
                raise


async def run_program(client: DaemonClient) -> dict[str, Any]:
    """Start the program, again where this computer stood still as it began; returns once it is past its first lines
    and moves the arm at full feed.
    """
    before = (await client.call("status"))["steps"]
    while True:
        run: dict[str, Any] = await client.call("program.run", name="pnp.ngc")

        def is_decided(now: dict[str, Any], motion: int = run["motion"]) -> bool:
            moves = now["line"] >= 7 and now["steps"] != before and now["rate"] > 0.9
            return now["motion_id"] == motion and (moves or not now["activity"])

        if (await client.status_where(is_decided, PATIENCE_S))["activity"]:
            return run
        with pytest.raises(RemoteError, match=STOOD_STILL):
            await client.wait(run)


async def jog(client: DaemonClient, frame: str, axis: str, speed: float) -> None:
    """Hold a key until half a second after the arm began to move, let go, wait until the arm stands. A computer that is
    too busy to tell in time that the key is still held lets go of it, too: then it is pressed again.
    """
    before = (await client.call("status"))["steps"]
    moving_for = 0
    async with asyncio.timeout(PATIENCE_S):
        while moving_for < 8:
            started = await client.call("jog.start", frame=frame, axis=axis, speed=speed)
            while moving_for < 8 and (await client.call("jog.keep", motion=started["motion"]))["moving"]:
                now = await client.call("status")
                if now["run_state"] == "RUNNING":
                    check(now, task_state="ON", activity="jog", mode="MANUAL")
                moving_for += now["steps"] != before
                await asyncio.sleep(0.06)
            await client.call("jog.end")
            await client.wait(started)
    now = await state(client, task_state="ON", run_state="IDLE", activity="", owner="")
    assert now["steps"] != before and all(now["homed"])


@pytest.mark.timeout(900)
async def test_operator_run(tmp_path: Path) -> None:
    board = await start_board(tmp_path)
    daemon = await start_daemon(tmp_path)
    try:
        async with client_of(tmp_path) as client, client_of(tmp_path, "attendant") as second, attended(second):
            await state(client, task_state="ESTOP", cause="the daemon has started", connected=True, homed=[False] * 5)
            with pytest.raises(RemoteError, match="then reset"):
                await client.call("home")
            await client.call("reset")
            await state(client, task_state="ON", run_state="IDLE", power=True, cause="", board_state="READY")
            with pytest.raises(RemoteError, match="not homed"):
                await client.call("move.joints", q_deg=POINTS["pick"])

            await watched_home(client)
            await state(client, task_state="ON", run_state="IDLE", homed=[True] * 5, owner="")

            await move(client, "move.joints", q_deg=POINTS["pick"])
            now = await state(client, run_state="IDLE", activity="")
            assert now["joints_deg"] == pytest.approx(POINTS["pick"], abs=0.05)
            await jog(client, "joint", "waist", 10)
            await jog(client, "joint", "roll", -10)
            await jog(client, "world", "z", 30)
            await jog(client, "tool", "z", 30)

            for name, q_deg in POINTS.items():
                await move(client, "move.joints", q_deg=q_deg)
                await client.call("teach.record", name=name)
            assert [point["name"] for point in await client.call("teach.list")] == list(POINTS)
            await move(client, "teach.go", name="pick", how="joint", speed=1.0)
            check(await client.call("status"), mode="MANUAL", run_state="IDLE")

            await upload(client, "pnp.ngc", (REPOSITORY / "examples" / "pick_and_place.ngc").read_text())
            checked = await client.call("program.check", name="pnp.ngc")
            assert checked["complete"] and 30 < checked["duration_s"] < 60
            run = await run_program(client)
            await passing(client, mode="AUTO", run_state="RUNNING", activity="program", program="pnp.ngc")
            await client.call("override", ratio=0.5)
            await passing(client, override=0.5, run_state="RUNNING")
            await client.status_where(lambda now: abs(now["rate"] - 0.5) < 0.01)
            await client.call("override", ratio=1.0)
            async with client_of(tmp_path, "colleague") as other:
                with pytest.raises(RemoteError, match="operator") as refused:
                    await other.call("home")
                assert refused.value.kind == "LeaseHeldError"
                await other.call("hold")
                await state(client, run_state="HELD", hold_cause="USER")
            held = (await client.call("status"))["steps"]
            await asyncio.sleep(2.0)
            assert (await state(client, run_state="HELD"))["steps"] == held
            await client.call("resume")
            await passing(client, run_state="RUNNING", hold_cause="")
            await client.status_where(lambda now: now["progress"] > 0.35, PATIENCE_S)
            await client.call("stop")
            with pytest.raises(RemoteError, match=r"STOP|OFF"):
                await client.wait(run)
            # without motor power the arm sinks: nothing is trusted, and OVERFLOW may follow
            stopped = await client.status_where(lambda now: not now["power"] and not any(now["homed"]))
            assert stopped["line"] >= 7
            await recover(client)
            await move(client, "move.joints", q_deg=POINTS["over"])

            # pull the link while the arm moves: the board holds by itself and nothing goes on alone
            run = await run_program(client)
            board.send(signal.SIGSTOP)
            await client.status_where(lambda now: now["link_silent"])
            await client.status_where(lambda now: not now["connected"])
            lost = await state(client, task_state="ESTOP", homed=[False] * 5)
            assert lost["cause"].startswith("the connection to the board is lost: it has been silent for")
            with pytest.raises(RemoteError, match=r"silent|ESTOP"):
                await client.wait(run)
            board.send(signal.SIGCONT)
            await client.status_where(lambda now: now["connected"])
            now = await state(client, task_state="ESTOP", cause=lost["cause"], homed=[True] * 5)
            steps = now["steps"]
            await asyncio.sleep(2.0)
            assert (await client.call("status"))["steps"] == steps
            await recover(client)
            await move(client, "move.joints", q_deg=POINTS["over"])
            final = await state(client, task_state="ON", run_state="IDLE", homed=[True] * 5)
        assert await daemon.end() == 0
        record = json.loads((tmp_path / "state" / "position.json").read_text())
        assert record["dirty"] is False and record["positions_steps"] == final["steps"]
        kinds = [json.loads(line)["kind"] for line in (tmp_path / "state" / "log.jsonl").read_text().splitlines()]
        assert {"started", "motion", "stop", "estop", "link_down", "link_up", "ended"} <= set(kinds)
        assert list((tmp_path / "state" / "blackbox").glob("*.gz"))
    finally:
        await daemon.end(signal.SIGKILL)
        await board.end(signal.SIGKILL)


@asynccontextmanager
async def attended(client: DaemonClient) -> AsyncIterator[None]:
    """Somebody resumes what is held because this computer stood still for a second."""

    async def resume() -> None:
        while True:
            await client.status_where(lambda now: now["run_state"] == "HELD" and now["hold_cause"] == "LINK_LOST", 1e4)
            with contextlib.suppress(RemoteError):
                await client.call("resume")
            await asyncio.sleep(0.1)

    attending = asyncio.create_task(resume())
    try:
        yield
    finally:
        attending.cancel()
        await asyncio.gather(attending, return_exceptions=True)


async def recover(client: DaemonClient) -> None:
    """What docs/recovery.md says: look at the status, reset naming the fault, home what is not trusted."""
    for _ in range(40):
        await asyncio.sleep(0.5)
        status = await client.call("status")
        if status["task_state"] == "ON":
            break
        with contextlib.suppress(RemoteError):
            await client.call("reset", fault=status["fault"] or None)
    status = await state(client, task_state="ON", run_state="IDLE")
    if not all(status["homed"]):
        await move(client, "home")
    await state(client, task_state="ON", run_state="IDLE", homed=[True] * 5)

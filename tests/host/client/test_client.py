"""The daemon's client against a line that answers from a script, on virtual time."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest

from rm501_host.client.client import DaemonClient, connect
from rm501_host.client.commands import nothing_to, show_progress
from rm501_host.errors import NoBoardError
from rm501_host.virtual_time import VirtualLoop

HOUR_S = 3600.0


class ScriptedLine:
    """Answers every request by `answer(method, params)` after the delay that it gives, s."""

    def __init__(self, answer: Callable[[str, dict[str, Any]], tuple[float, Any]]) -> None:
        self._answer = answer
        self._answers: asyncio.Queue[bytes | None] = asyncio.Queue()

    async def send(self, message: bytes) -> None:
        request = json.loads(message)
        delay_s, result = self._answer(request["method"], request["params"])
        answer = json.dumps({"jsonrpc": "2.0", "id": request["id"], "result": result}).encode()
        asyncio.get_running_loop().call_later(delay_s, self._answers.put_nowait, answer)

    async def receive(self) -> bytes | None:
        return await self._answers.get()

    async def aclose(self) -> None:
        self._answers.put_nowait(None)


def test_a_motion_is_waited_for_however_long_it_takes() -> None:
    waits = 0

    def answer(method: str, params: dict[str, Any]) -> tuple[float, Any]:
        nonlocal waits
        if method != "motion.wait":
            return 0.0, {"motion": 7}
        waits += 1
        is_over = waits * params["timeout_s"] >= 3 * HOUR_S
        return params["timeout_s"], {"done": is_over, "result": {"lines": 1}}

    async def long_motion() -> tuple[dict[str, Any], float]:
        async with DaemonClient(ScriptedLine(answer)) as client:
            result = await client.motion("program.run", name="endless.ngc")
        return result, asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        result, took_s = runner.run(long_motion())
    assert result == {"lines": 1}
    assert took_s >= 3 * HOUR_S


def test_a_check_is_waited_for_as_long_as_the_daemon_lives() -> None:
    alive = list[int]()

    def answer(method: str, params: dict[str, Any]) -> tuple[float, Any]:
        return (3 * HOUR_S, {"motion": 7}) if method == "program.run" else (0.01, {"checked_to_line": 5})

    async def long_check() -> tuple[Any, float]:
        async with DaemonClient(ScriptedLine(answer)) as client:
            client.on_alive = lambda status: alive.append(status["checked_to_line"])
            started = await client.call("program.run", name="endless.ngc")
        return started, asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        started, took_s = runner.run(long_check())
    assert started == {"motion": 7}
    assert took_s == pytest.approx(3 * HOUR_S, abs=1.0)
    assert len(alive) > 1000 and set(alive) == {5}


def test_a_daemon_that_stops_answering_is_not_waited_for() -> None:
    def answer(method: str, params: dict[str, Any]) -> tuple[float, Any]:
        return HOUR_S, {}

    async def no_answer() -> float:
        async with DaemonClient(ScriptedLine(answer)) as client:
            with pytest.raises(NoBoardError, match="is it stopped"):
                await client.call("program.run", name="endless.ngc")
            return asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        assert runner.run(no_answer()) < 60.0


def test_progress_is_shown_from_any_order_of_changes(capsys: pytest.CaptureFixture[str]) -> None:
    show = show_progress()
    for changed in (
        {"progress": 0.31, "time_left_s": 20.0},
        {"time_left_s": 19.0, "run_state": "HOLDING"},  # the share of the program stays, what else changes is told
        {"time_left_s": 18.0},
        {"progress": 0.42},
        {"progress": 0.43, "messages": ["part 1"]},
    ):
        show(changed)
    out, err = capsys.readouterr()
    assert out == "part 1\n"
    assert err.splitlines() == [" 31%  20 s left", "run state: HOLDING", " 42%  18 s left"]


def test_without_the_status_there_is_still_an_answer() -> None:
    assert nothing_to("hold", None) == "nothing moves, so there is nothing to hold"


def test_nobody_behind_a_web_address_is_told_in_words_with_the_remedy() -> None:
    with pytest.raises(NoBoardError, match=r"^no daemon on ws://127\.0\.0\.1:1/rpc \([^\[\]]+\); start it: .*--listen"):
        asyncio.run(connect("ws://127.0.0.1:1/rpc"))

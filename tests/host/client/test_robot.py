"""The blocking Robot without a daemon: what an interrupt does, and what a closed one says."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
from concurrent.futures import Future
from typing import Any

import pytest

from rm501_host import Robot
from rm501_host.errors import RefusedError
from tests.support.patience import PATIENCE_S, blocking_until


class _Client:
    """Moves for ever, and notes what it is asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.cancelled = False
        self.moving = threading.Event()

    async def __aenter__(self) -> _Client:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.asked.append("close")

    async def motion(self, method: str, **_: Any) -> dict[str, Any]:
        self.asked.append(method)
        self.moving.set()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            self.cancelled = True
            raise
        return {}

    async def call(self, method: str, **_: Any) -> dict[str, Any]:
        self.asked.append(method)
        return {}


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> _Client:
    client = _Client()

    async def connect(address: str, **_: Any) -> _Client:
        return client

    monkeypatch.setattr("rm501_host.robot.connect", connect)
    return client


def waits(thread: int) -> bool:
    """Whether a thread waits for a result."""
    frame = sys._current_frames()[thread]
    while frame is not None:
        if frame.f_code is Future.result.__code__:
            return True
        frame = frame.f_back  # type: ignore[assignment]  # None at the outermost
    return False


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to a thread here")
def test_an_interrupt_holds_the_arm(client: _Client) -> None:
    main = threading.get_ident()
    with Robot.connect("unix:/nowhere") as robot:

        def interrupt() -> None:
            assert client.moving.wait(PATIENCE_S)
            blocking_until(lambda: waits(main), "the caller waits for the motion")
            signal.pthread_kill(main, signal.SIGINT)

        helper = threading.Thread(target=interrupt)
        helper.start()
        with pytest.raises(KeyboardInterrupt):
            robot.move_joints([0, 60, -60, 60, 0])
        helper.join()
        assert client.asked == ["move.joints", "hold"]
        robot.resume()
    assert client.cancelled
    assert client.asked[2:] == ["resume", "close"]


def test_a_closed_robot_says_so(client: _Client) -> None:
    robot = Robot.connect("unix:/nowhere")
    robot.close()
    with pytest.raises(RefusedError, match="connect again"):
        robot.status()
    with pytest.raises(RefusedError, match="connect again"):
        robot.home()

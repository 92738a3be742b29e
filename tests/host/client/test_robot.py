"""The blocking Robot without a daemon: what an interrupt does, and what a closed one says."""

from __future__ import annotations

import asyncio
import signal
import threading
from typing import Any

import pytest

from rm501_host import Robot
from rm501_host.errors import RefusedError


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


@pytest.mark.timeout(30)
@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to a thread here")
def test_an_interrupt_holds_the_arm(client: _Client) -> None:
    main = threading.get_ident()
    with Robot.connect("unix:/nowhere") as robot:

        def interrupt() -> None:
            assert client.moving.wait(10)
            threading.Event().wait(0.3)  # until the caller waits, too
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

"""A small blocking interface for notebooks and scripts, on top of the daemon.

    from rm501_host import Robot
    with Robot.connect() as robot:
        robot.home()
        robot.move_joints([0, 60, -60, 60, 0])
        robot.move_linear([280, 60, 200, 0, 0, 0])
        robot.grip("close")

Every call returns when the motion has ended, and raises what ended it early. Interrupting one (Ctrl-C, "interrupt the
kernel") holds the arm on its path: `resume` goes on, `abort` ends the motion. The event loop runs in a thread of its
own, so it works where a loop is already running (Jupyter).
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Coroutine, Sequence
from types import TracebackType
from typing import Any, Literal, Self, TypeVar

from rm501_host.client.client import DaemonClient, connect
from rm501_host.daemon.paths import socket_path
from rm501_host.errors import RefusedError

T = TypeVar("T")


class Robot:
    """A connection to the daemon; made by `Robot.connect`, used in a `with` block or until `close`."""

    def __init__(self, address: str, token: str | None) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="rm501 client", daemon=True)
        self._thread.start()
        self._open = False
        try:
            self._client: DaemonClient = self._run(self._connect(address, token))
        except BaseException:
            self._end_loop()
            raise
        self._open = True

    @classmethod
    def connect(cls, address: str | None = None, *, token: str | None = None) -> Self:
        """Connect to a daemon, by default on its unix socket; raises NoBoardError with the remedy."""
        if address is None:
            address = f"unix:{socket_path(os.environ, os.getuid() if hasattr(os, 'getuid') else 0)}"
        return cls(address, token)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Hang up. A program that runs goes on; a jog ends."""
        if self._open:
            self._open = False
            self._run(self._client.__aexit__(None, None, None))
            self._end_loop()

    # ------------------------------------------------------------------------------------------------ moving

    def home(self, *joints: str) -> dict[str, Any]:
        """Switch the motors on if need be, and home joints (all without names).

        After a fault or a stop this does not reset by itself: `reset` does, when you have looked at the arm.
        """
        status = self.status()
        if status["task_state"] == "ESTOP" and status["cause"] == "the daemon has started":
            self.reset()
        return self._motion("home", joints=list(joints))

    def move_joints(self, q_deg: Sequence[float], speed: float = 1.0) -> None:
        """Go to joint angles (5), deg, at a share of the limits."""
        self._motion("move.joints", q_deg=[float(angle) for angle in q_deg], speed=speed)

    def move_linear(self, target: Sequence[float], feed_mm_s: float = 50.0) -> None:
        """Go straight to X Y Z A B C (mm, deg) of the program frame."""
        self._motion("move.linear", target=[float(value) for value in target], feed_mm_s=feed_mm_s)

    def follow(
        self,
        points_deg: Sequence[Sequence[float]],
        times_s: Sequence[float],
        velocities_deg_s: Sequence[Sequence[float]] | None = None,
        *,
        stretch: bool = False,
    ) -> dict[str, Any]:
        """Follow joint angles (n, 5), deg, at times (n,), s, with velocities (n, 5), deg/s, or those of a spline.

        Checked as a whole first; `stretch` slows a trajectory down that is too fast. Returns its `duration_s` and
        what it was `slowed_by`.
        """

        async def work() -> dict[str, Any]:
            started = await self._client.follow(points_deg, times_s, velocities_deg_s, stretch=stretch)
            return await self._client.wait(started)

        return self._moving(work())

    def grip(self, action: Literal["open", "close"]) -> None:
        """Open or close the hand and wait for its stroke."""
        self._motion("hand", action=action)

    def mdi(self, block: str) -> None:
        """Run one block of G-code."""
        self._motion("mdi", block=block)

    def run(self, name: str, *, line: int = 1, speed: float = 1.0) -> dict[str, Any]:
        """Run a program of the daemon's folder."""
        return self._motion("program.run", name=name, line=line, speed=speed)

    def go(self, point: str, how: Literal["joint", "linear"] = "joint", speed: float = 0.5) -> None:
        """Go to a teach point."""
        self._motion("teach.go", name=point, how=how, speed=speed)

    # ------------------------------------------------------------------------------------------- everything else

    def teach(self, point: str, note: str = "", *, replace: bool = False) -> dict[str, Any]:
        """Record where the arm stands; with `replace` also under a name that is taken."""
        return self._dict(self.call("teach.record", name=point, note=note, replace=replace))

    def hold(self) -> bool:
        """To rest on the path, motors on; False when nothing moves. Works from another thread while a motion is waited
        for.
        """
        return bool(self._dict(self.call("hold"))["held"])

    def resume(self) -> None:
        """Go on after a hold, M0 or M1."""
        self.call("resume")

    def override(self, ratio: float) -> None:
        """Feed override, 0 to 2; 1 is as programmed. Works from another thread while a motion is waited for."""
        self.call("override", ratio=float(ratio))

    def run_back(self, seconds: float) -> dict[str, Any]:
        """Run a held program back along its path by path time in s, at most 30; it is held again there, and `resume`
        goes forward. Returns how many `seconds` it will be, and what hand and outputs `repeats` on the way forward.
        """
        return self._dict(self.call("program.back", seconds=float(seconds)))

    def abort(self) -> bool:
        """End the motion on its path, motors on; the rest is dropped. False when there is none."""
        return bool(self._dict(self.call("abort"))["ended"])

    def stop(self) -> None:
        """STOP: to rest on the path, motors off. Works from another thread while a motion is waited for."""
        self.call("stop")

    def reset(self, fault: str | None = None) -> None:
        """Leave ESTOP or OFF; a latched fault has to be named."""
        self.call("reset", fault=fault)

    def status(self) -> dict[str, Any]:
        """The whole status."""
        return self._dict(self.call("status"))

    def call(self, method: str, **params: Any) -> Any:
        """Any method of docs/api.md."""
        return self._run(self._client.call(method, **params))

    # --------------------------------------------------------------------------------------------------- inside

    @staticmethod
    async def _connect(address: str, token: str | None) -> DaemonClient:
        client = await connect(address, token=token, name=f"robot {os.getpid()}")
        return await client.__aenter__()

    def _motion(self, method: str, **params: Any) -> dict[str, Any]:
        return self._moving(self._client.motion(method, **params))

    def _moving(self, work: Coroutine[Any, Any, T]) -> T:
        """Run what waits for a motion; whoever interrupts it wants the arm to rest."""
        try:
            return self._run(work)
        except KeyboardInterrupt:
            self._run(self._client.call("hold"))
            raise

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        if self._loop.is_closed():
            work.close()
            raise RefusedError("this Robot is closed; connect again with Robot.connect()")
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        except KeyboardInterrupt:
            future.cancel()
            raise

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    @staticmethod
    def _dict(value: Any) -> dict[str, Any]:
        result: dict[str, Any] = value
        return result

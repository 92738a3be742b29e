"""Taking things away from a moving arm at random instants, with real processes: what becomes of it, as a table.

The bench itself says where the arm stands: at rest within seconds, on its path, nothing goes on before an operator
acts; and the daemon, the same or a new one, must know what it may trust.
"""

from __future__ import annotations

import asyncio
import json
import random
import signal
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rm501_host.client import DaemonClient, RemoteError
from rm501_host.errors import Rm501Error
from tests.operator.processes import Process, client_of, start, start_daemon

A = (0.0, 60.0, -60.0, 30.0, 0.0)
B = (40.0, 75.0, -50.0, 45.0, 10.0)
ON_PATH_DEG = 0.15
"""Steps of 0.025 and 0.0375 deg, and the rounding of both wrist motors."""
BELIEF_DEG = 0.1
"""What a trusted position may be off: nothing but the rounding of steps."""
KINDS = ("kill -9 daemon", "kill -9 client", "SIGSTOP 5 s", "unplug pty 2 s")
_REST_LIMIT_S = 8.0
_CONNECT_LIMIT_S = 10.0


@dataclass(slots=True)
class Seen:
    """One take-away: what it was, and what became of the arm."""

    kind: str
    delay_s: float
    rest_s: float = 0.0
    """From the take-away to the first look at an arm that stands (looks are 0.4 s apart)."""
    from_path_deg: float = 0.0
    self_resumed: bool = False
    state: str = ""
    explained: bool = True
    """Outside ON/IDLE the daemon gives cause and remedy."""
    trusted: bool = False
    belief_error_deg: float = 0.0
    error: str = ""


class Bench:
    """The emulated board as a process, and its own account of where the arm is."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.process: Process | None = None

    async def start(self) -> None:
        """Start the process."""
        code = "from rm501_sim_board.cli import main; main()"
        self.process = await start(
            sys.executable, "-c", code, "--pty", str(self.folder / "arm"), "--control", str(self.folder / "control")
        )

    async def ask(self, **request: object) -> dict[str, Any]:
        """One request on the control socket; raises RuntimeError when it is refused."""
        reader, writer = await asyncio.open_unix_connection(self.folder / "control")
        writer.write(json.dumps(request).encode() + b"\n")
        answer: dict[str, Any] = json.loads(await reader.readline())
        writer.close()
        if not answer.get("ok"):
            raise RuntimeError(f"{request}: {answer}")
        return answer

    async def joints_deg(self) -> tuple[float, ...]:
        """Where the joints really are."""
        answer = await self.ask(do="truth")
        return tuple(answer["joint_deg"][:5])


async def ready(client: DaemonClient) -> None:
    """Reset and, when something is not trusted, home."""
    for _ in range(20):
        status = await client.call("status")
        if status["task_state"] == "ON" and status["run_state"] == "IDLE":
            break
        try:
            await client.call("reset", fault=status["fault"] or None)
        except RemoteError:
            await asyncio.sleep(0.5)
    status = await client.call("status")
    if not all(status["homed"]):
        await client.motion("home")


def distance_from_path(q_deg: tuple[float, ...]) -> float:
    """Largest joint distance from the line A-B, where the waist says how far along it is."""
    share = (q_deg[0] - A[0]) / (B[0] - A[0])
    return max(abs(q - (a + share * (b - a))) for q, a, b in zip(q_deg, A, B, strict=True))


def apart(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Largest joint distance, deg."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


async def at_rest(bench: Bench) -> tuple[float, ...]:
    """Wait until the arm stands; raises TimeoutError."""
    async with asyncio.timeout(_REST_LIMIT_S):
        before = await bench.joints_deg()
        while True:
            await asyncio.sleep(0.4)
            now = await bench.joints_deg()
            if apart(now, before) < 1e-6:
                return now
            before = now


class TakeAways:
    """A bench, a daemon in front of it, and what is done to them."""

    def __init__(self, folder: Path, bench: Bench, daemon: Process) -> None:
        self._folder = folder
        self._bench = bench
        self.daemon = daemon

    async def one(self, seen: Seen) -> None:
        """Move, take something away, look; fills `seen`. Raises what should never happen."""
        bench = self._bench
        loop = asyncio.get_running_loop()
        async with client_of(self._folder) as client:
            await self._begin(seen.kind, client)
            jogger = await self._move(seen.kind, client)
            await asyncio.sleep(seen.delay_s)
            taken_s = loop.time()
            await self._take(seen.kind, jogger)
        place = await at_rest(bench)
        seen.rest_s = loop.time() - taken_s
        seen.from_path_deg = 0.0 if jogger is not None else distance_from_path(place)
        if seen.kind == "SIGSTOP 5 s":
            self.daemon.send(signal.SIGCONT)
        if seen.kind == "kill -9 daemon":
            self.daemon = await start_daemon(self._folder)
        await asyncio.sleep(2.5)
        async with client_of(self._folder) as client:
            status = await client.status_where(lambda now: bool(now["connected"]), _CONNECT_LIMIT_S)
            seen.state = status["task_state"] + ("/" + status["run_state"] if status["task_state"] == "ON" else "")
            seen.explained = seen.state == "ON/IDLE" or bool(status["cause"] and status["remedy"])
            seen.trusted = all(status["homed"])
            if seen.trusted:
                seen.belief_error_deg = apart(tuple(status["joints_deg"]), await bench.joints_deg())
            seen.self_resumed = apart(place, await bench.joints_deg()) > 1e-6
            if status["run_state"] == "HELD":
                await client.call("abort")
            await ready(client)
            if seen.trusted:
                now = await client.call("status")
                error = apart(tuple(now["joints_deg"]), await bench.joints_deg())
                seen.belief_error_deg = max(seen.belief_error_deg, error)
            if jogger is not None:
                await client.motion("move.joints", q_deg=A)

    async def _begin(self, kind: str, client: DaemonClient) -> None:
        await ready(client)
        if distance_from_path(await self._bench.joints_deg()) > ON_PATH_DEG:
            await client.motion("move.joints", q_deg=A)

    async def _move(self, kind: str, client: DaemonClient) -> Process | None:
        """Start a move to the farther end, or a jog by a process of its own, which is returned."""
        here = await self._bench.joints_deg()
        goal = B if abs(here[0] - A[0]) < abs(here[0] - B[0]) else A
        if kind != "kill -9 client":
            await client.call("move.joints", q_deg=goal)
            return None
        code = "from rm501_host.cli import main; main()"
        child = await asyncio.create_subprocess_exec(
            sys.executable, "-c", code, "jog", "waist", "12" if goal is B else "-12",
            "--daemon", f"unix:{self._folder / 's.sock'}",
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        await client.status_where(lambda now: now["activity"] == "jog", 20)
        return Process(child, "")

    async def _take(self, kind: str, jogger: Process | None) -> None:
        if kind == "kill -9 daemon":
            await self.daemon.end(signal.SIGKILL)
        elif jogger is not None:
            await jogger.end(signal.SIGKILL)
        elif kind == "SIGSTOP 5 s":
            self.daemon.send(signal.SIGSTOP)
            await asyncio.sleep(5.0)
        else:
            await self._bench.ask(do="fault", spec="unplug/2s")


async def kill(count: int, seed: int) -> bool:
    """Take something away at random instants and print what became of the arm; False when a target is missed."""
    source = random.Random(seed)
    results: list[Seen] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = Bench(folder)
        await bench.start()
        trials = TakeAways(folder, bench, await start_daemon(folder))
        try:
            async with client_of(folder) as client:
                await ready(client)
                await client.motion("move.joints", q_deg=A)
            for number in range(count):
                # a quarter of them in the first tenth of a second, where a motion is being handed over
                delay_s = source.uniform(0.0, 0.1) if source.random() < 0.25 else source.uniform(0.0, 1.8)
                seen = Seen(KINDS[number % len(KINDS)], delay_s)
                results.append(seen)
                try:
                    await trials.one(seen)
                except (Rm501Error, TimeoutError, RuntimeError) as error:
                    ended = trials.daemon.child.returncode
                    seen.error = f"{type(error).__name__}: {error}"
                    print(f"trial {number}: the daemon {'runs' if ended is None else f'ended with {ended}'}; {seen}")
                    if sum(bool(one.error) for one in results) > 3:
                        raise
                    if ended is not None:
                        trials.daemon = await start_daemon(folder)
                print(number, seen, file=sys.stderr, flush=True)
        finally:
            await trials.daemon.end(signal.SIGKILL)
            assert bench.process is not None
            await bench.process.end(signal.SIGKILL)
    return show(results)


def show(results: list[Seen]) -> bool:
    """Print the table; whether every target is met."""
    print(
        f"{'taken away':16} {'trials':>6} {'at rest':>8} {'slowest':>8} {'off path':>9} {'resumed':>8} {'trusted':>8} "
        f"{'not':>4} {'belief off':>10} {'errors':>7}  states after"
    )
    good = True
    for kind in KINDS:
        mine = [seen for seen in results if seen.kind == kind]
        if not mine:
            continue
        whole = [seen for seen in mine if not seen.error]
        off = max((seen.from_path_deg for seen in whole), default=0.0)
        slowest = max((seen.rest_s for seen in whole), default=0.0)
        resumed = sum(seen.self_resumed for seen in whole)
        trusted = sum(seen.trusted for seen in whole)
        belief = max((seen.belief_error_deg for seen in whole), default=0.0)
        states = sorted({seen.state for seen in whole})
        counted = ", ".join(f"{state} {sum(seen.state == state for seen in whole)}" for state in states)
        print(
            f"{kind:16} {len(mine):6} {len(whole):8} {slowest:6.1f} s {off:7.3f} d {resumed:8} {trusted:8} "
            f"{len(whole) - trusted:4} {belief:8.4f} d {len(mine) - len(whole):7}  {counted}"
        )
        good = good and off <= ON_PATH_DEG and resumed == 0 and belief <= BELIEF_DEG and len(whole) == len(mine)
        # the arm kept its power and its counts in all four cases: the daemon must know that, and say what happened
        good = good and trusted == len(whole) and all(seen.explained for seen in whole)
    return good

"""What the methods of the API work on: one machine with everything around it, and the clients that are connected."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rm501_host.config import Config
from rm501_host.daemon.access import Access, RateLimit
from rm501_host.daemon.rpc import notification
from rm501_host.machine.gcode_source import Surroundings
from rm501_host.machine.jogging import Jogger
from rm501_host.machine.lease import Owner
from rm501_host.machine.machine import Machine, MachineParts
from rm501_host.machine.program_files import ProgramFiles
from rm501_host.machine.programs import Programs
from rm501_host.machine.snapshot import snapshot
from rm501_host.machine.status import MachineStatus, status_diff
from rm501_host.machine.trajectories import TimedPoints
from rm501_host.teach import TeachFile

SHORTEST_PERIOD_S = 0.02
"""50 Hz, the most that a subscription gets."""
MAX_CLIENTS = 32
MAX_UNSENT_BYTES = 256 * 1024
"""A subscriber that reads more slowly than this lags is passed over until it has caught up."""


@dataclass(frozen=True, slots=True)
class Folders:
    """Where the daemon keeps its files: `state` for its own, `programs` for G-code."""

    state: Path
    programs: Path


class Service:
    """One machine, its programs, jogs and teach points. Make it inside the running loop."""

    def __init__(self, config: Config, parts: MachineParts, folders: Folders) -> None:
        folders.state.mkdir(parents=True, exist_ok=True)
        folders.programs.mkdir(parents=True, exist_ok=True)
        self.config = config
        self.folders = folders
        self.machine = Machine(config, parts)
        self.teach = TeachFile(folders.state / "points.toml")
        self.around = Surroundings(folders.state, folders.programs, self.teach, config=config)
        self.programs = Programs(self.machine, ProgramFiles(folders.programs), self.around)
        self.jogger = Jogger(self.machine)
        self.clients: dict[int, Client] = {}
        self._numbers = itertools.count(1)
        self._loop = asyncio.get_running_loop()

    @property
    def clock_s(self) -> Callable[[], float]:
        """The event loop's time."""
        return self._loop.time

    def status(self) -> MachineStatus:
        """The status now."""
        return snapshot(self.machine, self.programs, self._loop.time(), jog_damped=self.jogger.is_damped)

    def connect(self, name: str, access: Access, send: Callable[[bytes], None], unsent: Callable[[], int]) -> Client:
        """A client has come; raises ConnectionRefusedError when there are too many."""
        if len(self.clients) >= MAX_CLIENTS:
            raise ConnectionRefusedError(f"{MAX_CLIENTS} clients are connected already")
        client = Client(self, next(self._numbers), name, access, send, unsent)
        self.clients[client.owner.id] = client
        return client

    def follow_subscriptions(self) -> None:
        """Let the board tell its status as often as the quickest subscriber wants it."""
        periods_s = [client.period_s for client in self.clients.values() if client.is_subscribed]
        self.machine.set_status_period(round(1000 * min(periods_s, default=1.0)))

    def disconnect(self, client: Client) -> None:
        """A client is gone: its jog ends by itself, its program goes on, its lease is free."""
        self.clients.pop(client.owner.id, None)
        client.unsubscribe()
        self.machine.lease.give_back(client.owner)
        self.programs.files.forget(client.owner.id)


class Client:
    """A connected client: who it is, what it may do, what it has subscribed to."""

    def __init__(
        self, service: Service, number: int, name: str, access: Access, send: Callable[[bytes], None],
        unsent: Callable[[], int],
    ) -> None:  # fmt: skip
        self.service = service
        self.owner = Owner(number, name)
        self.access = access
        self.send = send
        """Sends a message to this client; never blocks."""
        self.trajectory: TimedPoints | None = None
        """Points of a trajectory whose rest is still to come."""
        self._unsent = unsent
        self._rate = RateLimit(service.clock_s)
        self._timer: asyncio.TimerHandle | None = None
        self._period_s = 0.0
        self._fields: frozenset[str] = frozenset()
        self._last: dict[str, object] | None = None

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.service.machine

    @property
    def is_subscribed(self) -> bool:
        """Whether it gets status changes."""
        return self._timer is not None

    @property
    def period_s(self) -> float:
        """How often it gets them."""
        return self._period_s

    def may(self, access: Access) -> bool:
        """Whether this client may call methods of that level."""
        return access <= self.access

    def rate_limited(self) -> bool:
        """Count a call; True when it comes too fast."""
        return not self._rate.take()

    def rename(self, name: str) -> None:
        """Give the client a name for people."""
        self.owner = Owner(self.owner.id, name)

    def subscribe(self, period_s: float, fields: frozenset[str]) -> dict[str, object]:
        """Send status changes every `period_s` from now on; returns the whole status."""
        self.unsubscribe()
        self._period_s = max(SHORTEST_PERIOD_S, period_s)
        self._fields = fields
        self._last = self._view()
        self._timer = asyncio.get_running_loop().call_later(self._period_s, self._tick)
        self.service.follow_subscriptions()
        return self._last

    def unsubscribe(self) -> None:
        """No more status."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
            self.service.follow_subscriptions()
        self._last = None

    def _view(self) -> dict[str, object]:
        status = self.service.status()
        return {
            name: getattr(status, name)
            for name in status.__struct_fields__
            if not self._fields or name in self._fields or name == "time_s"
        }

    def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(self._period_s, self._tick)
        if self._unsent() > MAX_UNSENT_BYTES:
            return
        now = self._view()
        changed = status_diff(self._last, now)
        if set(changed) - {"time_s"}:
            self._last = now
            self.send(notification("status", changed))

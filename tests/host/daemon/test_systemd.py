"""The daemon as a service: what systemd says of the unit, and what the daemon tells systemd, in real time."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S, blocking_until
from tests.support.virtual_machine import REPOSITORY

UNIT = REPOSITORY / "packaging" / "systemd" / "rm501-host.service"
WATCHDOG_S = 0.4
COMMAND = [sys.executable, "-c", "from rm501_host.cli import main; main()"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path: Path) -> None:
    # the program need not be installed where the unit expects it
    text = UNIT.read_text()
    assert "/usr/bin/rm501-host" in text
    copy = tmp_path / UNIT.name
    copy.write_text(text.replace("/usr/bin/rm501-host", "/bin/true"))
    found = subprocess.run(["systemd-analyze", "verify", str(copy)], capture_output=True, text=True, timeout=PATIENCE_S)
    about_us = [line for line in found.stderr.splitlines() if "rm501" in line]
    assert found.returncode == 0 and not about_us, found.stderr


@contextmanager
def served(folder: Path, manager: socket.socket) -> Iterator[subprocess.Popen[str]]:
    manager.bind(str(folder / "notify"))
    environment = {
        **os.environ,
        "NOTIFY_SOCKET": str(folder / "notify"),
        "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)),
    }
    daemon = subprocess.Popen(
        [*COMMAND, "serve", "--socket", str(folder / "s.sock"), "--state", str(folder / "state")],
        env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        yield daemon
    finally:
        daemon.kill()
        daemon.wait()


def state_of(process: subprocess.Popen[str]) -> str:
    """The kernel's letter for what a process does: T when it is stopped."""
    return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0]


@pytest.mark.skipif(sys.platform != "linux", reason="systemd is for Linux")
def test_systemd_is_told_of_start_life_and_end(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.settimeout(PATIENCE_S)
        with served(tmp_path, manager) as daemon:
            heard = []
            while not heard or not heard[-1].startswith("READY=1"):
                heard.append(manager.recv(4096).decode())
            assert heard[-1].splitlines() == ["READY=1", f"STATUS=serving unix:{tmp_path / 's.sock'}"]
            assert set(heard[:-1]) <= {"WATCHDOG=1"}
            # ready means that it can be talked to
            assert (tmp_path / "s.sock").is_socket()
            assert [manager.recv(4096) for _ in range(4)] == [b"WATCHDOG=1"] * 4

            # a daemon that hangs does not say that it lives: systemd restarts it
            daemon.send_signal(signal.SIGSTOP)
            blocking_until(lambda: state_of(daemon) == "T", "the daemon stops")
            manager.setblocking(False)
            with pytest.raises(BlockingIOError):
                while True:  # what was sent before the stop
                    assert manager.recv(4096) == b"WATCHDOG=1"
            manager.settimeout(2 * WATCHDOG_S)
            with pytest.raises(TimeoutError):
                manager.recv(4096)
            daemon.send_signal(signal.SIGCONT)
            manager.settimeout(PATIENCE_S)
            assert manager.recv(4096) == b"WATCHDOG=1"

            daemon.send_signal(signal.SIGTERM)
            while (last := manager.recv(4096)) == b"WATCHDOG=1":
                pass
            assert last == b"STOPPING=1"
            assert daemon.wait(PATIENCE_S) == 0
            assert not (tmp_path / "s.sock").exists()

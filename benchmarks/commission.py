"""`rm501-host commission` as a newcomer uses it: a terminal, a daemon, a board that is wired otherwise than configured.

python -m benchmarks.commission [--right]

A board whose direction line of 724 lacks its inverter and whose wrist selects are exchanged runs behind a pty, with a
daemon in front of it that was given a configuration with exchanged wrist switches. The command runs on a pseudo
terminal; the person at it is a script that looks at the emulated arm and answers what it saw. Then `check-config` reads
what was written, a daemon serves with it, and the arm homes. `--right`: everything is wired as configured.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import pty
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from benchmarks.daemon_takeaways import Bench, apart, ready
from rm501_host.commission.commands import laid_over, without_none
from rm501_host.config.loader import load_config
from rm501_host.errors import Rm501Error
from rm501_host.ini_import.toml_text import toml_text
from tests.operator.processes import REPOSITORY, Process, client_of, start_daemon
from tests.support.commission_person import Watching

COMMAND = (sys.executable, "-c", "from rm501_host.cli import main; main()")
FAULTS = ("no-inverter:line=DIR_1", "swap:line=LEFT_WRIST_SELECT,with=RIGHT_WRIST_SELECT")
STEP_DEG = 5.0
STRAY_DEG = 0.06
"""Rounding of both wrist motors."""
HOME_DEG = 0.3
DEADLINE_S = 240.0


class Screen:
    """The master end of a pseudo terminal: what the command shows, and what is typed."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)
        self.text = ""
        self._seen = 0

    def read(self) -> None:
        """Take what was shown since."""
        try:
            while data := os.read(self._descriptor, 4096):
                self.text += data.decode(errors="replace")
        except OSError:
            pass  # nothing now, or the command has ended

    def new(self, pattern: str) -> re.Match[str] | None:
        """The next match behind what was answered already."""
        found = re.compile(pattern).search(self.text, self._seen)
        if found:
            self._seen = found.end()
        return found

    def type(self, line: str) -> None:
        """Type a line."""
        os.write(self._descriptor, line.encode() + b"\n")


class Person:
    """Sits at the screen and looks at the arm."""

    def __init__(self, screen: Screen, bench: Bench) -> None:
        self.screen = screen
        self.bench = bench
        self.watching: Watching | None = None
        self.steps: list[Watching] = []
        self.answers: list[str] = []

    async def live(self, over: Callable[[], bool]) -> None:
        """Until the command is over."""
        screen, bench = self.screen, self.bench
        while not over():
            await asyncio.sleep(0.05)
            screen.read()
            if self.watching is not None:
                self.watching.look(await bench.joints_deg())
            if pressed := screen.new(r"Press the switch of the (\w+)"):
                await bench.ask(do="input", line=f"SWITCH_{pressed[1].upper()}", active=True)
            elif screen.new(r"Let go\."):
                for joint in ("WAIST", "SHOULDER", "ELBOW", "PITCH", "ROLL"):
                    await bench.ask(do="input", line=f"SWITCH_{joint}", active=None)
            elif screen.new(r"Press Enter "):
                self.watching = Watching(await bench.joints_deg())
                screen.type("")
            elif asked := screen.new(r"(?:The|first on) (\w+)[^\n]*\): "):
                assert self.watching is not None
                answer = self.watching.answer(asked[1])
                self.steps.append(self.watching)
                self.answers.append(f"{asked[1]}: {answer}")
                screen.type(answer)


def _start(terminal: int, config: Path, out: Path, socket: Path) -> subprocess.Popen[bytes]:
    options = ["--config", str(config), "commission", "--out", str(out), "--daemon", f"unix:{socket}"]
    return subprocess.Popen(
        [*COMMAND, *options], stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True
    )


def _check(config: Path) -> int:
    return subprocess.run(
        [*COMMAND, "--config", str(config), "check-config"], capture_output=True, check=False
    ).returncode


async def commission(folder: Path, config: Path, faults: tuple[str, ...]) -> bool:
    """Commission, check, home; prints what happened."""
    bench = Bench(folder)
    await bench.start()
    daemon: Process | None = None
    try:
        for fault in faults:
            await bench.ask(do="fault", spec=fault)
        daemon = await start_daemon(folder, str(config))
        async with client_of(folder) as client:
            await client.status_where(lambda now: bool(now["connected"]))
        at_first = await bench.joints_deg()
        near, far = pty.openpty()
        found = folder / "found.toml"
        child = _start(far, config, found, folder / "s.sock")
        os.close(far)
        person = Person(Screen(near), bench)
        began_s = time.perf_counter()
        async with asyncio.timeout(DEADLINE_S):
            await person.live(lambda: child.poll() is not None)
        person.screen.read()
        took_s = time.perf_counter() - began_s
        print("\n".join(f"  | {line}" for line in person.screen.text.splitlines() if line.strip()))
        strayed_deg = max((max(step.farthest_deg) for step in person.steps), default=0.0)
        others_deg = max((sorted(step.farthest_deg)[-2] for step in person.steps), default=0.0)
        left_deg = apart(at_first, await bench.joints_deg())
        print(
            f"commission: exit code {child.returncode} after {took_s:.0f} s, {len(person.steps)} steps; no joint went "
            f"farther than {strayed_deg:.3f} deg (said: {STEP_DEG:.0f}), others than the one that turned "
            f"{others_deg:.3f} deg, in the end {left_deg:.3f} deg from where it began"
        )
        good = child.returncode == 0 and len(person.steps) == 5
        good = good and strayed_deg <= STEP_DEG + STRAY_DEG and others_deg <= 0.1 and left_deg <= STRAY_DEG
        if child.returncode != 0:
            return False
        checked_code = _check(found)
        drive, wiring = load_config(found).drive, load_config(found).board.wiring
        print(
            f"check-config: exit code {checked_code}; signs {drive.signs}, wrist matrix {drive.wrist_matrix}, "
            f"swap_wrist_switches {wiring.swap_wrist_switches}"
        )
        async with client_of(folder) as client:
            await client.call("stop")
            await client.status_where(lambda now: not now["power"])
        await daemon.end()
        daemon = await start_daemon(folder, str(found))
        async with client_of(folder) as client:
            await client.status_where(lambda now: bool(now["connected"]))
            await ready(client)
            truth, home = await bench.joints_deg(), load_config(found).home_deg
        off_deg = apart(truth, home)
        print(f"home: with the new configuration the arm stands {off_deg:.3f} deg from its home position")
        return good and checked_code == 0 and off_deg <= HOME_DEG
    finally:
        if daemon is not None:
            await daemon.end(signal.SIGKILL)
        assert bench.process is not None
        await bench.process.end(signal.SIGKILL)


def main() -> int:
    """Run it; exit code 1 when something is not as it should be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.commission", description=__doc__)
    parser.add_argument("--right", action="store_true", help="wired as configured")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = folder / "given.toml"
        thesis = load_config(REPOSITORY / "configs" / "thesis.toml")
        exchanged = {"board": {"wiring": {"swap_wrist_switches": not options.right}}}
        text = toml_text(laid_over(without_none(msgspec.to_builtins(thesis)), exchanged), {}, "Given.")
        config.write_text(text)
        try:
            good = asyncio.run(commission(folder, config, () if options.right else FAULTS))
        except (Rm501Error, TimeoutError) as error:
            print(f"{type(error).__name__}: {error}")
            good = False
    print(f"commission: {'all targets met' if good else 'a target was MISSED'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

"""Two processes on a real pty, in real time, as a user starts them: the same steps as in virtual time."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from rm501_host.config import Config
from tests.support.cell import run_in_cell
from tests.support.patience import PATIENCE_S, blocking_until

pytestmark = [
    pytest.mark.xdist_group("real time"),
    pytest.mark.skipif(sys.platform != "linux", reason="ptys are for Linux"),
]
ROOT = Path(__file__).parents[2]
_ATTEMPTS = 6
_STOOD_STILL = ("silent for a second", "link was lost for a while", "stood still for more than a second")
SHORT = "G21 G90 G94\nG0 X210 Y0 Z-150 A0 B0 C0\nG1 X230 F2800\nM102\nM2\n"


@dataclass
class Bench:
    """A running `rm501-sim-board` process."""

    link: Path
    control: Path
    process: subprocess.Popen[str]

    def ask(self, request: dict[str, object]) -> dict[str, object]:
        with socket.socket(socket.AF_UNIX) as plug:
            plug.settimeout(PATIENCE_S)
            plug.connect(str(self.control))
            plug.sendall(json.dumps(request).encode() + b"\n")
            answer = b""
            while not answer.endswith(b"\n"):
                answer += plug.recv(65536)
        decoded: dict[str, object] = json.loads(answer)
        assert decoded["ok"], decoded
        return decoded


class StoodStillError(Exception):
    """This computer let the board, or the host, stand still for a second: `run` rightly ends, whatever it was doing."""


def on_a_bench(folder: Path, scenario: Callable[[Bench, Path], None]) -> None:
    """Play `scenario(bench, program)`, on a fresh bench again while the computer is too busy for any motion."""
    for attempt in range(_ATTEMPTS):
        place = folder / str(attempt)
        place.mkdir()
        program = place / "short.ngc"
        program.write_text(SHORT)
        try:
            with running_bench(place) as bench:
                scenario(bench, program)
                return
        except StoodStillError as error:
            told = str(error)
    pytest.fail(f"in {_ATTEMPTS} attempts this computer stood still for a second each time: {told}")


def returned(running: subprocess.Popen[str], code: int) -> tuple[str, str]:
    """What a host printed, on standard output and error, after it has returned `code`."""
    out, err = running.communicate(timeout=PATIENCE_S)
    if running.returncode == 6 and any(text in err for text in _STOOD_STILL):
        raise StoodStillError(err)
    assert running.returncode == code, err
    return out, err


@contextmanager
def running_bench(folder: Path) -> Iterator[Bench]:
    link, control = folder / "board", folder / "control"
    command = [sys.executable, "-m", "rm501_sim_board", "--pty", str(link), "--control", str(control), "--seed", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    with process:
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
            assert str(link) in first, first
            blocking_until(control.exists, "the control socket")
            yield Bench(link, control, process)
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert process.returncode == 0


def host(bench: Bench, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "rm501_host", "--config", str(ROOT / "configs" / "thesis.toml")]
    return subprocess.Popen(
        [*command, "--port", str(bench.link), "--json", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_the_same_program_makes_the_same_steps(tmp_path: Path, thesis: Config) -> None:
    def scenario(bench: Bench, program: Path) -> None:
        out, _ = returned(host(bench, "run", str(program)), 0)
        report = json.loads(out)
        assert report["result"] == "ok"
        cell = run_in_cell(program, thesis)
        hashes = bench.ask({"do": "hashes"})
        assert hashes["steps"] == cell.emulator.recording.step_sequence_hash()
        assert report["cycle_s"] == cell.result.report.cycle_s

    on_a_bench(tmp_path, scenario)


def wait_for_steps(bench: Bench, running: subprocess.Popen[str]) -> None:
    """Return once the arm moves."""
    start = bench.ask({"do": "truth"})
    blocking_until(
        lambda: running.poll() is not None or bench.ask({"do": "truth"})["joint_deg"] != start["joint_deg"],
        "the arm moves",
    )


def test_a_pulled_plug_stops_the_arm_on_its_path_and_the_host_says_what_to_do(tmp_path: Path) -> None:
    def scenario(bench: Bench, program: Path) -> None:
        running = host(bench, "run", str(program))
        wait_for_steps(bench, running)
        bench.ask({"do": "fault", "spec": "unplug"})
        _, err = returned(running, 6)
        assert "holds on its path by itself" in err
        blocking_until(lambda: bench.ask({"do": "status"})["state"] == "HELD", "the arm rests")
        first = bench.ask({"do": "truth"})
        threading.Event().wait(1.0)
        later = bench.ask({"do": "truth"})
        assert first["joint_deg"] == later["joint_deg"]
        assert later["powered"] is True

    on_a_bench(tmp_path, scenario)


def test_after_an_interrupt_the_arm_holds_and_the_next_run_names_the_way_back(tmp_path: Path) -> None:
    def scenario(bench: Bench, program: Path) -> None:
        running = host(bench, "run", str(program))
        wait_for_steps(bench, running)
        running.send_signal(signal.SIGINT)
        _, err = returned(running, 130)
        assert "holds on its path" in err
        first = bench.ask({"do": "truth"})
        out, err = returned(host(bench, "run", str(program)), 5)
        assert out == ""
        assert "serve" in err
        assert "rm501-host reset" in err
        assert bench.ask({"do": "truth"})["joint_deg"] == first["joint_deg"]

    on_a_bench(tmp_path, scenario)

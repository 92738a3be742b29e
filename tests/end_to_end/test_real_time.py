"""Two processes on a real pty, in real time, as a user starts them: the same steps as in virtual time."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
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


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    link, control = tmp_path / "board", tmp_path / "control"
    command = [sys.executable, "-m", "rm501_sim_board", "--pty", str(link), "--control", str(control), "--seed", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    first = process.stdout.readline()
    assert str(link) in first, first
    for _ in range(10):
        if control.exists():
            break
        process.stdout.readline()
    yield Bench(link, control, process)
    process.send_signal(signal.SIGINT)
    try:
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


def test_the_same_program_makes_the_same_steps(bench: Bench, thesis: Config, tmp_path: Path) -> None:
    program = tmp_path / "short.ngc"
    program.write_text(SHORT)
    running = host(bench, "run", str(program))
    out, err = running.communicate(timeout=200)
    assert running.returncode == 0, err
    report = json.loads(out)
    assert report["result"] == "ok"
    cell = run_in_cell(program, thesis)
    hashes = bench.ask({"do": "hashes"})
    assert hashes["steps"] == cell.emulator.recording.step_sequence_hash()
    assert report["cycle_s"] == cell.result.report.cycle_s


def wait_for_steps(bench: Bench) -> None:
    """Return once the arm moves."""
    start = bench.ask({"do": "truth"})
    blocking_until(lambda: bench.ask({"do": "truth"})["joint_deg"] != start["joint_deg"], "the arm moves")


def test_a_pulled_plug_stops_the_arm_on_its_path_and_the_host_says_what_to_do(bench: Bench, tmp_path: Path) -> None:
    program = tmp_path / "short.ngc"
    program.write_text(SHORT)
    running = host(bench, "run", str(program))
    wait_for_steps(bench)
    bench.ask({"do": "fault", "spec": "unplug"})
    out, err = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 6, (out, err)
    assert "holds on its path by itself" in err
    blocking_until(lambda: bench.ask({"do": "status"})["state"] == "HELD", "the arm rests")
    first = bench.ask({"do": "truth"})
    threading.Event().wait(1.0)
    later = bench.ask({"do": "truth"})
    assert first["joint_deg"] == later["joint_deg"]
    assert later["powered"] is True


def test_after_an_interrupt_the_arm_holds_and_the_next_run_names_the_way_back(bench: Bench, tmp_path: Path) -> None:
    program = tmp_path / "short.ngc"
    program.write_text(SHORT)
    running = host(bench, "run", str(program))
    wait_for_steps(bench)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 130, err
    assert "holds on its path" in err
    first = bench.ask({"do": "truth"})
    again = host(bench, "run", str(program))
    out, err = again.communicate(timeout=PATIENCE_S)
    assert again.returncode == 5, err
    assert out == ""
    assert "serve" in err
    assert "rm501-host reset" in err
    assert bench.ask({"do": "truth"})["joint_deg"] == first["joint_deg"]

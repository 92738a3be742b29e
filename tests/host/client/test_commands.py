"""The command line and the blocking Robot against a real daemon process on an emulated board, in real time."""

from __future__ import annotations

import json
import os
import signal
import socket as socket_module
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rm501_host import Robot
from rm501_host.errors import NoBoardError, RefusedError, StoppedError
from tests.support.patience import PATIENCE_S, blocking_until
from tests.support.virtual_machine import REPOSITORY

COMMAND = [sys.executable, "-c", "from rm501_host.cli import main; main()"]


def run(*arguments: str, socket: Path, json_output: bool = False) -> subprocess.CompletedProcess[str]:
    options = ["--json"] if json_output else []
    return subprocess.run(
        [*COMMAND, *options, *arguments],
        env={**os.environ, "RM501_SOCKET": str(socket)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.fixture(scope="module")
def socket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The socket of a daemon that other tests may have used."""
    with daemon_in(tmp_path_factory.mktemp("daemon")) as path:
        yield path


@pytest.fixture
def fresh_socket(tmp_path: Path) -> Iterator[Path]:
    """The socket of a daemon that has just started."""
    with daemon_in(tmp_path) as path:
        yield path


@contextmanager
def daemon_in(folder: Path) -> Iterator[Path]:
    path = folder / "s.sock"
    (folder / "state").mkdir()
    (folder / "state" / "points.toml").write_text("[points.pick]\nnumber = 1\nq_deg = [0, 60, -60, 60, 0]\n")
    config = str(REPOSITORY / "configs" / "thesis.toml")
    daemon = subprocess.Popen(
        [*COMMAND, "--json", "--config", config, "--port", "emu://?preset=ideal", "serve", "--socket", str(path),
         "--state", str(folder / "state")],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with daemon:
        try:
            assert daemon.stdout is not None
            assert json.loads(daemon.stdout.readline())["ready"] is True
            blocking_until(
                lambda: json.loads(run("status", socket=path, json_output=True).stdout)["connected"], "a connection"
            )
            yield path
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(PATIENCE_S) == 0
        finally:
            daemon.kill()
    assert not path.exists()


def test_a_port_named_to_a_command_of_the_daemon_is_answered_by_how_to_start_it(tmp_path: Path) -> None:
    result = run("--port", "/dev/ttyACM7", "home", socket=tmp_path / "none.sock")
    assert result.returncode == 4
    assert "rm501-host --port /dev/ttyACM7 serve" in result.stderr


def test_a_daemon_without_a_board_says_so_once(tmp_path: Path) -> None:
    path = tmp_path / "s.sock"
    daemon = subprocess.Popen(
        [*COMMAND, "--port", str(tmp_path / "quatsch"), "serve", "--socket", str(path), "--state", str(tmp_path / "s")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    with daemon:
        try:
            assert daemon.stdout is not None and daemon.stderr is not None
            assert "serves" in daemon.stdout.readline()
            said = daemon.stderr.readline()
            assert said.startswith("no board yet: ") and "quatsch" in said and "tried again" in said
            blocking_until(
                lambda: (tmp_path / "s" / "log.jsonl").read_text().count("link_down") >= 2, "another attempt"
            )
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(PATIENCE_S) == 0
            assert daemon.stderr.read() == ""
        finally:
            daemon.kill()


def test_a_program_with_old_comments_is_sent_as_the_characters_that_it_shows(socket: Path, tmp_path: Path) -> None:
    program = tmp_path / "greifer.ngc"
    program.write_bytes("(Greifer öffnen)\nG1 X1 (ohne F: wird abgelehnt)\nM2\n".encode("latin-1"))
    result = run("send", str(program), socket=socket)
    assert "Traceback" not in result.stderr
    assert result.returncode == 5


def test_joints_of_a_point_are_five(tmp_path: Path) -> None:
    result = run("teach", "edit", "pick", "--joints", "1,2", socket=tmp_path / "none.sock")
    assert result.returncode == 2
    assert "five numbers" in result.stderr


def test_commission_says_nothing_to_do_before_it_has_a_daemon(tmp_path: Path) -> None:
    result = run("commission", "--out", str(tmp_path / "my.toml"), socket=tmp_path / "none.sock")
    assert result.returncode == 4 and "rm501-host serve" in result.stderr
    assert not result.stdout and not (tmp_path / "my.toml").exists()


@pytest.mark.parametrize("command", ["status", "home", "stop", "hold", "abort", "monitor", "verify", "doctor"])
def test_without_a_daemon_every_command_says_what_to_do(tmp_path: Path, command: str) -> None:
    result = run(command, socket=tmp_path / "none.sock")
    assert result.returncode == 4
    assert "rm501-host serve" in result.stderr and not result.stdout


def test_a_session_at_the_command_line(fresh_socket: Path) -> None:
    socket = fresh_socket
    status = run("status", socket=socket)
    assert status.returncode == 0 and "ESTOP" in status.stdout and "then reset" in status.stdout
    early = run("home", socket=socket)
    assert early.returncode == 5 and "then reset" in early.stderr
    for command in ("hold", "abort"):
        still = run(command, socket=socket)
        assert still.returncode == 5 and "the machine is ESTOP (the daemon has started)" in still.stderr, still
        assert not still.stdout
    assert run("reset", socket=socket).returncode == 0
    jogged = run("jog", "waist", "6", "--distance", "2", socket=socket, json_output=True)
    assert jogged.returncode == 0
    assert json.loads(jogged.stdout)["joints_deg"][0] == pytest.approx(2.0, abs=0.03)
    for _ in range(20):  # a busy computer may not get round to moving while the key is held
        held_key = run("jog", "waist", "-6", "--seconds", "0.5", socket=socket, json_output=True)
        assert held_key.returncode == 0
        if json.loads(held_key.stdout)["joints_deg"][0] < 1.9:
            break
    else:
        pytest.fail("a key that is held moves nothing")
    path = socket.parent / "way.csv"
    path.write_text("t_s,waist,shoulder,elbow,pitch,roll\n6,10,60,-60,60,0\n")
    for arguments, why in (
        (("follow", str(path)), "not homed"),
        (("limits", "--velocity", "waist=99"), "joints.waist.max_velocity_deg_s 99 is not within 0.3 to 30"),
        (("teach", "go", "nowhere"), "no teach point"),
        (("teach", "record", "here"), "not homed"),
        (("teach", "edit", "pick", "--joints", "0,900,0,0,0"), "shoulder 900.000 deg is outside its range"),
        (("send", str(REPOSITORY / "examples" / "pick_and_place.ngc")), "not homed"),
        (("jog", "knee", "5"), "no joint"),
        (("resume",), "nothing is held"),
        (("hold",), "nothing moves, so there is nothing to hold; the machine is IDLE"),
        (("abort",), "nothing moves, so there is nothing to abort; the machine is IDLE"),
        (("back", "5"), "no program is under way"),
        (("home", "knee"), "no joint"),
    ):
        refused = run(*arguments, socket=socket)
        assert refused.returncode == 5 and why in refused.stderr, (arguments, refused)
    faster = run("override", "150", socket=socket)
    assert faster.returncode == 0 and faster.stdout == "override 150 %\n"
    assert json.loads(run("status", socket=socket, json_output=True).stdout)["override"] == 1.5
    as_json = run("override", "100", socket=socket, json_output=True)
    assert json.loads(as_json.stdout) == {"override": 1.0}
    for arguments in (("override", "201"), ("override", "-1"), ("override", "nan"), ("back", "0"), ("back", "31")):
        assert run(*arguments, socket=socket).returncode in (2, 5), arguments
    lowered = run("limits", "--velocity", "waist=10", "--tool", "80", socket=socket)
    assert lowered.returncode == 0 and "waist           10       30" in lowered.stdout
    assert "limits   lowered: 10 " in run("status", socket=socket).stdout
    restored = json.loads(run("limits", "--reset", socket=socket, json_output=True).stdout)
    assert restored["in_force"] == restored["hard"]
    assert run("limits", "--velocity", "knee=1", socket=socket).returncode == 2
    assert run("gripper", "close", socket=socket).returncode == 0
    assert json.loads(run("status", socket=socket, json_output=True).stdout)["hand"] == "CLOSED"
    assert run("stop", socket=socket).returncode == 0
    seen = run("monitor", "--count", "1", "--period", "20", socket=socket, json_output=True)
    assert seen.returncode == 0 and "task_state" in json.loads(seen.stdout.splitlines()[0])
    killed = run("stop", "--kill", socket=socket)
    assert killed.returncode == 0
    unnamed = run("reset", socket=socket)
    assert unnamed.returncode == 5 and "KILLED" in unnamed.stderr
    assert run("reset", "--fault", "KILLED", socket=socket).returncode == 0
    second = subprocess.run(
        [*COMMAND, "--port", "emu://", "serve", "--socket", str(socket), "--state", str(socket.parent / "other")],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert second.returncode == 5 and "another daemon answers" in second.stderr


def test_clients_that_vanish_do_not_take_the_daemon_along(socket: Path) -> None:
    """Writing to a client that was killed raises SIGPIPE, which ended the daemon once."""
    for _ in range(10):
        with socket_module.socket(socket_module.AF_UNIX, socket_module.SOCK_STREAM) as client:
            client.connect(str(socket))
            call = {"jsonrpc": "2.0", "id": 1, "method": "config", "params": {}}
            subscribe = {"jsonrpc": "2.0", "id": 2, "method": "subscribe", "params": {"period_ms": 20}}
            client.sendall((json.dumps(subscribe) + "\n" + (json.dumps(call) + "\n") * 30).encode())
    assert run("status", socket=socket).returncode == 0


def test_the_blocking_robot(socket: Path) -> None:
    with Robot.connect(f"unix:{socket}") as robot:
        robot.reset()
        assert robot.status()["task_state"] == "ON"
        robot.grip("open")
        assert robot.status()["hand"] == "OPEN"
        with pytest.raises(RefusedError, match="not homed"):
            robot.move_joints([0, 60, -60, 60, 0])
        with pytest.raises(RefusedError, match="not homed"):
            robot.move_linear([250, 0, -100, 0, 0, 0])
        with pytest.raises(RefusedError, match="no program"):
            robot.run("nothing.ngc")
        started = robot.call("home")
        robot.stop()
        with pytest.raises(StoppedError):
            robot.call("motion.wait", motion=started["motion"])
    with pytest.raises(NoBoardError, match="rm501-host serve"):
        Robot.connect("unix:/nowhere/s.sock")

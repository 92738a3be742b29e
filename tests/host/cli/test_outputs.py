"""Files that `run` writes: tried before anything moves, and never at the price of the report."""

import json
from pathlib import Path

import pytest

from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.main import run_command_line
from rm501_host.cli.outputs import require_writable
from rm501_host.errors import RefusedError

PROGRAM = "G0 X260 Y0 Z250 A0 B0\nM2\n"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "short.ngc"
    path.write_text(PROGRAM)
    return path


@pytest.mark.parametrize("option", ["--report", "--picture", "--wire-log"])
def test_a_file_that_cannot_be_written_refuses_the_run_before_it_connects(
    option: str, program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    target = blocked / "below.png"
    assert run_command_line(["run", str(program), "--speed", "max", option, str(target)]) is ExitCode.REFUSED
    captured = capsys.readouterr()
    assert option in captured.err
    assert "below.png" in captured.err
    assert "connecting" not in captured.err


def test_a_picture_of_unknown_kind_refuses_the_run_before_it_connects(
    program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "path.jpg"
    assert run_command_line(["run", str(program), "--speed", "max", "--picture", str(picture)]) is ExitCode.REFUSED
    captured = capsys.readouterr()
    assert ".png or .svg" in captured.err
    assert "connecting" not in captured.err


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="folder"):
        require_writable("--report", tmp_path)


def test_trying_a_file_leaves_nothing_but_its_folder(tmp_path: Path) -> None:
    require_writable("--report", tmp_path / "new" / "report.json")
    assert list(tmp_path.rglob("*")) == [tmp_path / "new"]


def test_the_report_is_printed_though_its_file_cannot_be_written_any_more(
    program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rm501_host.cli.run.require_writable", lambda option, path: None)
    blocked = tmp_path / "file"
    blocked.write_text("")
    arguments = ["--json", "run", str(program), "--speed", "max", "--report", str(blocked / "report.json")]
    assert run_command_line(arguments) is ExitCode.REFUSED
    captured = capsys.readouterr()
    assert json.loads(captured.out)["result"] == "ok"
    assert "report.json" in captured.err


def test_the_wire_of_a_refused_run_is_written(
    program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "wire.log"
    assert run_command_line(["run", str(program), "--speed", "max", "--no-home", "--wire-log", str(log)]) is (
        ExitCode.REFUSED
    )
    assert "not homed" in capsys.readouterr().err
    assert len(log.read_text().splitlines()) > 2

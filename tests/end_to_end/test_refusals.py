"""What cannot be run is refused with file, line and remedy, exit code 5, and the arm never feels it."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.main import run_command_line

ROOT = Path(__file__).parents[2]
HEAD = "G21 G90 G94\nG0 X210 Y0 Z-150 A0 B0 C0\n"
REFUSED = {
    "unreachable": (HEAD + "G1 X600 Y0 Z-150 F2800\nM2\n", 3, "reach"),
    "unreachable on the way": (HEAD + "G1 X-210 Y0 Z-150 F2800\nM2\n", 3, ""),
    "unknown code": (HEAD + "G77 X3\nM2\n", 3, "G77"),
    "no feed": (HEAD + "G1 X220\nM2\n", 3, "F word"),
    "binary": ("\x00\x7fELF\x01\x02\x00\x00\xff\n\x00\x01", 1, ""),
    "empty": ("", 1, "M2"),
    "no end": (HEAD, 3, "M2"),
    "joint limit": (HEAD + "M110 P2 Q150\nM2\n", 3, "range"),
    "spindle": (HEAD + "M3 S100\nM2\n", 3, "M3"),
    "unreachable orientation": (HEAD + "G1 X220 A30 B20 C10 F500\nM2\n", 3, ""),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_program_is_refused_before_the_port_is_opened(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, line, word = REFUSED[name]
    program = tmp_path / "bad.ngc"
    program.write_bytes(text.encode("latin-1"))
    vcd = tmp_path / "pins.vcd"
    arguments = ["--config", str(ROOT / "configs" / "thesis.toml"), "--port", f"emu://?vcd={vcd}"]
    code = run_command_line([*arguments, "run", str(program), "--speed", "max"])
    captured = capsys.readouterr()
    assert code is ExitCode.REFUSED, captured
    assert captured.out == ""
    assert f"bad.ngc:{line}" in captured.err
    assert word in captured.err
    # the board would have written its pins when it was switched off: it never was switched on
    assert not vcd.exists()


def test_a_good_program_does_write_its_pins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The check above can fail: with a good program the file is there."""
    program = tmp_path / "good.ngc"
    program.write_text("G21 G90\nG0 X210 Y0 Z-150 A0 B0 C0\nM2\n")
    vcd = tmp_path / "pins.vcd"
    arguments = ["--config", str(ROOT / "configs" / "thesis.toml"), "--port", f"emu://?vcd={vcd}"]
    assert run_command_line([*arguments, "--json", "run", str(program), "--speed", "max"]) is ExitCode.OK
    assert vcd.stat().st_size > 1000
    assert '"result": "ok"' in capsys.readouterr().out


def test_usage_and_ports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = str(tmp_path / "missing.ngc")
    good = str(ROOT / "examples" / "pick_and_place.ngc")
    thesis = ["--config", str(ROOT / "configs" / "thesis.toml")]
    assert run_command_line(["run", missing]) is ExitCode.USAGE
    assert run_command_line([*thesis, "run", good, "--speed", "fast"]) is ExitCode.USAGE
    assert run_command_line([*thesis, "--port", str(tmp_path / "tty"), "run", good]) is ExitCode.NO_BOARD
    assert run_command_line([*thesis, "--port", "socket://127.0.0.1:1", "run", good]) is ExitCode.NO_BOARD
    assert run_command_line([*thesis, "--port", "smoke://signal", "run", good]) is ExitCode.NO_BOARD
    assert (
        run_command_line([*thesis, "--port", str(tmp_path / "tty"), "run", good, "--speed", "max"]) is ExitCode.REFUSED
    )
    assert run_command_line([*thesis, "run", good, "--speed", "max", "--no-home"]) is ExitCode.REFUSED
    captured = capsys.readouterr()
    assert "not homed" in captured.err

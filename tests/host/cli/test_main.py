"""The command line's frame: exit codes, errors on standard error, imports that are put off."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.main import run_command_line


def test_check_config_reports_what_follows(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["--json", "check-config"]) is ExitCode.OK
    report = json.loads(capsys.readouterr().out)
    assert report["frame_us"] == 320
    assert report["motors"]["right_wrist"]["max_rate_deg_s"] == pytest.approx(1250 / 26.66666)


def test_errors_have_their_exit_codes_and_leave_standard_output_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line(["--config", str(tmp_path / "none.toml"), "check-config"]) is ExitCode.CONFIG
    assert run_command_line(["no-such-command"]) is ExitCode.USAGE
    assert run_command_line(["--no-such-option"]) is ExitCode.USAGE
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "none.toml" in captured.err


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from rm501_host.cli.main import run_command_line\n"
        "run_command_line(['--help'])\n"
        "heavy = {'numpy', 'can', 'serial', 'aiohttp', 'rich', 'asyncio', 'msgspec'} & set(sys.modules)\n"
        "sys.exit(f'imported: {sorted(heavy)}' if heavy else 0)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    assert "run" in result.stdout

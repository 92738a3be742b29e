"""import-ini: the thesis's INI becomes the shipped configuration, and every value is accounted for."""

from __future__ import annotations

import json
import tomllib
from importlib import resources
from pathlib import Path

import pytest
from click.testing import CliRunner

from rm501_host.cli.context import CommandContext
from rm501_host.config import load_config
from rm501_host.ini_import import IniError, Outcome, convert_ini, parse_ini
from rm501_host.ini_import.command import import_ini_command

THESIS = Path(__file__).parent / "thesis.ini"


def base() -> dict[str, object]:
    return tomllib.loads((resources.files("rm501_host") / "data" / "rm501.toml").read_text("utf-8"))


def run(arguments: list[str], json_output: bool = False):  # type: ignore[no-untyped-def]
    context = CommandContext(None, None, json_output, 0)
    return CliRunner().invoke(import_ini_command, arguments, obj=context, catch_exceptions=False)


def test_thesis_ini_gives_the_shipped_joints_and_motors(tmp_path: Path) -> None:
    out = tmp_path / "imported.toml"
    result = run([str(THESIS), "--out", str(out)])
    assert result.exit_code == 0
    imported, shipped = load_config(out), load_config()
    # machine.md's table is the shipped configuration, and was converted by hand from the same listing.
    assert imported.joints == shipped.joints
    for ours, theirs in zip(imported.motors.ordered[:3], shipped.motors.ordered[:3], strict=True):
        assert ours == theirs
    for wrist in imported.motors.ordered[3:]:
        # STEPGEN_MAXVEL 45 deg/s, below the 46.9 deg/s that the step timing allows.
        assert wrist.max_rate_steps_s == pytest.approx(45 * 26.66666)
    assert imported.drive == shipped.drive
    assert imported.board == shipped.board
    assert imported.machine.coordinates == "XYZABC"
    assert imported.planner.tcp_max_speed_mm_s == 100.0


def test_every_value_is_accounted_for_exactly_once() -> None:
    ini = parse_ini("thesis.ini", THESIS.read_text())
    conversion = convert_ini(ini, base())
    lines = [finding.line for finding in conversion.findings if finding.line is not None]
    assert lines == [value.line for value in ini.values]
    by_place = {(finding.line, finding.place): finding for finding in conversion.findings}
    limits = [f for (_, place), f in by_place.items() if place == "[JOINT_1]MAX_LIMIT"]
    assert limits[0].outcome is Outcome.CONVERTED and limits[0].key == "joints.shoulder.min_deg"
    axes = [f for f in conversion.findings if f.place.startswith("[AXIS_")]
    assert len(axes) == 24 and all(f.outcome is Outcome.IGNORED and f.note for f in axes)


def test_every_ignored_value_says_why() -> None:
    conversion = convert_ini(parse_ini("thesis.ini", THESIS.read_text()), base())
    assert all(f.note for f in conversion.findings if f.outcome in (Outcome.IGNORED, Outcome.CONVERTED, Outcome.KEPT))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("JOINTS = 5", "JOINTS = 3", r"thesis.ini:22: .*five joints"),
        ("TYPE = ANGULAR", "TYPE = LINEAR", r"thesis.ini:24: .*ANGULAR"),
        ("MAX_LIMIT = 150", "MAX_LIMIT = lots", r"thesis.ini:29: .*'lots' is not a number"),
        ("HOME_USE_INDEX = NO", "HOME_USE_INDEX = YES", r"thesis.ini:36: .*not supported"),
        ("SCALE = 40", "SCALE = 0", r"thesis.ini:40: .*zero"),
        ("COORDINATES = X Y Z A B C", "COORDINATES = U V W", r"thesis.ini:14: .*coordinate system"),
        ("SERVO_PERIOD = 1000000", "what is this", r"thesis.ini:9: .*no section"),
        ("LINEAR_UNITS = mm", "LINEAR_UNITS = furlong", r"thesis.ini:15: .*no unit"),
    ],
)
def test_what_cannot_be_understood_is_refused_at_its_line(old: str, new: str, expected: str) -> None:
    text = THESIS.read_text().replace(old, new, 1)
    with pytest.raises(IniError, match=expected):
        convert_ini(parse_ini("thesis.ini", text), base())


def test_inch_units_and_negative_scale() -> None:
    text = (
        THESIS.read_text().replace("LINEAR_UNITS = mm", "LINEAR_UNITS = inch").replace("SCALE = 40", "SCALE = -40", 1)
    )
    conversion = convert_ini(parse_ini("thesis.ini", text), base())
    assert conversion.data["planner"]["tcp_max_speed_mm_s"] == pytest.approx(2540.0)
    assert conversion.data["drive"]["signs"] == [-1, -1, -1]
    assert conversion.data["motors"]["waist"]["steps_per_deg"] == 40.0


def test_existing_file_is_kept_without_force(tmp_path: Path) -> None:
    out = tmp_path / "have.toml"
    out.write_text("mine")
    assert run([str(THESIS), "--out", str(out)]).exit_code == 2
    assert out.read_text() == "mine"
    assert run([str(THESIS), "--out", str(out), "--force"]).exit_code == 0
    assert load_config(out).machine.name == "RM-501"


def test_json_report(tmp_path: Path) -> None:
    report = json.loads(run([str(THESIS)], json_output=True).stdout)
    assert tomllib.loads(report["toml"])["joints"]["elbow"]["min_deg"] == -90.01
    assert {finding["outcome"] for finding in report["findings"]} == {"taken", "converted", "ignored", "kept"}

"""`rm501-host plan` and `check` as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from rm501_host.cli.context import CommandContext
from rm501_host.errors import RefusedError
from rm501_host.kinematics import Arm
from rm501_host.planner.command import plan_command
from rm501_host.preflight.command import check_command
from tests.support.plan_checker import judge_samples, tool_positions

PROGRAM = "G21 G90 G94\nG61.1\nG0 X300 Y0 Z200 A0 B0\nG1 Y60 F3000\nM101\nG4 P0.1\nG1 X300 Y0\nM2\n"


def context(tmp_path: Path) -> CommandContext:
    return CommandContext(config_path=None, port=None, json_output=True, verbose=0)


def test_plan_prints_json_and_writes_samples(tmp_path: Path) -> None:
    program, out = tmp_path / "p.ngc", tmp_path / "p.npz"
    program.write_text(PROGRAM)
    obj = context(tmp_path)
    result = CliRunner().invoke(
        plan_command, [str(program), "--out", str(out), "--start", "0,80,-80,10,0"], obj=obj, catch_exceptions=False
    )
    summary = json.loads(result.stdout)
    assert result.exit_code == 0
    with np.load(out) as archive:
        data = dict(archive)
    n = len(data["t_s"])
    assert [data[name].shape for name in ("q_deg", "tcp_mm", "motor_steps", "line")] == [(n, 5), (n, 3), (n, 6), (n,)]
    np.testing.assert_allclose(np.diff(data["t_s"])[:-1], 1e-3, atol=1e-12)
    assert data["t_s"][-1] == pytest.approx(summary["cycle_s"])
    # the hand's stroke and the dwell are part of the cycle, not of the motion
    assert summary["cycle_s"] - summary["motion_s"] == pytest.approx(0.64 + 0.1, abs=1e-3)
    np.testing.assert_allclose(tool_positions(obj.config, data["q_deg"]), data["tcp_mm"], atol=1e-9)
    assert judge_samples(obj.config, data["t_s"], data["q_deg"]).worst <= 1.0 + 1e-6
    arm = Arm.from_config(obj.config)
    np.testing.assert_allclose(arm.motors_from_joints(data["q_deg"]), data["motor_steps"][:, :5], atol=1e-9)
    assert data["motor_steps"][-1, 5] == 800
    assert set(data["line"]) == {3, 4, 5, 6, 7}
    assert max(summary["limits"].values()) <= 1.0 + 1e-6


def test_plan_refuses_joints_that_are_none(tmp_path: Path) -> None:
    program = tmp_path / "p.ngc"
    program.write_text(PROGRAM)
    result = CliRunner().invoke(plan_command, [str(program), "--start", "0,80,-80"], obj=context(tmp_path))
    assert result.exit_code == 2
    assert "five joint angles" in result.output


def test_check_reports_as_json_and_refuses(tmp_path: Path) -> None:
    program = tmp_path / "p.ngc"
    program.write_text(PROGRAM.replace("G1 Y60", "G1 X900"))
    result = CliRunner().invoke(check_command, [str(program)], obj=context(tmp_path))
    report = json.loads(result.stdout)
    assert isinstance(result.exception, RefusedError)
    assert report["ok"] is False
    (finding,) = report["findings"]
    assert (finding["kind"], finding["line"], finding["unit"]) == ("unreachable", 4, "mm")
    assert finding["amount"] > 400


def test_check_of_a_good_program(tmp_path: Path) -> None:
    program = tmp_path / "p.ngc"
    program.write_text(PROGRAM)
    result = CliRunner().invoke(check_command, [str(program)], obj=context(tmp_path), catch_exceptions=False)
    report = json.loads(result.stdout)
    assert report["ok"] and report["complete"]
    assert report["checked_to_line"] == 8
    assert report["needed_lead_s"] > report["stop_horizon_s"] > 0.0


@pytest.mark.parametrize("command", [plan_command, check_command])
def test_a_start_out_of_range_blames_the_option_not_the_program(tmp_path: Path, command: click.Command) -> None:
    program = tmp_path / "p.ngc"
    program.write_text(PROGRAM)
    result = CliRunner().invoke(command, [str(program), "--start", "0,80,-120,10,0"], obj=context(tmp_path))
    assert result.exit_code == 2
    assert "--start: the elbow cannot start at -120 deg" in result.output

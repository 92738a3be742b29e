"""`workspace` and `export-urdf`, and the exported model against URDF readers."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from rm501_host.config import load_config
from rm501_host.kinematics import Arm, KinematicsError
from rm501_host.kinematics.commands import export_urdf_command, workspace_command
from rm501_host.kinematics.urdf import urdf_text
from tests.support.kinematics import random_joints, with_section

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
TILTED = Arm.from_config(with_section(CONFIG, "tool", length_mm=20.0, offset_mm=(5.0, 8.0), tilt_deg=(15.0, -30.0)))
APP = SimpleNamespace(config=CONFIG, json_output=False)
APP_JSON = SimpleNamespace(config=CONFIG, json_output=True)
JOINTS = ("waist", "shoulder", "elbow", "pitch", "roll")


@pytest.mark.parametrize("arm", [ARM, TILTED], ids=["plain", "tilted tool"])
def test_exported_model_has_our_forward_kinematics_in_a_reader(arm: Arm) -> None:
    urdf = pytest.importorskip("pytransform3d.urdf")
    model = urdf.UrdfTransformManager()
    model.load_urdf(urdf_text(arm))
    for q in random_joints(arm, 100, seed=90, margin_deg=0.5):
        for name, angle in zip(JOINTS, np.radians(q), strict=True):
            model.set_joint(name, angle)
        tool = model.get_transform("tool0", "base_link")
        pose = arm.fk(q)
        assert np.abs(tool[:3, 3] * 1e3 - pose.xyz_mm).max() <= 1e-9
        assert np.abs(tool[:3, :3] - pose.rotation).max() <= 1e-12
    low, high = arm.limits_deg
    limits = np.degrees([model.get_joint_limits(name) for name in JOINTS])
    np.testing.assert_allclose(limits, np.stack((low, high), axis=1), atol=1e-12)


def test_exported_model_by_hand() -> None:
    """Without any reader: the chain multiplied out from the XML."""
    robot = ElementTree.fromstring(urdf_text(TILTED, "arm"))
    assert robot.get("name") == "arm"
    links = {link.get("name") for link in robot.findall("link")}
    q = random_joints(TILTED, 1, seed=91, margin_deg=0.5)[0]
    frame = np.eye(4)
    for joint, angle in zip(robot.findall("joint"), (*np.radians(q), None), strict=True):
        parent, child = joint.find("parent"), joint.find("child")
        assert parent is not None and child is not None
        assert {parent.get("link"), child.get("link")} <= links
        origin = joint.find("origin")
        assert origin is not None
        step = np.eye(4)
        step[:3, 3] = [float(part) for part in str(origin.get("xyz")).split()]
        roll, pitch, yaw = (float(part) for part in str(origin.get("rpy")).split())
        step[:3, :3] = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
        frame = frame @ step
        if angle is not None:
            frame[:3, :3] = frame[:3, :3] @ turn(2, angle)
    np.testing.assert_allclose(frame[:3, 3] * 1e3, TILTED.fk(q).xyz_mm, atol=1e-9)
    np.testing.assert_allclose(frame[:3, :3], TILTED.fk(q).rotation, atol=1e-12)


def turn(axis: int, angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def test_export_command_writes_a_file_or_stdout(tmp_path: Path) -> None:
    out = tmp_path / "arm.urdf"
    result = CliRunner().invoke(export_urdf_command, ["--out", str(out), "--tool-length", "25"], obj=APP)
    assert result.exit_code == 0
    assert out.read_text("utf-8") == urdf_text(ARM.with_tool(25.0))
    result = CliRunner().invoke(export_urdf_command, [], obj=APP)
    assert result.stdout == urdf_text(ARM)
    result = CliRunner().invoke(export_urdf_command, [], obj=APP_JSON)
    assert json.loads(result.stdout) == {"urdf": urdf_text(ARM)}
    result = CliRunner().invoke(export_urdf_command, ["--out", str(tmp_path / "no" / "arm.urdf")], obj=APP)
    assert isinstance(result.exception, KinematicsError)
    assert "cannot be written" in str(result.exception)


def test_workspace_command_prints_numbers_and_draws(tmp_path: Path) -> None:
    out = tmp_path / "w.png"
    result = CliRunner().invoke(workspace_command, ["--out", str(out), "--step", "40"], obj=APP)
    assert result.exit_code == 0, result.output
    assert "radius" in result.output and "straight down" in result.output
    assert out.read_bytes().startswith(b"\x89PNG")
    assert out.stat().st_size > 20_000
    result = CliRunner().invoke(workspace_command, ["--step", "40"], obj=APP_JSON)
    report = json.loads(result.stdout)
    assert report["any_pitch"]["radius_mm"][1] == pytest.approx(440.0, abs=41.0)
    assert report["tool_down"]["radius_mm"][1] < report["any_pitch"]["radius_mm"][1]
    assert report["picture"] is None
    result = CliRunner().invoke(workspace_command, ["--out", str(tmp_path / "w.xyz"), "--step", "80"], obj=APP)
    assert result.exit_code != 0
    assert "use .png" in str(result.exception)

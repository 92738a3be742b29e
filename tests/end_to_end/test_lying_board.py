"""A board that refuses a segment in the middle of a program: a report, the arm at rest on its path, exit code 5."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rm501_firmware_model.limits import SegmentChecker
from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.main import run_command_line
from rm501_protocol.faults import RefusalReason
from rm501_protocol.messages import NO_MOTOR
from rm501_protocol.segment_message import Segment

ROOT = Path(__file__).parents[2]
LEG = "G1 X270 Z-110 F1500\nG1 X210 Z-150\n"
PROGRAM = "G21 G90 G94\nG0 X210 Y0 Z-150 A0 B0 C0\nG4 P2\n" + 4 * LEG + "M2\n"
AFTER_THE_DWELL = 40
"""Segments that are taken after the one of the dwell: more than the queue holds, so the arm moves by then."""
DWELL_FRAMES = 6250


def refuse_in_the_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the 41st segment after the dwell on there is no room, whatever the board said of its free slots."""
    honest = SegmentChecker.accepts
    taken = [-1]

    def accepts(self: SegmentChecker, segment: Segment, jog_lease: int) -> int:
        if segment.length_frames == DWELL_FRAMES and not segment.motors:
            taken[0] = 0
        elif taken[0] >= 0:
            taken[0] += 1
        if taken[0] > AFTER_THE_DWELL:
            self.refusal.set(RefusalReason.QUEUE_FULL, NO_MOTOR, 0, self.end_frame)
            return 0
        return honest(self, segment, jog_lease)

    monkeypatch.setattr(SegmentChecker, "accepts", accepts)


def test_a_refusal_in_the_middle_ends_the_run_with_its_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refuse_in_the_middle(monkeypatch)
    program = tmp_path / "there_and_back.ngc"
    program.write_text(PROGRAM)
    report = tmp_path / "report.json"
    arguments = ["--config", str(ROOT / "configs" / "thesis.toml"), "--port", "emu://?seed=2", "--json"]
    code = run_command_line([*arguments, "run", str(program), "--speed", "max", "--report", str(report)])
    captured = capsys.readouterr()
    assert code is ExitCode.REFUSED
    assert "no free slot in the segment queue" in captured.err
    assert (
        "the board refused a part of the motion: the arm holds on its path, motors on, position trusted" in captured.err
    )
    written = json.loads(report.read_text())
    assert written == json.loads(captured.out)
    assert written["result"] == "refused"
    assert "no free slot in the segment queue" in written["faults"][0]
    assert written["segments"] > AFTER_THE_DWELL
    assert written["limits"]["joint_velocity_ratio"] <= 1.0


def test_a_noisy_line_is_told_once_and_is_in_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "there_and_back.ngc"
    program.write_text(PROGRAM)
    arguments = ["--config", str(ROOT / "configs" / "thesis.toml"), "--port", "emu://?seed=2&fault=flip:p=0.001"]
    code = run_command_line([*arguments, "--json", "run", str(program), "--speed", "max"])
    captured = capsys.readouterr()
    assert code is ExitCode.OK
    assert captured.err.count("the line to the board is bad: ") == 1
    wire = json.loads(captured.out)["wire"]
    assert wire["bad_frames"] > 10 and wire["retransmits"] > 0

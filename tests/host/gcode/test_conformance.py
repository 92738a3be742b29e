"""The peer's listings are the oracle: recorded ones of this project's programs, and the shared set where it is."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import pytest

from rm501_host.gcode import GcodeError, Interpreter, Settings, TextLines
from rm501_host.gcode import canon as c

from .listings import SHARED, first_difference, run_text

RECORDED = [
    json.loads(line)
    for line in (Path(__file__).parent / "data" / "peer_listings.jsonl").read_text(encoding="utf-8").splitlines()
]
PROGRAMS = sorted((SHARED / "programs").iterdir()) if (SHARED / "programs").is_dir() else []


def test_there_are_recorded_listings() -> None:
    assert len(RECORDED) > 500
    assert sum(not case["accepted"] for case in RECORDED) > 100


@pytest.mark.parametrize("part", range(20))
def test_recorded_programs_give_the_peers_listing(part: int) -> None:
    """Programs written for this project or drawn at random, with what `rs274 -g` (LinuxCNC 2.9) lists for them."""
    for case in RECORDED[part::20]:
        outcome = run_text(case["program"])
        difference = first_difference(outcome.lines, case["listing"])
        assert difference is None, f"{difference}\n{case['program']}"
        assert (outcome.error is None) == case["accepted"], f"{outcome.error}\n{case['program']}"


@pytest.mark.skipif(not PROGRAMS, reason="the shared programs are not here")
@pytest.mark.parametrize("folder", PROGRAMS, ids=lambda p: p.name)
def test_shared_programs_give_the_expected_listing(folder: Path) -> None:
    program = next(folder.glob("*.ngc"))
    case = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    expected = (folder / "expected.canon").read_text(encoding="utf-8").splitlines()
    outcome = run_text(program.read_text(encoding="utf-8", errors="surrogateescape"), name=program.name)
    assert first_difference(outcome.lines, expected) is None
    assert (outcome.error is None) == (case["rc"] == 0)


def _motions_mm(text: str) -> list[tuple[str, list[float]]]:
    """Traverses, feeds and arcs of a program with lengths in mm."""
    out: list[tuple[str, list[float]]] = []
    mm = 1.0
    try:
        for call in Interpreter(TextLines(text), Settings.as_peer()).calls():
            match call:
                case c.UseLengthUnits():
                    mm = call.units.mm
                case c.StraightTraverse() | c.StraightFeed():
                    name = "traverse" if isinstance(call, c.StraightTraverse) else "feed"
                    out.append((name, [*(v * mm for v in call.target[:3]), *call.target[3:]]))
                case c.ArcFeed():
                    plane = [v * mm for v in (*call.end, *call.centre)]
                    out.append(("arc", [*plane, float(call.turns), call.axis_end * mm, *call.abc]))
                case _:
                    pass
    except GcodeError:
        pass
    return out


@pytest.mark.skipif(not PROGRAMS, reason="the shared programs are not here")
def test_shared_full_precision_listings() -> None:
    """Programs that open with G21: the same traverses, feeds and arcs to 1e-9."""
    compared = 0
    for folder in PROGRAMS:
        full = folder / "expected.full.jsonl"
        text = next(folder.glob("*.ngc")).read_text(encoding="utf-8", errors="surrogateescape")
        if not full.exists() or not text.startswith("G21") or "G5" in text.split("G54")[0].replace("G53", ""):
            continue
        expected = []
        for line in full.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            if entry.get("op") in ("traverse", "feed", "arc"):
                expected.append((entry["op"], entry["args"]))
        got = _motions_mm(text)
        assert [name for name, _ in got] == [name for name, _ in expected], folder.name
        for (_, a), (_, b) in zip(got, expected, strict=True):
            assert len(a) == len(b)
            for x, y in zip(a, b, strict=True):
                assert math.isclose(x, y, rel_tol=1e-9, abs_tol=1e-9), (folder.name, a, b)
        compared += len(got)
    assert compared > 100


def _error_table() -> list[tuple[str, int | None, bool]]:
    table = SHARED / "errors" / "table.md"
    if not table.is_file():
        return []
    rows = []
    for line in table.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) > 4 and cells[1][:1].isdigit():
            rows.append((cells[1], None if cells[2] == "None" else int(cells[2]), "ACCEPTED" in cells[4]))
    return rows


@pytest.mark.skipif(not _error_table(), reason="the shared programs are not here")
@pytest.mark.parametrize(("name", "line", "accepted"), _error_table(), ids=lambda v: str(v))
def test_shared_errors_are_found_where_they_are(name: str, line: int | None, accepted: bool) -> None:
    text = (SHARED / "errors" / f"{name}.ngc").read_text(encoding="utf-8", errors="surrogateescape")
    outcome = run_text(text, name=f"{name}.ngc")
    if accepted:
        assert outcome.error is None
        assert outcome.warnings, "what the peer accepts silently deserves a warning"
        if line is not None:
            assert line in [w.location.line for w in outcome.warnings]
        return
    assert outcome.error is not None
    if line is not None:
        assert outcome.error.line == line
    assert outcome.error.remedy
    assert f"{name}.ngc:{outcome.error.line}" in str(outcome.error)


@pytest.mark.skipif(shutil.which("rs274") is None, reason="the peer is not installed")
def test_the_peer_still_lists_what_was_recorded(tmp_path: Path) -> None:
    """The recordings are the peer's, not ours: replay a few when it is installed."""
    for case in RECORDED[::60]:
        (tmp_path / "p.ngc").write_text(case["program"], encoding="utf-8")
        done = subprocess.run(["rs274", "-g", "p.ngc"], cwd=tmp_path, capture_output=True, timeout=20, check=False)
        listing = done.stdout.decode("utf-8", "replace").splitlines()
        if not listing:
            continue
        assert first_difference(listing, case["listing"]) is None, case["program"]

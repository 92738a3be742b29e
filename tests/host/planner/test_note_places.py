"""Log comments come behind the piece in which the move before them ends, however far ahead the planner reads."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.planner import PieceKind
from rm501_host.program_plan import check_and_plan

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)


@pytest.mark.parametrize("eager", [5000, 0])
@pytest.mark.parametrize("mode", ["G61", "G64 P0.1 Q0.02"])
def test_a_note_is_between_the_pieces_of_the_moves_around_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str, eager: int
) -> None:
    monkeypatch.setattr("rm501_host.program_plan.EAGER_MOVES", eager)
    rows = [f"G21 G90 G94 {mode} F6000", "G0 X280 Y0 Z200 A0 B0", "(LOGOPEN, out.txt)"]
    for i in range(30):
        rows.append(f"G1 X{280 + 0.4 * (i % 2)} Y{0.3 * i:.1f}")
        if i % 5 == 4:
            rows.append(f"(LOG, {i})")
        if i == 17:
            rows.append("G4 P0.1")
    program = tmp_path / "notes.ngc"
    program.write_text("\n".join([*rows, "M2", ""]))
    pieces = list(check_and_plan(program, ARM, CONFIG, CONFIG.home_deg).pieces())
    notes = [number for number, piece in enumerate(pieces) if piece.kind is PieceKind.NOTE]
    assert len(notes) == 7
    for number in notes:
        line = pieces[number].source.line
        before = [p for p in pieces[:number] if p.kind is PieceKind.MOTION]
        after = [p for p in pieces[number:] if p.kind is PieceKind.MOTION]
        # the piece before reaches the last move before the note; nothing after it is all before the note
        reached = max(element.source.line for element in before[-1].law.table.elements)  # type: ignore[union-attr]
        merged = 5 if "Q" in mode else 1
        assert reached >= line - merged
        for piece in after:
            assert max(element.source.line for element in piece.law.table.elements) > line - merged  # type: ignore[union-attr]
        if mode == "G61":
            assert reached < line < after[0].source.line if after else reached < line

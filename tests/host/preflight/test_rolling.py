"""The rolling check: what has been checked is what is played, each move once, up to the first that may not be."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.errors import ProgramRefusedError, RefusedError
from rm501_host.gcode.errors import GcodeError
from rm501_host.gcode.program_log import ProgramLog
from rm501_host.kinematics import Arm
from rm501_host.moves import Feed, InputWait, LinearMove, Move, ProgramEnd, RapidMove
from rm501_host.planner import PieceKind, PlanError
from rm501_host.planner.grid import Grid
from rm501_host.planner.window import Window
from rm501_host.preflight import ProgramCheck, ProgramFault, RollingCheck
from rm501_host.program import read_moves
from rm501_host.program_plan import carry_out_notes, check_and_plan
from tests.host.planner.programs import PICK_START_DEG, at, target
from tests.host.preflight.test_runs import random_program

CONFIG = load_config()
ARM = Arm.from_config(CONFIG)
FEED = Feed(6000.0)


def rolling(moves: Iterator[Move], ahead: int) -> RollingCheck:
    return RollingCheck(ProgramCheck(ARM, CONFIG, PICK_START_DEG), moves, ahead)


def wiggle(count: int, first_line: int = 2) -> list[Move]:
    moves: list[Move] = [RapidMove(target(280, 0, 200), at(1))]
    moves += [LinearMove(target(280 + i % 2, 0.01 * i, 200), FEED, at(first_line + i)) for i in range(count)]
    return moves


@pytest.mark.parametrize("seed", range(3))
def test_it_stops_at_the_first_move_that_the_preflight_of_all_would_name(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rm501_host.preflight.along.suggest_via", lambda *_: None)
    monkeypatch.setattr("rm501_host.preflight.check.suggest_via", lambda *_: None)
    moves = random_program(random.Random(seed), 700)
    whole = ProgramCheck(ARM, CONFIG, PICK_START_DEG).run(moves, estimate=False)
    first_line = min(finding.source.line for finding in whole.errors)
    clean = [move for move in moves if move.source.line < first_line]
    check = rolling(iter(moves), 1)
    before = check.before_start()
    if not before.ok:
        assert min(finding.source.line for finding in before.errors) == first_line
        # the same with a good beginning longer than a chunk
        moves = [*wiggle(600, first_line=1), *moves]
        clean = moves[: len(clean) + 601]
        check = rolling(iter(moves), 1)
        assert check.before_start().ok
    *played, fault = list(check)
    assert played == clean
    assert isinstance(fault, ProgramFault)
    assert fault.source.line == first_line
    assert f"test.ngc:{first_line}: error:" in str(fault.error)
    assert "was running" in str(fault.error)
    assert not check.is_complete or check.checked_to_line < max(move.source.line for move in moves)


def test_a_good_program_passes_whole_and_once() -> None:
    moves = [*wiggle(3000), ProgramEnd(at(3002))]
    check = rolling(iter(moves), 700)
    report = check.before_start()
    assert report.ok and not report.complete
    assert 700 <= report.moves <= 700 + 512
    assert check.checked_to_line == report.checked_to_line < 3002
    assert list(check) == moves
    assert check.is_complete
    assert check.checked_to_line == 3002


def test_it_reads_no_farther_ahead_than_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rm501_host.preflight.rolling.AHEAD_WHILE_RUNNING", 1000)
    read = 0

    def endless() -> Iterator[Move]:
        nonlocal read
        yield RapidMove(target(280, 0, 200), at(1))
        while True:
            read += 1
            yield LinearMove(target(280 + read % 2, 0, 200), FEED, at(2 + read % 3))

    check = rolling(endless(), 2000)
    check.before_start()
    for taken, _ in enumerate(check, start=1):
        assert read - taken < 2000 + 512 if taken < 1500 else read - taken < 1000 + 512
        if taken == 20_000:
            break
    assert check.checked_to_line == 4


def test_what_depends_on_an_input_is_read_when_the_input_has_been_played() -> None:
    answered = False

    def program() -> Iterator[Move]:
        yield RapidMove(target(280, 0, 200), at(1))
        yield InputWait(0, 3, 1.0, False, at(2))
        assert answered
        yield LinearMove(target(290, 0, 200), FEED, at(3))
        yield LinearMove(target(900, 0, 200), FEED, at(4))

    check = rolling(program(), 1000)
    report = check.before_start()
    assert report.ok and not report.complete
    assert "test.ngc:2" in report.stopped_by
    lines = []
    for move in check:
        if isinstance(move, InputWait):
            answered = True
        if not isinstance(move, ProgramFault):
            lines.append(move.source.line)
    assert lines == [1, 2, 3]
    assert isinstance(move, ProgramFault) and move.source.line == 4


def test_errors_in_the_text_end_it_too(tmp_path: Path) -> None:
    program = tmp_path / "a.ngc"
    good = ["G21 G90 G94 G64 P0.1", "G0 X280 Y0 Z200 A0 B0", "F6000"]
    good += [f"G1 X{280 + i % 2} Y{0.01 * i:.2f}" for i in range(600)]
    program.write_text("\n".join([*good, "G1 Xoops", "M2", ""]))
    config = load_config()
    with pytest.raises(GcodeError, match=r"a\.ngc:604"):
        check_and_plan(program, ARM, config, config.home_deg)
    check = ProgramCheck(ARM, CONFIG, config.home_deg)
    moves = read_moves(program, ARM, lambda: check.q_deg.tolist(), config=config)
    rolled = RollingCheck(check, moves, 10)
    assert rolled.before_start().ok
    *played, fault = list(rolled)
    assert played[-1].source.line == 603
    assert isinstance(fault, ProgramFault)
    assert "a.ngc:604" in str(fault.error) and "was running" in str(fault.error)


def test_a_program_that_computes_for_ever_is_not_waited_for_before_the_start(tmp_path: Path) -> None:
    program = tmp_path / "a.ngc"
    program.write_text("G21 G90\nG0 X280 Y0 Z200 A0 B0\no1 while [1]\n#1=[#1+1]\no1 endwhile\nM2\n")
    planned = check_and_plan(program, ARM, CONFIG, CONFIG.home_deg)
    assert not planned.is_complete
    assert "checked as the program runs" in planned.preflight.stopped_by
    planned.close()


def test_and_ends_when_it_never_moves_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rm501_host.gcode.interpreter.HEARTBEAT_BLOCKS", 200)
    program = tmp_path / "a.ngc"
    program.write_text("G21 G90\nG0 X280 Y0 Z200 A0 B0\no1 while [1]\n#1=[#1+1]\no1 endwhile\nM2\n")
    planned = check_and_plan(program, ARM, CONFIG, CONFIG.home_deg)
    moved, last = list(planned.pieces())
    assert moved.kind is PieceKind.MOTION and moved.ends_at_rest
    assert isinstance(last.move, ProgramFault) and "loop for ever" in str(last.move.error)


LOGGED = """G21 G90 G94 F6000 G61.1
(LOGOPEN, out.txt)
(LOG, begin)
G0 X280 Y0 Z200 A0 B0
(LOG, first)
G1 X300
(LOG, second)
G1 X320
(LOGCLOSE)
M2
"""


def test_log_comments_are_written_as_it_is_played(tmp_path: Path) -> None:
    program = tmp_path / "a.ngc"
    program.write_text(LOGGED)
    planned = check_and_plan(program, ARM, CONFIG, CONFIG.home_deg)
    out = tmp_path / "out.txt"
    assert not out.exists()
    texts = []
    for piece in carry_out_notes(planned.pieces(), ProgramLog(tmp_path, print)):
        if piece.kind is PieceKind.MOTION:
            texts.append(out.read_text().split() if out.exists() else [])
    assert texts == [["begin"], ["begin", "first"], ["begin", "first", "second"]]


def test_a_refused_program_writes_nothing(tmp_path: Path) -> None:
    program = tmp_path / "a.ngc"
    program.write_text(LOGGED.replace("G1 X320", "G1 X900"))
    with pytest.raises(RefusedError, match=r"a\.ngc:8"):
        check_and_plan(program, ARM, CONFIG, CONFIG.home_deg)
    assert not (tmp_path / "out.txt").exists()


def test_a_plan_that_fails_on_the_way_ends_at_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The preflight lets it pass, the planner does not: a fault injected into the window."""
    monkeypatch.setattr("rm501_host.program_plan.EAGER_MOVES", 10)
    program = tmp_path / "a.ngc"
    lines = ["G21 G90 G94 G64 P0.1 Q0", "G0 X280 Y0 Z200 A0 B0", "F6000"]
    lines += [f"G1 X{280 + 5 * math.sin(0.02 * i):.4f} Y{0.15 * i:.2f}" for i in range(1, 1150)]
    program.write_text("\n".join([*lines, "M2", ""]))
    extend = Window.extend

    def failing(self: Window, elements: list, grid: Grid | None = None) -> None:  # type: ignore[type-arg]
        if any(element.source.line > 1100 for element in elements):
            raise PlanError("made up", source=at(1101))
        extend(self, elements, grid)

    monkeypatch.setattr(Window, "extend", failing)
    planned = check_and_plan(program, ARM, CONFIG, CONFIG.home_deg)
    *pieces, last = list(planned.pieces())
    assert last.kind is PieceKind.MARK and isinstance(last.move, ProgramFault)
    assert isinstance(last.move.error, ProgramRefusedError)
    assert "checked to line 1153" in str(last.move.error)
    moving = [piece for piece in pieces if piece.kind is PieceKind.MOTION]
    assert moving[-1].ends_at_rest and not moving[-2].ends_at_rest
    end = ARM.program_from_joints(moving[-1].rest_deg)
    assert end[1] == pytest.approx(0.15 * (1100 - 3), abs=0.31)


def test_a_blend_out_of_a_joints_range_is_named_as_what_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both lines pass the elbow's limit closely outside, the blend between them inside: only the planner knows."""
    monkeypatch.setattr("rm501_host.program_plan.EAGER_MOVES", 10)
    limit_mm = 258.1927203  # tool straight down at Z200, the elbow at -90.01
    x, slope = limit_mm + 0.1, 0.025
    program = tmp_path / "a.ngc"
    lines = ["G21 G90 G94 G64 P0.5 F6000", "G0 X300 Y-40 Z200 A0 B0"]
    lines += [f"G1 X{300 + 0.2 * (i % 2):.2f} Y{-40 - 0.01 * i:.2f}" for i in range(20)]
    lines += [f"G1 X{x - 40 * slope:.4f} Y-40", f"G1 X{x:.4f} Y0", f"G1 X{x - 40 * slope:.4f} Y40", "G1 X300", "M2", ""]
    program.write_text("\n".join(lines))
    planned = check_and_plan(program, ARM, CONFIG, CONFIG.home_deg)
    *pieces, last = list(planned.pieces())
    assert isinstance(last.move, ProgramFault) and last.move.source.line == 24
    text = str(last.move.error)
    assert "a.ngc:24: in the blend at its end the elbow would leave its range" in text
    assert "smaller P in G64" in text and "checked to line 27" in text
    assert pieces[-1].ends_at_rest


def test_what_takes_longer_to_check_is_checked_less_far_before_the_start() -> None:
    long_lines = [LinearMove(target(270 + 60 * (i % 2), 0.01 * i, 200), FEED, at(i + 2)) for i in range(2999)]
    slow = rolling(iter([RapidMove(target(330, 0, 200), at(1)), *long_lines]), 3000)
    report = slow.before_start()
    assert report.ok and report.moves == 1024
    quick = rolling(iter(wiggle(2999)), 3500)
    assert quick.before_start().moves == 3000


@pytest.mark.parametrize("runs", [True, False], ids=["run", "check"])
def test_a_program_that_is_all_wrong_is_not_read_to_its_end(runs: bool) -> None:
    moves = [LinearMove(target(900, i % 2, 200), FEED, at(i + 2)) for i in range(20_000)]
    check = ProgramCheck(ARM, CONFIG, PICK_START_DEG)
    if runs:
        report = RollingCheck(check, iter(moves), 10**6).before_start()
    else:
        report = check.run(moves)
    assert not report.ok and not report.complete
    assert report.stopped_by == "1000 errors"
    assert 1000 <= report.moves < 1000 + 1024
    assert report.errors[0].source.line == 2

"""Files, lazy reading, synchronisation with the machine, run from line, G68, and what persists."""

from __future__ import annotations

import math
import os
import stat
from pathlib import Path

import pytest

from rm501_host import moves as mv
from rm501_host.gcode import (
    FileLines,
    GcodeError,
    GcodeFileError,
    GcodeFlowError,
    GcodeGeometryError,
    GcodeSyntaxError,
    GcodeUnsupportedError,
    Interpreter,
    ProbeResult,
    Settings,
    TextLines,
    UserMCodeError,
    find_user_m,
    interpret,
    interpret_file,
    parse_tool_table,
    resolve,
    run_user_m,
)
from rm501_host.gcode import canon as c
from rm501_host.gcode.canon import Axes, Units

from .listings import body

# -- subroutine files


def test_subroutines_from_files_on_the_search_path(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "hole.ngc").write_text("o<hole> sub\nG0 X#1\no<deep> call [#1+1]\no<hole> endsub\nM2\n")
    (tmp_path / "deep.ngc").write_text("(a file of its own)\no<deep> sub\nG0 Y#1\no<deep> endsub [7]\nM2\n")
    settings = Settings(subroutine_path=(tmp_path / "a", tmp_path))
    assert body("o<hole> call [3]\nG0 Z#<_value>\nM2", settings)[:3] == [
        "STRAIGHT_TRAVERSE(3.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
        "STRAIGHT_TRAVERSE(3.0000, 4.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
        "STRAIGHT_TRAVERSE(3.0000, 4.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
    ]


def test_an_error_in_a_subroutine_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "bad.ngc").write_text("o<bad> sub\nG0 X[1/0]\no<bad> endsub\n")
    with pytest.raises(GcodeError) as caught:
        list(interpret("G0 X1\no<bad> call\nM2", Settings(subroutine_path=(tmp_path,)), name="main.ngc"))
    assert caught.value.file.endswith("bad.ngc")
    assert caught.value.line == 2
    assert caught.value.call_stack[0].called_from.file == "main.ngc"


def test_a_missing_subroutine_names_the_folders_searched(tmp_path: Path) -> None:
    with pytest.raises(GcodeFlowError) as caught:
        list(interpret("G0 X1\no<nowhere> call\nM2", Settings(subroutine_path=(tmp_path,))))
    assert caught.value.line == 2
    assert str(tmp_path) in str(caught.value)


def test_no_path_outside_the_folders(tmp_path: Path) -> None:
    (tmp_path / "x.ngc").write_text("o<../x> sub\nG0 X1\no<../x> endsub\n")
    (tmp_path / "sub").mkdir()
    with pytest.raises(GcodeFlowError):
        list(interpret("o<../x> call\nM2", Settings(subroutine_path=(tmp_path / "sub",))))


# -- reading


def test_a_program_is_read_as_its_calls_are_taken(tmp_path: Path) -> None:
    """A long file: the first motions come after one chunk, jumping back far works, memory holds few chunks."""
    path = tmp_path / "long.ngc"
    lines = ["#1=0", "o1 while [#1 LT 2]", "#1=[#1+1]", *(f"G0 X{i}" for i in range(40_000)), "o1 endwhile", "M2"]
    path.write_text("\n".join(lines))

    class Counting:
        def __init__(self, inner: FileLines) -> None:
            self.name, self.inner, self.furthest = inner.name, inner, 0

        def block(self, index: int) -> tuple[int, list[str]]:
            self.furthest = max(self.furthest, index)
            return self.inner.block(index)

    source = Counting(FileLines.open(path))
    calls = Interpreter(source, Settings()).calls()
    for call in calls:
        if isinstance(call, c.StraightTraverse):
            break
    assert source.furthest < 100
    motions = 1 + sum(isinstance(call, c.StraightTraverse) for call in calls)
    assert motions == 80_000
    source.inner.close()


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_line_ends(tmp_path: Path, ending: str) -> None:
    path = tmp_path / "p.ngc"
    path.write_bytes(ending.join(["G21", "(ünïcode)", "G0 X1", "M2"]).encode("utf-8"))
    calls = list(interpret_file(path))
    assert [call.target[0] for call in calls if isinstance(call, c.StraightTraverse)] == [1.0]
    assert "ünïcode" in [call.text for call in calls if isinstance(call, c.Comment)]


def test_text_and_file_give_the_same_lines(tmp_path: Path) -> None:
    text = "\n".join(f"G0 X{i % 77}" for i in range(30_000)) + "\nM2\n"
    path = tmp_path / "p.ngc"
    path.write_text(text)
    assert [type(a) for a in interpret_file(path)] == [type(b) for b in interpret(text)]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(GcodeFileError, match=r"nothing\.ngc"):
        list(interpret_file(tmp_path / "nothing.ngc"))
    binary = tmp_path / "binary.ngc"
    binary.write_bytes(b"\x7fELF" + bytes(200_000))
    with pytest.raises(GcodeError) as caught:
        list(interpret_file(binary))
    assert str(caught.value).startswith(f"{binary}:1: ")
    empty = tmp_path / "empty.ngc"
    empty.write_bytes(b"")
    with pytest.raises(GcodeFlowError, match="program end"):
        list(interpret_file(empty))


# -- the machine's answers


class _Machine:
    def __init__(self, contact_z: float) -> None:
        self.log: list[str] = []
        self.contact_z = contact_z

    def probe_result(self, start: Axes, target: Axes, units: Units) -> ProbeResult:
        self.log.append("probe")
        if target[2] > self.contact_z:
            return ProbeResult(target, target, False)
        at = (target[0], target[1], self.contact_z, *target[3:])
        return ProbeResult(at, (at[0], at[1], self.contact_z - 0.2, *at[3:]), True)

    def input_value(self, index: int, analog: bool, mode: int, timeout_s: float) -> float:
        self.log.append(f"input {index}")
        return 1.0


def test_the_machine_is_asked_only_after_the_call_was_taken() -> None:
    machine = _Machine(-3.0)
    text = "G21 F100\nG38.2 Z-10\n(DEBUG,#5063 #5070 #5422)\nM66 P4 L0\nG0 X#5399\nM2"
    seen: list[str] = []
    for call in interpret(text, feedback=machine):
        seen.append(type(call).__name__)
        if isinstance(call, c.StraightProbe | c.WaitInput):
            seen.append(f"log {len(machine.log)}")
        if isinstance(call, c.OperatorMessage):
            assert call.text == "-3.000000 1.000000 -3.200000"
        if isinstance(call, c.StraightTraverse):
            assert call.target[0] == 1.0
    assert "log 0" in seen
    assert seen[seen.index("WaitInput") + 1] == "log 1"
    assert machine.log == ["probe", "input 4"]


def test_a_missed_probe_is_an_error_with_g38_2_only() -> None:
    machine = _Machine(-30.0)
    with pytest.raises(GcodeGeometryError, match="without contact"):
        list(interpret("G21 F100\nG38.2 Z-10\nG0 Z5\nM2", feedback=machine))
    list(interpret("G21 F100\nG38.3 Z-10\nG0 Z5\nM2", feedback=machine))


# -- block delete, start line


def test_block_delete() -> None:
    text = "/G0 X1\nG0 X2\n/ N5 G0 X3\nM2"
    assert len([line for line in body(text) if "TRAVERSE" in line]) == 3
    assert len([line for line in body(text, Settings(block_delete=True)) if "TRAVERSE" in line]) == 1


PROGRAM = "G20 F10\nG10 L2 P2 X1\nG55 G64 P0.1\nM3 S100\nG1 X1 Y1\n#5=7\nG91\nG1 X1\nX#5\nM2"


def test_start_at_a_line_restores_what_was_set_before() -> None:
    whole = body(PROGRAM, Settings())
    part = body(PROGRAM, Settings(start_line=9))
    rest = whole[whole.index("STRAIGHT_FEED(9.0000, 1.0000, 0.0000, 0.0000, 0.0000, 0.0000)") :]
    assert part[-len(rest) :] == rest
    restored = part[: -len(rest)]
    assert restored == [
        "USE_LENGTH_UNITS(CANON_UNITS_INCHES)",
        "SELECT_PLANE(CANON_PLANE_XY)",
        "SET_G5X_OFFSET(2, 1.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
        "SET_G92_OFFSET(0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
        "SET_XY_ROTATION(0.0000)",
        "SET_FEED_RATE(10.0000)",
        "SET_MOTION_CONTROL_MODE(CANON_CONTINUOUS, 0.100000)",
        "SET_NAIVECAM_TOLERANCE(0.1000)",
        "SET_SPINDLE_SPEED(0, 100.0000)",
        "START_SPINDLE_CLOCKWISE(0)",
        "STRAIGHT_TRAVERSE(2.0000, 1.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
    ]


def test_every_start_line_leads_to_the_same_end() -> None:
    options = Settings(start_line=1)
    text = PROGRAM.replace("M3 S100\n", "G4 P1\n")
    end = [m.target for m in resolve(interpret(text, options)) if isinstance(m, mv.LinearMove)][-1]
    for line in range(1, 10):
        moves = list(resolve(interpret(text, Settings(start_line=line))))
        assert [m.target for m in moves if isinstance(m, mv.LinearMove)][-1] == pytest.approx(end)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("G0 X1\nM2\nG0 X2", 3, "never reached"),
        ("G0 X1\nM66 P1\nG0 X2\nM2", 3, "asks the machine"),
        ("o1 if [0]\nG0 X1\no1 endif\nM2", 20, "never reached"),
    ],
)
def test_start_lines_that_cannot_be(text: str, line: int, words: str) -> None:
    with pytest.raises(GcodeFlowError, match=words):
        list(interpret(text, Settings(start_line=line)))


# -- G68


def test_g68_turns_lines_arcs_and_splines() -> None:
    """The same figure drawn in turned coordinates: every canonical point turns about the centre."""
    figure = "G0 X10 Y0\nG1 X20 Y5\nG3 X20 Y15 I0 J5\nG91 G1 X-3 Y1\nG90 G5 I1 J0 P-1 Q0 X5 Y5\nG1 @7 ^20"
    plain = list(interpret(f"G21 F100\n{figure}\nM2"))
    turned = list(interpret(f"G21 F100\nG68 X1 Y2 R35\n{figure}\nM2"))
    cos, sin = math.cos(math.radians(35)), math.sin(math.radians(35))

    def turn(x: float, y: float) -> tuple[float, float]:
        return (1 + cos * (x - 1) - sin * (y - 2), 2 + sin * (x - 1) + cos * (y - 2))

    def points(calls: list[c.CanonCall]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for call in calls:
            if isinstance(call, c.StraightFeed | c.StraightTraverse):
                out.append((call.target[0], call.target[1]))
            elif isinstance(call, c.ArcFeed):
                out += [call.end, call.centre]
            elif isinstance(call, c.NurbsFeed):
                out += call.control_points[1:]
        return out

    expected = [turn(x, y) for x, y in points(plain)]
    got = points(turned)
    assert len(got) == len(expected) == 9
    for a, b in zip(got, expected, strict=True):
        assert a == pytest.approx(b, abs=1e-9)


def test_g69_ends_the_rotation_where_the_tool_is() -> None:
    lines = body("G21\nG68 X0 Y0 R90\nG0 X10\n(DEBUG,#5420 #5421)\nG69\nG91 G0 X1\nM2")
    assert 'MESSAGE("10.000000 0.000000")' in lines
    assert "STRAIGHT_TRAVERSE(1.0000, 10.0000, 0.0000, 0.0000, 0.0000, 0.0000)" in lines


# -- variable file and tool table


def test_variables_survive_a_program(tmp_path: Path) -> None:
    path = tmp_path / "arm.var"
    path.write_text("31\t5\n500\t1\n")
    first = Interpreter(TextLines("#31=42\n#501=3\nG10 L2 P2 X7 R30\nG55\nG28.1\nM2"), Settings(), variables=path)
    list(first.calls())
    first.save_parameters(path)
    second = Interpreter(TextLines("G0 X#31 Y#501 Z#5241\nM2"), Settings(), variables=path)
    target = next(call.target for call in second.calls() if isinstance(call, c.StraightTraverse))
    assert target[:3] == (42.0, 0.0, 7.0)
    assert len(path.read_text().splitlines()) == 119 + 2


def test_a_failed_save_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "arm.var"
    path.write_text("31\t5\n")
    interpreter = Interpreter(TextLines("#31=42\nM2"), Settings(), variables=path)
    list(interpreter.calls())

    def full_disk(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(GcodeFileError, match="untouched"):
        interpreter.save_parameters(path)
    assert path.read_text() == "31\t5\n"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("text", ["x\t1\n", "5\n", "9999\t1\n", "5\tnan\n", "6\t1\n5\t1\n"])
def test_broken_variable_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "arm.var"
    path.write_text(text)
    with pytest.raises(GcodeSyntaxError) as caught:
        Interpreter(TextLines("M2"), Settings(), variables=path)
    assert caught.value.file == str(path)
    assert caught.value.line >= 1


def test_tool_table() -> None:
    table = parse_tool_table("; comment\nT1 P1 Z10.5 D3 ;probe\n\nT12 P3 X1 Y-2 Z+3.25 A5\n")
    tool = table.get(12)
    assert tool is not None
    assert tool.offset == (1.0, -2.0, 3.25, 5.0, 0.0, 0.0)
    probe = table.get(1)
    assert probe is not None
    assert (probe.diameter, probe.comment) == (3.0, "probe")
    assert table.get(5) is None


@pytest.mark.parametrize("text", ["P1 Z3\n", "T1 Z3 huh\n", "T1.5 Z3\n", "T1\nT1\n"])
def test_broken_tool_tables(text: str) -> None:
    with pytest.raises(GcodeSyntaxError) as caught:
        parse_tool_table(text, "arm.tbl")
    assert caught.value.file == "arm.tbl"


# -- M100 to M199 as executables


def _script(folder: Path, number: int, content: str) -> None:
    path = folder / f"M{number}"
    path.write_text(f"#!/bin/sh\n{content}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def test_executables_are_found_and_run_with_p_and_q(tmp_path: Path) -> None:
    _script(tmp_path, 105, f'printf "%s;%s" "$1" "$2" > {tmp_path}/out')
    (tmp_path / "M106").write_text("not executable")
    table = find_user_m(tmp_path)
    assert sorted(table) == [101, 102, 105, 110, 111]
    calls = list(interpret("M105 P3 Q[1+1]\nM2", Settings(user_m=table)))
    call = next(call for call in calls if isinstance(call, c.UserMCode))
    run_user_m(tmp_path, call.number, call.p, call.q)
    assert (tmp_path / "out").read_text() == "3.000000;2.000000"
    with pytest.raises(GcodeUnsupportedError, match="M106"):
        list(interpret("M106\nM2", Settings(user_m=table)))


def test_executables_that_fail_or_hang(tmp_path: Path) -> None:
    _script(tmp_path, 105, "echo no paper >&2; exit 3")
    _script(tmp_path, 107, "sleep 5")
    with pytest.raises(UserMCodeError, match="exit status 3: no paper"):
        run_user_m(tmp_path, 105, None, None)
    with pytest.raises(UserMCodeError, match="took longer"):
        run_user_m(tmp_path, 107, None, None, timeout_s=0.05)
    with pytest.raises(UserMCodeError, match="cannot be run"):
        run_user_m(tmp_path, 108, None, None)


# -- where the tool is


def test_the_consumer_tells_where_the_tool_is() -> None:
    """After a joint move and after a tool length the next incremental move starts from the place that was told."""
    text = "G20\nG10 L2 P2 X1 R90\nG55\nM110 P1 Q30\nG91 G0 X1\nG43.1 Z2\nG0 Y1\nM2"
    interpreter = Interpreter(TextLines(text), Settings())
    interpreter.set_position((10.0, 20.0, 30.0, 1.0, 2.0, 3.0))
    targets = []
    for move in resolve(interpreter.calls()):
        if isinstance(move, mv.JointMove):
            interpreter.set_position((100.0, 50.0, 25.0, 0.0, 5.0, 0.0))
        elif isinstance(move, mv.ToolChange):
            interpreter.set_position((7.0, 8.0, 9.0, 0.0, 5.0, 0.0))
        elif isinstance(move, mv.RapidMove):
            targets.append(move.target)
    assert targets[0] == pytest.approx((100.0, 50.0 + 25.4, 25.0, 0.0, 5.0, 0.0))
    assert targets[1] == pytest.approx((7.0 - 25.4, 8.0, 9.0, 0.0, 5.0, 0.0))
    assert interpreter.warnings == []

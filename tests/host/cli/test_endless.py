"""Programs that never end, or that wait for somebody: bounded, told of while it takes long, refused before a motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from rm501_host.cli import progress
from rm501_host.cli.exit_codes import ExitCode
from rm501_host.cli.main import run_command_line
from rm501_host.moves import Dwell, Source
from rm501_host.reading import tell_while_reading

HEAD = "G21 G90\nG0 X270 Y0 Z250 A0 B0\n"
ENDLESS = HEAD + "o100 while [1]\nG1 X275 F1500\nG1 X270\no100 endwhile\nM2\n"


def program(tmp_path: Path, text: str) -> str:
    path = tmp_path / "e.ngc"
    path.write_text(text)
    return str(path)


def test_a_plan_of_an_endless_program_is_refused_at_the_bound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = run_command_line(["plan", program(tmp_path, ENDLESS), "--max-moves", "300"])
    out, err = capsys.readouterr()
    assert code is ExitCode.REFUSED
    assert out == ""
    assert "e.ngc:5: more than 300 moves, does it ever end?" in err and "--max-moves" in err


def test_a_plan_as_long_as_the_bound_is_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = program(tmp_path, HEAD + "G1 X275 F1500\nM2\n")
    assert run_command_line(["plan", path, "--max-moves", "4"]) is ExitCode.OK, capsys.readouterr()
    assert run_command_line(["plan", path, "--max-moves", "1"]) is ExitCode.REFUSED


@pytest.mark.parametrize(
    ("command", "word"),
    [(("plan", "--max-moves"), "planning line"), (("check", "--max-blocks"), "checking line")],
)
def test_long_reading_is_told_on_standard_error(
    command: tuple[str, str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    ticks = iter(range(10**9))
    monkeypatch.setattr(progress.time, "perf_counter", lambda: float(next(ticks)))
    name, bound = command
    path = program(tmp_path, ENDLESS)
    run_command_line([name, path, bound, "30"])
    out, err = capsys.readouterr()
    told = [line for line in err.splitlines() if line.startswith(word)]
    assert len(told) > 3 and "moves so far" in told[0]
    assert word not in out
    run_command_line(["--json", name, path, bound, "30"])
    assert word not in capsys.readouterr().err


def test_reading_is_told_by_the_clock_and_closed_with_its_reader() -> None:
    now_s, told, closed = 0.0, list[tuple[int, int]](), list[bool]()

    def moves() -> Iterator[Dwell]:
        try:
            for line in range(1, 100):
                yield Dwell(1.0, Source("e.ngc", line))
        finally:
            closed.append(True)

    reading = tell_while_reading(moves(), lambda line, count: told.append((line, count)), lambda: now_s, every_s=3.0)
    for _move in reading:
        now_s += 1.0
        if now_s >= 8.0:
            break
    reading.close()
    assert told == [(3, 3), (6, 6)]
    assert closed == [True]


@pytest.mark.parametrize(
    ("block", "remedy"),
    [("M66 P1 L3 Q2", "rm501-host serve, then send"), ("G38.2 X300 F500", "there is none on this machine")],
)
def test_a_run_that_would_wait_for_somebody_is_refused_before_the_port_is_opened(
    block: str, remedy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pins = tmp_path / "pins.vcd"
    path = program(tmp_path, f"{HEAD}{block}\nG1 X275 F1500\nM2\n")
    code = run_command_line(["--port", f"emu://?vcd={pins}", "run", path, "--speed", "max"])
    out, err = capsys.readouterr()
    assert code is ExitCode.REFUSED
    assert "e.ngc:3:" in err and remedy in err
    assert not pins.exists() and out == ""


def test_a_run_says_how_far_its_check_has_come(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = iter(range(10**9))
    monkeypatch.setattr(progress.time, "perf_counter", lambda: float(next(ticks)))
    text = HEAD + "\n".join(f"G1 X{270 + n % 5} F1500" for n in range(20)) + "\nM2\n"
    assert run_command_line(["run", program(tmp_path, text), "--speed", "max"]) is ExitCode.OK
    lines = capsys.readouterr().err.splitlines()
    checking = [at for at, line in enumerate(lines) if line.startswith("checking line")]
    assert checking and max(checking) < lines.index("connecting ...")

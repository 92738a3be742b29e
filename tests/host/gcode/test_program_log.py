"""Log comments write files of one folder and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.gcode import GcodeFileError, ProgramLog, ResolveOptions, interpret, resolve


def _run(text: str, folder: Path) -> list[str]:
    printed: list[str] = []
    log = ProgramLog(folder, printed.append)
    try:
        list(resolve(interpret(text), ResolveOptions(on_log=log)))
    finally:
        log.close()
    return printed


def test_open_append_close_and_print(tmp_path: Path) -> None:
    text = (
        "(LOG, dropped)\n(LOGOPEN, a.txt)\n(LOG, x=#5420)\nG0 X2\n(LOGCLOSE)\n(LOG, dropped)\n"
        "(LOGAPPEND, a.txt)\n(LOG, x=%.1f#5420)\n(PRINT, at %d#5420)\nM2"
    )
    assert _run(text, tmp_path) == [" at 2"]
    assert (tmp_path / "a.txt").read_text() == "x=0.000000\nx=2.0\n"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("name", ["../a.txt", "/etc/motd", "", "..", "b/c.txt"])
def test_no_file_outside_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(GcodeFileError, match="not a plain file name") as caught:
        _run(f"G0 X1\n(LOGOPEN, {name})\nM2", tmp_path)
    assert caught.value.line == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["pick.ngc", "tool.tbl", "rm501.var", "arm.toml", "log", ".txt"])
def test_a_log_has_the_name_of_a_log(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("precious")
    with pytest.raises(GcodeFileError, match="not the name of a log") as caught:
        _run(f"G0 X1\n(LOGAPPEND, {name})\n(LOG, scribble)\nM2", tmp_path)
    assert caught.value.line == 2
    assert (tmp_path / name).read_text() == "precious"


def test_a_log_is_a_plain_file(tmp_path: Path) -> None:
    (tmp_path / "pick.ngc").write_text("precious")
    (tmp_path / "a.txt").symlink_to("pick.ngc")
    with pytest.raises(GcodeFileError, match="link or a device"):
        _run("(LOGOPEN, a.txt)\nM2", tmp_path)
    assert (tmp_path / "pick.ngc").read_text() == "precious"


def test_a_log_that_cannot_be_written_names_its_line(tmp_path: Path) -> None:
    with pytest.raises(GcodeFileError, match="cannot write the log") as caught:
        _run("(LOGOPEN, a.txt)\nM2", tmp_path / "missing")
    assert caught.value.line == 1

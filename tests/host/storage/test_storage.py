"""Files that outlive the process: whole or untouched, also on a full disk."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import BinaryIO

import pytest

from rm501_host.storage import JsonLog, PositionFile, PositionRecord, StorageError, write_atomic


def test_a_failed_write_leaves_the_old_file_and_no_temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "state.json"
    write_atomic(path, b"old")

    def no_space(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(StorageError, match="No space left"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["state.json"]


class _Disk:
    """A disk that can be full: the file handle refuses to write."""

    def __init__(self) -> None:
        self.full = False

    def open(self, path: Path) -> BinaryIO:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        disk = self
        file = path.open("ab")

        class Handle:
            def write(self, data: bytes) -> int:
                if disk.full:
                    raise OSError(errno.ENOSPC, "No space left on device")
                return file.write(data)

            def __getattr__(self, name: str) -> object:
                return getattr(file, name)

        return Handle()  # type: ignore[return-value]


def test_log_survives_a_full_disk_and_says_what_it_lacks(tmp_path: Path) -> None:
    now = [0.0]
    disk = _Disk()
    log = JsonLog(tmp_path / "log.jsonl", lambda: now[0], lambda: "2000-01-01T00:00:00Z", opener=disk.open)
    log.write("started")
    disk.full = True
    for number in range(5):
        now[0] += 1
        log.write("moving", number=number)
    assert log.unwritten == 5 and "No space" in (log.last_error or "")
    disk.full = False
    now[0] += 20
    log.write("after")
    log.close()
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert kinds == ["started", "log_late", *["moving"] * 5, "after"]
    assert [record.kind for record in log.ring] == ["started", *["moving"] * 5, "after"]
    assert log.unwritten == 0


def test_log_rotates_and_keeps_a_bounded_number_of_files(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    log = JsonLog(path, lambda: 0.0, lambda: "", max_bytes=1000, files=3)
    for number in range(200):
        log.write("n", number=number)
    log.close()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.jsonl", "log.jsonl.1", "log.jsonl.2"]
    assert all(file.stat().st_size <= 1000 for file in tmp_path.iterdir())
    newest = json.loads(path.read_text().splitlines()[-1])
    assert newest["number"] == 199


def _record(dirty: bool) -> PositionRecord:
    return PositionRecord(
        dirty=dirty,
        boot_id=7,
        config_hash=8,
        positions_steps=(1, 2, 3, 4, 5, 0),
        homed=(True,) * 5,
        hand="OPEN",
        utc="",
    )


def test_position_file_round_trip_and_damage(tmp_path: Path) -> None:
    path = tmp_path / "position.json"
    file = PositionFile(path)
    assert file.read() is None and file.warning is None
    assert file.write(_record(True))
    assert PositionFile(path).read() == _record(True)
    assert file.write(_record(False))
    assert PositionFile(path).read() == _record(False)
    path.write_bytes(path.read_bytes()[:20])
    damaged = PositionFile(path)
    assert damaged.read() is None and "damaged" in (damaged.warning or "")


def test_position_file_on_a_full_disk_warns_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = PositionFile(tmp_path / "position.json")

    def no_space(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    assert not file.write(_record(True))
    assert "No space" in (file.warning or "")


def test_a_link_to_a_file_stays_a_link(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_atomic(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_what_is_no_regular_file_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)
    try:
        write_atomic(pipe, b"hello")
        assert pipe.is_fifo()
        assert os.read(reader, 100) == b"hello"
    finally:
        os.close(reader)

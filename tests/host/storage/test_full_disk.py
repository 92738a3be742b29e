"""A disk that really is full: the kernel refuses to let files grow beyond a limit, in the middle of a line too."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rm501_host.blackbox import BlackBox, read_dump
from rm501_host.storage import JsonLog, PositionFile, PositionRecord, jsonlog

resource = pytest.importorskip("resource")


@contextmanager
def files_end_at(size_bytes: int) -> Iterator[None]:
    """No file of this process grows beyond that; Python ignores the signal, so writing fails with EFBIG."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def lines_of(path: Path) -> list[dict[str, object]]:
    """Every line, whole."""
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.mark.parametrize("limit_bytes", [0, 1, 700, 723, 750])
def test_the_log_keeps_what_the_disk_does_not_take_and_writes_it_later(tmp_path: Path, limit_bytes: int) -> None:
    now = [0.0]
    path = tmp_path / "log.jsonl"
    log = JsonLog(path, lambda: now[0], lambda: "2000-01-01T00:00:00Z")
    with files_end_at(limit_bytes):
        for number in range(40):
            now[0] += 1.0
            log.write("moving", number=number)
        assert log.unwritten > 0 and log.last_error is not None
        on_disk = lines_of(path)  # nothing but whole lines
        assert len(on_disk) + log.unwritten == 40
    now[0] += 20.0
    log.write("after")
    log.close()
    records = [line for line in lines_of(path) if line["kind"] != "log_late"]
    assert [record.get("number") for record in records] == [*range(40), None]
    assert log.unwritten == 0 and log.last_error is None
    assert len(log.ring) == 41


def test_what_the_ring_has_forgotten_is_told_as_a_gap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jsonlog, "RING_RECORDS", 10)
    now = [0.0]
    path = tmp_path / "log.jsonl"
    log = JsonLog(path, lambda: now[0], lambda: "")
    with files_end_at(0):
        for number in range(30):
            log.write("moving", number=number)
    now[0] += 20.0
    log.write("after")
    log.close()
    late, gap, *kept, last = lines_of(path)
    assert (late["kind"], late["records"]) == ("log_late", 9)
    assert (gap["kind"], gap["records_missing"]) == ("log_gap", 21)
    assert [line["number"] for line in kept] == list(range(21, 30)) and last["kind"] == "after"


def test_a_line_that_a_killed_writer_left_half_spoils_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_bytes(b'{"kind":"whole"}\n{"kind":"ha')
    log = JsonLog(path, lambda: 0.0, lambda: "")
    log.write("first")
    log.write("second")
    log.close()
    lines = path.read_text().splitlines()
    assert [json.loads(lines[index])["kind"] for index in (0, 2, 3)] == ["whole", "first", "second"]


def test_the_black_box_leaves_no_half_file_and_is_whole_when_there_is_room(tmp_path: Path) -> None:
    box = BlackBox(tmp_path, lambda: 1.5)
    for number in range(300):
        box.add("sent", number.to_bytes(2, "little") * 20)
    with files_end_at(200):
        assert box.dump("OVERFLOW") is None
        assert box.warning is not None
        assert list(tmp_path.iterdir()) == []
    path = box.dump("OVERFLOW")
    assert path is not None and box.warning is None
    header, *entries = read_dump(path)
    assert header["reason"] == "OVERFLOW" and len(entries) == 300
    assert [bytes.fromhex(str(entry["payload"]))[:2] for entry in entries[:2]] == [b"\x00\x00", b"\x01\x00"]


def test_the_position_file_stays_the_old_one(tmp_path: Path) -> None:
    file = PositionFile(tmp_path / "position.json")
    record = PositionRecord(
        dirty=False, boot_id=7, config_hash=1, positions_steps=(0,) * 6, homed=(True,) * 5, hand="OPEN", utc=""
    )
    assert file.write(record)
    moved = PositionRecord(
        dirty=True, boot_id=7, config_hash=1, positions_steps=(9,) * 6, homed=(True,) * 5, hand="OPEN", utc=""
    )
    with files_end_at(50):
        assert not file.write(moved)
        assert file.warning is not None
        assert file.read() == record
        assert [path.name for path in tmp_path.iterdir()] == ["position.json"]
    assert file.write(moved) and file.read() == moved

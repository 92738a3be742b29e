"""The black box holds the last minute, no more memory than promised, and survives a disk that refuses."""

from __future__ import annotations

from pathlib import Path

from rm501_host.blackbox import BlackBox, read_dump


def test_dump_holds_exactly_the_last_minute(tmp_path: Path) -> None:
    now = [0.0]
    box = BlackBox(tmp_path, lambda: now[0])
    for second in range(200):
        now[0] = float(second)
        box.add("sent", bytes([second % 256]))
        box.add("status", b'{"state":"HELD"}')
    path = box.dump("OVERFLOW: elbow")
    assert path is not None and path.name == "blackbox-000001-overflow-elbow.jsonl.gz"
    header, *entries = read_dump(path)
    assert header["reason"] == "OVERFLOW: elbow"
    assert entries[0]["time_s"] == 139.0 and entries[-1]["time_s"] == 199.0
    assert entries[0] == {"time_s": 139.0, "kind": "sent", "payload": "8b"}
    assert entries[-1]["payload"] == {"state": "HELD"}


def test_memory_is_bounded_by_bytes() -> None:
    box = BlackBox(None, lambda: 0.0, max_bytes=10_000)
    for _ in range(1000):
        box.add("received", bytes(100))
    assert box.size_bytes <= 10_000
    assert 0 < len(box.entries()) < 100


def test_only_the_newest_dumps_stay_and_numbers_go_on_after_a_restart(tmp_path: Path) -> None:
    for _ in range(15):
        assert BlackBox(tmp_path, lambda: 0.0, keep=10).dump("stop") is not None
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) == 10 and names[-1] == "blackbox-000015-stop.jsonl.gz"


def test_a_disk_that_refuses_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    box = BlackBox(tmp_path / "file", lambda: 0.0)
    box.add("log", b"{}")
    assert box.dump("stop") is None
    assert box.warning is not None

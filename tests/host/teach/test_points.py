"""Teach points: every change is on disk or did not happen."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rm501_host.config import load_config
from rm501_host.storage import StorageError
from rm501_host.teach import TeachError, TeachFile, require_within_ranges
from rm501_host.teach import points as points_module

Q = (10.0, 20.0, -30.0, 40.0, -50.0)


def test_record_list_edit_rename_delete_survive_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "points.toml"
    file = TeachFile(path)
    file.record("pick", Q, note='over the "tray"')
    file.record("place", Q)
    file.record("park", Q, number=42)
    file.edit("place", q_deg=(1.0, 2.0, -3.0, 4.0, 5.0))
    file.rename("park", "rest")
    again = TeachFile(path)
    assert [(point.number, point.name) for point in again.points] == [(1, "pick"), (2, "place"), (42, "rest")]
    assert again.get("pick").note == 'over the "tray"' and again.get(2).q_deg == (1.0, 2.0, -3.0, 4.0, 5.0)
    again.delete("pick")
    assert TeachFile(path).record("new", Q).number == 1


def test_recording_again_keeps_number_and_note(tmp_path: Path) -> None:
    file = TeachFile(tmp_path / "points.toml")
    file.record("pick", Q, note="n")
    file.record("other", Q)
    with pytest.raises(TeachError, match="--replace"):
        file.record("pick", (0.0,) * 5)
    assert file.get("pick").q_deg == Q
    point = file.record("pick", (0.0,) * 5, replace_old=True)
    assert (point.number, point.note, point.q_deg) == (1, "n", (0.0,) * 5)


@pytest.mark.parametrize("name", ["", "../x", "Pick", "1st", "a" * 33, "a b", "a\nb"])
def test_names_that_are_refused(name: str) -> None:
    with pytest.raises(TeachError, match="name"):
        TeachFile(None).record(name, Q)


def test_a_full_disk_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "points.toml"
    file = TeachFile(path)
    file.record("pick", Q)

    def refuse(where: Path, data: bytes) -> None:
        raise StorageError(where, "cannot be written: No space left on device", "free some space")

    monkeypatch.setattr(points_module, "write_atomic", refuse)
    with pytest.raises(StorageError):
        file.record("place", Q)
    with pytest.raises(StorageError):
        file.delete("pick")
    assert [point.name for point in file.points] == ["pick"]
    assert [point.name for point in TeachFile(path).points] == ["pick"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[points.a]\nnumber = 1\nq_deg = [1, 2]", "five finite"),
        ("[points.a]\nnumber = 0\nq_deg = [1,2,3,4,5]", "between 1 and"),
        ("[points.a]\nnumber = 1\nq_deg = [1,2,3,4,nan]", "finite"),
        ("[points.a]\nnumber = 1\nq_deg = [1,2,3,4,5]\nspeed = 3", "keys are"),
        ("[points.a]\nnumber=1\nq_deg=[1,2,3,4,5]\n[points.b]\nnumber=1\nq_deg=[1,2,3,4,5]", "'a' and 'b'"),
        ("[points", "not TOML"),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "points.toml"
    path.write_text(text)
    with pytest.raises(TeachError, match=expected) as caught:
        TeachFile(path)
    assert str(path) in str(caught.value)


@given(
    q_deg=st.tuples(*[st.floats(-360, 360)] * 5),
    note=st.text(st.characters(min_codepoint=32, exclude_categories=["Cs", "Cc"]), max_size=60),
)
def test_every_point_is_read_back_as_it_was_written(tmp_path_factory: pytest.TempPathFactory, q_deg, note) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("teach") / "points.toml"
    written = TeachFile(path).record("p", q_deg, note=note)
    read = TeachFile(path).get("p")
    assert read.note == written.note
    assert read.q_deg == pytest.approx(written.q_deg, abs=1e-6)


def test_angles_outside_the_ranges_are_named() -> None:
    with pytest.raises(TeachError, match=r"'far': waist 170\.000 deg is outside its range -150 to 150 deg"):
        require_within_ranges("far", (170.0, 60.0, -60.0, 60.0, 0.0), load_config())
    require_within_ranges("edge", (150.0, 60.0, -60.0, 60.0, 0.0), load_config())

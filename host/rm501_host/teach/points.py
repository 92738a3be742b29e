"""The teach file: TOML, one table a point, written atomically, numbered so that programs can call points.

    [points.pick]
    number = 1
    q_deg = [90.0, 51.2, -88.0, 0.1, 0.0]
    note = "above the tray"

Joint angles are what is recorded: they say where the arm is without a branch to choose. A program reaches a point
as `O<goto> CALL [1]`, or through named parameters `#<_point_pick_q1>` .. `q5`.

    TeachError(Rm501Error)      unknown, malformed or duplicate points; the file is untouched
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rm501_host.config.schema import JOINT_NAMES, Config
from rm501_host.errors import Rm501Error
from rm501_host.storage.atomic import write_atomic

MAX_POINTS = 999
"""Enough for any cell, and it bounds the file and the number."""
_MAX_FILE_BYTES = 1_000_000
_NAME = re.compile(r"^[a-z][a-z0-9_]{0,31}$")
_MAX_NOTE = 200


class TeachError(Rm501Error):
    """A point or the teach file cannot be used."""


@dataclass(frozen=True, slots=True)
class TeachPoint:
    """A named position: joint angles (DH, deg), its number for programs, a note for people."""

    name: str
    number: int
    q_deg: tuple[float, float, float, float, float]
    note: str = ""


class TeachFile:
    """The points of one file. Every change is on disk when the method returns, or raises and changes nothing."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._points: dict[str, TeachPoint] = {} if path is None else _read(path)

    @property
    def points(self) -> tuple[TeachPoint, ...]:
        """All points by number."""
        return tuple(sorted(self._points.values(), key=lambda point: point.number))

    def get(self, key: str | int) -> TeachPoint:
        """The point of that name or number; raises TeachError naming those that exist."""
        for point in self._points.values():
            if key in (point.name, point.number):
                return point
        known = ", ".join(point.name for point in self.points) or "none"
        raise TeachError(f"there is no teach point {key!r}; known points: {known}")

    def record(
        self,
        name: str,
        q_deg: tuple[float, ...],
        note: str = "",
        number: int | None = None,
        *,
        replace_old: bool = False,
    ) -> TeachPoint:
        """Record a point: joint angles (5,), deg; with `replace_old` an existing one anew (it keeps its number and,
        without a new one, its note). Raises TeachError when the name is taken and nobody said so.
        """
        _check_name(name)
        old = self._points.get(name)
        if old is not None and not replace_old:
            raise TeachError(
                f"a teach point {name!r} exists already; say --replace (replace: true) to record it anew, or choose "
                "another name"
            )
        if number is None:
            number = old.number if old is not None else self._free_number()
        point = TeachPoint(name, number, _joints(name, q_deg), note or (old.note if old is not None else ""))
        self._put(point, old)
        return point

    def rename(self, name: str, new_name: str) -> TeachPoint:
        """Give a point another name; raises TeachError when that is taken."""
        _check_name(new_name)
        if new_name in self._points:
            raise TeachError(f"a teach point {new_name!r} exists already; delete it first or choose another name")
        old = self.get(name)
        point = replace(old, name=new_name)
        self._put(point, old)
        return point

    def edit(self, name: str, q_deg: tuple[float, ...] | None = None, note: str | None = None) -> TeachPoint:
        """Change angles or note of a point."""
        old = self.get(name)
        point = replace(
            old,
            q_deg=old.q_deg if q_deg is None else _joints(name, q_deg),
            note=old.note if note is None else note,
        )
        self._put(point, old)
        return point

    def delete(self, name: str) -> TeachPoint:
        """Remove a point; its number becomes free."""
        old = self.get(name)
        kept = {key: point for key, point in self._points.items() if key != old.name}
        self._save(kept)
        return old

    def _put(self, point: TeachPoint, old: TeachPoint | None) -> None:
        if not 1 <= point.number <= MAX_POINTS:
            raise TeachError(f"point {point.name!r}: number {point.number} is not between 1 and {MAX_POINTS}")
        if len(point.note) > _MAX_NOTE or any(ord(letter) < 32 for letter in point.note):
            raise TeachError(f"point {point.name!r}: the note is one line of at most {_MAX_NOTE} characters")
        kept = {key: other for key, other in self._points.items() if old is None or key != old.name}
        for other in kept.values():
            if other.number == point.number:
                raise TeachError(f"number {point.number} belongs to point {other.name!r}; choose another number")
        kept[point.name] = point
        self._save(kept)

    def _save(self, points: dict[str, TeachPoint]) -> None:
        if self.path is not None:
            write_atomic(self.path, _format(points).encode())
        self._points = points

    def _free_number(self) -> int:
        used = {point.number for point in self._points.values()}
        for number in range(1, MAX_POINTS + 1):
            if number not in used:
                return number
        raise TeachError(f"all {MAX_POINTS} points are in use; delete one first")


def require_within_ranges(name: str, q_deg: Sequence[float], config: Config) -> None:
    """Raise TeachError when joint angles (5,), deg, lie outside the joint ranges of `config`: point `name` could be
    kept, but not gone to.
    """
    for joint_name, joint, angle_deg in zip(JOINT_NAMES, config.joints.ordered, q_deg, strict=True):
        if not joint.min_deg <= angle_deg <= joint.max_deg:
            raise TeachError(
                f"point {name!r}: {joint_name} {angle_deg:.3f} deg is outside its range {joint.min_deg:g} to "
                f"{joint.max_deg:g} deg, the arm could not go there; correct the angle"
            )


def _check_name(name: str) -> None:
    if not _NAME.match(name):
        raise TeachError(
            f"{name!r} is no name for a point; use a letter, then letters, digits and _, lower case, at most 32"
        )


def _joints(name: str, q_deg: tuple[float, ...]) -> tuple[float, float, float, float, float]:
    if len(q_deg) != len(JOINT_NAMES) or not all(math.isfinite(angle) for angle in q_deg):
        raise TeachError(f"point {name!r}: give five finite joint angles in deg ({', '.join(JOINT_NAMES)})")
    q1, q2, q3, q4, q5 = (float(angle) for angle in q_deg)
    return (q1, q2, q3, q4, q5)


def _read(path: Path) -> dict[str, TeachPoint]:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise TeachError(f"{path}: cannot be read: {error.strerror}; correct its permissions") from error
    if len(data) > _MAX_FILE_BYTES:
        raise TeachError(f"{path}: is larger than {_MAX_FILE_BYTES} bytes; this is no teach file")
    try:
        tables = tomllib.loads(data.decode("utf-8")).get("points", {})
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise TeachError(f"{path}: is not TOML: {error}; correct it or move it away") from error
    points: dict[str, TeachPoint] = {}
    numbers: dict[int, str] = {}
    for name, table in tables.items():
        point = _from_table(path, name, table)
        if point.number in numbers:
            raise TeachError(f"{path}: points {numbers[point.number]!r} and {name!r} have the number {point.number}")
        numbers[point.number] = name
        points[name] = point
    return points


def _from_table(path: Path, name: str, table: object) -> TeachPoint:
    try:
        _check_name(name)
        if not isinstance(table, dict) or not set(table) <= {"number", "q_deg", "note"}:
            raise TeachError(f"[points.{name}]: the keys are number, q_deg and note")
        number, q_deg, note = table.get("number"), table.get("q_deg"), table.get("note", "")
        if not isinstance(number, int) or isinstance(number, bool) or not 1 <= number <= MAX_POINTS:
            raise TeachError(f"[points.{name}]: number must be between 1 and {MAX_POINTS}")
        if not isinstance(note, str):
            raise TeachError(f"[points.{name}]: note must be a text")
        if not isinstance(q_deg, list) or not all(
            isinstance(angle, int | float) and not isinstance(angle, bool) for angle in q_deg
        ):
            raise TeachError(f"[points.{name}]: q_deg must be five numbers")
        return TeachPoint(name, number, _joints(name, tuple(q_deg)), note)
    except TeachError as error:
        raise TeachError(f"{path}: {error}") from error


def _format(points: dict[str, TeachPoint]) -> str:
    lines = ["# Teach points: joint angles in deg (waist, shoulder, elbow, pitch, roll). Edit while nothing runs.\n"]
    for point in sorted(points.values(), key=lambda point: point.number):
        angles = ", ".join(repr(round(angle, 6)) for angle in point.q_deg)
        lines.append(f"[points.{point.name}]\nnumber = {point.number}\nq_deg = [{angles}]")
        if point.note:
            note = point.note.replace("\\", "\\\\").replace('"', '\\"')
            lines.append(f'note = "{note}"')
        lines.append("")
    return "\n".join(lines)

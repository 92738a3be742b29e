"""Reading a configuration file: TOML to types, with every complaint at its file, line and key.

A file may build on another: `extends = "rm501.toml"` (relative to itself) takes that file first and lays its own
keys over it, table by table. Nothing is ever taken from a default that stands in no file.

    ConfigError          one or more `Problem`s, each with file, line, key, message and remedy
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from rm501_host.config.checks import Complaint, complaints_about
from rm501_host.config.schema import Config
from rm501_host.errors import Rm501Error

_MAX_EXTENDS = 8
_HEADER = re.compile(r"^\s*\[{1,2}\s*([^\]]+?)\s*\]{1,2}\s*(?:#.*)?$")
_ASSIGNMENT = re.compile(r"^\s*((?:[A-Za-z0-9_-]+|\"[^\"]*\")(?:\s*\.\s*(?:[A-Za-z0-9_-]+|\"[^\"]*\"))*)\s*=")
_AT_PATH = re.compile(r"^(?P<what>.*?)(?: - at `\$\.?(?P<path>.*)`)?$", re.DOTALL)
_UNKNOWN = re.compile(r"unknown field `(?P<name>[^`]+)`")
_MISSING = re.compile(r"missing required field `(?P<name>[^`]+)`")


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a configuration."""

    file: str
    line: int | None
    key: str
    message: str
    remedy: str

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        key = f" {self.key}:" if self.key else ""
        return f"{place}:{key} {self.message}; {self.remedy}"


class ConfigError(Rm501Error):
    """The configuration cannot be used; `problems` says why, each with its place and remedy."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        super().__init__("\n".join(str(problem) for problem in problems))


@dataclass(frozen=True, slots=True)
class _File:
    name: str
    text: str
    data: dict[str, Any]


def load_config(path: str | Path | None = None) -> Config:
    """Read, type and check a configuration; without `path` the packaged copy of `configs/rm501.toml`.

    Raises ConfigError naming file, line and key of everything that is wrong.
    """
    if path is None:
        packaged = resources.files("rm501_host") / "data" / "rm501.toml"
        files = [_parse("rm501.toml (packaged)", packaged.read_text("utf-8"))]
    else:
        files = _read_chain(Path(path))
    merged: dict[str, Any] = {}
    for file in reversed(files):
        _lay_over(merged, file.data)
    merged.pop("extends", None)
    not_finite = [
        Complaint(key, f"{value} is not a number to work with", "give a finite number")
        for key, value in _floats(merged)
        if not math.isfinite(value)
    ]
    if not_finite:
        raise ConfigError(tuple(_locate(files, complaint) for complaint in not_finite))
    try:
        config = msgspec.convert(merged, Config)
    except msgspec.ValidationError as error:
        raise ConfigError((_locate(files, _from_msgspec(str(error))),)) from error
    complaints = complaints_about(config)
    if complaints:
        raise ConfigError(tuple(_locate(files, complaint) for complaint in complaints))
    return config


def _read_chain(path: Path) -> list[_File]:
    """The file and all that it extends, nearest first."""
    files: list[_File] = []
    seen: list[Path] = []
    while True:
        if path.resolve() in seen or len(seen) >= _MAX_EXTENDS:
            raise ConfigError((Problem(str(path), None, "extends", "files extend each other", "break the circle"),))
        seen.append(path.resolve())
        try:
            text = path.read_bytes().decode("utf-8")
        except OSError as error:
            reason = error.strerror or str(error)
            remedy = "give the path of a readable TOML file, such as configs/rm501.toml"
            raise ConfigError((Problem(str(path), None, "", f"cannot be read: {reason}", remedy),)) from error
        except UnicodeDecodeError as error:
            line = path.read_bytes()[: error.start].count(b"\n") + 1
            raise ConfigError((Problem(str(path), line, "", "is not UTF-8 text", "save it as UTF-8"),)) from error
        files.append(_parse(str(path), text))
        parent = files[-1].data.get("extends")
        if parent is None:
            return files
        if not isinstance(parent, str):
            complaint = Complaint("extends", "is not a file name", 'write extends = "rm501.toml"')
            raise ConfigError((_locate(files, complaint),))
        path = path.parent / parent


def _parse(name: str, text: str) -> _File:
    try:
        return _File(name, text, tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        match = re.search(r"\(at line (\d+), column \d+\)", str(error))
        line = int(match.group(1)) if match else text.count("\n") + 1
        message = re.sub(r"\s*\(at .*\)$", "", str(error))
        raise ConfigError((Problem(name, line, "", f"is not TOML: {message}", "correct this line"),)) from error


def _lay_over(base: dict[str, Any], top: dict[str, Any]) -> None:
    for key, value in top.items():
        if isinstance(value, dict) and isinstance(base.get(key), dict):
            _lay_over(base[key], value)
        else:
            base[key] = value


def _floats(data: object, path: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _floats(value, f"{path}.{key}" if path else key)
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from _floats(value, f"{path}[{index}]")
    elif isinstance(data, float):
        yield path, data


def _from_msgspec(text: str) -> Complaint:
    match = _AT_PATH.match(text)
    what, path = (match.group("what"), match.group("path") or "") if match else (text, "")
    if unknown := _UNKNOWN.search(what):
        key = f"{path}.{unknown.group('name')}" if path else unknown.group("name")
        return Complaint(key, "is not a key of this table", "remove it or correct its spelling")
    if missing := _MISSING.search(what):
        key = f"{path}.{missing.group('name')}" if path else missing.group("name")
        return Complaint(key, "is missing", 'add it, or start the file with extends = "rm501.toml"')
    return Complaint(path, what[0].lower() + what[1:], "give a value of that kind")


def _locate(files: list[_File], complaint: Complaint) -> Problem:
    """Put a complaint at the line of the nearest file that holds its key, or the longest known part of its key."""
    wanted = re.sub(r"\[[^\]]*\]", "", complaint.key).split(".")
    for length in range(len(wanted), 0, -1):
        for file in files:
            line = _line_of(file.text, wanted[:length])
            if line is not None:
                return Problem(file.name, line, complaint.key, complaint.message, complaint.remedy)
    return Problem(files[0].name, None, complaint.key, complaint.message, complaint.remedy)


def _line_of(text: str, wanted: list[str]) -> int | None:
    table: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = _keys(header.group(1))
            if table == wanted:
                return number
        elif (assignment := _ASSIGNMENT.match(line)) and table + _keys(assignment.group(1)) == wanted:
            return number
    return None


def _keys(dotted: str) -> list[str]:
    return [part.strip().strip('"') for part in dotted.split(".")]

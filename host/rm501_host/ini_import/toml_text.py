"""Writing a configuration as TOML, with a comment behind each value that says where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def toml_text(data: Mapping[str, Any], comments: Mapping[str, str], heading: str) -> str:
    """Tables, plain values, lists and lists of tables as TOML; `comments` by dotted key."""
    lines = [f"# {line}" for line in heading.splitlines()]
    _table(lines, data, comments, ())
    return "\n".join(lines) + "\n"


def _table(lines: list[str], data: Mapping[str, Any], comments: Mapping[str, str], path: tuple[str, ...]) -> None:
    plain = {key: value for key, value in data.items() if not _is_table(value)}
    if path and (plain or not data):
        lines += ["", f"[{'.'.join(path)}]"]
    for key, value in plain.items():
        comment = comments.get(".".join((*path, key)))
        lines.append(f"{key} = {_value(value)}" + (f"  # {comment}" if comment else ""))
    for key, value in data.items():
        if isinstance(value, Mapping):
            _table(lines, value, comments, (*path, key))
        elif _is_table(value):
            for item in value:
                lines += ["", f"[[{'.'.join((*path, key))}]]"]
                lines += [f"{name} = {_value(entry)}" for name, entry in item.items()]


def _is_table(value: object) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple) and bool(value) and all(isinstance(item, Mapping) for item in value)
    )


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    raise TypeError(f"{type(value).__name__} has no place in a configuration")

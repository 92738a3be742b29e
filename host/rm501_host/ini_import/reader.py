"""Reading LinuxCNC's INI dialect: sections, `KEY = value`, comments with # or ; at the start of a line, repeated keys.

IniError(Rm501Error)      a line that is neither, with file and line
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from rm501_host.errors import Rm501Error

_SECTION = re.compile(r"^\[\s*([A-Za-z0-9_]+)\s*\]\s*(?:[#;].*)?$")
_ASSIGNMENT = re.compile(r"^([A-Za-z_][A-Za-z0-9_]*)\s*=\s*(.*)$")
_TRAILING_COMMENT = re.compile(r"\s+[#;].*$")
_MAX_CHARACTERS = 1_000_000


class IniError(Rm501Error):
    """The INI file cannot be read; `file` and `line` say where."""

    def __init__(self, file: str, line: int | None, message: str, remedy: str) -> None:
        place = file if line is None else f"{file}:{line}"
        super().__init__(f"{place}: {message}; {remedy}")
        self.file = file
        self.line = line


@dataclass(frozen=True, slots=True)
class IniValue:
    """One assignment, as written."""

    section: str
    key: str
    text: str
    line: int


@dataclass(frozen=True, slots=True)
class IniFile:
    """All assignments of a file, in order."""

    name: str
    values: tuple[IniValue, ...]

    def get(self, section: str, key: str) -> IniValue | None:
        """The first value of that key (as LinuxCNC takes it), or None."""
        return next((value for value in self.values if (value.section, value.key) == (section, key)), None)

    def sections(self) -> tuple[str, ...]:
        """Names of the sections that hold values, in order."""
        return tuple(dict.fromkeys(value.section for value in self.values))


def parse_ini(name: str, text: str) -> IniFile:
    """Parse the text of an INI file; raises IniError at the first line that is no comment, section or assignment."""
    if len(text) > _MAX_CHARACTERS:
        raise IniError(name, None, "is larger than 1 MB", "this is no LinuxCNC INI file")
    section: str | None = None
    values: list[IniValue] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if not line or line[0] in "#;":
            continue
        if match := _SECTION.match(line):
            section = match.group(1)
        elif match := _ASSIGNMENT.match(line):
            if section is None:
                raise IniError(name, number, "a value stands before the first [SECTION]", "move it into its section")
            values.append(IniValue(section, match.group(1), _TRAILING_COMMENT.sub("", match.group(2)).strip(), number))
        else:
            raise IniError(name, number, f"{raw.strip()!r} is no section, value or comment", "correct or remove it")
    return IniFile(name, tuple(values))

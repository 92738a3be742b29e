"""How programs are read: the arm's way, or exactly as `rs274 -g` does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from rm501_host.gcode import canon as c
from rm501_host.gcode.context import BUILT_IN_USER_M
from rm501_host.gcode.tools import PEER_DEFAULT_TOOLS, ToolTable


@dataclass(frozen=True, slots=True)
class Settings:
    """How to read programs. The defaults are the arm's; `as_peer` is `rs274 -g`'s."""

    machine_units: c.Units = c.Units.MM
    """Unit of the variable file, the tool table and #5161 to #5390."""
    block_delete: bool = False
    """Skip blocks that begin with `/`."""
    subroutine_path: tuple[Path, ...] = ()
    """Folders searched for `NAME.ngc` when a called subroutine is not in the program."""
    user_m: Mapping[int, c.UserMKind] = field(default_factory=lambda: dict(BUILT_IN_USER_M))
    peer_standalone: bool = False
    start_line: int = 1
    """Begin at this line (from 1) of the main program, with the modes its earlier lines leave behind."""
    max_blocks: int | None = None
    """End with an error after so many blocks; None reads on for ever."""

    @classmethod
    def as_peer(cls, **changes: object) -> Settings:
        """The settings under which listings compare with `rs274 -g`: machine units inch."""
        base: dict[str, object] = {"machine_units": c.Units.INCH, "peer_standalone": True}
        return cls(**{**base, **changes})  # type: ignore[arg-type]  # the fields' own types hold at run time


def default_tools(settings: Settings) -> ToolTable:
    """An empty table, or the peer's built-in one."""
    return ToolTable(PEER_DEFAULT_TOOLS if settings.peer_standalone else ())

"""A block as it was read: words, codes, assignments, comment, O-word. Values may still depend on parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

from rm501_host.gcode.errors import GcodeError
from rm501_host.gcode.expressions import Node, ParameterTarget


@dataclass(frozen=True, slots=True)
class OWord:
    """A control word. `label` is text (numbers in decimal) or an expression; `fanuc` marks a bare `O100`."""

    keyword: str
    label: str | Node
    arguments: tuple[Node, ...] = ()
    offset: int = 0
    fanuc: bool = False
    fault: GcodeError | None = None
    """What is wrong with the arguments, found while skipping: counts only if they are needed."""


@dataclass(slots=True)
class Block:
    """One block. Filled by the parser, never changed afterwards (blocks are cached and shared)."""

    number: int | None = None
    deletable: bool = False
    words: list[tuple[str, Node, int]] = field(default_factory=list)
    g_words: list[tuple[Node, int]] = field(default_factory=list)
    m_words: list[tuple[Node, int]] = field(default_factory=list)
    assignments: list[tuple[ParameterTarget, Node, int]] = field(default_factory=list)
    comment: str | None = None
    oword: OWord | None = None
    g_modes: dict[int, int] | None = None
    """Modal group to ten times the G number, when all are known at once."""
    m_modes: dict[int, int] | None = None
    constant_words: dict[str, float] | None = None
    only_assignments: bool = False
    empty: bool = False

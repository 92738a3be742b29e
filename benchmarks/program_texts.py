"""Texts of long programs for the benchmarks: spirals of short moves of every kind, endless if need be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi, sin
from pathlib import Path

TURN = 2_000
"""Moves of one turn of the pattern: out and back on a spiral, 0.2 mm each."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of program: its head, a pattern of `TURN` moves that ends where it begins, and its configuration."""

    name: str
    head: str
    pattern: tuple[str, ...]
    is_thesis: bool = False


def spiral() -> list[tuple[float, float]]:
    """Points (mm) from (313, 0) outwards and back, on a spiral about (303, 0)."""
    points = []
    angle = 0.0
    for i in range(TURN):
        share = i if i < TURN // 2 else TURN - i
        radius = 10.0 + 0.02 * share
        angle += (0.2 if i < TURN // 2 else -0.2) / radius
        points.append((303 + radius * cos(angle), radius * sin(angle)))
    return points


def _along(words: Callable[[int], str]) -> tuple[str, ...]:
    return tuple(f"G1 X{x:.4f} Y{y:.4f}{words(i)}\n" for i, (x, y) in enumerate(spiral()))


def _wave(i: int, amount: float, turns: int) -> float:
    return amount * sin(2.0 * pi * turns * i / TURN)


def _mixed() -> tuple[str, ...]:
    """The spiral with turning tools, here and there a small circle or a half circle to and fro."""
    lines = []
    for i, (x, y) in enumerate(spiral()):
        if i % 20 == 13:
            lines.append("G3 I-0.5 J0\n")
        elif i % 20 == 17:
            lines.append(f"G2 X{x:.4f} Y{y:.4f} R2\n")
        else:
            lines.append(f"G1 X{x:.4f} Y{y:.4f} C{_wave(i, 10.0, 5):.3f}\n")
    return tuple(lines)


_HEAD = "G21 G90 G94 G64 P0.5 F6000\nG0 X313 Y0 Z150 A0 B0\n"
_THESIS_HEAD = "G21 G90 G94 G64 P0.5 F6000\nG0 X313 Y0 Z10 A0 B0 C0\n"
_HALF_TURNS = ("G3 X312 Y0 I-0.5 J0\n", "G3 X313 Y0 I0.5 J0\n")
_HELICES = ("G3 X293 Y0 Z155 I-10 J0\n", "G3 X313 Y0 Z150 I10 J0\n")
_SPLINES = ("G5 X303 Y10 I0 J5 P5 Q0\n", "G5 X313 Y0 I5 J0 P0 Q5\n")

PLAIN = Kind("lines", _HEAD, _along(lambda i: ""))
MIXED = Kind("mixed", _THESIS_HEAD, _mixed(), is_thesis=True)
KINDS = (
    PLAIN,
    Kind("lines, A B turning", _HEAD, _along(lambda i: f" A{_wave(i, 3.0, 7):.3f} B{_wave(i, 10.0, 5):.3f}")),
    Kind("XYZABC lines", _THESIS_HEAD, _along(lambda i: ""), is_thesis=True),
    Kind("XYZABC lines, C turning", _THESIS_HEAD, _along(lambda i: f" C{_wave(i, 10.0, 5):.3f}"), is_thesis=True),
    Kind("half circles of 1 mm", _HEAD, _HALF_TURNS * (TURN // 2)),
    Kind("half helices of 20 mm", _HEAD, _HELICES * (TURN // 2)),
    Kind("XYZABC half circles", _THESIS_HEAD, _HALF_TURNS * (TURN // 2), is_thesis=True),
    Kind("splines of 16 mm", _HEAD, _SPLINES * (TURN // 2)),
    Kind("XYZABC splines", _THESIS_HEAD, _SPLINES * (TURN // 2), is_thesis=True),
    MIXED,
)
"""What the table of speeds shows."""


def write_program(path: Path, kind: Kind, moves: int | None, size: int | None = None) -> int:
    """A program of so many moves, or so many bytes; how many lines it has."""
    turn = "".join(kind.pattern)
    with path.open("w") as file:
        file.write(kind.head)
        if size is not None:
            turns = size // len(turn)
            for _ in range(turns):
                file.write(turn)
            written = turns * TURN
        else:
            assert moves is not None
            whole, rest = divmod(moves, TURN)
            for _ in range(whole):
                file.write(turn)
            file.write("".join(kind.pattern[:rest]))
            written = moves
        file.write("M2\n")
    return written + 3

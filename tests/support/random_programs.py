"""Random programs as text, from a seed: everything that moves, in all sizes, and what tends to break planners.

Coordinates are incremental, so no part depends on where an earlier one has led: lines, arcs and helices in all planes,
circles and nearly circles, splines, rapids, joint moves, tools, turns on the spot, G93, inches, G61, G61.1, G64 P Q
changing within a program, moves of 1e-9 mm, reversals, corners of 179.9 deg, tangent arcs, repeated points.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, radians, sin
from random import Random

MODES = (
    "G61",
    "G61.1",
    "G64",
    "G64 P0.001",
    "G64 P0.02",
    "G64 P0.5",
    "G64 P3",
    "G64 P20",
    "G64 P1 Q0.3",
    "G64 P0.2 Q0.2",
)
SIZES_MM = (1e-4, 0.01, 0.5, 3.0, 12.0)
PLANES = {17: ("XYZ", "IJ"), 18: ("ZXY", "KI"), 19: ("YZX", "JK")}
Joints = tuple[float, float, float, float, float]


def number(value: float) -> str:
    """As G-code writes it, to 1e-9."""
    return f"{value:.9f}".rstrip("0").rstrip(".") or "0"


class RandomProgram:
    """`text` and the joints `start_deg` from which it is meant to run."""

    def __init__(self, seed: int, *, most_moves: int = 4, sizes_mm: tuple[float, ...] = SIZES_MM) -> None:
        self._random = r = Random(seed)
        self._sizes = sizes_mm
        self.start_deg: Joints = (
            r.uniform(-120, 120),
            r.uniform(0, 85),
            r.uniform(-85, -8),
            r.uniform(10, 120),
            r.uniform(-100, 100),
        )
        self._size = r.choice(sizes_mm)
        self._unit = 1.0
        slowest = "0.1" if self._size < 0.02 else "200"
        self._feed = r.choice(("300", "2000", "12000", slowest, "1000000"))
        self._lines = ["G21 G94 G91 G17", r.choice(MODES), "F" + self._feed]
        kinds = tuple(KINDS)
        weights = tuple(weight for weight, _ in KINDS.values())
        for kind in r.choices(kinds, weights, k=r.randint(1, most_moves)):
            KINDS[kind][1](self)
        self.text = "\n".join((*self._lines, "M2", ""))

    def _v(self, share: float = 1.0) -> str:
        return number(self._random.uniform(-1.0, 1.0) * self._size / self._unit * share)

    def _add(self, *lines: str) -> None:
        self._lines.extend(lines)

    def line(self) -> None:
        self._add(f"G1 X{self._v()} Y{self._v()} Z{self._v()}")

    def turning_line(self) -> None:
        r = self._random
        angles = f"A{number(r.uniform(-4, 4))} B{number(r.uniform(-8, 8))}"
        self._add(f"G1 X{self._v()} Y{self._v()} Z{self._v()} {angles}")

    def arc(self, kind: str = "arc") -> None:
        r = self._random
        plane = r.choice((17, 18, 19))
        (first, second, normal), (i, j) = PLANES[plane]
        radius = self._size / self._unit * r.choice((0.05, 0.5, 1.0))
        sweep = {
            "arc": r.uniform(0.05, 5.8),
            "helix": r.uniform(0.3, 6.0),
            "circle": 2.0 * pi,
            "nearly": 2.0 * pi - r.choice((2e-5, 1e-3)),
        }[kind]
        way = r.choice((-1, 1))
        a, b = (start := r.uniform(0.0, 2.0 * pi)), start + way * sweep
        words = [f"G{plane}", "G3" if way > 0 else "G2"]
        if kind != "circle":
            words += [f"{first}{number(radius * (cos(b) - cos(a)))}", f"{second}{number(radius * (sin(b) - sin(a)))}"]
        if kind == "helix":
            words.append(f"{normal}{self._v()}")
            words += ["P2"] if r.random() < 0.3 else []
        if r.random() < 0.2:
            words.append(f"A{number(r.uniform(-3, 3))} B{number(r.uniform(-3, 3))}")
        words += [f"{i}{number(-radius * cos(a))}", f"{j}{number(-radius * sin(a))}"]
        self._add(" ".join(words), "G17")

    def helix(self) -> None:
        self.arc("helix")

    def circle(self) -> None:
        self.arc("circle")

    def nearly_circle(self) -> None:
        self.arc("nearly")

    def tangent(self) -> None:
        """A line, an arc that goes on in its direction, a line that goes on in the arc's."""
        size, sweep = self._size / self._unit, self._random.uniform(0.2, 2.5)
        radius = 0.5 * size
        self._add(
            f"G1 X{number(0.6 * size)}",
            f"G3 X{number(radius * sin(sweep))} Y{number(radius * (1 - cos(sweep)))} I0 J{number(radius)}",
            f"G1 X{number(0.5 * size * cos(sweep))} Y{number(0.5 * size * sin(sweep))}",
        )

    def sharp(self) -> None:
        size, angle = self._size / self._unit, radians(self._random.choice((179.9, 179.0, 90.0, 1e-4, 0.05)))
        self._add(f"G1 X{number(size)}", f"G1 X{number(size * cos(angle))} Y{number(size * sin(angle))}")

    def rapid(self) -> None:
        r = self._random
        if r.random() < 0.5:
            self._add(f"G0 X{self._v()} Y{self._v()} Z{self._v()}")
        else:
            self._add(f"G0 X{self._v()} A{number(r.uniform(-6, 6))} B{number(r.uniform(-9, 9))}")

    def cubic(self) -> None:
        inner = "I0 J0 P0 Q0" if self._random.random() < 0.3 else f"I{self._v()} J{self._v()} P{self._v()} Q{self._v()}"
        self._add(f"G5 {inner} X{self._v()} Y{self._v()}")

    def quadratic(self) -> None:
        self._add(f"G5.1 I{self._v()} J{self._v()} X{self._v()} Y{self._v()}")

    def nurbs(self) -> None:
        r = self._random
        self._add(f"G5.2 L{r.choice((3, 4))} P1 X{self._v()} Y{self._v()}")
        self._add(*(f"X{self._v()} Y{self._v()} P{number(r.uniform(0.3, 2))}" for _ in range(r.randint(3, 4))), "G5.3")

    def joint(self) -> None:
        r = self._random
        self._add(f"M111 P{r.randint(1, 5)} Q{number(r.choice((1e-6, 0.01, 3.0, 8.0)) * r.choice((-1, 1)))}")

    def tool(self) -> None:
        r = self._random
        self._add(f"G43.1 Z{number(r.uniform(-10, 30) / self._unit)} X{number(r.choice((0, 5)) / self._unit)}")

    def turn(self) -> None:
        r = self._random
        pitch, roll = r.choice((1e-8, 0.01, 5.0)) * r.uniform(-1, 1), r.choice((0.0, 1e-6, 9.0)) * r.uniform(-1, 1)
        self._add(f"F2000 G1 A{number(pitch)} B{number(roll)}", "F" + self._feed)

    def inverse_time(self) -> None:
        r = self._random
        f = r.choice((20, 100, 6000))
        self._add(
            f"G93 G1 X{self._v()} Y{self._v()} F{f}",
            f"G1 A{number(r.uniform(-3, 3))} F{r.choice((20, 100))}",
            f"G94 F{self._feed}",
        )

    def mode(self) -> None:
        self._add(self._random.choice(MODES))

    def reversal(self) -> None:
        x, y = self._v(), self._v()
        self._add(f"G1 X{x} Y{y}", f"G1 X{number(-float(x))} Y{number(-float(y))}")

    def nothing(self) -> None:
        self._add("G1 X0 Y0 Z0", "G1 X0 Y0 Z0", "G1 A0 B0")

    def specks(self) -> None:
        r = self._random
        self._add(
            *(
                f"G1 X{number(r.choice((1e-9, 1e-6, 1e-4)))} Y{number(r.choice((0, 1e-9, 1e-5)))}"
                for _ in range(r.randint(1, 8))
            )
        )

    def dwell(self) -> None:
        self._add("G4 P0.01")

    def hand(self) -> None:
        self._add(self._random.choice(("M101", "M102")))

    def size(self) -> None:
        # at F0.1 a millimetre takes ten minutes
        self._size, self._feed = self._random.choice(self._sizes), "2000"
        self._add("F2000")
        self.line()

    def inches(self) -> None:
        if self._unit == 1.0:
            self._unit, self._feed = 25.4, self._random.choice(("10", "100"))
            self._add("G20", "F" + self._feed)


KINDS: dict[str, tuple[float, Callable[[RandomProgram], None]]] = {
    "line": (4.0, RandomProgram.line),
    "turning line": (1.5, RandomProgram.turning_line),
    "arc": (1.5, RandomProgram.arc),
    "helix": (1.0, RandomProgram.helix),
    "circle": (0.6, RandomProgram.circle),
    "nearly a circle": (0.6, RandomProgram.nearly_circle),
    "tangent": (1.0, RandomProgram.tangent),
    "sharp": (1.0, RandomProgram.sharp),
    "rapid": (1.5, RandomProgram.rapid),
    "cubic": (0.3, RandomProgram.cubic),
    "quadratic": (0.2, RandomProgram.quadratic),
    "nurbs": (0.2, RandomProgram.nurbs),
    "joint": (1.0, RandomProgram.joint),
    "tool": (0.6, RandomProgram.tool),
    "turn": (1.0, RandomProgram.turn),
    "inverse time": (0.7, RandomProgram.inverse_time),
    "mode": (1.5, RandomProgram.mode),
    "reversal": (1.0, RandomProgram.reversal),
    "nothing": (0.5, RandomProgram.nothing),
    "specks": (1.0, RandomProgram.specks),
    "dwell": (0.4, RandomProgram.dwell),
    "hand": (0.2, RandomProgram.hand),
    "size": (0.5, RandomProgram.size),
    "inches": (0.4, RandomProgram.inches),
}

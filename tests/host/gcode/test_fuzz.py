"""Whatever the text: only GcodeError escapes, nothing hangs, memory stays bounded.

`RM501_FUZZ_BLOCKS` sets how many blocks are tried (default 10,000).
"""

from __future__ import annotations

import os
import random
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_host.gcode import GcodeError, Interpreter, Settings, TextLines, format_call, resolve, to_json

from .test_conformance import RECORDED

BLOCKS = int(float(os.environ.get("RM501_FUZZ_BLOCKS", "1e4")))
_PIECES = (
    *[
        "G0",
        "G1",
        "G2",
        "G3",
        "G4",
        "G5",
        "G5.1",
        "G5.2",
        "G5.3",
        "G10",
        "G17",
        "G18",
        "G19",
        "G20",
        "G21",
        "G28",
        "G28.1",
        "G30",
        "G38.2",
        "G38.5",
        "G40",
        "G43",
        "G43.1",
        "G43.2",
    ],
    *[
        "G49",
        "G52",
        "G53",
        "G54",
        "G59.3",
        "G61",
        "G64",
        "G68",
        "G69",
        "G73",
        "G80",
        "G81",
        "G82",
        "G83",
        "G85",
        "G89",
        "G90",
        "G91",
        "G90.1",
        "G92",
        "G92.1",
        "G92.3",
        "G93",
    ],
    *[
        "G94",
        "G98",
        "G99",
        "M0",
        "M1",
        "M2",
        "M3",
        "M5",
        "M6",
        "M30",
        "M48",
        "M50",
        "M61",
        "M62",
        "M66",
        "M67",
        "M70",
        "M72",
        "M73",
        "M98",
        "M99",
        "M101",
        "M110",
    ],
    *[
        "X",
        "Y",
        "Z",
        "A",
        "B",
        "C",
        "I",
        "J",
        "K",
        "R",
        "P",
        "Q",
        "L",
        "H",
        "D",
        "E",
        "F",
        "S",
        "T",
        "U",
        "@",
        "^",
        "N",
        "/",
        "%",
        "#",
        "#<",
        ">",
        "=",
        "[",
        "]",
        "(",
        ")",
        ";",
        "+",
        "-",
        "*",
        "/",
        "**",
    ],
    *[
        "MOD",
        "AND",
        "OR",
        "XOR",
        "EQ",
        "LT",
        "GE",
        "SIN[",
        "ATAN[",
        "SQRT[",
        "EXISTS[",
        "ABS[",
        "#1",
        "#2",
        "#5220",
        "#5221",
        "#<a>",
        "#<_x>",
        "0",
        "1",
        "2",
    ],
    *[
        "-1",
        ".5",
        "1e9",
        "99999999999999999999",
        "0.0001",
        "1.5",
        "10",
        "100",
        "o1",
        "o2",
        "o<a>",
        "sub",
        "endsub",
        "call",
        "return",
        "if",
        "elseif",
        "else",
    ],
    *[
        "endif",
        "while",
        "endwhile",
        "do",
        "repeat",
        "endrepeat",
        "break",
        "continue",
        "[1]",
        "[0]",
        "[1000000000]",
        "(MSG,",
        "(DEBUG,",
        "(PRINT,",
        "(LOG,",
    ],
    *("(ABORT,", "[#1 LT 3]", "\t", "\0", "½", "\udc80"),
)


def _drain(text: str) -> int:
    """Interpret and resolve a program to its end, its error or 3000 blocks; returns the calls made."""
    count = 0
    interpreter = Interpreter(TextLines(text), Settings(max_blocks=3000))
    try:
        for _ in resolve(_formatted(interpreter)):
            count += 1
    except GcodeError as error:
        str(error)
    assert len(interpreter.warnings) <= 1000
    return count


def _formatted(interpreter: Interpreter):  # type: ignore[no-untyped-def]  # a pass-through that also formats
    for call in interpreter.calls():
        format_call(call)
        to_json(call)
        yield call


def _random_block(rng: random.Random) -> str:
    return rng.choice(["", " "]).join(rng.choice(_PIECES) for _ in range(rng.randint(1, 9)))


def test_grammar_soup() -> None:
    rng = random.Random(1234)
    for _ in range(BLOCKS // 2 // 8):
        _drain("\n".join(["F100", *(_random_block(rng) for _ in range(7)), "M2"]))


def test_mutated_programs() -> None:
    rng = random.Random(99)
    done = 0
    while done < BLOCKS // 2:
        data = bytearray(rng.choice(RECORDED)["program"].encode())
        done += data.count(b"\n") + 1
        for _ in range(rng.randint(1, 6)):
            at = rng.randrange(len(data))
            match rng.randrange(4):
                case 0:
                    data[at] = rng.randrange(256)
                case 1:
                    del data[at : at + rng.randint(1, 5)]
                case 2:
                    data[at:at] = bytes(
                        rng.choice(b"GMXYZ0123456789.-[]#<>()oN%/ \n") for _ in range(rng.randint(1, 4))
                    )
                case _:
                    other = rng.randrange(len(data))
                    data[at:at] = data[other : other + 20]
            if not data:
                data = bytearray(b"M2")
        _drain(data.decode("utf-8", "surrogateescape"))


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=200))
def test_any_text(text: str) -> None:
    _drain(text)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_from_a_file(data: bytes) -> None:
    import tempfile

    from rm501_host.gcode import interpret_file

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "p.ngc"
        path.write_bytes(data)
        try:
            for _ in interpret_file(path, Settings(max_blocks=3000)):
                pass
        except GcodeError as error:
            assert str(path) in str(error)

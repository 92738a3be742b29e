"""The longest path through compiled AVR code, from its disassembly: no run of the program can take more cycles."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

__all__ = ["longest_path"]

LINE = re.compile(r"^\s*([0-9a-f]+):\t((?:[0-9a-f]{2} )+)\s*\t(\S+)\s*([^;]*)(?:;\s*0x([0-9a-f]+))?")
NAME = re.compile(r"^([0-9a-f]+) <(\S+)>:$")
TARGET = re.compile(r"\.([+-]\d+)")

# ATmega2560: a program counter of 22 bits, data in internal RAM (AVR instruction set manual, cycles of AVRe+)
CYCLES = {
    **dict.fromkeys(("lds", "sts", "ld", "ldd", "st", "std", "push", "pop", "mul", "muls", "mulsu"), 2),
    **dict.fromkeys(("adiw", "sbiw", "sbi", "cbi", "rjmp"), 2),
    **dict.fromkeys(("jmp", "lpm", "elpm"), 3),
    "rcall": 4,
    **dict.fromkeys(("call", "ret", "reti"), 5),
}
ONE_CYCLE = frozenset(
    [
        "add",
        "adc",
        "sub",
        "subi",
        "sbc",
        "sbci",
        "and",
        "andi",
        "or",
        "ori",
        "eor",
        "com",
        "neg",
        "inc",
        "dec",
        "tst",
        "clr",
        "ser",
        "mov",
        "movw",
        "ldi",
        "lsl",
        "lsr",
        "rol",
        "ror",
        "asr",
        "swap",
        "cp",
        "cpc",
        "cpi",
        "bst",
        "bld",
        "in",
        "out",
        "nop",
        "sec",
        "clc",
        "sei",
        "cli",
        "set",
        "clt",
    ]
)
BRANCHES = frozenset(
    [
        "breq",
        "brne",
        "brcs",
        "brcc",
        "brsh",
        "brlo",
        "brmi",
        "brpl",
        "brge",
        "brlt",
        "brts",
        "brtc",
        "brvs",
        "brvc",
        "brhs",
        "brhc",
        "brid",
        "brie",
    ]
)
SKIPS = frozenset(["cpse", "sbrc", "sbrs", "sbic", "sbis"])
ENDS = frozenset(("ret", "reti"))


@dataclass(frozen=True, slots=True)
class Instruction:
    """One line of the disassembly; addresses in bytes."""

    name: str
    size: int
    target: int | None


def _read(disassembly: str) -> tuple[dict[int, Instruction], dict[str, int]]:
    code: dict[int, Instruction] = {}
    names: dict[str, int] = {}
    for line in disassembly.splitlines():
        if head := NAME.match(line):
            names[head[2]] = int(head[1], 16)
        elif found := LINE.match(line):
            address, size, name, operands = int(found[1], 16), len(found[2].split()), found[3], found[4]
            target = None
            if relative := TARGET.search(operands):
                target = address + 2 + int(relative[1])
            elif name in ("call", "jmp"):
                target = int(operands.strip(), 16)
            code[address] = Instruction(name, size, target)
    return code, names


def longest_path(disassembly: str, function: str, not_called: Collection[str] = ()) -> int:
    """Cycles of the longest path from a function's first instruction to its return, both included.

    `disassembly` is what `avr-objdump -d` prints; functions in `not_called` count as if they
    returned at once. Every way through the code counts, whether the program can take it or
    not, so the result is an upper bound. ValueError for a loop, an indirect jump or an instruction that is not known:
    there is no bound then.
    """
    code, names = _read(disassembly)
    if function not in names:
        raise ValueError(f"{function} is not in the disassembly")
    known = {names[name]: CYCLES["ret"] for name in not_called}
    open_paths: set[int] = set()

    def longest(address: int) -> int:
        """Straight pieces are walked, whatever forks is asked for again; each piece is looked at once."""
        if address in known:
            return known[address]
        if address in open_paths:
            raise ValueError(f"{function}: the loop at {address:#x} has no bound")
        open_paths.add(address)
        cycles, here = 0, address
        while True:
            at = code[here]
            following = here + at.size
            if at.name in ENDS:
                cycles += CYCLES[at.name]
                break
            if at.name in BRANCHES and at.target is not None:
                cycles += max(1 + longest(following), 2 + longest(at.target))
                break
            if at.name in SKIPS:
                skipped = code[following]
                cycles += max(1 + longest(following), 1 + skipped.size // 2 + longest(following + skipped.size))
                break
            if at.name in ("jmp", "rjmp") and at.target is not None:
                cycles += CYCLES[at.name] + longest(at.target)
                break
            if at.name in ("call", "rcall") and at.target is not None:
                cycles += CYCLES[at.name] + longest(at.target)
            elif at.name in CYCLES and at.target is None:
                cycles += CYCLES[at.name]
            elif at.name in ONE_CYCLE:
                cycles += 1
            else:
                raise ValueError(f"{function}: no cycles known for {at.name} at {here:#x}")
            here = following
        open_paths.remove(address)
        known[address] = cycles
        return cycles

    return longest(names[function])

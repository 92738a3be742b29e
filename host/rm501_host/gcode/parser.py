"""Text of a block to a `Block`.

Reading drops blanks and case outside comments, as the dialect does, and works on what remains; an error carries an
index into that compact text, and `column_of` maps it back to the line for the caret.
"""

from __future__ import annotations

import re

from rm501_host.gcode.block import Block, OWord
from rm501_host.gcode.errors import (
    GcodeError,
    GcodeLimitError,
    GcodeModalError,
    GcodeSyntaxError,
    GcodeUnsupportedError,
)
from rm501_host.gcode.expressions import ExpressionReader, Node, to_integer
from rm501_host.gcode.registry import G_CODES, M_CODES, USER_M, Support, g_group, m_group

MAX_LINE_CHARACTERS = 252
"""LinuxCNC 2.9 refuses longer lines ("Command too long"), counted in bytes without the line end."""
MAX_M_WORDS = 4
"""M words allowed in one block (LinuxCNC 2.9)."""
MAX_CALL_ARGUMENTS = 30

_BLANKS = str.maketrans("", "", " \t\r\n\v\f")
_KEYWORDS = (
    "sub", "endsub", "call", "return", "while", "endwhile", "do", "if", "elseif", "else", "endif", "repeat",
    "endrepeat", "break", "continue",
)  # fmt: skip
_KEYWORD = re.compile("|".join(sorted(_KEYWORDS, key=len, reverse=True)))
_WITH_CONDITION = {"while", "if", "elseif", "repeat"}
_WITH_RESULT = {"endsub", "return"}
_DIGITS = re.compile(r"[0-9]+")
_LINE_NUMBER = re.compile(r"[0-9]+(?:\.[0-9]*)?")
_AXES = "xyzabc"
_LETTERS = frozenset("abcdefhijklpqrstxyz@^$")
_NAMES = {"@": "polar radius", "^": "polar angle", "$": "spindle number"}


def split_comments(line: str) -> tuple[str, str | None]:
    """Compact lower-case text and the last bracketed comment. Raises GcodeSyntaxError for unclosed or nested ones."""
    if "(" not in line:
        cut = line.find(";")
        if cut >= 0:
            line = line[:cut]
        return line.translate(_BLANKS).lower(), None
    parts: list[str] = []
    comment: str | None = None
    position = 0
    while True:
        opened = line.find("(", position)
        semicolon = line.find(";", position)
        if semicolon >= 0 and (opened < 0 or semicolon < opened):
            parts.append(line[position:semicolon])
            break
        if opened < 0:
            parts.append(line[position:])
            break
        parts.append(line[position:opened])
        closed = line.find(")", opened + 1)
        nested = line.find("(", opened + 1)
        compact = len("".join(parts).translate(_BLANKS))
        if nested >= 0 and (closed < 0 or nested < closed):
            raise GcodeSyntaxError("nested comment found", "Comments cannot contain brackets.", offset=compact)
        if closed < 0:
            raise GcodeSyntaxError("unclosed comment found", "Close the comment with ')'.", offset=compact)
        comment = line[opened + 1 : closed]
        position = closed + 1
    return "".join(parts).translate(_BLANKS).lower(), comment


def column_of(line: str, offset: int) -> int:
    """Column (from 1) in the line of index `offset` of its compact text."""
    seen = 0
    in_comment = False
    for column, character in enumerate(line):
        if in_comment:
            in_comment = character != ")"
            continue
        if character == "(":
            if seen == offset:
                return column + 1
            in_comment = True
            continue
        if character == ";":
            return column + 1
        if character in " \t\r\n\v\f":
            continue
        if seen == offset:
            return column + 1
        seen += 1
    return len(line) + 1


def check_length(line: str) -> None:
    """Raises GcodeLimitError for a line longer than the dialect allows."""
    if len(line) > MAX_LINE_CHARACTERS or (
        not line.isascii() and len(line.encode("utf-8", "surrogateescape")) > MAX_LINE_CHARACTERS
    ):
        raise GcodeLimitError(
            f"command too long: {len(line)} characters, at most {MAX_LINE_CHARACTERS}",
            "Split the block, or move the comment to a line of its own.",
        )


def parse_block(line: str) -> Block:
    """Read a whole line. Raises GcodeError with `offset` set where a place is known."""
    check_length(line)
    text, comment = split_comments(line)
    block = Block(comment=comment)
    reader = ExpressionReader(text)
    if text.startswith("/"):
        block.deletable = True
        reader.position = 1
    _read_number(reader, block)
    end = len(text)
    while reader.position < end:
        _read_item(reader, block)
    _analyse(block)
    return block


def parse_control(line: str) -> Block | None:
    """Read a line that is being skipped: only its O-word counts. None where it has none."""
    check_length(line)
    text, comment = split_comments(line)
    reader = ExpressionReader(text)
    block = Block(comment=comment)
    if text.startswith("/"):
        block.deletable = True
        reader.position = 1
    start = reader.position
    if text[start : start + 1] == "n":
        _read_number(reader, block)
    if text[reader.position : reader.position + 1] != "o":
        return None
    _read_oword(reader, block, skipped=True)
    return block


def _read_number(reader: ExpressionReader, block: Block) -> None:
    text = reader.text
    if text[reader.position : reader.position + 1] != "n":
        return
    match = _LINE_NUMBER.match(text, reader.position + 1)
    if match is None:
        raise reader.fail("bad line number", "N is followed by a number without a sign.", reader.position)
    block.number = int(match.group().split(".")[0])
    reader.position = match.end()


def _read_item(reader: ExpressionReader, block: Block) -> None:
    text, start = reader.text, reader.position
    letter = text[start]
    if letter == "#":
        _read_assignment(reader, block)
    elif letter == "o":
        if block.words or block.g_words or block.m_words or block.assignments:
            raise reader.fail(
                "an O-word must be the first word of its block", "Put it on a line of its own; or is it a zero?"
            )
        _read_oword(reader, block)
    elif letter == "g":
        reader.position = start + 1
        block.g_words.append((reader.value(), start))
    elif letter == "m":
        reader.position = start + 1
        block.m_words.append((reader.value(), start))
    elif letter in _LETTERS:
        if any(word[0] == letter for word in block.words):
            name = _NAMES.get(letter, f"{letter.upper()} word")
            raise reader.fail(f"multiple {name}s in one block", "Use the word once, or split the block.")
        reader.position = start + 1
        block.words.append((letter, reader.value(), start))
    elif letter in "uvw":
        raise GcodeUnsupportedError(
            f"{letter.upper()} word: the arm has no {letter.upper()} axis", "Use X Y Z A B C.", offset=start
        )
    elif "\udc80" <= letter <= "\udcff":  # how a byte that is not UTF-8 is kept
        raise reader.fail(
            f"byte 0x{ord(letter) - 0xDC00:02x} is not text (UTF-8)", "Outside comments a program is plain ASCII text."
        )
    else:
        raise reader.fail(f"bad character {letter!r} used", "Words are a letter and a value, as X10.5.")


def _read_assignment(reader: ExpressionReader, block: Block) -> None:
    start = reader.position
    reader.position = start + 1
    target = reader.parameter()
    if reader.position >= len(reader.text) or reader.text[reader.position] != "=":
        raise reader.fail("equal sign missing in a parameter setting", "Write #1=[...] or #<name>=[...].")
    reader.position += 1
    block.assignments.append((target, reader.value(), start))


def _read_oword(reader: ExpressionReader, block: Block, *, skipped: bool = False) -> None:
    text, start = reader.text, reader.position
    reader.position = start + 1
    label: str | Node
    if text[reader.position : reader.position + 1] == "<":
        label = reader.name()
    else:
        digits = _DIGITS.match(text, reader.position)
        if digits is not None:
            label = str(int(digits.group()))
            reader.position = digits.end()
        else:
            value = reader.value()
            label = str(to_integer(value, "O-word number")) if isinstance(value, float) else value
    match = _KEYWORD.match(text, reader.position)
    if match is None:
        if reader.position < len(text):
            raise reader.fail(
                "unknown control command in O-word",
                "Known are sub endsub call return if elseif else endif while endwhile do repeat endrepeat break "
                "continue.",
            )
        block.oword = OWord("program", label, (), start, fanuc=True)
        return
    keyword = match.group()
    reader.position = match.end()
    try:
        arguments = _read_arguments(reader, keyword)
    except GcodeError as fault:
        if not skipped:
            raise
        block.oword = OWord(keyword, label, (), start, fault=fault)
        return
    block.oword = OWord(keyword, label, arguments, start)


def _read_arguments(reader: ExpressionReader, keyword: str) -> tuple[Node, ...]:
    text = reader.text
    arguments: list[Node] = []
    if keyword in _WITH_CONDITION:
        if text[reader.position : reader.position + 1] != "[":
            raise reader.fail(f"left bracket missing after {keyword!r}", f"Write {keyword} [condition].")
        arguments.append(reader.bracketed())
    elif keyword in _WITH_RESULT or keyword == "call":
        limit = MAX_CALL_ARGUMENTS if keyword == "call" else 1
        while text[reader.position : reader.position + 1] == "[":
            if len(arguments) == limit:
                raise GcodeLimitError(
                    f"too many parameters for {keyword}: at most {limit}",
                    "Pass the rest in global parameters.",
                    offset=reader.position,
                )
            arguments.append(reader.bracketed())
    if reader.position < len(text):
        raise reader.fail("unexpected character after an O-word", "Put the rest on a line of its own.")
    return tuple(arguments)


def _analyse(block: Block) -> None:
    """What can be known once for all evaluations."""
    if len(block.m_words) > MAX_M_WORDS:
        raise GcodeModalError(f"too many M codes on one line: at most {MAX_M_WORDS}", "Split the block.")
    if all(isinstance(node, float) for node, _ in block.g_words):
        block.g_modes = g_modes([(node, at) for node, at in block.g_words if isinstance(node, float)])
    if all(isinstance(node, float) for node, _ in block.m_words):
        block.m_modes = m_modes([(node, at) for node, at in block.m_words if isinstance(node, float)])
    if all(isinstance(node, float) for _, node, _ in block.words):
        block.constant_words = {letter: node for letter, node, _ in block.words if isinstance(node, float)}
    bare = not (block.words or block.g_words or block.m_words or block.oword) and block.comment is None
    block.only_assignments = bare and bool(block.assignments)
    block.empty = bare and not block.assignments


def g_modes(values: list[tuple[float, int]]) -> dict[int, int]:
    """Modal groups of the G words of a block. Raises GcodeError."""
    modes: dict[int, int] = {}
    for value, offset in values:
        key = _g_key(value, offset)
        code = G_CODES[key]
        if code.support is Support.REFUSED:
            raise GcodeUnsupportedError(
                f"{code.name} ({code.title}) is not supported", f"{code.note} Remove it.", offset=offset
            )
        group = g_group(key)
        assert group is not None
        if group in modes:
            raise GcodeModalError("two G codes used from same modal group", "Split the block.", offset=offset)
        modes[group] = key
    return modes


def _g_key(value: float, offset: int) -> int:
    if value < 0:
        raise GcodeModalError("negative G code used", "G codes are positive.", offset=offset)
    tenfold = value * 10.0
    key = round(tenfold)
    if abs(tenfold - key) > 1e-3 or key > 999:
        raise GcodeModalError(f"G code out of range: G{value:g}", "G codes have at most one decimal.", offset=offset)
    if key not in G_CODES:
        raise GcodeModalError(f"unknown G code used: G{value:g}", "See the table in docs/gcode.md.", offset=offset)
    return key


def m_modes(values: list[tuple[float, int]]) -> dict[int, int]:
    """Modal groups of the M words of a block. Raises GcodeError."""
    modes: dict[int, int] = {}
    for value, offset in values:
        try:
            number = to_integer(value, "M code")
        except GcodeError as error:
            error.offset = offset
            raise
        if number < 0:
            raise GcodeModalError("negative M code used", "M codes are positive.", offset=offset)
        group = m_group(number)
        if group is None:
            raise GcodeModalError(f"unknown M code used: M{number}", "See the table in docs/gcode.md.", offset=offset)
        if number not in USER_M and M_CODES[number].support is Support.REFUSED:
            code = M_CODES[number]
            raise GcodeUnsupportedError(
                f"{code.name} ({code.title}) is not supported", f"{code.note} Remove it.", offset=offset
            )
        if group in modes:
            raise GcodeModalError("two M codes used from same modal group", "Split the block.", offset=offset)
        modes[group] = number
    return modes

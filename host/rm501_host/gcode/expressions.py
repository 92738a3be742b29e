"""Values of RS274/NGC: numbers, parameters, functions and bracketed expressions.

Text becomes a node: a plain `float` where the value is known at once, else a function of the environment. Nodes are
cached with their block, so a loop evaluates them without reading the text again. Precedence, lowest first: AND OR XOR;
EQ NE GT GE LT LE; + -; * / MOD; ** ; all of them group to the left (LinuxCNC 2.9: `[2**3**2]` is 64, and a sign binds
tighter than `**`, so `[-2**2]` is 4).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Protocol

from rm501_host.gcode.errors import GcodeLimitError, GcodeMathError, GcodeParameterError, GcodeSyntaxError

EQUAL_TOLERANCE = 1e-4
"""EQ and NE call numbers equal that differ by less (LinuxCNC 2.9)."""
INTEGER_TOLERANCE = 1e-4
"""How near a number must be to an integer where one is wanted (LinuxCNC 2.9: `#1.00001` is `#1`)."""
MAX_PARAMETER = 5601
MAX_DEPTH = 120
"""Nesting of brackets, signs and functions; a block of 252 characters cannot use more with sense."""


class Environment(Protocol):
    """What an expression can see of the interpreter."""

    numbered: list[float]

    def read_numbered(self, index: int) -> float:
        """Value of #index. Raises GcodeParameterError."""

    def read_named(self, name: str) -> float:
        """Value of #<name>. Raises GcodeParameterError."""

    def has_named(self, name: str) -> bool:
        """Whether #<name> has a value."""


Evaluate = Callable[[Environment], float]
Node = float | Evaluate
ParameterTarget = int | str | Evaluate
"""What `#...` names: an index, a named parameter, or an index known at run time only."""

_NUMBER = re.compile(r"[+-]?[0-9.]+")
_PLAIN_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)\Z")


def evaluate(node: Node, env: Environment) -> float:
    """The value of a node now."""
    return node if isinstance(node, float) else node(env)


def to_integer(value: float, what: str = "integer") -> int:
    """Round a number that must be an integer. Raises GcodeMathError."""
    if not math.isfinite(value):
        raise GcodeMathError(f"{what} is {value}", "Check the expression.")
    nearest = round(value)
    if abs(value - nearest) > INTEGER_TOLERANCE:
        raise GcodeMathError(f"non-integer value {value:g} where an integer is needed ({what})", "Use a whole number.")
    return nearest


# -- functions and operators -----------------------------------------------------------------------------------


def _finite(value: float) -> float:
    if value - value != 0.0:  # inf or nan
        kind = "not a number" if value != value else "infinity"
        raise GcodeMathError(f"calculation resulted in {kind!r}", "Check the operands.")
    return value


def _checked(function: Callable[[float], float], name: str, condition: str) -> Callable[[float], float]:
    def apply(x: float) -> float:
        try:
            return _finite(function(x))
        except (ValueError, OverflowError) as error:
            raise GcodeMathError(f"argument {x:g} to {name} out of range", f"{name} needs {condition}.") from error

    return apply


def _sqrt(x: float) -> float:
    if x < 0.0:
        raise GcodeMathError(f"negative argument {x:g} to sqrt", "SQRT needs a number from 0 up.")
    return math.sqrt(x)


def _ln(x: float) -> float:
    if x <= 0.0:
        raise GcodeMathError(f"zero or negative argument {x:g} to ln", "LN needs a number above 0.")
    return math.log(x)


def _round(x: float) -> float:
    return float(math.floor(x + 0.5)) if x >= 0.0 else float(-math.floor(-x + 0.5))


_RAD = math.pi / 180.0

FUNCTIONS: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "acos": _checked(lambda x: math.acos(x) / _RAD, "acos", "a number from -1 to 1"),
    "asin": _checked(lambda x: math.asin(x) / _RAD, "asin", "a number from -1 to 1"),
    "cos": lambda x: math.cos(x * _RAD),
    "exp": _checked(math.exp, "exp", "a smaller number"),
    "fix": lambda x: float(math.floor(x)),
    "fup": lambda x: float(math.ceil(x)),
    "ln": _ln,
    "round": _round,
    "sin": lambda x: math.sin(x * _RAD),
    "sqrt": _sqrt,
    "tan": lambda x: math.tan(x * _RAD),
}


def _divide(a: float, b: float) -> float:
    if b == 0.0:
        raise GcodeMathError("attempt to divide by zero", "Check the divisor, or guard the block with an O-word if.")
    return _finite(a / b)


def _modulo(a: float, b: float) -> float:
    if b == 0.0:
        raise GcodeMathError("MOD by zero is not a number", "Check the divisor.")
    result = math.fmod(a, b)
    return result + abs(b) if result < 0.0 else result


def _power(a: float, b: float) -> float:
    if a < 0.0 and b != math.floor(b):
        raise GcodeMathError(
            "attempt to raise a negative number to a non-integer power", "Use ABS, or an integer exponent."
        )
    try:
        return _finite(a**b)
    except (OverflowError, ZeroDivisionError) as error:
        raise GcodeMathError("calculation resulted in 'infinity'", "Check base and exponent.") from error


def _add(a: float, b: float) -> float:
    return _finite(a + b)


def _subtract(a: float, b: float) -> float:
    return _finite(a - b)


def _multiply(a: float, b: float) -> float:
    return _finite(a * b)


OPERATORS: dict[str, tuple[int, Callable[[float, float], float]]] = {
    "**": (6, _power),
    "*": (5, _multiply),
    "/": (5, _divide),
    "mod": (5, _modulo),
    "+": (4, _add),
    "-": (4, _subtract),
    "eq": (3, lambda a, b: 1.0 if abs(a - b) < EQUAL_TOLERANCE else 0.0),
    "ne": (3, lambda a, b: 0.0 if abs(a - b) < EQUAL_TOLERANCE else 1.0),
    "gt": (3, lambda a, b: 1.0 if a > b else 0.0),
    "ge": (3, lambda a, b: 1.0 if a >= b else 0.0),
    "lt": (3, lambda a, b: 1.0 if a < b else 0.0),
    "le": (3, lambda a, b: 1.0 if a <= b else 0.0),
    "and": (2, lambda a, b: 1.0 if a != 0.0 and b != 0.0 else 0.0),
    "or": (2, lambda a, b: 1.0 if a != 0.0 or b != 0.0 else 0.0),
    "xor": (2, lambda a, b: 1.0 if (a != 0.0) != (b != 0.0) else 0.0),
}

_OPERATOR = re.compile(r"\*\*|[*/+-]|mod|and|xor|or|eq|ne|gt|ge|lt|le")
_FUNCTION = re.compile(r"[a-z]+")


def _fails(function: Callable[..., float], *arguments: float) -> Node:
    """A constant expression without a value: an error when it is evaluated, not where it is only read over."""

    def evaluate_again(env: Environment) -> float:
        del env
        return function(*arguments)

    return evaluate_again


def _unary_node(function: Callable[[float], float], argument: Node) -> Node:
    if isinstance(argument, float):
        try:
            return function(argument)
        except GcodeMathError:
            return _fails(function, argument)
    return lambda env: function(argument(env))


def _negative(argument: Node) -> Node:
    if isinstance(argument, float):
        return -argument
    return lambda env: -argument(env)


def _binary_node(function: Callable[[float, float], float], left: Node, right: Node) -> Node:
    if isinstance(left, float):
        if isinstance(right, float):
            try:
                return function(left, right)
            except GcodeMathError:
                return _fails(function, left, right)
        return lambda env: function(left, right(env))
    if isinstance(right, float):
        return lambda env: function(left(env), right)
    return lambda env: function(left(env), right(env))


# -- reading ---------------------------------------------------------------------------------------------------


class ExpressionReader:
    """Reads values from a block without blanks and comments, in lower case; `position` is where it stands."""

    __slots__ = ("_depth", "position", "text")

    def __init__(self, text: str, position: int = 0) -> None:
        self.text = text
        self.position = position
        self._depth = 0

    def fail(self, message: str, remedy: str, position: int | None = None) -> GcodeSyntaxError:
        """A syntax error at `position`, by default here."""
        return GcodeSyntaxError(message, remedy, offset=self.position if position is None else position)

    def value(self) -> Node:
        """A number, parameter, function or bracketed expression. Raises GcodeSyntaxError, GcodeMathError."""
        start = self.position
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise GcodeLimitError(
                f"expression nested deeper than {MAX_DEPTH} levels", "Split it over several parameters.", offset=start
            )
        try:
            return self._value()
        except GcodeMathError as error:
            if error.offset is None:
                error.offset = start
            raise
        finally:
            self._depth -= 1

    def _value(self) -> Node:
        text, position = self.text, self.position
        match = _NUMBER.match(text, position)
        if match is not None:
            word = match.group()
            if _PLAIN_NUMBER.match(word) is None:
                raise self.fail(f"bad number format {word!r}", "A number is digits with at most one decimal point.")
            self.position = match.end()
            return float(word)
        if position >= len(text):
            raise self.fail("a number or expression is missing at the end of the block", "Complete the word.")
        first = text[position]
        if first == "[":
            return self.bracketed()
        if first == "#":
            self.position += 1
            return self.parameter_value()
        if first == "+":
            self.position += 1
            return self.value()
        if first == "-":
            self.position += 1
            return _negative(self.value())
        if "a" <= first <= "z":
            return self._function()
        raise self.fail(f"bad number format: {first!r} does not start a value", "Write a number or an [expression].")

    def bracketed(self) -> Node:
        """`[ value (operator value)* ]`."""
        if self.position >= len(self.text) or self.text[self.position] != "[":
            raise self.fail("a left bracket is missing", "Put the expression in square brackets.")
        opened = self.position
        self.position += 1
        values = [self.value()]
        operators: list[tuple[int, Callable[[float, float], float]]] = []
        while True:
            if self.position >= len(self.text):
                raise self.fail("unclosed expression", "Close the bracket.", opened)
            if self.text[self.position] == "]":
                self.position += 1
                break
            operator = self._operator()
            while operators and operators[-1][0] >= operator[0]:
                right = values.pop()
                values[-1] = _binary_node(operators.pop()[1], values[-1], right)
            operators.append(operator)
            values.append(self.value())
        while operators:
            right = values.pop()
            values[-1] = _binary_node(operators.pop()[1], values[-1], right)
        return values[0]

    def _operator(self) -> tuple[int, Callable[[float, float], float]]:
        match = _OPERATOR.match(self.text, self.position)
        if match is None:
            raise self.fail(
                f"unknown operation {self.text[self.position]!r}",
                "Operators are + - * / ** MOD, AND OR XOR, EQ NE GT GE LT LE.",
            )
        self.position = match.end()
        return OPERATORS[match.group()]

    def _function(self) -> Node:
        start = self.position
        match = _FUNCTION.match(self.text, start)
        name = match.group() if match is not None else ""
        self.position = start + len(name)
        if name == "atan":
            return self._arc_tangent()
        if name == "exists":
            return self._exists()
        function = FUNCTIONS.get(name)
        if function is None:
            self.position = start
            raise self.fail(
                f"unknown word {name!r} where a number belongs",
                "A word is a letter and a number, as X10.5; a comment stands in (..) or behind ;. Functions are "
                f"{', '.join(sorted([*FUNCTIONS, 'atan', 'exists'])).upper()} (docs/gcode.md).",
            )
        self._need_bracket(name)
        return _unary_node(function, self.value())

    def _need_bracket(self, name: str) -> None:
        if self.position >= len(self.text) or self.text[self.position] != "[":
            raise self.fail(f"left bracket missing after {name.upper()}", f"Write {name.upper()}[...].")

    def _arc_tangent(self) -> Node:
        self._need_bracket("atan")
        y = self.value()
        if self.position >= len(self.text) or self.text[self.position] != "/":
            raise self.fail("slash missing after the first argument of ATAN", "Write ATAN[y]/[x].")
        self.position += 1
        self._need_bracket("atan[y]/")
        x = self.value()
        return _binary_node(lambda a, b: math.atan2(a, b) / _RAD, y, x)

    def _exists(self) -> Node:
        self._need_bracket("exists")
        text, end = self.text, self.position + 1
        if text[end : end + 2] != "#<":
            raise self.fail("EXISTS needs a named parameter", "Write EXISTS[#<name>].", end)
        self.position = end + 1
        name = self.name()
        if self.position >= len(text) or text[self.position] != "]":
            raise self.fail("unclosed EXISTS", "Write EXISTS[#<name>].")
        self.position += 1
        return lambda env: 1.0 if env.has_named(name) else 0.0

    def name(self) -> str:
        """`<name>`, without its angle brackets."""
        start = self.position
        end = self.text.find(">", start)
        if end < 0:
            raise self.fail("named parameter without closing '>'", "Write #<name>.", start)
        self.position = end + 1
        return self.text[start + 1 : end]

    def parameter(self) -> ParameterTarget:
        """What stands behind a `#`."""
        start = self.position
        if start < len(self.text) and self.text[start] == "<":
            return self.name()
        node = self.value()
        if isinstance(node, float):
            return parameter_index(node, start)
        return node

    def parameter_value(self) -> Node:
        """The value of the parameter behind a `#`."""
        start = self.position
        target = self.parameter()
        if isinstance(target, str):
            return _named_node(target, start)
        if isinstance(target, int):
            return _numbered_node(target)
        return lambda env: env.read_numbered(parameter_index(target(env), start))


def parameter_index(value: float, offset: int | None) -> int:
    """Check a parameter's number. Raises GcodeParameterError, GcodeMathError."""
    index = to_integer(value, "parameter number")
    if not 1 <= index <= MAX_PARAMETER:
        raise GcodeParameterError(
            f"parameter number {index} out of range", f"Parameters are #1 to #{MAX_PARAMETER}.", offset=offset
        )
    return index


def _numbered_node(index: int) -> Evaluate:
    if 5000 <= index < MAX_PARAMETER:  # positions and the like are computed when read
        return lambda env: env.read_numbered(index)
    return lambda env: env.numbered[index]


def _named_node(name: str, offset: int) -> Evaluate:
    def read(env: Environment) -> float:
        try:
            return env.read_named(name)
        except GcodeParameterError as error:
            if error.offset is None:
                error.offset = offset
            raise

    return read

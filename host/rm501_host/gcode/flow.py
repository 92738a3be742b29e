"""O-words and M98/M99: which line comes next.

As in LinuxCNC 2.9 there is no block structure before run time: a false `if` or a finished loop sets a label to skip to,
and blocks that are skipped are not read, but for their O-words. Labels belong to the subroutine (or main program) they
stand in and to one place each. Loop counters belong to the call level, so recursion cannot disturb them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from rm501_host.gcode.block import OWord
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import CallFrame, GcodeFlowError, GcodeLimitError, Location
from rm501_host.gcode.expressions import evaluate, to_integer
from rm501_host.gcode.mcodes import restore_modes
from rm501_host.gcode.source import ProgramLines
from rm501_host.gcode.state import SavedModes

MAX_CALL_LEVELS = 10
"""LinuxCNC 2.9 allows nine calls inside one another."""
MAX_LABELS = 1_000_000
LOCAL_PARAMETERS = 30


class Skip(Enum):
    """Why blocks are being skipped."""

    NO = 0
    DEFINITION = 1
    SEEK = 2
    BRANCH = 3
    LOOP = 4
    CONTINUE = 5


@dataclass(slots=True)
class Label:
    """What stands at a label: keyword and place; `taken` and `remaining` are its state at this call level."""

    keyword: str
    line: int
    at: Location


@dataclass(slots=True)
class Frame:
    """One call: where to go back to, and what to bring back."""

    label: str
    call: Location
    source: ProgramLines
    return_pc: int
    scope: tuple[str, str]
    fanuc: bool
    numbered: list[float]
    named: dict[str, float]
    saved: SavedModes | None
    taken: dict[str, bool]
    remaining: dict[str, int]
    repeats: int = 1
    start: tuple[ProgramLines, int] | None = None


@dataclass(slots=True)
class Subroutine:
    """Where a subroutine begins (line index behind its first line)."""

    source: ProgramLines
    body: int
    fanuc: bool
    at: Location


@dataclass(slots=True)
class Flow:
    """Program counter, skip state, labels and call stack."""

    source: ProgramLines
    find_file: Callable[[str], ProgramLines | None]
    pc: int = 0
    """Index of the next line."""
    skip: Skip = Skip.NO
    skip_label: str = ""
    skip_at: Location | None = None
    frames: list[Frame] = field(default_factory=list)
    labels: dict[tuple[str, str, str], Label] = field(default_factory=dict)
    subs: dict[str, Subroutine] = field(default_factory=dict)
    taken: dict[str, bool] = field(default_factory=dict)
    remaining: dict[str, int] = field(default_factory=dict)
    scope: tuple[str, str] = ("", "")
    pending_fanuc: bool = False
    jumped_back: bool = False

    def call_stack(self) -> tuple[CallFrame, ...]:
        """The calls in force, outermost first."""
        return tuple(CallFrame(frame.label, frame.call) for frame in self.frames)

    # -- O-words

    def control(self, ctx: Context, word: OWord) -> None:
        """Carry out an O-word of the line just read (its index is pc - 1). Raises GcodeFlowError."""
        label = self._label(ctx, word)
        if self.skip is not Skip.NO:
            self._while_skipping(ctx, word, label)
            return
        handler = _HANDLERS.get(word.keyword)
        if handler is not None:
            handler(self, ctx, word, label)

    def _label(self, ctx: Context, word: OWord) -> str:
        if isinstance(word.label, str):
            return word.label
        return str(to_integer(evaluate(word.label, ctx.parameters), "O-word number"))

    def _while_skipping(self, ctx: Context, word: OWord, label: str) -> None:
        keyword = word.keyword
        if self.skip is Skip.DEFINITION:
            if keyword == "sub":
                raise GcodeFlowError("nested subroutine definition", "End the first one with endsub before this one.")
            if keyword == "endsub" and label == self.skip_label:
                self._stop_skipping()
            return
        if label != self.skip_label:
            return
        if self.skip is Skip.SEEK:
            self._enter_found(ctx, word, label)
        elif self.skip is Skip.BRANCH:
            if keyword == "elseif":
                self._elseif(ctx, word, label)
            elif keyword == "else":
                self._else(ctx, word, label)
            elif keyword == "endif":
                self._endif(ctx, word, label)
        elif keyword in ("endwhile", "endrepeat", "while"):
            again = self.skip is Skip.CONTINUE
            begun = self._require(label, keyword)
            if keyword == "while" and begun.keyword != "do":
                return
            self._stop_skipping()
            if again:
                _HANDLERS[keyword](self, ctx, word, label)

    def _start_skipping(self, ctx: Context, why: Skip, label: str) -> None:
        self.skip, self.skip_label, self.skip_at = why, label, ctx.at

    def _stop_skipping(self) -> None:
        self.skip, self.skip_label, self.skip_at = Skip.NO, "", None

    def _true(self, ctx: Context, word: OWord) -> bool:
        if word.fault is not None:
            raise word.fault
        return evaluate(word.arguments[0], ctx.parameters) != 0.0

    def _define(self, ctx: Context, keyword: str, label: str) -> None:
        """Remember a label; meeting it again is fine, at another line it is a mistake."""
        key = (*self.scope, label)
        known = self.labels.get(key)
        line = self.pc - 1
        if known is None:
            if len(self.labels) >= MAX_LABELS:
                raise GcodeLimitError(f"more than {MAX_LABELS} O-word labels", "Use subroutines or loops.")
            self.labels[key] = Label(keyword, line, ctx.at)
        elif known.line != line:
            raise GcodeFlowError(
                f"duplicate O-word label - already defined in line {known.line + 1}", "Give every block its own label."
            )

    def _require(self, label: str, keyword: str, *kinds: str) -> Label:
        known = self.labels.get((*self.scope, label))
        if known is None:
            raise GcodeFlowError(
                f"undefined O-word label: {keyword!r} without a beginning", "Check the label's number."
            )
        if kinds and known.keyword not in kinds:
            raise GcodeFlowError(
                f"no matching {' or '.join(kinds)} label for {keyword!r}: found {known.keyword!r} in line "
                f"{known.line + 1}",
                "Check the labels.",
            )
        return known

    # -- branches

    def _if(self, ctx: Context, word: OWord, label: str) -> None:
        self._define(ctx, "if", label)
        taken = self._true(ctx, word)
        self.taken[label] = taken
        if not taken:
            self._start_skipping(ctx, Skip.BRANCH, label)

    def _elseif(self, ctx: Context, word: OWord, label: str) -> None:
        self._require(label, "elseif", "if")
        if self.skip is Skip.NO or self.taken.get(label, False):
            if self.skip is Skip.NO:
                if ctx.peer_standalone:
                    self._true(ctx, word)  # LinuxCNC 2.9 computes conditions that no longer count
                self._start_skipping(ctx, Skip.BRANCH, label)
            return
        if self._true(ctx, word):
            self.taken[label] = True
            self._stop_skipping()

    def _else(self, ctx: Context, word: OWord, label: str) -> None:
        del word
        self._require(label, "else", "if")
        if self.skip is Skip.NO:
            self._start_skipping(ctx, Skip.BRANCH, label)
        elif not self.taken.get(label, False):
            self.taken[label] = True
            self._stop_skipping()

    def _endif(self, ctx: Context, word: OWord, label: str) -> None:
        del ctx, word
        self._require(label, "endif", "if")
        self._stop_skipping()

    # -- loops

    def _while(self, ctx: Context, word: OWord, label: str) -> None:
        known = self.labels.get((*self.scope, label))
        if known is not None and known.keyword == "do":
            if self._true(ctx, word):
                self._jump(known.line + 1)
            return
        self._define(ctx, "while", label)
        if not self._true(ctx, word):
            self._start_skipping(ctx, Skip.LOOP, label)

    def _endwhile(self, ctx: Context, word: OWord, label: str) -> None:
        del ctx, word
        self._jump(self._require(label, "endwhile", "while").line)

    def _do(self, ctx: Context, word: OWord, label: str) -> None:
        del word
        self._define(ctx, "do", label)

    def _repeat(self, ctx: Context, word: OWord, label: str) -> None:
        self._define(ctx, "repeat", label)
        count = evaluate(word.arguments[0], ctx.parameters)
        times = math.floor(count + 0.5)
        self.remaining[label] = times
        if times <= 0:
            self._start_skipping(ctx, Skip.LOOP, label)

    def _endrepeat(self, ctx: Context, word: OWord, label: str) -> None:
        del ctx, word
        known = self._require(label, "endrepeat", "repeat")
        left = self.remaining.get(label, 0) - 1
        self.remaining[label] = left
        if left > 0:
            self._jump(known.line + 1)

    def _break(self, ctx: Context, word: OWord, label: str) -> None:
        self._require(label, word.keyword, "while", "do")
        self._start_skipping(ctx, Skip.LOOP if word.keyword == "break" else Skip.CONTINUE, label)

    def _jump(self, index: int) -> None:
        self.pc = index
        self.jumped_back = True

    # -- subroutines

    def _sub(self, ctx: Context, word: OWord, label: str) -> None:
        del word
        known = self.subs.get(label)
        if known is not None and (known.body != self.pc or known.source is not self.source):
            raise GcodeFlowError(
                f"subroutine o<{label}> again, already defined in {known.at}", "Give every subroutine its own name."
            )
        self.subs[label] = Subroutine(self.source, self.pc, False, ctx.at)
        self._start_skipping(ctx, Skip.DEFINITION, label)

    def _enter_found(self, ctx: Context, word: OWord, label: str) -> None:
        if word.keyword == "sub":
            if self.pending_fanuc:
                raise GcodeFlowError(
                    "'O... sub' subroutine must be called with 'O... call'", f"Call it with: o{label} call"
                )
        elif word.keyword == "program":
            if not self.pending_fanuc:
                raise GcodeFlowError(
                    "a bare 'O...' subroutine must be called with 'M98'", f"Call it with: M98 P{label}"
                )
        else:
            return
        self.subs[label] = Subroutine(self.source, self.pc, word.fanuc, ctx.at)
        self._stop_skipping()
        self.frames[-1].start = (self.source, self.pc)

    def _call(self, ctx: Context, word: OWord, label: str) -> None:
        parameters = ctx.parameters
        arguments = [evaluate(node, parameters) for node in word.arguments]
        self._push(ctx, label, fanuc=False)
        numbered = parameters.numbered
        count = len(arguments)
        numbered[1 : count + 1] = arguments
        numbered[count + 1 : LOCAL_PARAMETERS + 1] = [0.0] * (LOCAL_PARAMETERS - count)
        parameters.value_returned = False
        self._go_to_sub(ctx, label)

    def fanuc_call(self, ctx: Context, label: str, repeats: int) -> None:
        """M98 P L: call `label`, `repeats` times. Raises GcodeFlowError."""
        if repeats < 1:
            return
        self._push(ctx, label, fanuc=True)
        self.frames[-1].repeats = repeats
        self._go_to_sub(ctx, label)

    def _push(self, ctx: Context, label: str, *, fanuc: bool) -> None:
        if len(self.frames) + 1 >= MAX_CALL_LEVELS:
            raise GcodeLimitError(
                f"too many subroutine levels: at most {MAX_CALL_LEVELS - 1} calls inside one another",
                "Replace the recursion by a loop.",
            )
        parameters = ctx.parameters
        self.frames.append(
            Frame(
                label=f"o<{label}>",
                call=ctx.at,
                source=self.source,
                return_pc=self.pc,
                scope=self.scope,
                fanuc=fanuc,
                numbered=parameters.numbered[1 : LOCAL_PARAMETERS + 1],
                named=parameters.locals,
                saved=parameters.saved,
                taken=self.taken,
                remaining=self.remaining,
            )
        )
        parameters.locals = {}
        parameters.saved = None
        parameters.call_level = len(self.frames)
        self.taken, self.remaining = {}, {}

    def _go_to_sub(self, ctx: Context, label: str) -> None:
        fanuc = self.frames[-1].fanuc
        self.scope = (self.source.name, label)
        known = self.subs.get(label)
        if known is not None:
            if known.fanuc != fanuc:
                how = f"M98 P{label}" if known.fanuc else f"o{label} call"
                raise GcodeFlowError(f"subroutine o<{label}> is called the wrong way", f"Call it with: {how}")
            self.source, self.pc = known.source, known.body
            self.scope = (known.source.name, label)
            self.frames[-1].start = (known.source, known.body)
            self.jumped_back = True
            return
        found = self.find_file(label)
        if found is not None:
            self.source, self.pc = found, 0
            self.scope = (found.name, label)
        self.pending_fanuc = fanuc
        self._start_skipping(ctx, Skip.SEEK, label)

    def _endsub(self, ctx: Context, word: OWord, label: str) -> None:
        if not self.frames:
            raise GcodeFlowError(
                f"not in a subroutine definition: {word.keyword!r}", f"Begin the subroutine with: o{label} sub"
            )
        frame = self.frames[-1]
        if frame.fanuc:
            raise GcodeFlowError("a subroutine called with 'M98' must end with 'M99'", "Use M99 here.")
        if isinstance(word.label, str) and frame.label != f"o<{label}>":
            raise GcodeFlowError(
                f"{word.keyword} of o<{label}> inside {frame.label}", "Check the label: subroutines cannot overlap."
            )
        parameters = ctx.parameters
        parameters.value_returned = bool(word.arguments)
        parameters.return_value = evaluate(word.arguments[0], parameters) if word.arguments else 0.0
        self._pop(ctx)

    def fanuc_return(self, ctx: Context) -> bool:
        """M99: True when there is nothing to return from. Raises GcodeFlowError."""
        if not self.frames:
            return True
        frame = self.frames[-1]
        if not frame.fanuc:
            raise GcodeFlowError(
                "'endsub' or 'return' must end a subroutine that begins with 'sub'", "Use them instead of M99."
            )
        frame.repeats -= 1
        if frame.repeats > 0 and frame.start is not None:
            self.source, self.pc = frame.start
            self.jumped_back = True
            return False
        self._pop(ctx)
        return False

    def _program(self, ctx: Context, word: OWord, label: str) -> None:
        """A bare `O100` that is simply reached: the number of a program, unless a subroutine is being carried out."""
        del ctx, word
        if self.frames and not self.frames[-1].fanuc:
            raise GcodeFlowError(
                f"a bare 'O{label}' subroutine must be called with 'M98'", "End the subroutine before it with endsub."
            )

    def _pop(self, ctx: Context) -> None:
        frame = self.frames.pop()
        parameters = ctx.parameters
        saved = parameters.saved
        if not frame.fanuc:
            parameters.numbered[1 : LOCAL_PARAMETERS + 1] = frame.numbered
        parameters.locals = frame.named
        parameters.saved = frame.saved
        parameters.call_level = len(self.frames)
        self.taken, self.remaining = frame.taken, frame.remaining
        self.source, self.pc, self.scope = frame.source, frame.return_pc, frame.scope
        self.jumped_back = True
        if saved is not None and saved.at_return:
            restore_modes(ctx, saved)


_HANDLERS: dict[str, Callable[[Flow, Context, OWord, str], None]] = {
    "if": Flow._if,
    "elseif": Flow._elseif,
    "else": Flow._else,
    "endif": Flow._endif,
    "while": Flow._while,
    "endwhile": Flow._endwhile,
    "do": Flow._do,
    "repeat": Flow._repeat,
    "endrepeat": Flow._endrepeat,
    "break": Flow._break,
    "continue": Flow._break,
    "program": Flow._program,
    "sub": Flow._sub,
    "call": Flow._call,
    "endsub": Flow._endsub,
    "return": Flow._endsub,
}

"""The interpreter: lines in, canonical calls out, lazily.

    lines -> [fast path: plain G0..G3 blocks] -> canonical calls
          -> [block cache] -> evaluate -> who uses the axis words? -> execute

It is sans-IO: lines come from a `ProgramLines`, answers of the machine from a `MachineFeedback`, and a consumer takes
the calls one by one. Nothing is read ahead of the call that was taken, so an answer to M66 or a probe is asked for only
after the consumer has had the call that needs it. Memory is bounded: parsed blocks are cached up to a limit, lines are
read in chunks, labels and parameters have limits of their own.

The fast path reads a block of G0 to G3 with plain numbers in the usual order by one regular expression; anything else,
and every error, goes the long way, so both give the same calls (a property test holds them together).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NoReturn

from rm501_host.gcode import canon as c
from rm501_host.gcode.block import Block
from rm501_host.gcode.comments import execute_comment, is_active
from rm501_host.gcode.context import Context, MachineFeedback, OfflineFeedback, PeerFeedback
from rm501_host.gcode.coordinates import emit_g5x, emit_g92, emit_rotation
from rm501_host.gcode.ends import end_of_file, has_last_percent, require_lone_percent, skip_to_program, unfinished_loops
from rm501_host.gcode.errors import (
    GcodeBudgetError,
    GcodeError,
    GcodeFlowError,
    GcodeModalError,
    GcodeParameterError,
    GcodeStoppedError,
    GcodeWarning,
    Location,
)
from rm501_host.gcode.executor import Evaluated, check_words, end_of_program, execute, resolve_motion
from rm501_host.gcode.expressions import evaluate, parameter_index, to_integer
from rm501_host.gcode.fast_path import FastPath
from rm501_host.gcode.flow import Flow, Skip
from rm501_host.gcode.parameters import G5X, G5X_INDEX, G92, G92_ACTIVE, Parameters
from rm501_host.gcode.parser import column_of, g_modes, m_modes, parse_block, parse_control
from rm501_host.gcode.registry import M_IO
from rm501_host.gcode.settings import Settings, default_tools
from rm501_host.gcode.source import FileLines, ProgramLines, TextLines
from rm501_host.gcode.start_line import moves_machine, restore_for_start
from rm501_host.gcode.state import State
from rm501_host.gcode.tools import ToolTable

__all__ = ["Interpreter", "Settings", "interpret", "interpret_file"]

BLOCK_CACHE = 4096
"""Parsed blocks kept: more than any loop has, a few MB at most."""
HEARTBEAT_BLOCKS = 10_000
MAX_WARNINGS = 1000


class Interpreter:
    """Reads one program. `calls()` yields its canonical calls; `warnings` grows meanwhile."""

    def __init__(
        self,
        source: ProgramLines,
        settings: Settings | None = None,
        *,
        tools: ToolTable | None = None,
        variables: Path | None = None,
        feedback: MachineFeedback | None = None,
        on_warning: Callable[[GcodeWarning], None] | None = None,
    ) -> None:
        self.settings = settings or Settings()
        self.source = source
        self.state = State(machine_units=self.settings.machine_units)
        table = tools.copy() if tools is not None else default_tools(self.settings)
        self.parameters = Parameters(self.state, table)
        if variables is not None:
            self.parameters.load(variables)
        self.warnings: list[GcodeWarning] = []
        self._on_warning = on_warning
        self._out: list[c.CanonCall] = []
        self._context = Context(
            state=self.state,
            parameters=self.parameters,
            tools=table,
            feedback=feedback or (PeerFeedback() if self.settings.peer_standalone else OfflineFeedback()),
            emit=self._out.append,
            warn=self._warn,
            user_m=self.settings.user_m,
            machine_units=self.settings.machine_units,
            peer_standalone=self.settings.peer_standalone,
        )
        self._flow = Flow(source, self._find_file, scope=(source.name, ""))
        self._cache: dict[str, Block] = {}
        self._stop = False
        self._moved = False
        self._opened: list[FileLines] = []
        self._start_state()

    def _start_state(self) -> None:
        state, parameters = self.state, self.parameters
        state.g5x_index = max(1, min(9, round(parameters.numbered[G5X_INDEX])))
        first = G5X + 20 * (state.g5x_index - 1)
        state.g5x = parameters.axes(first)
        state.rotation_deg = parameters.numbered[first + 9]
        if parameters.numbered[G92_ACTIVE] != 0.0:
            state.g92 = parameters.axes(G92)
        state.position = state.program_position([0.0] * 6)

    # -- for the consumer

    def stop(self) -> None:
        """Ask the interpreter to stop: the next block raises GcodeStoppedError. May be called from another thread."""
        self._stop = True

    def set_position(self, tool_centre_mm_deg: tuple[float, float, float, float, float, float]) -> None:
        """Tell where the tool centre point is: program frame (G53), mm and deg, with the tool length in force.

        Before the first block, after a joint move and after a change of tool length: then words that a block leaves
        out have their true values. Takes effect on the next block.
        """
        state = self.state
        factor = state.units.mm
        machine = [v / factor if i < 3 else v for i, v in enumerate(tool_centre_mm_deg)]
        # `program_position` takes the point that carries the tool, the caller gives the tool's own
        state.position = state.program_position([a + b for a, b in zip(machine, state.tool_offset, strict=True)])
        state.tool_unplaced = False

    def calls(self) -> Iterator[c.CanonCall]:
        """The canonical calls of the program, lazily. Raises GcodeError; what came before it has been yielded."""
        out = self._out
        self._prologue()
        yield from out
        out.clear()
        try:
            for _ in self._steps():
                if out:
                    yield from out
                    out.clear()
        except GcodeError as error:
            self._locate(error)
            yield from out
            out.clear()
            self._signal(c.Signal.ON_RESET)
            self._signal(c.Signal.ON_RESET)
            yield from out
            out.clear()
            raise
        finally:
            for file in self._opened:
                file.close()
            self._opened.clear()
        yield from out
        out.clear()
        self._signal(c.Signal.ON_RESET)
        self._signal(c.Signal.ON_RESET)
        yield from out
        out.clear()

    def save_parameters(self, path: Path) -> None:
        """Write the variable file, atomically. Raises GcodeFileError."""
        self.parameters.save(path)

    # -- inside

    def _signal(self, signal: c.Signal) -> None:
        at = self._context.at
        self._out.append(c.SignalCall(signal, Location(at.file, at.line)))

    def _prologue(self) -> None:
        ctx = self._context
        ctx.at = Location(self.source.name, 0)
        self._out.append(c.UseLengthUnits(self.state.units, ctx.at))
        emit_g5x(ctx)
        emit_g92(ctx)
        emit_rotation(ctx)
        self._signal(c.Signal.SET_FEED_REFERENCE_XYZ)
        self._signal(c.Signal.ON_RESET)

    def _warn(self, message: str) -> None:
        self._warn_at(message, self._context.at)

    def _warn_at(self, message: str, at: Location) -> None:
        warning = GcodeWarning(message, at)
        if len(self.warnings) < MAX_WARNINGS and warning not in self.warnings[-10:]:
            self.warnings.append(warning)
            if self._on_warning is not None:
                self._on_warning(warning)

    def _locate(self, error: GcodeError) -> None:
        if error.location is None:
            error.location = self._context.at
            if error.offset is not None:
                error.column = column_of(error.location.block, error.offset)
        if not error.call_stack:
            error.call_stack = self._flow.call_stack()

    def _find_file(self, label: str) -> ProgramLines | None:
        for folder in self.settings.subroutine_path:
            path = folder / f"{label}.ngc"
            if "/" not in label and "\\" not in label and path.is_file():
                file = FileLines.open(path)
                self._opened.append(file)
                return file
        return None

    def _steps(self) -> Iterator[None]:
        """Run block by block; control comes back after every block that made calls."""
        flow, ctx, out, cache = self._flow, self._context, self._out, self._cache
        parameters = self.parameters
        fast = FastPath(self.state, self._out, ctx).run
        source = flow.source
        base = 0
        lines: list[str] = []
        silent = blocks = 0
        limit = self.settings.max_blocks
        starting = self.settings.start_line if self.settings.start_line > 1 else 0
        percent = skip_to_program(flow, ctx)
        while True:
            if flow.source is not source:
                source, base, lines = flow.source, 0, []
            index = flow.pc
            local = index - base
            if not 0 <= local < len(lines):
                ctx.at = Location(source.name, index + 1)
                base, lines = source.block(index)
                local = index - base
                if not lines:
                    if starting:
                        self._never_reached(starting)
                    raise end_of_file(flow, ctx, percent, self.settings.subroutine_path)
            text = lines[local]
            flow.pc = index + 1
            if ctx.pending is not None:
                self._take_answer()
            if (
                starting
                and index + 1 >= starting
                and not flow.frames
                and flow.skip is Skip.NO
                and source is self.source
            ):
                starting = 0
                self._begin_here(index + 1, text)
                yield None
            if flow.skip is Skip.NO and fast(text, index + 1, source.name):
                silent = 0
                if not starting:
                    yield None
                blocks += 1
            else:
                if "\0" in text:
                    text = self._cut_at_nul(text, source.name, index + 1)
                parameters.line = index + 1
                if percent and text.lstrip()[:1] == "%" and source is self.source:
                    ctx.at = Location(source.name, index + 1, text)
                    require_lone_percent(text)
                    self._signal(c.Signal.FINISH)
                    return
                block = cache.get(text) if flow.skip is Skip.NO else None
                if block is None:
                    block = self._parse(text, source.name, index + 1)
                if block is not None and self._run_block(block, text, source.name, index + 1):
                    if starting:
                        self._never_reached(starting)
                    if percent and not has_last_percent(flow.source, index + 1):
                        out.append(c.Comment("interpreter: percent sign missing from end of file", ctx.at))
                    for message, at in unfinished_loops(flow):
                        self._warn_at(message, at)
                    return
                blocks += 1
                silent += 1
                if out:
                    silent = 0
                    if not starting:
                        yield None
                elif silent >= HEARTBEAT_BLOCKS:
                    silent = 0
                    out.append(c.Heartbeat(HEARTBEAT_BLOCKS, ctx.at))
                    yield None
            if starting:
                self._pass_over(starting)
            if self._stop:
                raise GcodeStoppedError("the interpreter was asked to stop")
            if limit is not None and blocks > limit:
                raise GcodeBudgetError(
                    f"the program did not end within {limit} blocks", "It may loop for ever; raise the limit if not."
                )

    # -- run from line

    def _never_reached(self, line: int) -> NoReturn:
        raise GcodeFlowError(
            f"the start line {line} is never reached", "Choose a line of the main program that is executed."
        )

    def _pass_over(self, starting: int) -> None:
        self._moved = moves_machine(self._out, starting) or self._moved
        self._out.clear()

    def _begin_here(self, line: int, text: str) -> None:
        """Restore what the lines before have set, then go to where they left the tool."""
        self._out.clear()
        self._context.at = Location(self.source.name, line, text)
        restore_for_start(self._context, moved=self._moved)

    def _take_answer(self) -> None:
        pending, self._context.pending = self._context.pending, None
        if pending is not None:
            pending()

    def _cut_at_nul(self, text: str, name: str, line: int) -> str:
        text = text[: text.index("\0")]
        self._warn_at("NUL byte: the rest of the line is ignored", Location(name, line, text))
        return text

    # -- one block

    def _parse(self, text: str, name: str, line: int) -> Block | None:
        try:
            if self._flow.skip is not Skip.NO:
                return parse_control(text)
            block = parse_block(text)
        except GcodeError:
            self._context.at = Location(name, line, text)
            raise
        cache = self._cache
        if len(cache) >= BLOCK_CACHE:
            cache.clear()
        cache[text] = block
        return block

    def _run_block(self, block: Block, text: str, name: str, line: int) -> bool:
        """Evaluate and execute; True at the end of the program."""
        if block.empty or (block.deletable and self.settings.block_delete):
            return False
        ctx, parameters = self._context, self.parameters
        ctx.at = Location(name, line, text, block.number)
        if block.only_assignments:
            self._assign(block)
            return False
        if block.oword is not None:
            self._flow.control(ctx, block.oword)
            if block.comment is not None and is_active(block.comment):
                self._warn_at("a comment beside an O-word has no effect", Location(name, line, text))
            return False
        words = block.constant_words
        if words is None:
            words = {}
            for letter, node, offset in block.words:
                try:
                    words[letter] = evaluate(node, parameters)
                except GcodeError as error:
                    if error.offset is None:
                        error.offset = offset
                    raise
        g = block.g_modes
        if g is None:
            g = g_modes([(evaluate(node, parameters), at) for node, at in block.g_words])
        m = block.m_modes
        if m is None:
            m = m_modes([(evaluate(node, parameters), at) for node, at in block.m_words])
        evaluated = Evaluated(words, g, m)
        try:
            resolve_motion(ctx, evaluated)
            check_words(self.state, evaluated)
        except GcodeModalError as error:
            self._point_at_word(error, block)
            raise
        if block.assignments:
            self._assign(block)
        if block.comment is not None:
            execute_comment(ctx, block.comment)
        ended = execute(ctx, evaluated)
        call = m.get(M_IO)
        if call is not None and call >= 98:
            return self._fanuc(call, words)
        return ended

    def _point_at_word(self, error: GcodeError, block: Block) -> None:
        """Errors that begin with a letter and 'word' are about that word."""
        letter = error.message[:1].lower()
        if error.offset is None and error.message[1:6] == " word":
            for word, _, offset in block.words:
                if word == letter:
                    error.offset = offset

    def _fanuc(self, code: int, words: Mapping[str, float]) -> bool:
        ctx = self._context
        if code == 98:
            if "p" not in words:
                raise GcodeFlowError("found 'M98' code with no P-word", "P is the number of the subroutine.")
            label = str(to_integer(words["p"], "P, the subroutine"))
            self._flow.fanuc_call(ctx, label, to_integer(words.get("l", 1.0), "L, the repeats"))
            return False
        if self._flow.fanuc_return(ctx):
            self._warn("M99 in the main program ends it")
            end_of_program(ctx, exchange=False)
            return True
        return False

    def _assign(self, block: Block) -> None:
        """Parallel assignment: every value is read before the first is written."""
        parameters = self.parameters
        for target, _, _ in block.assignments:
            if type(target) is str and not parameters.has_named(target):
                parameters.write_named(target, 0.0)  # as the peer: a name exists, as 0, in its own first value
        if len(block.assignments) == 1:
            target, node, offset = block.assignments[0]
            value = node if isinstance(node, float) else node(parameters)
            if type(target) is int and target < 5000:
                parameters.numbered[target] = value
                return
            values = [(target, value, offset)]
        else:
            values = [(t, evaluate(n, parameters), o) for t, n, o in block.assignments]
        for target, value, offset in values:
            try:
                if isinstance(target, str):
                    parameters.write_named(target, value)
                else:
                    index = target if isinstance(target, int) else parameter_index(target(parameters), offset)
                    parameters.write_numbered(index, value)
            except GcodeParameterError as error:
                if error.offset is None:
                    error.offset = offset
                raise


def interpret(
    text: str,
    settings: Settings | None = None,
    *,
    name: str = "<text>",
    tools: ToolTable | None = None,
    variables: Path | None = None,
    feedback: MachineFeedback | None = None,
    on_warning: Callable[[GcodeWarning], None] | None = None,
) -> Iterator[c.CanonCall]:
    """Canonical calls of a program in memory, lazily. Raises GcodeError."""
    return Interpreter(
        TextLines(text, name), settings, tools=tools, variables=variables, feedback=feedback, on_warning=on_warning
    ).calls()


def interpret_file(
    path: Path,
    settings: Settings | None = None,
    *,
    tools: ToolTable | None = None,
    variables: Path | None = None,
    feedback: MachineFeedback | None = None,
    on_warning: Callable[[GcodeWarning], None] | None = None,
) -> Iterator[c.CanonCall]:
    """Canonical calls of a program file of any size, lazily. Raises GcodeError (GcodeFileError when unreadable)."""
    source = FileLines.open(path)
    try:
        yield from Interpreter(
            source, settings, tools=tools, variables=variables, feedback=feedback, on_warning=on_warning
        ).calls()
    finally:
        source.close()

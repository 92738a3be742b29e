"""Active comments: (MSG, ...), (DEBUG, ...), (PRINT, ...), (LOG...), (ABORT, ...)."""

from __future__ import annotations

import re

from rm501_host.gcode.canon import Comment, LogAction, LogCall, OperatorMessage, PrintText, Signal, SignalCall
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeAbortError, GcodeError, GcodeUnsupportedError
from rm501_host.gcode.expressions import MAX_PARAMETER
from rm501_host.gcode.parameters import DEBUG_SWITCH, Parameters

_KEYWORD = re.compile(r"\s*(msg|debug|print|logopen|logappend|log|abort),", re.IGNORECASE)
_PYTHON = re.compile(r"\s*py\s*,", re.IGNORECASE)
_LOG_CLOSE = re.compile(r"\s*logclose\s*\Z", re.IGNORECASE)
_FIELD = re.compile(r"%d|%f|%\.[0-9]f|#<[^>]*>|#[0-9]+")
_UNKNOWN = "######"
"""What the peer shows for a parameter without a value."""


def expand(text: str, parameters: Parameters) -> str:
    """Replace parameters by their values; `%d`, `%f`, `%.3f` set the form of those that follow."""
    form = "%f"

    def replace(match: re.Match[str]) -> str:
        nonlocal form
        field = match.group()
        if field.startswith("%"):
            form = "%.0f" if field == "%d" else field
            return ""
        try:
            if field.startswith("#<"):
                value = parameters.read_named("".join(field[2:-1].split()).lower())
            else:
                index = int(field[1:])
                if not 1 <= index <= MAX_PARAMETER:
                    return _UNKNOWN
                value = parameters.read_numbered(index)
        except GcodeError:
            return _UNKNOWN
        return form % value

    return _FIELD.sub(replace, text)


def is_active(comment: str) -> bool:
    """Whether a comment does something."""
    return _KEYWORD.match(comment) is not None or _LOG_CLOSE.match(comment) is not None


def execute_comment(ctx: Context, comment: str) -> None:
    """One comment. Raises GcodeAbortError for (ABORT, ...)."""
    at = ctx.at
    match = _KEYWORD.match(comment)
    if match is None:
        if _LOG_CLOSE.match(comment):
            ctx.emit(SignalCall(Signal.LOG_CLOSE, at))
        elif _PYTHON.match(comment):
            raise GcodeUnsupportedError("embedded Python is not supported", "Use M100 to M199 for external programs.")
        elif comment:
            ctx.emit(Comment(comment.lstrip(), at))
        return
    keyword = match.group(1).lower()
    text = comment[match.end() :]
    if keyword == "msg":
        ctx.emit(OperatorMessage(text, at))
    elif keyword == "debug":
        if ctx.parameters.numbered[DEBUG_SWITCH] != 0.0:
            ctx.emit(OperatorMessage(expand(text, ctx.parameters), at))
    elif keyword == "print":
        ctx.emit(PrintText(expand(text, ctx.parameters), at))
    elif keyword == "log":
        ctx.emit(LogCall(LogAction.TEXT, expand(text, ctx.parameters), at))
    elif keyword == "abort":
        raise GcodeAbortError(
            f"the program aborted: {expand(text, ctx.parameters).strip()}", "See the (ABORT, ...) comment."
        )
    else:
        ctx.emit(LogCall(LogAction.OPEN if keyword == "logopen" else LogAction.APPEND, text, at))

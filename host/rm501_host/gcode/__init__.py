"""The RS274/NGC interpreter: programs in, canonical calls and moves out.

for call in interpret_file(path, Settings()): ...           canonical calls
for move in resolve(interpret_file(path, Settings())): ...  moves in the program frame (rm501_host.moves)
"""

from rm501_host.gcode.canon import CanonCall, UserMKind
from rm501_host.gcode.canon_format import CanonPrinter, format_call, format_canon, format_canon_lines, to_json
from rm501_host.gcode.context import MachineFeedback, OfflineFeedback, ProbeResult
from rm501_host.gcode.errors import (
    CallFrame,
    GcodeAbortError,
    GcodeBudgetError,
    GcodeError,
    GcodeFileError,
    GcodeFlowError,
    GcodeGeometryError,
    GcodeLimitError,
    GcodeMathError,
    GcodeModalError,
    GcodeParameterError,
    GcodeStoppedError,
    GcodeSyntaxError,
    GcodeUnsupportedError,
    GcodeWarning,
    Location,
)
from rm501_host.gcode.interpreter import Interpreter, interpret, interpret_file
from rm501_host.gcode.program_log import ProgramLog
from rm501_host.gcode.registry import CODES, Code, Support
from rm501_host.gcode.resolve import ExternalAction, ResolvedMove, ResolveOptions, Resolver, resolve
from rm501_host.gcode.settings import Settings
from rm501_host.gcode.source import FileLines, ProgramLines, TextLines
from rm501_host.gcode.tools import Tool, ToolTable, load_tool_table, parse_tool_table
from rm501_host.gcode.user_m import UserMCodeError, find_user_m, run_user_m

__all__ = [
    "CODES",
    "CallFrame",
    "CanonCall",
    "CanonPrinter",
    "Code",
    "ExternalAction",
    "FileLines",
    "GcodeAbortError",
    "GcodeBudgetError",
    "GcodeError",
    "GcodeFileError",
    "GcodeFlowError",
    "GcodeGeometryError",
    "GcodeLimitError",
    "GcodeMathError",
    "GcodeModalError",
    "GcodeParameterError",
    "GcodeStoppedError",
    "GcodeSyntaxError",
    "GcodeUnsupportedError",
    "GcodeWarning",
    "Interpreter",
    "Location",
    "MachineFeedback",
    "OfflineFeedback",
    "ProbeResult",
    "ProgramLines",
    "ProgramLog",
    "ResolveOptions",
    "ResolvedMove",
    "Resolver",
    "Settings",
    "Support",
    "TextLines",
    "Tool",
    "ToolTable",
    "UserMCodeError",
    "UserMKind",
    "find_user_m",
    "format_call",
    "format_canon",
    "format_canon_lines",
    "interpret",
    "interpret_file",
    "load_tool_table",
    "parse_tool_table",
    "resolve",
    "run_user_m",
    "to_json",
]

"""The names others build on."""

from __future__ import annotations

import rm501_host.gcode as gcode

EXPECTED = {
    "CODES", "CallFrame", "CanonCall", "CanonPrinter", "Code", "ExternalAction", "FileLines", "GcodeAbortError",
    "GcodeBudgetError",
    "GcodeError", "GcodeFileError", "GcodeFlowError", "GcodeGeometryError", "GcodeLimitError", "GcodeMathError",
    "GcodeModalError", "GcodeParameterError", "GcodeStoppedError", "GcodeSyntaxError", "GcodeUnsupportedError",
    "GcodeWarning", "Interpreter", "Location", "MachineFeedback", "OfflineFeedback", "ProbeResult",
    "ProgramLines", "ProgramLog",
    "ResolveOptions", "ResolvedMove", "Resolver", "Settings", "Support", "TextLines", "Tool", "ToolTable",
    "UserMCodeError", "UserMKind", "find_user_m", "format_call", "format_canon", "format_canon_lines", "interpret",
    "interpret_file", "load_tool_table", "parse_tool_table", "resolve", "run_user_m", "to_json",
}  # fmt: skip


def test_public_names() -> None:
    assert set(gcode.__all__) == EXPECTED
    assert all(hasattr(gcode, name) for name in gcode.__all__)

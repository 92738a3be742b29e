"""The preflight: what would go wrong, found before anything moves."""

from .check import ProgramCheck, check_program
from .findings import Finding, FindingKind, PreflightReport, Severity, Via
from .keep_out import KeepOut
from .rolling import ProgramFault, RollingCheck
from .via import suggest_via

__all__ = [
    "Finding",
    "FindingKind",
    "KeepOut",
    "PreflightReport",
    "ProgramCheck",
    "ProgramFault",
    "RollingCheck",
    "Severity",
    "Via",
    "check_program",
    "suggest_via",
]

"""`import-ini`: a LinuxCNC INI file becomes our configuration, with an account of every value."""

from rm501_host.ini_import.convert import Conversion, Finding, Outcome, convert_ini
from rm501_host.ini_import.reader import IniError, IniFile, IniValue, parse_ini

__all__ = ["Conversion", "Finding", "IniError", "IniFile", "IniValue", "Outcome", "convert_ini", "parse_ini"]

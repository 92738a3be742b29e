"""The black box: what happened in the minute before a fault."""

from rm501_host.blackbox.recorder import BlackBox, Entry, read_dump

__all__ = ["BlackBox", "Entry", "read_dump"]

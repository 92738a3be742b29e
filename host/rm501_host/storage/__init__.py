"""What outlives the process: whole files written atomically, a log that survives a full disk, the position file."""

from rm501_host.storage.atomic import StorageError, write_atomic
from rm501_host.storage.jsonlog import JsonLog, LogRecord
from rm501_host.storage.position_file import PositionFile, PositionRecord

__all__ = ["JsonLog", "LogRecord", "PositionFile", "PositionRecord", "StorageError", "write_atomic"]

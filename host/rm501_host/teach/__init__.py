"""Teach points: named joint positions in a plain file that a person can read and edit."""

from rm501_host.teach.points import MAX_POINTS, TeachError, TeachFile, TeachPoint, require_within_ranges

__all__ = ["MAX_POINTS", "TeachError", "TeachFile", "TeachPoint", "require_within_ranges"]

"""Replace a file as a whole: a reader sees the old text or the new one, also after a crash or on a full disk.

StorageError(Rm501Error)     the file could not be written or read; the old one is untouched
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from rm501_host.errors import Rm501Error


class StorageError(Rm501Error):
    """A file could not be written or read; `path` says which."""

    def __init__(self, path: Path, what: str, remedy: str) -> None:
        super().__init__(f"{path}: {what}; {remedy}")
        self.path = path


def write_atomic(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """Write `data` to `path`: temporary file beside it, fsync, rename, fsync of the folder.

    A symbolic link stays one: the file that it points to is replaced. What is there and is no regular file (a pipe,
    `/dev/stdout`) is written to as it is.

    Raises StorageError when any step fails; `path` then holds what it held before, and no temporary file is left.
    """
    if path.exists() and not path.is_file():
        _write_in_place(path, data)
        return
    path = path.resolve() if path.is_symlink() else path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    except OSError as error:
        raise _failed(path, error) from error
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(mode)
        temporary.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise _failed(path, error) from error


def _write_in_place(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise _failed(path, error) from error


def _sync_folder(folder: Path) -> None:
    """Make the rename itself last; systems without folder descriptors (Windows) do without."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _failed(path: Path, error: OSError) -> StorageError:
    reason = error.strerror or str(error)
    return StorageError(path, f"cannot be written: {reason}", "free some space or correct the folder's permissions")

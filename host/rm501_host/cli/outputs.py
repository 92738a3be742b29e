"""Files that a command will write: looked at before anything moves, so that a mistyped name costs no run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from rm501_host.errors import RefusedError


def require_writable(option: str, path: Path | None) -> None:
    """Make the folder of `path` and try it; None asks for nothing.

    Raises RefusedError naming `option` when `path` is a folder, or when no file can be made there.
    """
    if path is None:
        return
    if path.is_dir():
        raise RefusedError(f"{option} {path}: is a folder; give the name of a file in it")
    try:
        if path.exists():
            if not os.access(path, os.W_OK):
                raise PermissionError(13, "Permission denied")
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise RefusedError(
            f"{option} {path}: cannot be written: {error.strerror or error}; choose a file in a folder of yours"
        ) from error


def require_suffix(option: str, path: Path | None, suffixes: Iterable[str]) -> None:
    """Raise RefusedError naming `option` unless `path` is None or ends in one of `suffixes` (lower case, with dot)."""
    known = tuple(suffixes)
    if path is not None and path.suffix.lower() not in known:
        raise RefusedError(f"{option} {path}: give a name that ends in {' or '.join(known)}")

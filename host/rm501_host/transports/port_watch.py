"""Stable names of serial ports, and waiting for one to come back, without polling where the kernel can tell."""

from __future__ import annotations

import asyncio
import ctypes
import os
import sys
from pathlib import Path

__all__ = ["BY_ID", "stable_path", "wait_for_path"]

BY_ID = Path("/dev/serial/by-id")
_IN_CREATE, _IN_MOVED_TO, _IN_ATTRIB = 0x100, 0x80, 0x4
_NONBLOCK_CLOEXEC = os.O_NONBLOCK | getattr(os, "O_CLOEXEC", 0) if hasattr(os, "O_NONBLOCK") else 0
_FALLBACK_S = 0.5


def stable_path(path: str, by_id: Path = BY_ID) -> str:
    """The name under `/dev/serial/by-id` of the device at `path`, which it keeps when replugged; `path` itself when
    it has none.
    """
    try:
        target = Path(path).resolve(strict=True)
        for link in sorted(by_id.iterdir()):
            if link.resolve() == target:
                return str(link)
    except OSError:
        pass
    return path


async def wait_for_path(path: str) -> None:
    """Return when `path` exists and may be read and written; bound it with `asyncio.timeout`."""
    while not os.access(path, os.R_OK | os.W_OK):
        await _something_changed(Path(path))


async def _something_changed(path: Path) -> None:
    """Return when a directory on the way to `path` changed."""
    folder = path.parent
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    watch = _watch(folder)
    if watch is None:
        await asyncio.sleep(_FALLBACK_S)
        return
    loop = asyncio.get_running_loop()
    changed = asyncio.Event()
    try:
        if os.access(path, os.R_OK | os.W_OK) or (path.parent.is_dir() and folder != path.parent):
            return  # it came between the look and the watch
        loop.add_reader(watch, changed.set)
        await changed.wait()
    finally:
        loop.remove_reader(watch)
        os.close(watch)


def _watch(folder: Path) -> int | None:
    """An inotify descriptor that becomes readable when an entry of `folder` appears, None where there is no inotify."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor: int = libc.inotify_init1(_NONBLOCK_CLOEXEC)
    if descriptor < 0:
        return None
    wanted = _IN_CREATE | _IN_MOVED_TO | _IN_ATTRIB
    if libc.inotify_add_watch(descriptor, os.fsencode(folder), wanted) < 0:
        os.close(descriptor)
        return None
    return descriptor

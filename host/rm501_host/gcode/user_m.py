"""M100 to M199 as executables of a folder, as LinuxCNC has them: `M105` is called with P and Q as its two arguments.

Never through a shell, always with a timeout. The interpreter only names the call; whoever carries out the program runs
it at its place in the motion.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

from rm501_host.gcode.canon import UserMKind
from rm501_host.gcode.context import BUILT_IN_USER_M
from rm501_host.gcode.errors import GcodeError
from rm501_host.gcode.registry import USER_M

DEFAULT_TIMEOUT_S = 10.0
MAX_OUTPUT_BYTES = 4096


class UserMCodeError(GcodeError):
    """An executable of an M code could not be run, failed, or took too long."""


def find_user_m(folder: Path | None) -> dict[int, UserMKind]:
    """The table of handlers: the built-in ones and every executable file M100 to M199 of the folder."""
    table: dict[int, UserMKind] = {}
    if folder is not None:
        for number in USER_M:
            path = folder / f"M{number}"
            if path.is_file() and os.access(path, os.X_OK):
                table[number] = UserMKind.EXTERNAL
    return {**table, **BUILT_IN_USER_M}


def run_user_m(
    folder: Path,
    number: int,
    p: float | None,
    q: float | None,
    *,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    environment: Mapping[str, str] | None = None,
) -> None:
    """Run `folder/M<number> P Q` and wait for it; missing words are passed as -1, as the peer does.

    Blocking: call it from a worker thread. Raises UserMCodeError when it is missing, fails or takes too long.
    """
    path = (folder / f"M{number}").resolve()
    arguments = [f"{-1.0 if word is None else word:f}" for word in (p, q)]
    try:
        done = subprocess.run(
            [str(path), *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=timeout_s,
            check=False,
            env=None if environment is None else dict(environment),
        )
    except subprocess.TimeoutExpired:
        raise UserMCodeError(
            f"M{number} took longer than {timeout_s:g} s and was ended", f"Make {path} return sooner."
        ) from None
    except OSError as error:
        raise UserMCodeError(
            f"M{number} cannot be run: {error.strerror or error}", f"Check {path} and its permissions."
        ) from error
    if done.returncode != 0:
        tail = done.stderr[-MAX_OUTPUT_BYTES:].decode("utf-8", "replace").strip()
        raise UserMCodeError(
            f"M{number} failed with exit status {done.returncode}" + (f": {tail}" if tail else ""), f"See {path}."
        )

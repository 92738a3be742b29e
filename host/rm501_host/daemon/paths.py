"""Where daemon and clients meet, and where the daemon keeps its files, from the environment that is passed in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def socket_path(environment: Mapping[str, str], user_id: int) -> Path:
    """RM501_SOCKET, or rm501.sock in the user's run-time folder, or /tmp/rm501-UID.sock."""
    if named := environment.get("RM501_SOCKET"):
        return Path(named)
    if folder := environment.get("XDG_RUNTIME_DIR"):
        return Path(folder) / "rm501.sock"
    return Path(f"/tmp/rm501-{user_id}.sock")


def state_folder(environment: Mapping[str, str], home: Path) -> Path:
    """RM501_STATE, systemd's STATE_DIRECTORY, or rm501 in the user's state folder."""
    if named := environment.get("RM501_STATE") or environment.get("STATE_DIRECTORY"):
        return Path(named.split(":")[0])
    return Path(environment.get("XDG_STATE_HOME", home / ".local" / "state")) / "rm501"
